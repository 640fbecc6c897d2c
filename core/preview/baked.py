"""What a bake knows of the light at surfaces: its images over the atlas, where these are fine enough and on the baked side."""

from __future__ import annotations

import numpy as np

from .light import Baked
from .rasters import CornerUV, Raster
from .surfaces import Surfaces

NARROW = 2.0
"""Texels: islands of the atlas that are not as wide mix with nothing or with their margin, as on the edge of a thin wall."""


class BakedLight:
    """A bake's light at places on surfaces."""

    def __init__(self, surfaces: Surfaces, baked: Baked):
        scene = surfaces.scene
        receives = np.array([o.receives and not o.at_vertices for o in scene.objects], bool)
        self._surfaces = surfaces
        self._knows = receives[scene.triangle_object] & np.isfinite(scene.atlas_uv).all((1, 2))
        self._knows &= surfaces.strip_width * max(baked.irradiance.shape[:2]) >= NARROW
        self._uv = CornerUV(scene.atlas_uv)
        others = [image for image in (baked.first, baked.caustics) if image is not None]
        first = np.zeros_like(baked.irradiance)
        for image in others:
            first += _as_large(image, first.shape)
        # side by side, so that one look-up fetches both
        pairs = [image[..., k] for k in range(3) for image in (first, baked.irradiance)]
        self._image = Raster(np.stack(pairs, axis=-1))

    def holds(self, triangle: np.ndarray, facing: np.ndarray) -> np.ndarray:
        """(n,) bool: whether the light of triangles (n,) is known on the sides that these normals, (n, 3), point to.

        Only the side is baked to which a face's own normal points: the other one of a leaf is lit otherwise.
        """
        return self._knows[triangle] & self._surfaces.is_front(triangle, facing)

    def read(self, triangle, u, v) -> tuple[np.ndarray, np.ndarray]:
        """First light and caustics together, and indirect light, (3, n) float32 W/m² each."""
        found = self._image.at(*self._uv.at(triangle, u, v))
        return found[0::2], found[1::2]


def _as_large(image, shape):
    """An image with as many texels as another of this shape."""
    if image.shape == shape:
        return image
    v, u = ((np.arange(count, dtype=np.float32) + np.float32(0.5)) / count for count in shape[:2])
    return Raster(image).at(np.tile(u, len(v)), np.repeat(v, len(u))).T.reshape(shape)
