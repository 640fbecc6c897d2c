"""How light passes between surfaces: gather once with cosine rays, solve all bounces by linear algebra."""

from .elements import Elements, ElementTransport, Links, find_elements, link_elements
from .entries import Entries, find_entries
from .gather import Begun, Gatherer
from .onward import find_bending
from .transport import Transport, make_gatherer, make_piece_gatherer, make_transport

__all__ = [
    "Begun",
    "ElementTransport",
    "Elements",
    "Entries",
    "Gatherer",
    "Links",
    "Transport",
    "find_bending",
    "find_elements",
    "find_entries",
    "link_elements",
    "make_gatherer",
    "make_piece_gatherer",
    "make_transport",
]
