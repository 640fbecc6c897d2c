"""What can be shown before any bake: shading kept in world space, in a hash table, while frames come in (Delaere 2021)."""

from .cache import Cache
from .implicit_points import ImplicitPoints
from .one_point import OnePointCache
from .places import Places

__all__ = ["Cache", "ImplicitPoints", "OnePointCache", "Places"]
