"""Where light is known: points on surfaces, the atlas' texels, and patches that pass light on."""

from .patches import Patches, make_patches
from .samples import SurfaceSamples, no_samples, sample_triangles, surface_colour
from .texels import Texels, make_texels
from .vertices import Vertices, make_vertices

__all__ = [
    "Patches",
    "SurfaceSamples",
    "Texels",
    "Vertices",
    "make_patches",
    "make_texels",
    "make_vertices",
    "no_samples",
    "sample_triangles",
    "surface_colour",
]
