"""Penumbra casting: which samples of a lamp are blocked for which receivers, as rays would say, but for most without rays.

After Laine and Aila, Hierarchical Penumbra Casting (2005): many receivers and the whole lamp are decided at once. A
cluster of receivers whose shaft towards the lamp is empty sees all of it; one behind a single polygon for every receiver
and sample sees none. For the others each polygon's edges are lines across the lamp (see lines.py), and what those leave
open is decided by the very rays that brute force would cast. So the result is that of rays, to the last bit.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

import numpy as np

from ..rays import chunks, in_threads
from .casting import cast_rays, settle, trace_all, trace_open
from .cost import Cost
from .lamp import LampSamples
from .lines import line_table
from .masks import AWAY, LIT, UMBRA, Masks, Statistics, full_mask, words_of
from .occluders import LampView, Occluders
from .receivers import CLUSTER, Receivers, clusters
from .shafts import Boxes, candidates
from .silhouettes import line_items

BATCH = 128
"""Clusters decided together: enough that numpy's calls cost little, few enough for the cache."""

ITEMS = 1024
"""Lines of a step, CLUSTER values each: its arrays stay in the second-level cache."""


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
    return Masks(index, np.concatenate(words), lamp.count, work.statistics(index))


@dataclass
class _Tally:
    """What threads have counted so far."""

    rays: int = 0
    pairs: int = 0
    clusters: int = 0
    mixed: int = 0
    by_rays: int = 0


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
        self.full = full_mask(lamp.count)
        self.tally = _Tally()
        self.seconds: dict[str, float] = {}
        self._lock = threading.Lock()

    def _guard(self, deepest):
        """Width of the band along lines in which rays decide, in the table's units: what float32 rays can be wrong by."""
        if self.lamp.distant:
            size = 1.0
        else:
            size = deepest + float(np.abs(self.lamp.centre).max()) + float(np.abs(self.used).max(initial=0))
        return max(1e-4, 16 * 6e-8 * size / float(self.lamp.half[:2].min()))

    def note(self, stage, seconds):
        with self._lock:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds

    def decide(self, part: slice) -> tuple[np.ndarray, np.ndarray]:
        """(n,) int32 index of the receivers of these clusters, and words of the mixed ones, counted from 0."""
        began = time.thread_time()
        rows = self.groups[part]
        place = (self.receivers.position[rows] - self.origin) @ self.lamp.axes.T
        boxes = Boxes(place.min(axis=1).astype(np.float32), place.max(axis=1).astype(np.float32))
        state = np.full(len(rows), LIT, np.int32)
        cluster, polygon, crowded = candidates(boxes, self.view.tree, self.lamp, 4 * self.cost.most_candidates())
        found = time.thread_time()
        crowded |= np.bincount(cluster, minlength=len(rows)) > self.cost.most_candidates()
        keep = ~crowded[cluster]
        cluster, polygon = cluster[keep], polygon[keep]
        if self.table is None:
            crowded[cluster] = True
            items = None
        else:
            items = line_items(self.view, place, cluster, polygon, self.table)
            state[items.dark] = UMBRA
            crowded |= self.cost.prefers_rays(items.lines)
            items.drop(crowded)
            state[items.cluster] = 0
        state[crowded] = 0
        culled = time.thread_time()
        index = np.repeat(state, CLUSTER)
        words, spent_rays, spent_lines, rays = self._mixed(rows, place, state, crowded, items)
        mixed = np.flatnonzero(index == 0)
        own, kept = settle(words, self.lamp.count)
        index[mixed] = own
        with self._lock:
            self.tally.rays += rays
            self.tally.by_rays += int(crowded.sum())
            self.tally.clusters += len(rows)
            self.tally.mixed += int((state == 0).sum())
            self.tally.pairs += 0 if items is None else len(items.cluster)
        for stage, seconds in (
            ("shafts", found - began),
            ("bounds", culled - found),
            ("lines", spent_lines),
            ("rays", spent_rays),
        ):
            self.note(stage, seconds)
        return index, kept

    def _mixed(self, rows, place, state, crowded, items):
        """(m, words) uint64 masks of the receivers of clusters that are neither lit nor dark, row by row; seconds of
        rays and of lines, and how many rays."""
        open_clusters = np.flatnonzero(state == 0)
        words = np.zeros((len(open_clusters), CLUSTER, len(self.full)), np.uint64)
        slot = np.full(len(rows), -1)
        slot[open_clusters] = np.arange(len(open_clusters))
        rays, spent_rays, spent_lines = 0, 0.0, 0.0
        given_up = np.flatnonzero(crowded)
        if len(given_up):
            began = time.thread_time()
            traced = rows[given_up].ravel()
            found = trace_all(self.receivers, traced, self.lamp, self.targets, self.occluders.occluded)
            words[slot[given_up]] = found.reshape(len(given_up), CLUSTER, -1)
            rays += len(traced) * self.lamp.count
            spent_rays += time.thread_time() - began
            self.cost.learn_rays(len(traced) * self.lamp.count, spent_rays)
        if items is not None and len(items.cluster):
            for first, last in items.steps(ITEMS):
                began = time.thread_time()
                which, sure, maybe = items.masks(first, last, place, self.receivers, rows, self.table)
                open_words = maybe & ~sure
                middle = time.thread_time()
                traced = rows[which].ravel()
                count = trace_open(
                    self.receivers, traced, self.lamp, self.targets, self.occluders.occluded, open_words, sure
                )
                words[slot[which]] = sure.reshape(len(which), CLUSTER, -1)
                end = time.thread_time()
                rays += count
                spent_lines += middle - began
                spent_rays += end - middle
                self.cost.learn_lines(int(items.first[last] - items.first[first]), middle - began)
        return words.reshape(-1, words.shape[2]), spent_rays, spent_lines, rays

    def statistics(self, index) -> Statistics:
        samples = self.lamp.count
        count = lambda state: int((index == state).sum()) * samples  # noqa: E731
        relations = len(index) * samples
        lit, umbra, away = count(LIT), count(UMBRA), count(AWAY)
        tally = self.tally
        return Statistics(
            relations, lit, umbra, away, relations - lit - umbra - away - tally.rays, tally.rays,
            tally.pairs / max(tally.mixed - tally.by_rays, 1), tally.by_rays / max(tally.clusters, 1), dict(self.seconds),
        )  # fmt: skip
