"""ArviZ, imported when it is needed and without its notice of the coming rewrite."""

from __future__ import annotations

import warnings


def arviz():
    """The module."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        import arviz
    return arviz
