"""Posteriors: exact ensemble sampling around a fit, with convergence that is measured, not assumed."""

from pixelid.sample.posterior import Posterior
from pixelid.sample.sample import sample

__all__ = ["Posterior", "sample"]
