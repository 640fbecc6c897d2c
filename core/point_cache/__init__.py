"""Where light is stored: a Poisson set of points, denser where the scene needs it (Bikker & Reijerse 2010)."""

from .build import Ground, lamp_radius, make_points, make_points_by_darts, survey
from .gaps import serve
from .gradients import gather_gradients
from .interpolation import Interpolator, Weights
from .points import PointSet

__all__ = [
    "Ground",
    "Interpolator",
    "PointSet",
    "Weights",
    "gather_gradients",
    "lamp_radius",
    "make_points",
    "make_points_by_darts",
    "serve",
    "survey",
]
