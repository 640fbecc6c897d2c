"""What surfaces look like where a ray lands: albedo and emission, constant, from a texture or from the atlas' maps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..scene import Scene
from .rasters import CornerUV, Raster


@dataclass(frozen=True)
class Texture:
    """An image that a material's albedo comes from: albedo = offset + scale · texel.

    image: (H, W, 3) float32, row 0 at v = 0, linear, or, where `encoded`, in sRGB: that is how Cycles has images of bytes,
    and it mixes texels before it decodes them. scale, offset: (3,). extension: beyond [0, 1] the image is
    repeated ("REPEAT"), its border goes on ("EXTEND"), or there is `offset` alone ("CLIP"). smooth: bilinear.
    transform: (2, 3), from the scene's `texture_uv` to the image's.
    """

    image: np.ndarray
    scale: np.ndarray
    offset: np.ndarray
    extension: str = "REPEAT"
    smooth: bool = True
    transform: np.ndarray | None = None
    encoded: bool = False

    @property
    def mean(self) -> np.ndarray:
        """(3,) albedo over the image."""
        image = decoded(self.image) if self.encoded else self.image
        return np.clip(self.offset + self.scale * image.mean((0, 1)), 0, 1)

    def on(self, uv: CornerUV) -> _Placed:
        """The texture on the triangles of a scene whose `texture_uv` this is."""
        return _Placed(self, uv)


_CODES = 1 << 14
_code = np.arange(_CODES + 1) / _CODES
_LINEAR = np.where(_code <= 0.04045, _code / 12.92, ((_code + 0.055) / 1.055) ** 2.4).astype(np.float32)


def decoded(values: np.ndarray) -> np.ndarray:
    """float32 in [0, 1], linear, of sRGB in [0, 1], of any shape; to within 1e-4."""
    return _LINEAR.take((np.clip(values, 0, 1) * np.float32(_CODES) + np.float32(0.5)).astype(np.int32))


class _Placed:
    """A texture on a scene's triangles."""

    def __init__(self, texture: Texture, uv: CornerUV):
        self._texture, self._uv = texture, uv
        self._raster = Raster(texture.image, texture.extension, texture.smooth)

    def at(self, triangle: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(3, n) float32 albedo."""
        texture = self._texture
        x, y = self._uv.at(triangle, u, v)
        if texture.transform is not None:
            (a, b, c), (d, e, f) = texture.transform.astype(np.float32)
            x, y = a * x + b * y + c, d * x + e * y + f
        found = self._raster.at(x, y)
        if texture.encoded:
            found = decoded(found)
        for k in range(3):
            found[k] *= np.float32(texture.scale[k])
            found[k] += np.float32(texture.offset[k])
        return np.clip(found, 0, 1, out=found)


def corner_values(values: np.ndarray, triangle: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(n, C) of per-corner values (T, 3, C) at barycentric places of triangles (n,)."""
    corners = values[triangle]
    u, v = u[:, None], v[:, None]
    return corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v


class Looks:
    """Colours of a scene's surfaces. textures: of materials, by their number."""

    def __init__(self, scene: Scene, textures: Mapping[int, Texture] | None = None):
        self.scene = scene
        self._textures = {}
        if scene.texture_uv is not None and textures:
            uv = CornerUV(scene.texture_uv)
            self._textures = {number: texture.on(uv) for number, texture in textures.items()}
        placed = np.isfinite(scene.atlas_uv).all((1, 2))
        mapped = np.array([m.mapped for m in scene.materials], bool)[scene.triangle_material] & placed
        if self._textures:
            self._textured = np.isin(scene.triangle_material, list(self._textures))
            self._textured &= np.isfinite(scene.texture_uv).all((1, 2))
        self._atlas_uv = CornerUV(scene.atlas_uv)
        self._own, self._maps = {}, {}
        for what in ("albedo", "emission"):
            constant = np.array([getattr(m, what) for m in scene.materials], np.float32)
            self._own[what] = constant[scene.triangle_material]
            image = getattr(scene, f"{what}_map")
            shown = mapped & ~self._textured if what == "albedo" and self._textures else mapped
            if image is not None and shown.any():
                self._maps[what] = shown, Raster(image)
        self.emits = bool(self._own["emission"].any() or "emission" in self._maps)

    def albedo(self, triangle: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(n, 3) float32 diffuse reflectance at barycentric places of triangles (n,)."""
        colour = self._colour("albedo", triangle, u, v)
        if self._textures:
            textured = np.flatnonzero(self._textured[triangle])
            material = self.scene.triangle_material[triangle[textured]]
            for number, texture in self._textures.items():
                rows = textured[material == number]
                if len(rows):
                    _put(colour, rows, texture.at(triangle[rows], u[rows], v[rows]))
        return colour

    def emission(self, triangle: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(n, 3) float32 emitted radiance, W/(m² sr)."""
        return self._colour("emission", triangle, u, v)

    def _colour(self, what, triangle, u, v):
        colour = self._own[what].take(triangle, axis=0, mode="clip")
        if what not in self._maps:
            return colour
        shown, image = self._maps[what]
        rows = np.flatnonzero(shown[triangle])
        if len(rows):
            _put(colour, rows, image.at(*self._atlas_uv.at(triangle[rows], u[rows], v[rows])))
        return colour


def _put(colour, rows, found):
    """Rows of (n, 3) become what (3, k) says."""
    if len(rows) == len(colour):
        colour[:] = found[:3].T
        return
    for k in range(3):
        colour[rows, k] = found[k]
