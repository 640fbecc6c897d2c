"""Penumbra casting: which samples of a lamp are blocked for which receivers, as rays would say, but for most without rays.

After Laine and Aila, Hierarchical Penumbra Casting (2005): many receivers and the whole lamp are decided at once. A
cluster of receivers whose shaft towards the lamp is empty sees all of it; one behind a single polygon for every receiver
and sample sees none. For the others each polygon's edges are lines across the lamp (see lines.py), and what those leave
open is decided by the very rays that brute force would cast. So the result is that of rays, to the last bit.
"""

from __future__ import annotations

import threading
import time

import numpy as np

from ..rays import chunks
from ..threads import in_threads
from .casting import RAYS, cast_rays, settle, trace_all, trace_open
from .cost import Cost
from .lamp import LampSamples
from .lines import line_table
from .masks import AWAY, LIT, UMBRA, Masks, Statistics, words_of
from .occluders import LampView, Occluders
from .receivers import CLUSTER, Receivers, clusters
from .shafts import Boxes, candidates
from .silhouettes import Items, line_items

BATCH = 128
"""Clusters decided together: enough that numpy's calls cost little."""

ITEMS = 2048
"""Lines of a step, CLUSTER values each: some megabytes. Shorter ones leave two threads waiting for each other's Python."""

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
    if not cost.worth(len(receivers)):
        return cast_rays(receivers, lamp, occluders.occluded, threads)
    began = time.thread_time()
    groups = clusters(receivers, lamp)
    index = np.full(len(receivers), AWAY, np.int32)
    if not len(groups):
        relations = len(receivers) * lamp.count
        return Masks(
            index, np.zeros((0, words_of(lamp.count)), np.uint64), lamp.count, Statistics(relations, away=relations)
        )
    work = _Work(receivers, lamp, occluders, groups, cost)
    work.note("prepare", time.thread_time() - began)
    parts = in_threads(work.decide, chunks(len(groups), BATCH), threads)
    mixed = 0
    words = []
    for part, (found, own) in zip(chunks(len(groups), BATCH), parts, strict=True):
        rows = groups[part].ravel()
        found[found >= 0] += mixed
        index[rows] = found
        mixed += len(own)
        words.append(own)
    return Masks(index, np.concatenate(words), lamp.count, work.statistics())


class _Work:
    """What all batches share."""

    def __init__(self, receivers: Receivers, lamp: LampSamples, occluders: Occluders, groups, cost: Cost):
        self.receivers, self.lamp, self.occluders = receivers, lamp, occluders
        self.groups, self.cost = groups, cost
        self.targets = lamp.targets()
        origin = np.zeros(3) if lamp.distant else lamp.centre
        self.origin = origin
        self.used = receivers.position[groups.ravel()]
        deepest = float(((self.used - origin) @ lamp.axes[2]).max(initial=0.0))
        self.view = LampView(occluders, lamp, deepest)
        self.table = None
        if lamp.planar:
            self.table = line_table(lamp.places[..., :2], self._guard(deepest))
        self.words = words_of(lamp.count)
        # what became of each cluster: LIT, UMBRA, BY_LINES or BY_RAYS
        self.state = np.full(len(groups), LIT, np.int32)
        self.rays = self.pairs = 0
        self.seconds: dict[str, float] = {}
        self._lock = threading.Lock()

    def _guard(self, deepest):
        """Width of the band along lines in which rays decide, in the table's units: what float32 rays can be wrong by."""
        if self.lamp.distant:
            size = 1.0
        else:
            size = deepest + float(np.abs(self.lamp.centre).max()) + float(np.abs(self.used).max(initial=0))
        return max(1e-4, 16 * 6e-8 * size / float(self.lamp.half[:2].min()))

    def note(self, stage: str, seconds: float) -> None:
        """Add to the time of a stage."""
        with self._lock:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds

    def decide(self, part: slice) -> tuple[np.ndarray, np.ndarray]:
        """(n,) int32 index of the receivers of these clusters, and words of the mixed ones, counted from 0."""
        began = time.thread_time()
        rows = self.groups[part]
        place = (self.receivers.position[rows] - self.origin) @ self.lamp.axes.T
        boxes = Boxes(place.min(axis=1).astype(np.float32), place.max(axis=1).astype(np.float32))
        state = self.state[part]
        most = self.cost.most_candidates()
        # blocks count more than is in them that matters
        cluster, polygon, crowded = candidates(boxes, self.view.tree, self.lamp, 4 * most)
        found = time.thread_time()
        self.note("shafts", found - began)
        crowded |= np.bincount(cluster, minlength=len(rows)) > most
        keep = ~crowded[cluster]
        cluster, polygon = cluster[keep], polygon[keep]
        words = np.zeros((len(rows), CLUSTER, self.words), np.uint64)
        if self.table is None:
            crowded[cluster] = True
        else:
            items = line_items(self.view, place, cluster, polygon, self.table)
            state[items.dark] = UMBRA
            crowded |= self.cost.prefers_rays(items.lines)
            items.drop(crowded)
            state[items.cluster] = BY_LINES
            self.note("bounds", time.thread_time() - found)
            self._by_lines(rows, place, items, words)
        state[crowded] = BY_RAYS
        self._by_rays(rows, np.flatnonzero(crowded), words)
        index = np.repeat(state, CLUSTER)
        mixed = index >= 0
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
            self.cost.learn_lines(int(items.first[last] - items.first[first]), middle - began)
        with self._lock:
            self.rays += rays
            self.pairs += len(items.cluster)

    def _by_rays(self, rows, which, words) -> None:
        """Set the words of the clusters `which` without any geometry."""
        if not len(which):
            return
        began = time.thread_time()
        traced = rows[which].ravel()
        step = max(1, RAYS // self.lamp.count)
        parts = [
            trace_all(self.receivers, traced[part], self.lamp, self.targets, self.occluders.occluded)
            for part in chunks(len(traced), step)
        ]
        words[which] = np.concatenate(parts).reshape(len(which), CLUSTER, -1)
        count = len(traced) * self.lamp.count
        spent = time.thread_time() - began
        self.note("rays", spent)
        self.cost.learn_rays(count, spent)
        with self._lock:
            self.rays += count

    def statistics(self) -> Statistics:
        """Of all that was decided."""
        size = np.full(len(self.groups), CLUSTER)
        size[-1] = len(np.unique(self.groups[-1]))
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
            by_rays=float((self.state == BY_RAYS).mean()),
            seconds=dict(self.seconds),
        )
