"""Where mirrors and glass focus the lamps' light: photons as beams, refined where light converges (adaptive caustics)."""

from .atlas import PHOTONS, CausticAtlas, Progress
from .casters import SHARP, Casters, casters
from .lamp import Energy
from .landings import Landings

__all__ = ["PHOTONS", "SHARP", "Casters", "CausticAtlas", "Energy", "Landings", "Progress", "casters"]
