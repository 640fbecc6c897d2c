"""Cosine rays from points, each turned into the id of the surface that it lands on.

The tracing mesh is cut along the patches' borders, so the triangle's number alone names the patch and
no hit position is ever computed. One pattern of directions serves a chunk of points, turned about each
point's normal by its own angle: all directions are one small matrix product.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..caustics.bending import Bending
from ..rays import CHUNK, LAYERS, Bvh, Hits, Tracer, Transmission, chunks, product3
from ..sampling import cosine_hemisphere, frame, hammersley_points, hash_uniform
from ..scene import Scene
from ..surface import Patches, SurfaceSamples
from ..threads import in_threads
from .onward import Onward

ROWS = 16
"""Directions of the pattern handled together: their ids stay in the second-level cache."""


@dataclass
class Begun:
    """A gather that may end before its time: what has landed so far, and the chunks that are finished."""

    rows: np.ndarray | None = None
    done: set[int] = field(default_factory=set)

    def rows_of(self, shape: tuple[int, ...]) -> np.ndarray:
        """The rows, of 0 where nothing has landed yet; those of another gather count for nothing."""
        if self.rows is None or self.rows.shape != shape:
            self.rows = np.zeros(shape, np.float32)
            self.done.clear()
        return self.rows


class Gatherer:
    """Names what rays land on.

    front, back: (p,) int32 id of each piece's two sides. miss: id of the sky's first bin; a sky with
    `bins` = (rows, columns) > (1, 1) has one id for each direction bin from `miss` on. bare: (p,) bool of the
    fronts and backs that have no entry. bending: mirrors and glass by which rays go on; without them glass lets rays
    straight on and metal stops them.
    """

    def __init__(
        self,
        scene: Scene,
        patches: Patches,
        bvh: Bvh,
        front: np.ndarray,
        back: np.ndarray,
        miss: int,
        bins: tuple[int, int] = (1, 1),
        offset: float = 0.0,
        bare: tuple[np.ndarray, np.ndarray] | None = None,
        bending: Bending | None = None,
    ):
        self.bvh = bvh
        self.miss = miss
        self.bins = bins
        self.size = miss + bins[0] * bins[1]
        self.offset = offset
        # the last row answers Embree's −1
        self._front = np.append(front, miss).astype(np.int32)
        self._back = np.append(back, miss).astype(np.int32)
        self._two_sided = self._front != self._back
        self._any_two_sided = bool(self._two_sided.any())
        cross = np.cross(patches.corners[:, 1] - patches.corners[:, 0], patches.corners[:, 2] - patches.corners[:, 0])
        self._flat = cross.astype(np.float32)
        self._patches = patches
        self._bare = bare
        solid = None if bending is None else bending.bends
        self._transmission = Transmission(scene, solid)
        clear = self._transmission.see_through[patches.parent]
        self._clear = np.append(clear, False)
        self._any_clear = bool(clear.any())
        self._tracer = Tracer(scene, threads=1, solid=solid) if self._any_clear else None
        self._onward = None if bending is None else Onward(scene, patches, bending, self._transmission, offset)

    def gather(
        self,
        points: SurfaceSamples,
        rays: int,
        seed: int,
        consume: Callable[[slice, np.ndarray], None],
        tick: Callable[[int], None] | None = None,
        threads: int | None = None,
        done: set[int] | None = None,
        apart: bool = False,
    ) -> None:
        """Shoot `rays` cosine rays from each point.

        consume(points' slice, ids (rows, m) int32) gets blocks of at most ROWS rays of a chunk of points;
        the blocks of one slice come in order from one thread. tick(rays done) follows each chunk; an
        exception that it raises ends the gather. done: first points of the chunks that are finished; those in it are
        not gathered again, so that a gather can go on where another has ended. apart: whether rays that mirrors and glass
        have bent have ids of their own, `size` more.
        """
        # rays below the surface carry nothing, as in Cycles; only smooth shading has such rays
        smooth = bool((np.einsum("nd,nd->n", points.normal, points.flat) < 0.9999).any())

        def chunk(piece: slice):
            origins = np.ascontiguousarray(points.position[piece] + points.flat[piece] * np.float32(self.offset))
            count = len(origins)
            turn = turns(points.normal[piece], piece, seed).reshape(3, -1)
            flat = np.ascontiguousarray(points.flat[piece].T) if smooth else None
            pattern = cosine_hemisphere(hammersley_points(rays, seed + 7919 * (1 + piece.start // CHUNK)))
            for start in range(0, rays, ROWS):
                block = pattern[start : start + ROWS].astype(np.float32)
                directions = product3(block, turn).reshape(len(block), count, 3)
                consume(piece, self._land_all(origins, directions, flat, apart))
            done.add(piece.start)
            if tick is not None:
                tick(rays * count)

        done = set() if done is None else done
        in_threads(chunk, [piece for piece in chunks(len(points)) if piece.start not in done], threads)

    def visible(self, origins: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """(n,) float32 part of the light between places that passes: origins + t · vectors, 0 < t < 1."""
        origins, vectors = np.ascontiguousarray(origins), np.ascontiguousarray(vectors)
        if self._any_clear:
            seen = self._tracer.visibility(origins, vectors)
            return seen if seen.ndim == 1 else seen.mean(axis=1)
        blocked = [self.bvh.occluded(origins[s], vectors[s]) for s in chunks(len(origins))]
        return 1 - np.concatenate(blocked or [np.zeros(0)]).astype(np.float32)

    def dead_ends(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) bool, whether rays meet a side that has no entry of its own, and (n,) float32 distances, m."""
        hits = self.bvh.hits(origins, directions)
        behind = np.einsum("nd,nd->n", self._flat.take(hits.triangle, axis=0, mode="wrap"), directions) > 0
        bare = np.where(
            behind, self._bare[1].take(hits.triangle, mode="wrap"), self._bare[0].take(hits.triangle, mode="wrap")
        )
        return bare & (hits.triangle >= 0), hits.distance

    def meet(self, origins: np.ndarray, directions: np.ndarray, flat: np.ndarray | None) -> tuple[np.ndarray, Hits]:
        """Ids (n,) int32 of what rays land on, and where they first hit, which for rays that went on through see-through
        surfaces is not where they landed.

        flat: (3, n) float32 geometric normals, without which no ray is below the surface.
        """
        hits = self.bvh.hits(origins, directions)
        return self._land(origins, directions, flat, hits.triangle), hits

    def land(
        self, origins: np.ndarray, directions: np.ndarray, flat: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Ids (n,) int32 as by `meet`, and how far off (n,) float32, m, infinite in the sky."""
        ids, hits = self.meet(origins, directions, flat)
        return ids, np.where(hits.triangle < 0, np.inf, hits.distance)

    def lets_on(self, piece: np.ndarray) -> np.ndarray:
        """(n,) bool: at which of the patches' pieces rays may go on, straight or bent; −1, the sky, is none."""
        return self._clear.take(piece, mode="wrap") if self._onward is None else self._onward.meets(piece)

    @property
    def bends(self) -> bool:
        """Whether any rays are mirrored or refracted."""
        return self._onward is not None

    @property
    def both_ways(self) -> bool:
        """Whether rays that are bent pass one way as easily as the other."""
        return self._onward is None or self._onward.both_ways

    def _land_all(self, origins, directions, flat, apart):
        """(m, n) ids of directions (m, n, 3) from origins (n, 3)."""
        ids = np.empty(directions.shape[:2], np.int32)
        if self._onward is None:
            for row, ahead in enumerate(directions):
                ids[row] = self._land(origins, ahead, flat)
            return ids
        piece = np.empty(ids.shape, np.int32)
        for row, ahead in enumerate(directions):
            piece[row] = self.bvh.closest(origins, ahead)
        # few rays of a row meet mirrors or glass: those of all rows go on together
        some = np.flatnonzero(self._onward.meets(piece))
        row, point = np.divmod(some, len(origins))
        ahead = directions[row, point]
        below = None if flat is None else _below(flat[:, point], ahead)
        piece.reshape(-1)[some], ahead, bent, lost = self._onward.follow(self.bvh, origins[point], ahead)
        for k, first in enumerate(directions):
            ids[k] = self._name(piece[k], first, flat)
        found = self._name(piece.reshape(-1)[some], ahead, None)
        found[lost] = self.miss - 1
        if apart:
            found[bent] += self.size
        if below is not None:
            found[below] = self.miss - 1
        ids.reshape(-1)[some] = found
        return ids

    def _land(self, origins, directions, flat, triangle=None):
        if self._onward is not None:
            return self._land_all(origins, directions[None], flat, False)[0]
        if triangle is None:
            triangle = self.bvh.closest(origins, directions)
        if self._any_clear:
            triangle = self._pass_clear(origins, directions, triangle)
        return self._name(triangle, directions, flat)

    def _name(self, triangle, directions, flat):
        ids = self._front.take(triangle, mode="wrap")
        if self._any_two_sided:
            rows = np.flatnonzero(self._two_sided.take(triangle, mode="wrap"))
            behind = np.einsum("nd,nd->n", self._flat[triangle[rows]], directions[rows]) > 0
            rows = rows[behind]
            ids[rows] = self._back[triangle[rows]]
        if self.bins != (1, 1):
            rows = np.flatnonzero(triangle < 0)
            ids[rows] = self.miss + sky_bin(directions[rows], self.bins)
        if flat is not None:
            ids[_below(flat, directions)] = self.miss - 1
        return ids

    def _pass_clear(self, origins, directions, triangle):
        """Let rays through see-through surfaces with the odds of their mean transmission."""
        triangle = triangle.copy()
        rows = np.flatnonzero(self._clear.take(triangle, mode="wrap"))
        start, ahead = origins[rows], directions[rows]
        for layer in range(LAYERS):
            if not len(rows):
                break
            hits = self.bvh.hits(start, ahead)
            triangle[rows] = hits.triangle
            stay = ~self._clear.take(hits.triangle, mode="wrap")
            index = np.flatnonzero(~stay)
            piece = hits.triangle[index]
            inside = np.stack([1 - hits.u[index] - hits.v[index], hits.u[index], hits.v[index]], 1)
            parent = np.einsum("nk,nkc->nc", inside, self._patches.weights[piece])
            odds = self._transmission.at(self._patches.parent[piece], parent[:, 1], parent[:, 2]).mean(axis=1)
            # the direction's own bits decide, so that the choice depends on neither chunk nor thread
            bits = np.ascontiguousarray(ahead[index]).view(np.uint32).astype(np.uint64)
            dice = hash_uniform(
                bits[:, 0] ^ (bits[:, 1] << np.uint64(20)) ^ (bits[:, 2] << np.uint64(32)), 11 + layer, 0
            )
            on = index[dice < odds]
            step = (hits.distance[on] + self.offset)[:, None]
            rows, start, ahead = rows[on], start[on] + ahead[on] * step, ahead[on]
        triangle[rows] = -1
        return triangle


def _below(flat, directions):
    """(n,) bool: which directions (n, 3) point below the surface, whose normals are (3, n)."""
    return flat[0] * directions[:, 0] + flat[1] * directions[:, 1] + flat[2] * directions[:, 2] <= 0


def turns(normal: np.ndarray, number: slice | np.ndarray, seed: int) -> np.ndarray:
    """(3, n, 3) float32: frames about normals (n, 3), each turned by its own angle, so that pattern @ frame are
    directions. number: the points' numbers, from which the angles come."""
    tangent, bitangent = frame(normal)
    number = np.arange(number.start, number.stop) if isinstance(number, slice) else number
    angle = (2 * np.pi * hash_uniform(number, 5, seed)).astype(np.float32)[:, None]
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([tangent * cos + bitangent * sin, bitangent * cos - tangent * sin, normal])


def sky_bin(directions: np.ndarray, bins: tuple[int, int]) -> np.ndarray:
    """(n,) int32 bin of the sky for unit directions (n, 3); rows of equal height in z, hence equal solid angle."""
    rows, columns = bins
    row = np.clip(((directions[:, 2] + 1) * (0.5 * rows)).astype(np.int32), 0, rows - 1)
    around = 0.5 - np.arctan2(directions[:, 1], directions[:, 0]) / np.float32(2 * np.pi)
    column = np.clip((around * columns).astype(np.int32), 0, columns - 1)
    return row * columns + column
