"""Engines: three ways to evaluate and climb the same objective, which must agree.

    casadi   IPOPT; the whole likelihood as one symbolic expression with exact first and second derivatives
    torch    the same expression on tensors, any device; L-BFGS or Adam
    scipy    the compiled scan; damped Newton (trust region) or L-BFGS-B

An engine's libraries are imported when it is made.
"""

from __future__ import annotations

from pixelid.errors import InputError
from pixelid.fit.engines.engine import Engine

ENGINES = ("casadi", "torch", "scipy")

__all__ = ["ENGINES", "Engine", "engine"]


def engine(name: str, **options) -> Engine:
    """The engine of a name, with its own options.  Raises InputError for an unknown name."""
    if name == "casadi":
        from pixelid.fit.engines.casadi_engine import CasadiEngine

        return CasadiEngine(**options)
    if name == "torch":
        from pixelid.fit.engines.torch_engine import TorchEngine

        return TorchEngine(**options)
    if name == "scipy":
        from pixelid.fit.engines.scipy_engine import ScipyEngine

        return ScipyEngine(**options)
    raise InputError(f"engine must be one of {', '.join(ENGINES)}, found {name!r}")
