"""The scripts of pages: each is in the page, and the page's policy names its hash and lets no other run."""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup


@dataclass(frozen=True)
class Script:
    """text: as it stands in the page;  hash: as its content security policy names it."""

    text: Markup
    hash: str


def script(name: str) -> Script:
    """A script of `templates/`, by its name without the suffix."""
    text = (Path(__file__).parent / "templates" / f"{name}.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
    return Script(Markup(text), f"sha256-{digest}")
