"""The preview: what a camera sees, path traced a sample a pixel and frame, better with every frame."""

from .accumulation import PixelCache
from .camera import Camera
from .gbuffer import background
from .light import Baked, Lamps
from .looks import Texture
from .preview import PASSES, Preview, Settings
from .surfaces import Surfaces

__all__ = [
    "PASSES",
    "Baked",
    "Camera",
    "Lamps",
    "PixelCache",
    "Preview",
    "Settings",
    "Surfaces",
    "Texture",
    "background",
]
