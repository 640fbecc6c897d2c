"""What a camera sees of a stage, and how open each of its pixels is: frames of one ray a pixel, and a reference."""

from __future__ import annotations

import functools
import hashlib
from dataclasses import asdict, dataclass

import numpy as np
from lightpanes.core.files import replacing
from lightpanes.core.preview.camera import Camera
from lightpanes.core.rays import Bvh, chunks
from lightpanes.core.sampling import PLASTIC, frame_parts, hammersley_points, hash_uniform
from lightpanes.core.threads import in_threads
from lightpanes.core.vectors import around, dot, join, scaled, split

from . import harness
from .implicit_scenes import STAGES, Stage

WIDTH, HEIGHT = 480, 270
REFERENCE = 2048
"""Rays a pixel of the reference, as in the thesis."""

PIECE = 1 << 14
"""Pixels that are traced together."""


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


def camera(stage: Stage, eye=None, target=None) -> Camera:
    """A stage's; at another eye, towards another target, where these are given."""
    eye, target = (
        np.asarray(own if other is None else other, np.float64)
        for own, other in ((stage.eye, eye), (stage.target, target))
    )
    matrix = np.eye(4)
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, (0, 0, 1))
    right /= np.linalg.norm(right)
    matrix[:3] = np.stack([right, np.cross(right, ahead), -ahead, eye], axis=1)
    return Camera.from_lens(matrix, WIDTH, HEIGHT, lens=36 / stage.width, sensor=(36, 24), clip=(0.01, 100))


def look(stage: Stage, bvh: Bvh, through: Camera) -> View:
    """Through the middles of pixels."""
    # a camera's rows go up, a picture's down
    origins, ways = (part.reshape(HEIGHT, WIDTH, 3)[::-1].reshape(-1, 3) for part in through.rays()[:2])

    def trace(part):
        origin, way = origins[part], ways[part]
        hits = bvh.hits(origin, way)
        rows = np.flatnonzero(hits.triangle >= 0)
        triangle, way = hits.triangle[rows], way.take(rows, axis=0)
        normal = stage.facing(triangle, way)
        place = scaled(way, hits.distance[rows])
        place += origin.take(rows, axis=0)
        footprint = through.footprint(through.depth(place))
        return place + np.float32(1e-4) * normal, normal, stage.object_id[triangle], footprint, hits.triangle >= 0

    parts = zip(*in_threads(trace, chunks(len(ways), PIECE)), strict=True)
    *made, hit = (np.concatenate(columns) for columns in parts)
    return View(*made, hit, np.flatnonzero(hit))


@functools.cache
def _shifts() -> np.ndarray:
    """(2, HEIGHT · WIDTH) float32, where each pixel's sequence begins."""
    pixel = np.arange(HEIGHT * WIDTH)
    return np.stack([hash_uniform(pixel, d, 1) for d in (0, 1)])


def _cosine_rays(view, part, frame_number):
    """Three (n,) components of rays, one a pixel: each takes the R2 sequence, shifted."""
    points = _shifts().take(view.pixel[part], axis=1)
    for row, step in zip(points, PLASTIC, strict=True):
        row += np.float32(step * (frame_number + 1) % 1)
        row -= np.floor(row)
    return _around(view.normal[part], points)


def _around(normal, points):
    radius, angle = np.sqrt(points[0]), points[1] * np.float32(2 * np.pi)
    return around(split(normal), radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - points[0]))


def openness(view: View, bvh: Bvh, reach: float, frame_number: int) -> np.ndarray:
    """(n,) float32, 0 or 1, of one cosine ray a pixel."""

    def trace(part):
        ways = [row * np.float32(reach) for row in _cosine_rays(view, part, frame_number)]
        return ~bvh.occluded(view.position[part], join(*ways))

    return np.concatenate(in_threads(trace, chunks(len(view.position), PIECE))).astype(np.float32)


def one_bounce(view: View, bvh: Bvh, stage: Stage, lamp, frame_number: int) -> np.ndarray:
    """(n, 3) float32 light of a point lamp of π W/m² at 1 m that one cosine ray a pixel finds on coloured surfaces."""
    colours = [
        np.float32(0.2) + np.float32(0.6) * hash_uniform(np.arange(int(stage.object_id.max()) + 1), d, 3)
        for d in range(3)
    ]

    def trace(part):
        position = view.position[part]
        ways = join(*_cosine_rays(view, part, frame_number))
        hits = bvh.hits(position, ways)
        light = np.zeros((len(ways), 3), np.float32)
        rows = np.flatnonzero(hits.triangle >= 0)
        triangle, ways = hits.triangle[rows], ways.take(rows, axis=0)
        normal = stage.facing(triangle, ways)
        place = scaled(ways, hits.distance[rows])
        place += position.take(rows, axis=0)
        place += np.float32(1e-4) * normal
        away = [np.float32(lamp[k]) - place[:, k] for k in range(3)]
        squared = dot(away, away)
        received = np.maximum(dot(normal.T, away), 0) / (squared * np.sqrt(squared))
        received *= ~bvh.occluded(place, join(*away))
        owner = stage.object_id[triangle]
        for k, colour in enumerate(colours):
            light[rows, k] = received * colour.take(owner)
        return light

    return np.concatenate(in_threads(trace, chunks(len(view.position), PIECE)))


def reference(view: View, bvh: Bvh, reach: float, rays: int = REFERENCE) -> np.ndarray:
    """(n,) float32 openness by so many rays a pixel."""
    lattice = hammersley_points(rays)
    shift = np.stack([hash_uniform(view.pixel, d, 2) for d in (0, 1)])

    def trace(part):
        total = np.zeros(part.stop - part.start, np.float32)
        up = split(view.normal[part]) * np.float32(reach)
        sides = [[row * np.float32(reach) for row in side] for side in frame_parts(*split(view.normal[part]))]
        for point in lattice:
            moved = shift[:, part] + point[:, None]
            moved -= np.floor(moved)
            radius, angle = np.sqrt(moved[0]), moved[1] * np.float32(2 * np.pi)
            a, b, c = radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - moved[0])
            ways = join(*(t * a + s * b + n * c for t, s, n in zip(*sides, up, strict=True)))
            total += ~bvh.occluded(view.position[part], ways)
        return total / rays

    return np.concatenate(in_threads(trace, chunks(len(view.position))))


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
    view = look(stage, bvh, camera(stage))
    seen = np.stack([openness(view, bvh, stage.reach, k) > 0 for k in range(frames)])
    made = Footage(view, seen, reference(view, bvh, stage.reach))
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        np.savez(part, **asdict(view), frames=np.packbits(seen, axis=1), reference=made.reference)
    return made
