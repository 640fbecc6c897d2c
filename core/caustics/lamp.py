"""The caustics of one lamp at unit power, from coarse to fine."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..scene import Light
from .borders import sharpen
from .deposit import deposit
from .emission import is_soft
from .landings import Landings, landings_of, none
from .planting import Tree, plant, points_of
from .quadtree import Forest, Photons
from .receivers import Receivers
from .softness import Cells, Softness, slopes, worst_alike
from .splat import SAMPLES
from .surfaces import Surfaces
from .tracing import trace

FIRST = 2_500
"""Photons of the first picture, about."""

BASE = 0.2
"""Part of the photons that go onto uniform grids, so that no island of light is overlooked."""

PASSES = 5
"""In which the rest refines the worst patches."""

SHARPEN = 0.1
"""Part of the photons that finds the borders across the patches which are left divided."""

NEW = 10
"""New photons of a refined patch, about; it has sixteen, some of them its neighbours' too."""

WHOLE = 200_000
"""Photons up to which a lamp's patches are kept together; more are traced part by part."""

PART = 200_000
"""Photons of a part, about."""

LEAST_GRIDS = 0.5
"""Part of the photons that the coarsest grids of all points and objects may take together: the rest refines."""


GRAZING = 0.4
"""What a photon of an outer reflection counts for where it just missed the object, in the choice of what to refine."""


@dataclass(frozen=True)
class Energy:
    """Where the light goes that a lamp of unit power sends towards the casters, W (a sun's: of 1 W/m²).

    emitted = landed + absorbed + escaped + missed + untraced, but for what the photons' grid rounds. missed: passed the
    casters by, was stopped before them, or went straight on through what is clear in them. untraced: what paths carry that were not followed. Means over the channels.
    """

    emitted: float
    landed: float
    absorbed: float
    escaped: float
    missed: float
    untraced: float


class LampCaustics:
    """What a lamp's photons have brought so far; `advance` goes on.

    photons: to spend in all.
    """

    def __init__(
        self,
        light: Light,
        surfaces: Surfaces,
        receivers: Receivers,
        photons: int,
        seed: int = 0,
        threads: int | None = None,
    ):
        self.light, self.photons = light, photons
        self._surfaces, self._receivers, self._seed, self._threads = surfaces, receivers, seed, threads
        self._forest: Forest | None = None
        self._trees: list[Tree] = []
        self._cells: Cells | None = None
        self._power: np.ndarray | None = None
        self._lit: np.ndarray | None = None
        # photons of parts that are done, and all power with theirs
        self._used = 0
        self._parted: np.ndarray | None = None
        self.done = not light.casts_shadow
        self._steps = self._run()

    @property
    def used(self) -> int:
        """Photons so far."""
        return self._used + (0 if self._forest is None else len(self._forest.photons))

    def advance(self) -> None:
        """One step further, to a better picture; `done` says when it was the last."""
        if not self.done:
            self.done = next(self._steps, self) is self
            self._power = self._lit = None

    def _run(self) -> Iterator[None]:
        """Refine until the photons are spent."""
        soft = is_soft(self.light)
        self._plant(1, FIRST)
        yield
        if soft and self._trees:
            points = points_of(self.photons)
            # with many objects fewer points of the lamp: each of the trees so far is to stand at every point
            points = min(points, int(LEAST_GRIDS * self.photons / (_grid(1) * len(self._trees))))
            if points > 1:
                self._plant(points, BASE * self.photons)
                yield
        if not self._trees:
            return
        whole = min(self.photons, WHOLE)
        last = SHARPEN * whole
        whole -= last
        while self.used < BASE * whole:
            if not self._refine_worst(self._forest, BASE * whole - self.used):
                break
            yield
        for step in range(PASSES):
            if not self._refine_worst(self._forest, (whole - self.used) / (PASSES - step)):
                break
            if step < PASSES - 1:
                yield
        self._sharpen(self._forest, last)
        if self.photons > self.used >= 0.9 * WHOLE:
            yield
            yield from self._in_parts()

    def _in_parts(self) -> Iterator[None]:
        """Refine further one part after another, each forgotten once its power is in the picture."""
        forest, scores = self._forest, self._forest.scores().astype(np.float64)
        power, budget = self.power(), self.photons - self.used
        parts = int(np.ceil(budget / PART))
        # neighbours together, and those of all points alike; as much to do in each
        names = forest.names(self._group)
        order = np.argsort(names, kind="stable") if self._cells else np.arange(len(forest))
        bounds = np.searchsorted(np.cumsum(scores[order]), scores.sum() * np.arange(1, parts) / parts)
        if self._cells:
            bounds = np.searchsorted(names[order], names[order[np.minimum(bounds, len(order) - 1)]])
        for rows in np.split(order, np.unique(bounds)):
            share = budget * scores[rows].sum() / max(scores.sum(), 1e-300)
            if share < 16:
                continue
            part = forest.part(rows)
            before = len(part.photons)
            for step in range(PASSES):
                left = share - (len(part.photons) - before)
                if not self._refine_worst(part, left / (PASSES - step)):
                    break
            fine, coarse = (self._deposit(f, r, SAMPLES) for f, r in ((part, np.arange(len(part))), (forest, rows)))
            power = power + (fine - coarse)
            self._used += len(part.photons) - before
            self._parted = power
            yield

    def power(self) -> np.ndarray:
        """(resolution², c) float W at each texel."""
        if self._parted is not None:
            return self._parted
        if self._power is None:
            self._power = np.zeros((self._receivers.resolution**2, self._surfaces.channels))
            if self._trees:
                rows = np.arange(len(self._forest))
                samples = SAMPLES if self.done else SAMPLES / 6
                self._power = self._deposit(self._forest, rows, samples)
        return self._power

    def irradiance(self) -> np.ndarray:
        """(resolution², c) float32 W/m²."""
        if self._lit is not None:
            return self._lit
        lit = self._receivers.irradiance(self.power())
        if self.done:
            # a lamp at rest needs no more than this
            self._lit, self._power = lit, None
            if self._parted is not None:
                self._parted = self._parted.astype(np.float32)
        return lit

    def energy(self) -> Energy:
        if not self._trees:
            return Energy(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        photons, weights = self._forest.photons, self._forest.weights()
        landed = float(weights @ photons.power.mean(axis=1))
        rest = weights @ photons.rest[:, 6:]
        # every family of an object starts from the same light
        squares = [t.emitter for t in self._trees if t.family == 0]
        emitted = sum(e.emitted() for e in squares)
        absorbed, escaped, untraced, missed, twice = (float(v) for v in rest)
        return Energy(emitted, landed - twice, absorbed, escaped, missed, untraced)

    def landings(self) -> Landings:
        return landings_of(self._forest) if self._trees else none()

    def _plant(self, points: int, photons: float) -> None:
        """Trees for so many points of the lamp, on grids with about so many photons in all."""
        self._trees, self._cells = plant(self._surfaces, self.light, points, self.photons, self._seed)
        self._power = None
        if not self._trees:
            self._forest = None
            return
        self._group = np.array([t.group for t in self._trees], np.int64)
        self._cell = np.array([t.cell for t in self._trees], np.int64)
        self._family = np.array([t.family for t in self._trees], np.int64)
        self._caster = np.array([t.caster for t in self._trees], np.int32)
        self._unfollowed = np.stack([t.unfollowed for t in self._trees], 1)
        # what is not refracted straight through is weaker and wider: a quarter of the photons do
        coarser = (self._family > 0).astype(np.int64)
        each = photons / (0.25**coarser).sum()
        level = int(np.clip(np.round(np.log2(max(np.sqrt(each) - 1, 1) / 2)), 2, 7))
        # many objects share what there is: grids as coarse as that leaves to refine
        room = LEAST_GRIDS * self.photons
        least = next((k for k in (2, 1) if _grid(k) * len(self._trees) <= room), 0)
        self._forest = Forest(
            self._photons, np.maximum(level - coarser, 2) if least == 2 else np.full(len(coarser), least)
        )

    def _refine_worst(self, forest: Forest, photons: float) -> bool:
        """Refine the patches with the highest scores by about so many photons; False where there is nothing to do."""
        scores, count = forest.scores(), max(0, int(photons / NEW))
        if self._cells is None:
            rows = np.argsort(-scores, kind="stable")[:count]
            rows = rows[scores[rows] > 0]
        else:
            rows = worst_alike(forest, scores, self._group, count)
        if not len(rows):
            return False
        forest.refine(rows)
        self._power = None
        return True

    def _deposit(self, forest, rows, samples):
        soft = None
        if self._cells is not None:
            soft = Softness(slopes(forest, self._group, self._cells.point[self._cell]), self._cell, self._cells.offset)
        return deposit(forest, rows, self._receivers, samples, soft)

    def _sharpen(self, forest: Forest, photons: float) -> None:
        """Find the borders across patches whose photons differ, with about so many photons."""
        if sharpen(forest, photons):
            self._power = None

    def _photons(self, tree: np.ndarray, s: np.ndarray, t: np.ndarray) -> Photons:
        """Trace photons at places of trees; tree (n,) int sorted."""
        n, surfaces, receivers = len(tree), self._surfaces, self._receivers
        origins, directions = np.empty((3, n), np.float32), np.empty((3, n), np.float32)
        power = np.empty(n, np.float32)
        ends = np.searchsorted(tree, np.arange(len(self._trees) + 1))
        for number in range(len(self._trees)):
            part = slice(ends[number], ends[number + 1])
            if part.start < part.stop:
                emitter = self._trees[number].emitter
                origins[:, part], directions[:, part], power[part] = emitter.rays(s[part], t[part])
        found = trace(surfaces, origins, directions, self._caster[tree], self._family[tree], self._threads)
        triangle = np.maximum(found.triangle, 0)
        lands = found.triangle >= 0
        placed = lands & ~found.back & (receivers.chart[triangle] > 0)
        place = np.where(placed, receivers.place(triangle, found.u, found.v), np.float32(0)).T
        chart = np.where(placed, receivers.chart[triangle], 0).astype(np.int32)
        signature = _signature(found.path, lands, placed, np.where(placed, chart, surfaces.object[triangle] * lands))
        untraced = found.lost + (found.left * self._unfollowed[:, tree]).sum(axis=0)
        corners = surfaces.scene.positions[surfaces.scene.triangles[triangle]]
        position = corners[:, 0] + (corners[:, 1] - corners[:, 0]) * found.u[:, None]
        position += (corners[:, 2] - corners[:, 0]) * found.v[:, None]
        normal = np.where(found.back[:, None], -surfaces.flat[triangle], surfaces.flat[triangle])
        base = self._family[tree] == 0
        missed = base * np.where(found.path == 0, np.float32(1), found.past)
        told = (found.absorbed, found.escaped, untraced, missed, found.twice)
        tallies = np.stack([part * power for part in told], 1)
        rest = np.concatenate([position, normal, tallies], axis=1).astype(np.float32)
        landed = (found.carried * power).T.copy()
        # just inside an outline all light is reflected, in a strip that a coarse grid may miss
        grazes = (found.path == 0) & (self._family[tree] & 1 == 1)
        carried = landed.mean(axis=1) + np.where(grazes, GRAZING, found.escaped) * power
        return Photons(np.ascontiguousarray(place), landed, carried, signature, chart, rest)


def _grid(level: int) -> int:
    """Photons of a tree's first grid."""
    return ((2 << level) + 1) ** 2


def _signature(path, lands, placed, where):
    """(n,) int32, see Forest."""
    mixed = path.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + where.astype(np.uint64)
    mixed = (mixed ^ mixed >> np.uint64(31)) * np.uint64(0xBF58476D1CE4E5B9)
    number = (mixed >> np.uint64(36)).astype(np.int64) * 4 + 2 + placed
    return np.where(lands, number, np.where(path == 0, 0, -number)).astype(np.int32)
