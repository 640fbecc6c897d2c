"""Points on a scene's surface and what the scene says about them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..memory import slices
from ..rays import sample_map
from ..scene import Scene

PASSING = 300
"""Bytes of a sample while it is made."""


@dataclass(frozen=True)
class SurfaceSamples:
    """Points on triangles.

    position: (n, 3) float32, m. normal: (n, 3) float32 unit shading normal. flat: (n, 3) float32
    unit geometric normal, on the shading normal's side. triangle: (n,) int32 of the scene.
    weights: (n, 3) float32 barycentric weights of its corners.
    """

    position: np.ndarray
    normal: np.ndarray
    flat: np.ndarray
    triangle: np.ndarray
    weights: np.ndarray

    def __len__(self) -> int:
        return len(self.triangle)

    def take(self, rows: np.ndarray) -> SurfaceSamples:
        """The samples at `rows` (an index array, a mask or a slice)."""
        return SurfaceSamples(
            self.position[rows], self.normal[rows], self.flat[rows], self.triangle[rows], self.weights[rows]
        )

    def join(self, *more: SurfaceSamples) -> SurfaceSamples:
        """These samples, then `more`."""
        names = self.__dataclass_fields__
        return SurfaceSamples(*(np.concatenate([getattr(s, n) for s in (self, *more)]) for n in names))

    def flipped(self, back: np.ndarray) -> SurfaceSamples:
        """The same places, seen from the other side where `back` (n,) bool is set."""
        sign = np.where(back, -1, 1).astype(np.float32)[:, None]
        return SurfaceSamples(self.position, self.normal * sign, self.flat * sign, self.triangle, self.weights)

    def on_side(self, scene: Scene, back: np.ndarray) -> SurfaceSamples:
        """The same places, seen from the side that their triangles' winding names, its reverse where `back` is set.

        Smooth shading can turn the flat normal over; the winding stays.
        """
        return self.flipped(back ^ self.behind(scene))

    def behind(self, scene: Scene) -> np.ndarray:
        """(n,) bool: which lie on the reverse of what their triangles' winding names."""
        return np.einsum("nd,nd->n", scene.triangle_cross(self.triangle), self.flat) < 0


def no_samples() -> SurfaceSamples:
    """None at all."""
    empty = np.zeros((0, 3), np.float32)
    return SurfaceSamples(empty, empty, empty, np.zeros(0, np.int32), empty)


def sample_triangles(scene: Scene, triangle: np.ndarray, weights: np.ndarray) -> SurfaceSamples:
    """Samples at barycentric `weights` (n, 3) of triangles (n,)."""
    triangle, weights = triangle.astype(np.int32, copy=False), weights.astype(np.float32, copy=False)
    position, normal, flat = (np.empty((len(triangle), 3), np.float32) for _ in range(3))
    for s in slices(len(triangle), PASSING):
        position[s], normal[s], flat[s] = _places(scene, triangle[s], weights[s])
    return SurfaceSamples(position, normal, flat, triangle, weights)


def _places(scene, triangle, weights):
    """Positions, shading and geometric normals, (n, 3) float32 each."""
    corners = scene.positions[scene.triangles[triangle]]
    position = np.einsum("nk,nkd->nd", weights, corners)
    flat = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    normal = np.einsum("nk,nkd->nd", weights, scene.corner_normals[triangle])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    # opposite corner normals can cancel; the face's own normal is the best guess there
    normal = np.where(length > 1e-6, normal / np.maximum(length, 1e-6), flat)
    facing = np.einsum("nd,nd->n", flat, normal)
    return position, normal, np.where(facing[:, None] < 0, -flat, flat)


def inside_triangle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n, 3) float32 barycentric weights, uniform by area where the (n,) numbers are uniform in [0, 1)."""
    root = np.sqrt(first)
    inside = np.stack([1 - root, root * (1 - second), root * second], 1).astype(np.float32)
    # off the very edge, where a wall may stand
    return np.float32(0.999) * inside + np.float32(0.001 / 3)


def unit(vectors: np.ndarray) -> np.ndarray:
    """(n, 3) float32 scaled to length 1; float64 inside, since millimetre scenes square to denormals."""
    wide = vectors.astype(np.float64)
    return (wide / np.maximum(np.linalg.norm(wide, axis=1, keepdims=True), 1e-300)).astype(np.float32)


def surface_colour(scene: Scene, what: str, triangle: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(n, 3) float32 `what` ("albedo", "emission" or "transmission") at places on triangles."""
    constant = np.array([getattr(m, what) for m in scene.materials], np.float32)
    material = scene.triangle_material[triangle]
    colour = constant[material]
    image = getattr(scene, f"{what}_map")
    if image is not None:
        mapped = np.array([m.mapped for m in scene.materials], bool)[material]
        rows = np.flatnonzero(mapped & np.isfinite(scene.atlas_uv[triangle]).all((1, 2)))
        if len(rows):
            uv = np.einsum("nk,nkd->nd", weights[rows], scene.atlas_uv[triangle[rows]])
            colour[rows] = sample_map(image, uv)
    return colour
