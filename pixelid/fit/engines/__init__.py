"""Engines: three ways to evaluate and maximise the same log posterior, which must agree, in two forms.

              discrete form                                        continuous form
    casadi    IPOPT; exact derivatives of one symbolic expression   Radau collocation, differentiated exactly
    torch     L-BFGS or Adam; the same expression on tensors        torchdiffeq, autograd
    scipy     damped Newton or L-BFGS-B on the compiled scan        solve_ivp, central differences

An engine's libraries are imported when it is made.
"""

from __future__ import annotations

from pixelid.errors import InputError
from pixelid.fit.engines.engine import Engine

ENGINES = ("casadi", "torch", "scipy")
FORMS = ("discrete", "continuous")

__all__ = ["ENGINES", "FORMS", "Engine", "engine"]


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
