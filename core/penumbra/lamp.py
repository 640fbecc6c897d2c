"""The samples of a lamp: the places on it, the same for all receivers, that each receiver sees or does not see.

Penumbra casting decides for every receiver and sample whether something stands between them, so samples can't be drawn
anew for each receiver. Several sets of samples, which neighbours take in turns, keep the steps between samples from
showing as bands (Laine & Aila 2005, Hierarchical Penumbra Casting, extensions).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..lights import SUN_REACH
from ..sampling import concentric_disk, frame, hammersley_points, uniform_sphere
from ..scene import Light, SceneError


@dataclass(frozen=True)
class LampSamples:
    """Samples of one lamp.

    name: of the lamp, for messages.
    axes: (3, 3) float64, rows of a rotation: two unit vectors in the lamp's plane, and the one from the lamp into the scene.
    centre: (3,) float64, the lamp's middle, m; of a distant lamp the vector towards its middle, of length 1.
    half: (3,) float64 half extents along `axes`, m; the third is 0 unless the lamp has a depth. Of a distant lamp the
        tangents of half its angles.
    places: (sets, L, 3) float32 in [−1, 1], samples in units of `half`.
    distant: at infinity (a sun); rays towards it have length `reach`, m.
    one_sided: shines into the scene along axes[2] only.
    """

    name: str
    axes: np.ndarray
    centre: np.ndarray
    half: np.ndarray
    places: np.ndarray
    distant: bool = False
    one_sided: bool = True
    reach: float = 0.0

    @property
    def sets(self) -> int:
        return self.places.shape[0]

    @property
    def count(self) -> int:
        """L, samples of a set."""
        return self.places.shape[1]

    @property
    def planar(self) -> bool:
        """Whether all samples lie in one plane, so that an edge seen from a receiver is a line across them."""
        return bool(self.half[2] == 0)

    def targets(self) -> np.ndarray:
        """(sets, L, 3) float32 places of the samples, m; of a distant lamp the vectors towards them."""
        return (self.centre + (self.places * self.half) @ self.axes).astype(np.float32)

    def vectors(self, positions: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """(n, 3) float32 segments from positions (n, 3) to targets (n, 3), row by row: those that a shadow ray follows.

        Whoever casts rays for these samples must take them from here: then all agree to the last bit.
        """
        if self.distant:
            return targets * np.float32(self.reach)
        return targets - positions

    def corners(self) -> np.ndarray:
        """(4 or 8, 3) float64 corners of the box around all samples, m; of a distant lamp vectors towards them."""
        signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1) if not self.planar else (0,))).reshape(3, -1).T
        return self.centre + (signs * self.half) @ self.axes


def sample_lamp(light: Light, count: int, sets: int = 1, seed: int = 0, extent: float = 0.0) -> LampSamples:
    """Samples of a lamp of Blender's: a golden-ratio lattice over its face, another one for each set.

    count: samples of a set. extent: of the receivers, m; rays to a sun reach ten times as far. POINT and SPOT lamps with
    a radius have a depth: their samples are spread over the ball's surface. Raises SceneError where the lamp has no size to sample, or count or sets is below 1.
    """
    if count < 1 or sets < 1:
        raise SceneError(f"Lamp '{light.name}' needs at least one sample and one set, not {count} and {sets}.")
    lattices = _lattices(count, sets, seed)
    if light.kind == "AREA":
        return _panel(light, lattices)
    if light.kind == "SUN":
        return _sun(light, lattices, SUN_REACH + 10 * extent)
    return _ball(light, lattices)


def sample_quad(corners: np.ndarray, count: int, sets: int = 1, seed: int = 0, name: str = "Quad") -> LampSamples:
    """Samples of an emissive parallelogram, (4, 3) corners in m, wound so that it shines to where they run anticlockwise.

    Raises SceneError where the corners are no parallelogram.
    """
    a, b, c, d = np.asarray(corners, np.float64)
    u, v = (b - a) / 2, (d - a) / 2
    normal = np.cross(u, v)
    size = np.linalg.norm(u) + np.linalg.norm(v)
    if np.linalg.norm(normal) < 1e-9 * size**2 or np.linalg.norm(a + c - b - d) > 1e-4 * size:
        raise SceneError(f"'{name}' is no parallelogram; split it into some.")
    lattices = _lattices(count, sets, seed) * 2 - 1
    normal /= np.linalg.norm(normal)
    x = u / np.linalg.norm(u)
    y = np.cross(normal, x)
    # a sheared face is a sheared pattern within its bounding rectangle
    shear, height = v @ x, v @ y
    half = np.array([np.linalg.norm(u) + abs(shear), height, 0])
    across = lattices[..., 0] * np.linalg.norm(u) + lattices[..., 1] * shear
    places = np.stack([across / half[0], lattices[..., 1], 0 * across], axis=-1).astype(np.float32)
    return LampSamples(name, np.stack([x, y, normal]), (a + c) / 2, half, places)


def sample_ball(centre, radius: float, count: int, sets: int = 1, seed: int = 0, name: str = "Ball") -> LampSamples:
    """Samples spread evenly through a ball: a lamp with a volume (the paper's extension).

    centre: (3,) m. radius: m, above 0.
    """
    if radius <= 0:
        raise SceneError(f"'{name}' needs a radius above 0.")
    lattices = _lattices(count, sets, seed)
    # the third coordinate: an additive recurrence along the lattice's first
    deep = np.modf(np.arange(1, count + 1) * np.sqrt(2))[0]
    directions = _sphere(lattices)
    places = directions * np.cbrt(deep)[None, :, None]
    half = np.full(3, float(radius))
    return LampSamples(
        name, np.eye(3), np.asarray(centre, np.float64), half, places.astype(np.float32), one_sided=False
    )


def _lattices(count: int, sets: int, seed: int) -> np.ndarray:
    """(sets, count, 2) float32 in [0, 1)."""
    return np.stack([hammersley_points(count, seed * 1009 + k) for k in range(sets)])


def _panel(light: Light, lattices) -> LampSamples:
    half = np.array([*light.size, 0], np.float64) / 2
    if min(half[:2]) <= 0:
        raise SceneError(f"Area lamp '{light.name}' has no size; give it one.")
    if light.spread <= 0:
        raise SceneError(f"Area lamp '{light.name}' shines parallel light (Spread 0): its shadows are sharp.")
    flat = _disk(lattices) if light.shape in ("DISK", "ELLIPSE") else lattices * 2 - 1
    places = np.concatenate([flat, np.zeros_like(flat[..., :1])], axis=-1)
    return LampSamples(light.name, _axes(light), light.position.copy(), half, places.astype(np.float32))


def _sun(light: Light, lattices, reach: float) -> LampSamples:
    if not 0 < light.angle < np.pi:
        raise SceneError(
            f"Sun '{light.name}' has an angle of {np.degrees(light.angle):.3g}°; it must be above 0 and below 180."
        )
    # samples even in solid angle, projected onto the plane at distance 1 in front of the sun's middle
    flat = _disk(lattices)
    radius = np.linalg.norm(flat, axis=-1, keepdims=True)
    depth = radius[..., 0] ** 2 * (1 - np.cos(light.angle / 2))
    unit = flat / np.maximum(radius, 1e-12)
    tangent = np.sqrt(depth * (2 - depth)) / (1 - depth)
    half = np.tan(light.angle / 2)
    places = np.concatenate([unit * (tangent / half)[..., None], np.zeros_like(flat[..., :1])], axis=-1)
    towards = -light.direction
    side = frame(towards[None])[0][0].astype(np.float64)
    side -= towards * (side @ towards)
    side /= np.linalg.norm(side)
    axes = np.stack([side, np.cross(-towards, side), -towards])
    return LampSamples(
        light.name, axes, towards, np.array([half, half, 0]), places.astype(np.float32), distant=True, reach=reach
    )


def _ball(light: Light, lattices) -> LampSamples:
    if light.radius <= 0:
        raise SceneError(f"Lamp '{light.name}' has no radius: its shadows are sharp.")
    axes = _axes(light)
    half = np.full(3, float(light.radius))
    return LampSamples(light.name, axes, light.position.copy(), half, _sphere(lattices), one_sided=False)


def _axes(light: Light) -> np.ndarray:
    # right-handed, with the lamp's own −Z as its third axis
    x = -light.matrix[:3, 0] / np.linalg.norm(light.matrix[:3, 0])
    y = np.cross(light.direction, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)])


def _disk(lattices):
    return np.stack([concentric_disk(lattice) for lattice in lattices]).astype(np.float64)


def _sphere(lattices):
    return np.stack([uniform_sphere(lattice) for lattice in lattices])
