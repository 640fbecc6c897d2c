"""What images hold, as arrays."""

from __future__ import annotations

import bpy
import numpy as np


def read_pixels(image: bpy.types.Image) -> np.ndarray:
    """(H, W, C) float32, the first row at the bottom; C is 4 for all images that we make. Raises ValueError for an image
    that holds nothing."""
    # asked for its length, an image reads its file, packed or not
    values = np.empty(len(image.pixels), np.float32)
    width, height = image.size
    image.pixels.foreach_get(values)
    return values.reshape(height, width, -1)
