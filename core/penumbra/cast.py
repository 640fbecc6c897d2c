"""Penumbra casting: which samples of a lamp are blocked for which receivers, as rays would say, but for most without rays.

After Laine and Aila, Hierarchical Penumbra Casting (2005): many receivers and the whole lamp are decided at once. A
cluster of receivers whose shaft towards the lamp is empty sees all of it; one behind a single polygon for every receiver
and sample sees none. For the others each polygon's edges are lines across the lamp (see lines.py), and what those leave
open is decided by the very rays that brute force would cast. So the result is that of rays, to the last bit.
"""

from __future__ import annotations

import threading
import time
from collections import deque

import numpy as np

from ..rays import chunks
from ..threads import in_threads, thread_count
from .casting import RAYS, cast_rays, settle, trace_all, trace_open
from .cost import Cost
from .lamp import LampSamples
from .lines import line_table
from .masks import AWAY, LIT, UMBRA, Masks, Statistics, words_of
from .occluders import BLOCK, LampView, Occluders
from .receivers import CLUSTER, Receivers, clusters
from .shafts import Boxes, candidates
from .silhouettes import Items, line_items

BATCH = 128
LEAST_BATCH = 64
FIRST_BATCH = 32
"""Clusters decided together: enough that numpy's calls cost little, and few enough for all threads to have some."""

ITEMS = 2048
"""Lines of a step, CLUSTER values each: some megabytes. Shorter ones leave two threads waiting for each other's Python."""

PILOTS = 16
"""Clusters looked at before anything is prepared."""

BY_LINES, BY_RAYS = 0, 1
"""What else may become of a cluster, beside LIT and UMBRA."""


def cast(
    receivers: Receivers,
    lamp: LampSamples,
    occluders: Occluders,
    threads: int | None = None,
    cost: Cost | None = None,
) -> Masks:
    """Masks of the lamp's samples that are blocked, equal to `cast_rays`.

    cost: decides between lines and rays; None: as is fastest, learnt while casting.
    """
    cost = cost or Cost(lamp.count)
    threads = threads or thread_count()
    if not cost.worth(len(receivers)):
        return cast_rays(receivers, lamp, occluders.occluded, threads)
    began = time.thread_time()
    groups = clusters(receivers, lamp)
    work = _Work(receivers, lamp, occluders, groups, cost, threads)
    if not work.pilot():
        return cast_rays(receivers, lamp, occluders.occluded, threads)
    work.prepare()
    work.note("prepare", time.thread_time() - began)
    index = np.full(len(receivers), AWAY, np.int32)
    words = [np.zeros((0, work.words), np.uint64)]
    mixed = 0

    def keep(parts, results):
        nonlocal mixed
        for part, (found, own) in zip(parts, results, strict=True):
            found[found >= 0] += mixed
            index[groups[part].ravel()] = found
            mixed += len(own)
            words.append(own)

    parts = _batches(len(groups), threads)
    keep(parts, in_threads(work.step, parts, threads))
    in_threads(lambda _: work.trace_some(), range(len(work.left)), threads)
    if work.traced:
        keep(*zip(*sorted(work.traced, key=lambda found: found[0][0]), strict=True))
    return Masks(index, np.concatenate(words), lamp.count, work.statistics())


def _batches(count: int, threads: int) -> list[slice]:
    """Slices of range(count): some small ones, from which the cost of lines is learnt, before the others."""
    first = min(2 * threads * FIRST_BATCH, count)
    size = min(max((count - first) // (8 * threads), LEAST_BATCH), BATCH)
    rest = [slice(part.start + first, part.stop + first) for part in chunks(count - first, size)]
    return chunks(first, FIRST_BATCH) + rest


class _Work:
    """What all batches share."""

    def __init__(self, receivers: Receivers, lamp: LampSamples, occluders: Occluders, groups, cost: Cost, threads: int):
        self.receivers, self.lamp, self.occluders = receivers, lamp, occluders
        self.groups, self.cost, self.threads = groups, cost, threads
        self.targets = lamp.targets()
        self.origin = np.zeros(3) if lamp.distant else lamp.centre
        self.words = words_of(lamp.count)
        # what became of each cluster: LIT, UMBRA, BY_LINES or BY_RAYS
        self.state = np.full(len(groups), LIT, np.int32)
        self.rays = self.pairs = 0
        self.seconds: dict[str, float] = {}
        # clusters left to rays, some at a time, and what became of them
        self.left: deque[np.ndarray] = deque()
        self.traced: list[tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]] = []
        self._numpy = threading.Semaphore((threads + 1) // 2)
        self._lock = threading.Lock()

    def pilot(self) -> bool:
        """Whether there is anything to win, by what rays take here and by the blocks that a few clusters meet."""
        some = self.groups[:: max(1, len(self.groups) // PILOTS)]
        if not len(some):
            return True
        rows = some[:: max(1, len(some) * self.lamp.count // RAYS), 0]
        # twice: the second time the rays' hierarchy is at hand, as for most receivers of a cluster
        for _ in range(2):
            began = time.thread_time()
            trace_all(self.receivers, rows, self.lamp, self.targets, self.occluders.occluded)
            spent = time.thread_time() - began
        self.cost.learn_rays(len(rows) * self.lamp.count, spent)
        tree = self.occluders.blocks_before(self.lamp)
        met = candidates(self._boxes(self._place(some)), tree, self.lamp, np.inf)[0]
        blocks = np.bincount(met, minlength=len(some)) * BLOCK
        return self.cost.worth_preparing(blocks, len(self.groups), len(self.occluders.polygons), self.threads)

    def prepare(self) -> None:
        """All that `decide` needs."""
        used = self.receivers.position[self.groups.ravel()]
        deepest = float(((used - self.origin) @ self.lamp.axes[2]).max(initial=0.0))
        self.view = LampView(self.occluders, self.lamp, deepest)
        self.table = None
        if self.lamp.planar:
            self.table = line_table(self.lamp.places[..., :2], self._guard(deepest, used))

    def _guard(self, deepest, used):
        """Width of the band along lines in which rays decide, in the table's units: what float32 rays can be wrong by."""
        if self.lamp.distant:
            size = 1.0
        else:
            size = deepest + float(np.abs(self.lamp.centre).max()) + float(np.abs(used).max(initial=0))
        return max(1e-4, 16 * 6e-8 * size / float(self.lamp.half[:2].min()))

    def note(self, stage: str, seconds: float) -> None:
        """Add to the time of a stage."""
        with self._lock:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds

    def _place(self, rows):
        """(c, 3, CLUSTER) float64 places of receivers (c, CLUSTER), m, in the lamp's frame."""
        return np.matmul(self.lamp.axes, (self.receivers.position[rows] - self.origin).transpose(0, 2, 1))

    def _boxes(self, place):
        return Boxes(place.min(axis=2).astype(np.float32), place.max(axis=2).astype(np.float32))

    def step(self, part: slice) -> tuple[np.ndarray, np.ndarray]:
        """`decide`, and before it rays, if there are any, for as long as half of the threads do numpy's work: more of
        them wait for each other's Python, and rays don't."""
        turn = self._numpy.acquire(blocking=False)
        while not turn and self.trace_some():
            turn = self._numpy.acquire(blocking=False)
        try:
            result = self.decide(part)
        finally:
            if turn:
                self._numpy.release()
        crowded = part.start + np.flatnonzero(self.state[part] == BY_RAYS)
        step = max(1, 4 * RAYS // (CLUSTER * self.lamp.count))
        self.left.extend(crowded[some] for some in chunks(len(crowded), step))
        return result

    def trace_some(self) -> bool:
        """Trace some of the clusters that are left to rays; whether there were any."""
        try:
            which = self.left.popleft()
        except IndexError:
            return False
        self.traced.append((which, self.trace(which)))
        return True

    def decide(self, part: slice) -> tuple[np.ndarray, np.ndarray]:
        """(n,) int32 index of the receivers of these clusters, and words of the mixed ones, counted from 0.

        Clusters that are left to rays get a state, and nothing else.
        """
        began = time.thread_time()
        rows = self.groups[part]
        place = self._place(rows)
        state = self.state[part]
        cluster, polygon, crowded = candidates(
            self._boxes(place), self.view.tree, self.lamp, self.cost.most_in_blocks()
        )
        found = time.thread_time()
        self.note("shafts", found - began)
        if self.table is None:
            crowded[cluster] = True
            state[crowded] = BY_RAYS
            return np.repeat(state, CLUSTER), np.zeros((0, self.words), np.uint64)
        crowded |= np.bincount(cluster, minlength=len(rows)) > self.cost.most_candidates()
        keep = ~crowded[cluster]
        cluster, polygon = cluster[keep], polygon[keep]
        items = line_items(self.view, place, cluster, polygon, self.table)
        state[items.dark] = UMBRA
        spent = time.thread_time() - found
        self.note("bounds", spent)
        self.cost.learn_candidates(len(cluster), int(items.lines.sum()), spent)
        crowded |= self.cost.prefers_rays(items.lines)
        items.drop(crowded)
        state[items.cluster] = BY_LINES
        state[crowded] = BY_RAYS
        words = np.zeros((len(rows), CLUSTER, self.words), np.uint64)
        self._by_lines(rows, place, items, words)
        index = np.repeat(state, CLUSTER)
        mixed = index == BY_LINES
        index[mixed], kept = settle(words.reshape(-1, self.words)[mixed], self.lamp.count)
        return index, kept

    def _by_lines(self, rows, place, items: Items, words) -> None:
        """Set the words (clusters, CLUSTER, words) of the clusters of these items."""
        rays = 0
        for first, last in items.steps(ITEMS):
            began = time.thread_time()
            which, sure, maybe = items.masks(first, last, place, self.receivers, rows, self.table)
            maybe &= ~sure
            middle = time.thread_time()
            rays += trace_open(
                self.receivers, rows[which].ravel(), self.lamp, self.targets, self.occluders.occluded, maybe, sure
            )
            words[which] = sure.reshape(len(which), CLUSTER, -1)
            self.note("lines", middle - began)
            self.note("rays", time.thread_time() - middle)
            self.cost.learn_lines(int(items.first[last] - items.first[first]), time.thread_time() - began)
        with self._lock:
            self.rays += rays
            self.pairs += len(items.cluster)

    def trace(self, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same as `decide` of the clusters `which`, (n,) int, by rays alone."""
        began = time.thread_time()
        traced = self.groups[which].ravel()
        step = max(1, RAYS // self.lamp.count)
        parts = [
            trace_all(self.receivers, traced[part], self.lamp, self.targets, self.occluders.occluded)
            for part in chunks(len(traced), step)
        ]
        spent = time.thread_time() - began
        self.note("rays", spent)
        self.cost.learn_rays(len(traced) * self.lamp.count, spent)
        with self._lock:
            self.rays += len(traced) * self.lamp.count
        return settle(np.concatenate(parts), self.lamp.count)

    def statistics(self) -> Statistics:
        """Of all that was decided."""
        size = np.full(len(self.groups), CLUSTER)
        size[-1:] = len(np.unique(self.groups[-1:]))
        lit, umbra, lines, rays = (
            int(size[self.state == state].sum()) * self.lamp.count for state in (LIT, UMBRA, BY_LINES, BY_RAYS)
        )
        relations = len(self.receivers) * self.lamp.count
        return Statistics(
            relations=relations,
            lit=lit,
            umbra=umbra,
            away=relations - lit - umbra - lines - rays,
            geometry=lines + rays - self.rays,
            rays=self.rays,
            candidates=self.pairs / max(int((self.state == BY_LINES).sum()), 1),
            by_rays=float((self.state == BY_RAYS).sum() / max(len(self.groups), 1)),
            seconds=dict(self.seconds),
        )
