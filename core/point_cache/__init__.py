"""Where light is stored: a Poisson set of points, denser where the scene needs it (Bikker & Reijerse 2010)."""

from .build import Ground, make_points, survey
from .interpolation import Interpolator, Weights
from .points import PointSet

__all__ = ["Ground", "Interpolator", "PointSet", "Weights", "make_points", "survey"]
