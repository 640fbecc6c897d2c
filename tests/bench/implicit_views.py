"""What a camera sees of a stage, and how open each of its pixels is: frames of one ray a pixel, and a reference."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from lightpanes.core.files import replacing
from lightpanes.core.rays import Bvh, chunks
from lightpanes.core.sampling import PLASTIC, cosine_hemisphere, frame, hammersley_points, hash_uniform
from lightpanes.core.threads import in_threads

from . import harness
from .implicit_scenes import STAGES, Stage

WIDTH, HEIGHT = 480, 270
REFERENCE = 2048
"""Rays a pixel of the reference, as in the thesis."""


@dataclass(frozen=True)
class View:
    """Surfaces under the pixels that hit one, by rows. position (n, 3) float32, m, lifted off the surface; normal (n, 3)
    float32 unit, towards the camera; object_id (n,) int32; footprint (n,) float32, m; hit (HEIGHT · WIDTH,) bool."""

    position: np.ndarray
    normal: np.ndarray
    object_id: np.ndarray
    footprint: np.ndarray
    hit: np.ndarray
    pixel: np.ndarray

    def image(self, value: np.ndarray) -> np.ndarray:
        """(HEIGHT, WIDTH) float32; the sky is open, 1."""
        result = np.ones(len(self.hit), np.float32)
        result[self.hit] = value.reshape(-1)
        return result.reshape(HEIGHT, WIDTH)


def axes(eye, target) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ahead, right and up of a camera."""
    ahead = np.subtract(target, eye, dtype=np.float64)
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, (0, 0, 1))
    right /= np.linalg.norm(right)
    return ahead, right, np.cross(right, ahead)


def look(stage: Stage, bvh: Bvh, eye=None, target=None) -> View:
    """Through the middles of pixels; from another eye to another target where these are given."""
    eye = stage.eye if eye is None else eye
    ahead, right, up = axes(eye, stage.target if target is None else target)
    pixel_width = stage.width / WIDTH
    across = (np.arange(WIDTH) + 0.5 - WIDTH / 2) * pixel_width
    down = (np.arange(HEIGHT) + 0.5 - HEIGHT / 2) * pixel_width
    directions = ahead + across[None, :, None] * right - down[:, None, None] * up
    directions = directions.reshape(-1, 3).astype(np.float32)
    origins = np.broadcast_to(np.array(eye, np.float32), directions.shape).copy()
    found = in_threads(lambda part: bvh.hits(origins[part], directions[part]), chunks(len(directions)))
    triangle = np.concatenate([hits.triangle for hits in found])
    depth = np.concatenate([hits.distance for hits in found])
    hit = triangle >= 0
    a, b, c = stage.corners[triangle[hit]].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal[np.einsum("nd,nd->n", normal, directions[hit]) > 0] *= -1
    position = origins[hit] + depth[hit, None] * directions[hit] + 1e-4 * normal
    return View(
        position.astype(np.float32),
        normal.astype(np.float32),
        stage.object_id[triangle[hit]],
        (depth[hit] * pixel_width).astype(np.float32),
        hit,
        np.flatnonzero(hit),
    )


def openness(view: View, bvh: Bvh, reach: float, frame_number: int) -> np.ndarray:
    """(n,) float32, 0 or 1, of one cosine ray a pixel: each pixel takes the R2 sequence, shifted."""
    shift = np.stack([hash_uniform(view.pixel, d, 1) for d in (0, 1)], axis=1)
    points = shift + np.array(PLASTIC) * (frame_number + 1)
    points = (points - np.floor(points)).astype(np.float32)

    def trace(part):
        return ~_blocked(view, bvh, part, points[part], reach)

    return np.concatenate(in_threads(trace, chunks(len(view.position)))).astype(np.float32)


def reference(view: View, bvh: Bvh, reach: float, rays: int = REFERENCE) -> np.ndarray:
    """(n,) float32 openness by so many rays a pixel."""
    lattice = hammersley_points(rays)
    shift = np.stack([hash_uniform(view.pixel, d, 2) for d in (0, 1)], axis=1)

    def trace(part):
        total = np.zeros(part.stop - part.start, np.float32)
        for point in lattice:
            moved = shift[part] + point
            total += ~_blocked(view, bvh, part, moved - np.floor(moved), reach)
        return total / rays

    return np.concatenate(in_threads(trace, chunks(len(view.position))))


def _blocked(view, bvh, part, points, reach):
    across, along = frame(view.normal[part])
    local = cosine_hemisphere(points)
    directions = local[:, :1] * across + local[:, 1:2] * along + local[:, 2:] * view.normal[part]
    return bvh.occluded(view.position[part], directions * np.float32(reach))


@dataclass(frozen=True)
class Footage:
    """A view at rest: (frames, n) bool openness and its (n,) float32 reference."""

    view: View
    frames: np.ndarray
    reference: np.ndarray

    def frame(self, number: int) -> np.ndarray:
        """(n,) float32."""
        return self.frames[number].astype(np.float32)


def mark(stage: Stage) -> str:
    """Another for another stage."""
    told = repr((stage.eye, stage.target, stage.width, stage.reach)).encode()
    return hashlib.sha256(stage.corners.tobytes() + told).hexdigest()[:12]


def footage(name: str, frames: int = 64) -> Footage:
    """Of a stage; kept in out/bench, since its reference takes a minute."""
    stage = STAGES[name]()
    path = harness.OUT / "implicit" / f"{name}-{WIDTH}x{HEIGHT}-{REFERENCE}-{frames}-{mark(stage)}.npz"
    if path.exists():
        with np.load(path) as kept:
            view = View(*(kept[key] for key in View.__dataclass_fields__))
            return Footage(view, np.unpackbits(kept["frames"], axis=1, count=len(view.pixel)) > 0, kept["reference"])
    bvh = Bvh(stage.corners)
    view = look(stage, bvh)
    seen = np.stack([openness(view, bvh, stage.reach, k) > 0 for k in range(frames)])
    made = Footage(view, seen, reference(view, bvh, stage.reach))
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        np.savez(part, **view.__dict__, frames=np.packbits(seen, axis=1), reference=made.reference)
    return made
