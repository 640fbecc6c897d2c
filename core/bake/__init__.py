"""What a bake is, how it is made, saved and loaded."""

from ..planner import Settings
from .record import Bake, BakeError
from .run import Progress, bake

__all__ = ["Bake", "BakeError", "Progress", "Settings", "bake"]
