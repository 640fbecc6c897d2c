"""Hierarchical penumbra casting as the paper has it: slow, readable, the reference that faster ones are compared with.

Laine & Aila 2005, Hierarchical Penumbra Casting. Rays are transposed: instead of finding for each relation of receiver
and sample a triangle that blocks it, find for each triangle all relations that it blocks. Each triangle's penumbra
volumes descend a hierarchy of receivers ("Processing a Triangle"), and hard shadows decide in its leaves. What they
leave open, being too near an edge, is asked of the very ray that brute force would cast. So the masks are its masks.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ..rays import chunks
from .casting import RAYS, Occluded, settle, trace_open
from .lamp import LampSamples
from .masks import AWAY, LIT, Masks, Statistics, words_from
from .receivers import Receivers, facing
from .volumes import LightHierarchy, Space, cross, hard_shadows, light_hierarchy, penumbra_volumes

LEAF = 8
"""Receivers of a leaf, at most."""

PROBES = 32
"""Receivers that are asked which triangles look large."""


@dataclass(frozen=True)
class Optimisations:
    """Those of the paper ("Optimizations") that can be done without; none changes a bit.

    umbra: receivers that see nothing of the lamp any more are done with, and so are nodes of nothing else.
    rebuild: the receiver hierarchy is built anew, of those that still see some of it, once so large a part of it is in
        umbra; 1 for never. Only with umbra.
    plane_sets: planes that a node is wholly inside of are not tested below it.
    sort: triangles that seem to block most go first, so that umbra is found early.
    """

    umbra: bool = True
    rebuild: float = 0.5
    plane_sets: bool = True
    sort: bool = True


@dataclass
class Work:
    """What a cast took: triangles whose penumbra volume holds receivers, nodes visited, planes tested against boxes of
    nodes, relations tested in leaves, hierarchies rebuilt, masks allotted."""

    triangles: int = 0
    nodes: int = 0
    planes: int = 0
    relations: int = 0
    rebuilds: int = 0
    masks: int = 0


def cast_hierarchically(
    receivers: Receivers,
    lamp: LampSamples,
    corners: np.ndarray,
    occluded: Occluded,
    optimisations: Optimisations | None = None,
    work: Work | None = None,
) -> Masks:
    """All relations between receivers and a lamp's samples: the masks of `cast_rays`, bit for bit.

    corners: (T, 3, 3) float32, m, of the triangles that `occluded` (as Bvh.occluded) knows, no more and no fewer; both
    their sides block. Takes the time of T · log R calls of numpy: meant for hundreds of triangles. `work` is added to.
    Statistics: lit, of receivers that no triangle comes near; umbra, of those that geometry finds wholly blocked.
    """
    optimisations, work = optimisations or Optimisations(), work or Work()
    began = perf_counter()
    rows = np.flatnonzero(facing(receivers, lamp))
    marks = Marks(len(receivers), lamp.count)
    # a triangle that is a point has no inside; Embree misses it always, and drops what is not finite
    corners = np.asarray(corners, np.float32)
    corners = corners[np.isfinite(corners).all(axis=(1, 2)) & np.ptp(corners, axis=1).any(axis=1)]
    if len(rows) and len(corners):
        targets = lamp.targets()
        space = Space.around(receivers.position[rows], corners, *([] if lamp.distant else [targets]))
        points = space.local(receivers.position)
        cast = Cast(points, receivers.sets(np.arange(len(receivers))), light_hierarchy(lamp, space), marks, space.band)
        triangles = space.local(corners)
        if optimisations.sort:
            probes = points[rows[:: -(-len(rows) // PROBES)]]
            triangles = triangles[np.argsort(-blocking_power(triangles, probes, cast.lights), kind="stable")]
        cast.all(triangles, rows, optimisations, work)
    settled = perf_counter()
    masks = marks.resolve(receivers, rows, lamp, occluded)
    work.masks += marks.count
    masks.statistics.seconds = {"geometry": settled - began, "rays": perf_counter() - settled}
    return masks


class Marks:
    """What is known of R receivers' relations to L samples; memory only for receivers that something came near
    ("Optimizations", on-demand bit mask allocation).

    full: (R,) bool, whether every sample is blocked. count: masks allotted.
    """

    def __init__(self, receivers: int, samples: int):
        self.full = np.zeros(receivers, bool)
        self.count = 0
        self._slot = np.full(receivers, -1, np.int32)
        # a byte a bit while bits are set, 0 open, 1 blocked
        self._blocked = np.zeros((64, samples), bool)
        self._open = np.zeros((64, samples), bool)

    def note(self, rows: np.ndarray, samples: np.ndarray, blocked: np.ndarray, undecided: np.ndarray) -> None:
        """Add what a triangle does to distinct relations of receivers `rows` and `samples`; all (n,), two of them bool."""
        touched = blocked | undecided
        rows, samples = rows[touched], samples[touched]
        receivers = np.unique(rows)
        self._allot(receivers[self._slot[receivers] < 0])
        place = self._slot[rows], samples
        self._blocked[place] |= blocked[touched]
        self._open[place] |= undecided[touched]
        self.full[receivers] = self._blocked[self._slot[receivers]].all(axis=1)

    def _allot(self, rows) -> None:
        self._slot[rows] = np.arange(self.count, self.count + len(rows))
        self.count += len(rows)
        while self.count > len(self._blocked):
            self._blocked = np.concatenate([self._blocked, np.zeros_like(self._blocked)])
            self._open = np.concatenate([self._open, np.zeros_like(self._open)])

    def resolve(self, receivers: Receivers, rows: np.ndarray, lamp: LampSamples, occluded: Occluded) -> Masks:
        """Trace what is open, and give the masks; receivers that are not in `rows` (n,) face away."""
        count = lamp.count
        touched = rows[self._slot[rows] >= 0]
        slots = self._slot[touched]
        words = words_from(self._blocked[slots])
        undecided = words_from(self._open[slots] & ~self._blocked[slots])
        targets, rays = lamp.targets(), 0
        for part in chunks(len(touched), max(1, RAYS // count)):
            rays += trace_open(receivers, touched[part], lamp, targets, occluded, undecided[part], words[part])
        index = np.full(len(receivers), AWAY, np.int32)
        index[rows] = LIT
        index[touched], words = settle(words, count)
        statistics = Statistics(relations=len(receivers) * count, rays=rays)
        statistics.away = (len(receivers) - len(rows)) * count
        statistics.lit = (len(rows) - len(touched)) * count
        statistics.umbra = int(np.count_nonzero(self.full)) * count
        statistics.geometry = len(rows) * count - statistics.lit - statistics.umbra - rays
        return Masks(index, words, count, statistics)


@dataclass
class Tree:
    """Hierarchy of receivers: axis-aligned boxes, halves of about equal number ("The Acceleration Structures").

    order: (n,) rows of the receivers, those of a node side by side. first, last: (nodes,) its part of them.
    middle, half: (nodes, 3) float64, of its box, local. child: (nodes,) the first of two children, −1 for leaves.
    dark: (nodes,) the umbra bits: whether all its receivers see nothing of the lamp.
    """

    order: np.ndarray
    first: np.ndarray
    last: np.ndarray
    middle: np.ndarray
    half: np.ndarray
    child: np.ndarray
    dark: np.ndarray

    @classmethod
    def build(cls, points: np.ndarray, rows: np.ndarray) -> Tree:
        """Of points[rows], at least one; node 0 is the root."""
        order = rows.copy()
        spans, boxes, child = [(0, len(order))], [], []
        # grows while it is walked: breadth first
        for first, last in spans:
            inside = points[order[first:last]]
            low, high = inside.min(axis=0), inside.max(axis=0)
            boxes.append(((low + high) / 2, (high - low) / 2))
            child.append(len(spans) if last - first > LEAF else -1)
            if last - first > LEAF:
                cut = (last - first) // 2
                along = np.argpartition(inside[:, np.argmax(high - low)], cut)
                order[first:last] = order[first:last][along]
                spans += [(first, first + cut), (first + cut, last)]
        first, last = np.array(spans).T
        middle, half = np.moveaxis(np.array(boxes), 1, 0)
        return cls(order, first, last, middle, half, np.array(child), np.zeros(len(spans), bool))

    def darken(self, full: np.ndarray) -> int:
        """Set the umbra bits from those of receivers, (R,) bool; returns how many receivers still see something."""
        done = np.append(0, np.cumsum(full[self.order]))
        self.dark = done[self.last] - done[self.first] == self.last - self.first
        return int(len(self.order) - done[-1])

    def receivers(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m,) rows of the receivers of nodes (n,), and (m,) which of these nodes each is in."""
        counts = self.last[nodes] - self.first[nodes]
        node = np.repeat(np.arange(len(nodes)), counts)
        place = np.arange(len(node)) - np.repeat(np.cumsum(counts) - counts, counts)
        return self.order[self.first[nodes][node] + place], node


class Front(NamedTuple):
    """Nodes (n,) of one level of the receiver hierarchy, and what of a triangle is still active there.

    groups: (n, g) bool, light groups. main_planes, group_planes: (n, p) bool, planes of their volumes.
    """

    nodes: np.ndarray
    groups: np.ndarray
    main_planes: np.ndarray
    group_planes: np.ndarray

    def take(self, which: np.ndarray) -> Front:
        return Front(*(array[which] for array in self))

    def children(self, tree: Tree) -> Front:
        """Those below, with the same lists."""
        child = tree.child[self.nodes]
        below = (np.concatenate([array, array]) for array in self[1:])
        return Front(np.concatenate([child, child + 1]), *below)


@dataclass(frozen=True)
class Cast:
    """points: (R, 3) float64 local places of receivers. of_set: (R,) which samples each looks at. band: local guard."""

    points: np.ndarray
    of_set: np.ndarray
    lights: LightHierarchy
    marks: Marks
    band: float

    def all(self, triangles: np.ndarray, rows: np.ndarray, optimisations: Optimisations, work: Work) -> None:
        """Find what triangles (T, 3, 3), local, do to the receivers `rows`."""
        tree = Tree.build(self.points, rows)
        for triangle in triangles:
            nodes, groups = self.descend(triangle, tree, optimisations, work)
            if not len(nodes):
                continue
            self.shade(triangle, tree, nodes, groups, optimisations, work)
            if not optimisations.umbra:
                continue
            left = tree.darken(self.marks.full)
            if not left:
                return
            if left < (1 - optimisations.rebuild) * len(tree.order):
                tree = Tree.build(self.points, tree.order[~self.marks.full[tree.order]])
                work.rebuilds += 1

    def descend(self, triangle, tree: Tree, optimisations: Optimisations, work: Work) -> tuple[np.ndarray, np.ndarray]:
        """(n,) leaves of the receiver hierarchy that a triangle may touch, and (n, g) bool their active light groups.

        Steps 1 to 3 of "Processing a Triangle", a level at a time. Groups' volumes are made only once the main one
        holds a receiver node.
        """
        keep = not optimisations.plane_sets
        main, groups = penumbra_volumes(triangle, self.lights.root, self.lights, self.band), None
        front = Front(np.zeros(1, np.intp), *(np.ones((1, n), bool) for n in (0, len(main.planes), 0)))
        leaves = []
        while len(front.nodes):
            if optimisations.umbra:
                front = front.take(~tree.dark[front.nodes])
            work.nodes += len(front.nodes)
            inside = np.ones((len(front.nodes), 1), bool)
            boxes = tree.middle[front.nodes], tree.half[front.nodes]
            work.planes += main.meet(*boxes, inside, front.main_planes, keep)
            front = front.take(inside[:, 0])
            if not len(front.nodes):
                break
            if groups is None:
                work.triangles += 1
                groups = penumbra_volumes(triangle, self.lights.groups, self.lights, self.band)
                every = (np.ones((1, n), bool) for n in (len(self.lights.groups), len(groups.planes)))
                front = front._replace(**dict(zip(("groups", "group_planes"), every, strict=True)))
            boxes = tree.middle[front.nodes], tree.half[front.nodes]
            work.planes += groups.meet(*boxes, front.groups, front.group_planes, keep)
            front = front.take(front.groups.any(axis=1))
            leaf = tree.child[front.nodes] < 0
            leaves.append((front.nodes[leaf], front.groups[leaf]))
            front = front.take(~leaf).children(tree)
        if not leaves:
            return np.zeros(0, np.intp), np.zeros((0, len(self.lights.groups)), bool)
        return tuple(np.concatenate(part) for part in zip(*leaves, strict=True))

    def shade(self, triangle, tree: Tree, nodes, groups, optimisations: Optimisations, work: Work) -> None:
        """Step 4: the receivers of leaves `nodes` (n,) against hard shadows of samples in active groups (n, g) bool."""
        rows, leaf = tree.receivers(nodes)
        active = groups[leaf]
        if optimisations.umbra:
            active &= ~self.marks.full[rows, None]
        # only samples in reach of a receiver get hard shadows
        receiver, sample = np.nonzero(active[np.arange(len(rows))[:, None], self.lights.group[self.of_set[rows]]])
        rows = rows[receiver]
        chosen, which = np.unique(self.of_set[rows] * self.lights.group.shape[1] + sample, return_inverse=True)
        shadows = hard_shadows(triangle, self.lights, chosen, self.band)
        self.marks.note(rows, sample, *shadows.test(self.points[rows], which))
        work.relations += len(rows)


def blocking_power(triangles: np.ndarray, probes: np.ndarray, lights: LightHierarchy) -> np.ndarray:
    """(T,) how much of the lamp triangles (T, 3, 3) may block from probes (n, 3), roughly ("coarse blocker sorting").

    The mean solid angle that a triangle fills there (Van Oosterom & Strackee 1983), less what is off the lamp's way.
    """
    lamp = lights.root[0].mean(axis=0) - lights.near * probes
    lamp /= np.maximum(np.linalg.norm(lamp, axis=1, keepdims=True), 1e-12)
    spokes = triangles[:, None] - probes[:, None]
    spokes /= np.maximum(np.linalg.norm(spokes, axis=3, keepdims=True), 1e-12)
    a, b, c = np.moveaxis(spokes, 2, 0)
    volume = np.abs((a * cross(b, c)).sum(axis=2))
    angle = 2 * np.arctan2(volume, 1 + (a * b).sum(axis=2) + (b * c).sum(axis=2) + (c * a).sum(axis=2))
    towards = np.einsum("tnd,nd->tn", a + b + c, lamp) / 3
    return (angle * np.maximum(towards, 0) ** 2).mean(axis=1)
