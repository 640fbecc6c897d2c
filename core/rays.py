"""Rays through Embree: closest hits, occlusion, straight-through surfaces; chunks of them.

The only file that imports embreex; it loads without one, and raises once rays are asked for. Embree releases the
GIL, so chunks run on threads; the order of results, and with it every bake, does not depend on how many there are.
"""

from __future__ import annotations

import copy
from typing import NamedTuple

import numpy as np

from .scene import Scene, used_rows
from .threads import in_threads

UNUSABLE = ""
"""Why embreex does not load here, in its own words; empty where it does."""

try:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene
except Exception as error:  # a build for another numpy or another system raises more than ImportError
    UNUSABLE = f"{type(error).__name__}: {error}"

CHUNK = 8192
"""Rays a call: small enough for the second-level cache, large enough to hide Python."""

LAYERS = 24
"""See-through surfaces a ray may pass before it counts as blocked."""


def chunks(count: int, size: int = CHUNK) -> list[slice]:
    """Slices of at most `size` that cover range(count)."""
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]


def product3(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """left (m, 3) @ right (3, n), for use inside `in_threads`: without BLAS, whose own threads would fight ours.

    With it the gather took half as long again on two cores.
    """
    result = np.multiply(left[:, :1], right[0])
    term = np.empty_like(result)
    for k in (1, 2):
        np.multiply(left[:, k : k + 1], right[k], out=term)
        result += term
    return result


class EngineError(RuntimeError):
    """Rays can't be traced here; the message says why."""


class Hits(NamedTuple):
    """triangle (n,) int32, −1 where nothing was hit; u, v (n,) float32 barycentric weights of the
    second and third corner; distance (n,) float32 in lengths of the direction vector."""

    triangle: np.ndarray
    u: np.ndarray
    v: np.ndarray
    distance: np.ndarray


READ_AT_ONCE = 10_000
"""Triangles that embreex may read without letting other threads in between, in 20 ms; it then takes half of the time."""


class _Numbers(np.ndarray):
    """Gives its numbers one by one, in Python, so that other threads get their turn in between.

    embreex reads a mesh number by number and holds the GIL meanwhile, a quarter of a second for 100,000 triangles.
    """

    def __getitem__(self, key):
        return self.item(key)


class _Rows(np.ndarray):
    """The same for the rows of an array, asked for in order: so many at a time are lists."""

    part, rows = -1, ()

    def __getitem__(self, key):
        part, place = divmod(key, CHUNK)
        if part != self.part:
            self.part, self.rows = part, np.asarray(self)[part * CHUNK : (part + 1) * CHUNK].tolist()
        return self.rows[place]


class Bvh:
    """Embree's hierarchy over triangles, in metres: corners (T, 3, 3) float32, or, in less time, positions (V, 3) float32
    and triangles (T, 3) int, the positions of each one's corners. Raises EngineError without embreex."""

    def __init__(self, corners: np.ndarray, triangles: np.ndarray | None = None):
        if UNUSABLE:
            raise EngineError(f"Tracing rays needs embreex, which does not load here ({UNUSABLE}).")
        self.size = len(corners if triangles is None else triangles)
        self._scene = EmbreeScene()
        if self.size:
            named = None
            if triangles is not None:
                used = used_rows(triangles, len(corners))
                number = np.zeros(len(corners), np.int32)
                number[used] = np.arange(len(used))
                corners, named = corners[used], number[triangles]
            corners = np.ascontiguousarray(corners, np.float32)
            if self.size > READ_AT_ONCE:
                corners, named = corners.view(_Numbers), None if named is None else named.view(_Rows)
            TriangleMesh(self._scene, corners, named)
            # Embree builds at the first query; do it here, on one thread
            self._scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))

    def closest(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(n,) int32 triangle hit first, −1 for none. One Embree call: chunk before it."""
        if not self.size:
            return np.full(len(origins), -1, np.int32)
        return self._scene.run(origins, directions)

    def hits(self, origins: np.ndarray, directions: np.ndarray, reach: np.ndarray | None = None) -> Hits:
        """Closest hits with their place; `reach` (n,) float32 bounds the distance."""
        if not self.size:
            empty = np.zeros(len(origins), np.float32)
            return Hits(np.full(len(origins), -1, np.int32), empty, empty, empty + np.float32(np.inf))
        far = np.full(len(origins), 1e30, np.float32) if reach is None else np.array(reach, np.float32)
        found = self._scene.run(origins, directions, dists=far, output=True)
        return Hits(found["primID"], found["u"], found["v"], found["tfar"])

    def occluded(self, origins: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """(n,) bool: whether anything stands on the open segment origins + t · vectors, 0 < t < 1."""
        if not self.size:
            return np.zeros(len(origins), bool)
        # just below 1, so that the surface on which the segment ends does not block it
        reach = np.full(len(origins), 1 - 1e-4, np.float32)
        return self._scene.run(origins, vectors, dists=reach, query="OCCLUDED") == 0


class Transmission:
    """What each triangle lets straight through: constants, or the scene's map where it has one.

    solid: (T,) bool, triangles that mirror or refract what their map or transmission stands for; they let through what
    is `clear` in their optics alone.
    """

    def __init__(self, scene: Scene, solid: np.ndarray | None = None):
        self.scene = scene
        constant = np.array([m.transmission for m in scene.materials], np.float32)
        mapped = np.array([m.mapped for m in scene.materials], bool)
        self.value = constant[scene.triangle_material]
        self.mapped = np.zeros(len(scene.triangles), bool)
        if scene.transmission_map is not None:
            self.mapped = mapped[scene.triangle_material] & np.isfinite(scene.atlas_uv).all((1, 2))
        if solid is not None:
            clear = np.array([m.optics.clear if m.optics else (0.0, 0.0, 0.0) for m in scene.materials], np.float32)
            self.value[solid] = clear[scene.triangle_material[solid]]
            self.mapped &= ~solid
        self.see_through = self.value.any(axis=1) | self.mapped
        self.tinted = bool(np.ptp(self.value, axis=1).any()) or (
            scene.transmission_map is not None and bool(np.ptp(scene.transmission_map, axis=2).max() > 1e-3)
        )

    def at(self, triangle: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(n, 3) float32 in [0, 1] at barycentric places of triangles."""
        result = self.value[triangle]
        rows = np.flatnonzero(self.mapped[triangle])
        if len(rows):
            corners = self.scene.atlas_uv[triangle[rows]]
            a, b = u[rows, None], v[rows, None]
            uv = corners[:, 0] * (1 - a - b) + corners[:, 1] * a + corners[:, 2] * b
            result[rows] = sample_map(self.scene.transmission_map, uv)
        return result


def sample_map(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(n, C) values of an (H, W, C) image at (n, 2) coordinates in [0, 1], nearest texel; row 0 is v = 0."""
    height, width = image.shape[:2]
    column = np.clip((uv[:, 0] * width).astype(np.int32), 0, width - 1)
    row = np.clip((uv[:, 1] * height).astype(np.int32), 0, height - 1)
    return image[row, column]


class Tracer:
    """Shadow rays of a scene.

    solid: (T,) bool, triangles that let on what is `clear` in their optics alone, though their material lets more straight
    on: those of the casters, where caustics show the light that they mirror and refract (`caustics.casters`).
    offset: m; lift origins off their surface by this much along the geometric normal.
    """

    def __init__(self, scene: Scene, threads: int | None = None, solid: np.ndarray | None = None):
        self.threads = threads
        casts = np.array([o.casts_shadow for o in scene.objects], bool)[scene.triangle_object]
        self.transmission = Transmission(scene, solid)
        see_through = self.transmission.see_through
        self.scene = scene
        self._opaque = np.flatnonzero(casts & ~see_through)
        self._solid = Bvh(scene.positions, scene.triangles[self._opaque])
        self._panes_of_glass = np.flatnonzero(casts & see_through)
        self._glass = Bvh(scene.positions, scene.triangles[self._panes_of_glass])
        # float32 steps grow with the distance from the origin, lifts must exceed them
        reach = float(np.abs(scene.positions).max(initial=0.0))
        self.offset = max(2e-5 * scene.extent, 4e-7 * reach)

    def alone(self) -> Tracer:
        """The same rays on the calling thread only, for callers that spend threads themselves."""
        single = copy.copy(self)
        single.threads = 1
        return single

    @property
    def solid(self) -> tuple[Bvh, np.ndarray]:
        """The hierarchy over the opaque triangles that cast shadows, and the (n,) numbers that these have in the scene."""
        return self._solid, self._opaque

    @property
    def solid_corners(self) -> np.ndarray:
        """(n, 3, 3) float32 corners, m, of the opaque triangles that cast shadows."""
        return self.scene.positions[self.scene.triangles[self._opaque]]

    @property
    def glass_corners(self) -> np.ndarray:
        """(n, 3, 3) float32 corners, m, of those that let some light straight through."""
        return self.scene.positions[self.scene.triangles[self._panes_of_glass]]

    @property
    def has_glass(self) -> bool:
        """Whether any surface lets light straight through."""
        return bool(self._glass.size)

    def blocked(self, origins: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """(n,) bool: whether anything opaque stands on open segments, (n, 3) float32 each; on the calling thread."""
        return _occluded(self._solid, origins, vectors)

    def meets_glass(self, origins: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """(n,) bool: whether anything see-through stands there, as `blocked`."""
        return _occluded(self._glass, origins, vectors)

    def visibility(self, origins: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Part of the light that passes along open segments origins + t · vectors, 0 < t < 1.

        origins, vectors: (n, 3) float32, m. Returns (n,) float32 in [0, 1], or (n, 3) where the scene
        holds tinted see-through surfaces. Lift origins by `offset` first.
        """
        origins = np.ascontiguousarray(origins, np.float32)
        vectors = np.ascontiguousarray(vectors, np.float32)
        parts = in_threads(lambda s: self._segment(origins[s], vectors[s]), chunks(len(origins)), self.threads)
        if parts:
            return np.concatenate(parts)
        return np.zeros((0, 3) if self._glass.size and self.transmission.tinted else 0, np.float32)

    def _segment(self, origins, vectors):
        free = 1 - self._solid.occluded(origins, vectors).astype(np.float32)
        if not self._glass.size:
            return free
        passed = np.repeat(free[:, None], 3, axis=1)
        alive = np.flatnonzero(free)
        start, rest = origins[alive], vectors[alive]
        for _ in range(LAYERS):
            if not len(alive):
                break
            hits = self._glass.hits(start, rest, np.full(len(alive), 1 - 1e-4, np.float32))
            hit = np.flatnonzero(hits.triangle >= 0)
            alive, start, rest = alive[hit], start[hit], rest[hit]
            triangle = self._panes_of_glass[hits.triangle[hit]]
            passed[alive] *= self.transmission.at(triangle, hits.u[hit], hits.v[hit])
            start, rest = _step_on(start, rest, hits.distance[hit], self.offset)
            more = np.flatnonzero(passed[alive].any(axis=1))
            alive, start, rest = alive[more], start[more], rest[more]
        passed[alive] = 0
        return passed if self.transmission.tinted else passed.mean(axis=1)


def _occluded(bvh, origins, vectors):
    if len(origins) <= CHUNK:
        return bvh.occluded(origins, vectors)
    return np.concatenate([bvh.occluded(origins[s], vectors[s]) for s in chunks(len(origins))])


def _step_on(start, vectors, distance, offset):
    """The rest of segments after a hit, begun `offset` metres behind it."""
    length = np.linalg.norm(vectors, axis=1)
    step = np.minimum(distance + offset / np.maximum(length, 1e-30), 1)[:, None]
    return start + vectors * step, vectors * (1 - step)
