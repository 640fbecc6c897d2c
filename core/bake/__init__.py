"""What a bake is, how it is made, saved and loaded."""

from ..planner import Settings
from .cache import Cache
from .clock import Progress
from .kept import Cancelled, Kept
from .record import Bake, BakeError
from .run import bake

__all__ = ["Bake", "BakeError", "Cache", "Cancelled", "Kept", "Progress", "Settings", "bake"]
