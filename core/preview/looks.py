"""What surfaces look like where a ray lands: albedo and emission, constant, from a texture or from the atlas' maps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..scene import Scene


@dataclass(frozen=True)
class Texture:
    """An image that a material's albedo comes from: albedo = offset + scale · texel.

    image: (H, W, 3) float32, linear, row 0 at v = 0. scale, offset: (3,). extension: beyond [0, 1] the image is
    repeated ("REPEAT"), its border goes on ("EXTEND"), or there is `offset` alone ("CLIP"). smooth: bilinear.
    transform: (2, 3), from the scene's `texture_uv` to the image's.
    """

    image: np.ndarray
    scale: np.ndarray
    offset: np.ndarray
    extension: str = "REPEAT"
    smooth: bool = True
    transform: np.ndarray | None = None

    def at(self, uv: np.ndarray) -> np.ndarray:
        """(n, 3) float32 albedo at (n, 2) coordinates of the scene's `texture_uv`."""
        if self.transform is not None:
            uv = uv @ self.transform[:, :2].T.astype(np.float32) + self.transform[:, 2].astype(np.float32)
        texel = sample(self.image, uv, self.extension, self.smooth)
        return np.clip(self.offset + self.scale * texel, 0, 1).astype(np.float32)


def sample(image: np.ndarray, uv: np.ndarray, extension: str = "EXTEND", smooth: bool = True) -> np.ndarray:
    """(n, C) float32 of an (H, W, C) image, row 0 at v = 0, at (n, 2) coordinates; extension, smooth as in Texture."""
    height, width = image.shape[:2]
    flat = image.reshape(height * width, -1)
    uv = np.nan_to_num(uv, nan=0.0, posinf=0.0, neginf=0.0)
    outside = None
    if extension == "REPEAT":
        uv = uv - np.floor(uv)
    elif extension == "CLIP":
        outside = ((uv < 0) | (uv > 1)).any(axis=1)
    x, y = uv[:, 0] * np.float32(width), uv[:, 1] * np.float32(height)

    def index(row, column):
        if extension == "REPEAT":
            return (row % height) * width + column % width
        return np.clip(row, 0, height - 1) * width + np.clip(column, 0, width - 1)

    if not smooth:
        found = flat.take(index(np.floor(y).astype(np.int32), np.floor(x).astype(np.int32)), axis=0)
    else:
        x, y = x - np.float32(0.5), y - np.float32(0.5)
        left, low = np.floor(x), np.floor(y)
        a, b = (x - left)[:, None], (y - low)[:, None]
        left, low = left.astype(np.int32), low.astype(np.int32)
        below, above = (
            flat.take(index(row, left), axis=0) * (1 - a) + flat.take(index(row, left + 1), axis=0) * a
            for row in (low, low + 1)
        )
        found = below * (1 - b) + above * b
    if outside is not None:
        found[outside] = 0
    return found


def corner_values(values: np.ndarray, triangle: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(n, C) of per-corner values (T, 3, C) at barycentric places of triangles (n,)."""
    corners = values[triangle]
    u, v = u[:, None], v[:, None]
    return corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v


class Looks:
    """Colours of a scene's surfaces. textures: of materials, by their number."""

    def __init__(self, scene: Scene, textures: Mapping[int, Texture] | None = None):
        self.scene = scene
        self._textures = dict(textures or {}) if scene.texture_uv is not None else {}
        placed = np.isfinite(scene.atlas_uv).all((1, 2))
        mapped = np.array([m.mapped for m in scene.materials], bool)[scene.triangle_material] & placed
        self._own, self._varies = {}, {}
        for what in ("albedo", "emission"):
            constant = np.array([getattr(m, what) for m in scene.materials], np.float32)
            self._own[what] = constant[scene.triangle_material]
            varies = mapped.copy() if getattr(scene, f"{what}_map") is not None else np.zeros(len(mapped), bool)
            if what == "albedo" and self._textures:
                self._textured = np.isin(scene.triangle_material, list(self._textures))
                self._textured &= np.isfinite(scene.texture_uv).all((1, 2))
                varies |= self._textured
            self._varies[what] = varies if varies.any() else None
        self.emits = bool(self._own["emission"].any() or self._varies["emission"] is not None)

    def albedo(self, triangle: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(n, 3) float32 diffuse reflectance at barycentric places of triangles (n,)."""
        colour = self._colour("albedo", triangle, u, v)
        if self._textures:
            textured = np.flatnonzero(self._textured[triangle])
            material = self.scene.triangle_material[triangle[textured]]
            for number, texture in self._textures.items():
                rows = textured[material == number]
                if len(rows):
                    uv = corner_values(self.scene.texture_uv, triangle[rows], u[rows], v[rows])
                    colour[rows] = texture.at(uv)
        return colour

    def emission(self, triangle: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(n, 3) float32 emitted radiance, W/(m² sr)."""
        return self._colour("emission", triangle, u, v)

    def _colour(self, what, triangle, u, v):
        colour = self._own[what].take(triangle, axis=0)
        if self._varies[what] is None or getattr(self.scene, f"{what}_map") is None:
            return colour
        rows = np.flatnonzero(self._varies[what][triangle] & np.isfinite(self.scene.atlas_uv[triangle, 0, 0]))
        if len(rows):
            uv = corner_values(self.scene.atlas_uv, triangle[rows], u[rows], v[rows])
            colour[rows] = sample(getattr(self.scene, f"{what}_map"), uv)
        return colour
