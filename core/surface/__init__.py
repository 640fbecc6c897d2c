"""Where light is known: points on surfaces, the atlas' texels, and patches that pass light on."""

from .elements import cut_patches
from .footprints import texel_places
from .patches import Patches, make_patches
from .samples import SurfaceSamples, inside_triangle, no_samples, sample_triangles, surface_colour, unit
from .texels import Texels, make_texels
from .vertices import Vertices, make_vertices

__all__ = [
    "Patches",
    "SurfaceSamples",
    "Texels",
    "Vertices",
    "cut_patches",
    "inside_triangle",
    "make_patches",
    "make_texels",
    "make_vertices",
    "no_samples",
    "sample_triangles",
    "surface_colour",
    "texel_places",
    "unit",
]
