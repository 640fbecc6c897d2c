"""How light passes between surfaces: gather once with cosine rays, solve all bounces by linear algebra."""

from .elements import Elements, ElementTransport, find_elements, make_element_transport
from .entries import Entries, find_entries
from .gather import Begun, Gatherer
from .transport import Transport, make_gatherer, make_piece_gatherer, make_transport

__all__ = [
    "Begun",
    "ElementTransport",
    "Elements",
    "Entries",
    "Gatherer",
    "Transport",
    "find_elements",
    "find_entries",
    "make_element_transport",
    "make_gatherer",
    "make_piece_gatherer",
    "make_transport",
]
