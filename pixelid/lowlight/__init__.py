"""Low light: when one pole describes the photoreceptor, when it does not, and what recordings say."""

from pixelid.lowlight.analysis import analyse

__all__ = ["analyse"]
