"""What an inspection was made with, and of which bytes."""

from __future__ import annotations

import hashlib
from pathlib import Path


def provenance(path: Path) -> dict:
    """Versions of what did the work, and the SHA-256 of the input, under stable keys."""
    import platform

    import numpy
    import scipy

    from pixelid import __version__

    with Path(path).open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {
        "versions": {
            "pixelid": __version__,
            "numpy": numpy.__version__,
            "scipy": scipy.__version__,
            "python": platform.python_version(),
        },
        "inputs_sha256": {str(path): digest},
    }
