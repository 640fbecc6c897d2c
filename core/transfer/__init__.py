"""How light passes between surfaces: gather once with cosine rays, solve all bounces by linear algebra."""

from .entries import Entries, find_entries
from .gather import Begun, Gatherer
from .transport import Transport, make_gatherer, make_piece_gatherer, make_transport

__all__ = [
    "Begun",
    "Entries",
    "Gatherer",
    "Transport",
    "find_entries",
    "make_gatherer",
    "make_piece_gatherer",
    "make_transport",
]
