"""Where light is known: points on surfaces, the atlas' texels, and patches that pass light on."""

from .patches import Patches, make_patches
from .samples import SurfaceSamples, sample_triangles, surface_colour
from .texels import Texels, make_texels

__all__ = ["Patches", "SurfaceSamples", "Texels", "make_patches", "make_texels", "sample_triangles", "surface_colour"]
