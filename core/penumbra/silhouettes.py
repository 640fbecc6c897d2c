"""The lines that a cluster's candidates draw across the lamp, and the masks that follow from them.

An edge which all receivers of a cluster and all samples see on its inner side is left out (the paper's active plane
sets); a polygon without any edge left hides the whole lamp from the whole cluster (its umbra); one of whose edges all
are outside hides nothing. The same three cases are then told apart for each receiver, before any sample is looked at.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from ..rays import chunks
from .lines import ROUNDING, LineTable
from .masks import full_mask
from .occluders import LampView
from .receivers import CLUSTER, Receivers

PAIRS = 4096
"""Pairs of a receiver and a polygon whose masks are made at once: a quarter of a megabyte at 256 samples."""


@dataclass
class Items:
    """Pairs of a cluster and a polygon, sorted by cluster, and the lines of each.

    cluster: (p,) int. count: (p,) int lines of each pair, at least one. lines: (clusters,) int lines of each cluster.
    dark: clusters that see nothing. coefficient: (l, 3, 4) float32, ga, gb and g0 around the cluster's middle (see
    lines.edge_coefficients), scaled so that their rounding errors are below lines.ROUNDING. middle: (clusters, 3).
    """

    cluster: np.ndarray
    count: np.ndarray
    lines: np.ndarray
    dark: np.ndarray
    coefficient: np.ndarray
    middle: np.ndarray
    first: np.ndarray = field(init=False)

    def __post_init__(self):
        self.first = np.append(0, np.cumsum(self.count))

    def drop(self, clusters: np.ndarray) -> None:
        """Leave out the pairs of clusters at which `clusters` (bool) is set."""
        if not clusters[self.cluster].any():
            return
        keep = ~clusters[self.cluster]
        self.coefficient = self.coefficient[np.repeat(keep, self.count)]
        self.cluster, self.count = self.cluster[keep], self.count[keep]
        self.first = np.append(0, np.cumsum(self.count))

    def steps(self, size: int) -> Iterator[tuple[int, int]]:
        """Ranges of pairs (first, last), whole clusters of about `size` lines."""
        if not len(self.cluster):
            return
        begin = np.flatnonzero(np.append(True, self.cluster[1:] != self.cluster[:-1]))
        ends = np.append(begin[1:], len(self.cluster))
        step = self.first[begin] // size
        cut = np.flatnonzero(np.append(True, step[1:] != step[:-1]))
        last = np.append(cut[1:], len(begin)) - 1
        for a, b in zip(cut, last, strict=True):
            yield int(begin[a]), int(ends[b])

    def masks(self, first: int, last: int, place, receivers: Receivers, rows, table: LineTable):
        """Clusters (c,) of the pairs first … last, and the samples that their polygons surely block, and may block, two
        (c · CLUSTER, words) uint64.

        place: (clusters, 3, CLUSTER) float64 in the lamp's frame. rows: (clusters, CLUSTER) of the receivers.
        """
        cluster, count = self.cluster[first:last], self.count[first:last]
        begin = np.flatnonzero(np.append(True, cluster[1:] != cluster[:-1]))
        which = cluster[begin]
        # lines of each pair, and of each cluster, counted from the first of this step
        starts = self.first[first:last] - self.first[first]
        ends = np.append(starts[begin], self.first[last] - self.first[first])
        lines = slice(int(self.first[first]), int(self.first[last]))
        ga, gb, g0 = self._values(lines, ends, place[which] - self.middle[which][:, :, None])
        # lines that miss the lamp have it on one side as a whole
        size = np.abs(ga)
        size += np.abs(gb)
        edge = size * np.float32(1 + table.guard)
        edge += 2 * ROUNDING
        inside = g0 > edge
        edge += g0
        outside = edge < 0
        crossing, need, dark = _undecided(inside, outside, starts, begin, count)
        at = np.flatnonzero(crossing)
        size = size.ravel().take(at)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            index = table.index(*(value.ravel().take(at) for value in (ga, gb, g0)))
        # too close to a receiver for float32; planes through the cluster are made so that they end here too
        index[size < np.float32(2 * ROUNDING / table.guard)] = table.unknown
        # receivers one after another, and for each its pairs in their order
        block = np.repeat(np.arange(len(which), dtype=np.uint16), np.diff(ends))
        receiver = _receiver(block, at)
        if table.sets > 1:
            sets = receivers.sets(rows[which].ravel())[receiver]
            index += np.where(index == table.unknown, 0, sets * table.rows_per_set)
        index = index.take(np.argsort(receiver, kind="stable"))
        pair = np.flatnonzero(need)
        block = np.repeat(np.arange(len(which), dtype=np.uint16), np.diff(np.append(begin, len(cluster))))
        receiver = _receiver(block, pair)
        order = np.argsort(receiver, kind="stable")
        sure = np.zeros((len(which) * CLUSTER, table.words), np.uint64)
        maybe = np.zeros_like(sure)
        _combine(index, receiver.take(order), need.ravel().take(pair).take(order), table, sure, maybe)
        sure[dark] = maybe[dark] = full_mask(table.samples)
        return which, sure, maybe

    def _values(self, lines, ends, local):
        """ga, gb and g0, (3, e, CLUSTER) float32, of these lines, each for the receivers of its cluster."""
        coefficient = np.ascontiguousarray(self.coefficient[lines].transpose(1, 0, 2))
        value = np.empty((*coefficient.shape[:2], CLUSTER), np.float32)
        around = np.ones((len(local), 4, CLUSTER), np.float32)
        around[:, 1:] = local
        for a, b, places in zip(ends[:-1], ends[1:], around, strict=True):
            # small enough for BLAS to stay on this thread
            np.matmul(coefficient[:, a:b], places, out=value[:, a:b])
        return value


def _receiver(block, at):
    """(n,) uint16 receivers, counted over all clusters, of places (n,) in rows of CLUSTER; block: cluster of each row."""
    return block.take(at // CLUSTER) * np.uint16(CLUSTER) + (at % CLUSTER).astype(np.uint16)


def _undecided(inside, outside, starts, begin, count):
    """What is left to the table: crossing (e, CLUSTER) bool, lines that cut the lamp and matter; (p, CLUSTER) uint8, how
    many of them each pair has; (c · CLUSTER,) bool receivers that see nothing at all.

    inside, outside: (e, CLUSTER) bool. starts: (p,) first line of each pair, begin: (c,) first pair of each cluster.
    """
    # eight receivers in a word
    word = np.uint64
    crossing = inside
    crossing |= outside
    np.logical_not(crossing, out=crossing)
    need = np.add.reduceat(crossing.view(word), starts, axis=0)
    none = np.bitwise_or.reduceat(outside.view(word), starts, axis=0).view(bool)
    dark = np.bitwise_or.reduceat((~none & (need.view(np.uint8) == 0)).view(word), begin, axis=0)
    gone = none.view(word) | np.repeat(dark, np.diff(np.append(begin, len(starts))), axis=0)
    alive = ~gone.view(bool)
    need = need.view(np.uint8) * alive
    crossing &= np.repeat(alive.view(word), count, axis=0).view(bool)
    return crossing, need, dark.view(bool).ravel()


def _combine(index, receiver, count, table, sure, maybe):
    """Polygons hide what all their edges have inside, receivers lose what any polygon hides.

    index: (n,) rows of the table, as many of them for each pair as `count` (m,) says. receiver: (m,) of each pair, sorted.

    The order of polygons is any: were those that hide most the first, as in the paper, receivers that see nothing could
    end early, but at most a twelfth of all rows is looked up for them (among boxes; a hundredth elsewhere).
    """
    if not len(receiver):
        return
    begin = np.cumsum(count, dtype=np.intp) - count
    mask = np.empty((len(count), 2 * table.words), np.uint64)
    for size in np.flatnonzero(np.bincount(count)):
        own = np.flatnonzero(count == size)
        for part in chunks(len(own), PAIRS):
            some = own[part]
            at = begin[some]
            hidden = table.rows.take(index[at], axis=0)
            for k in range(1, size):
                hidden &= table.rows.take(index[at + k], axis=0)
            mask[some] = hidden
    starts = np.flatnonzero(np.append(True, receiver[1:] != receiver[:-1]))
    total = np.bitwise_or.reduceat(mask, starts, axis=0)
    seen = receiver[starts]
    sure[seen], maybe[seen] = total[:, : table.words], total[:, table.words :]


def line_items(view: LampView, place: np.ndarray, cluster: np.ndarray, polygon: np.ndarray, table: LineTable) -> Items:
    """Lines of candidate pairs (cluster, polygon), two (n,) sorted by cluster.

    place: (c, 3, CLUSTER) float64 receivers in the lamp's frame.
    """
    low, high = place.min(axis=2), place.max(axis=2)
    # representable, so that differences from it lose nothing
    middle = ((low + high) / 2).astype(np.float32).astype(np.float64)
    half = np.maximum(high - middle, middle - low)
    near = view.occluders.near_plane
    # receivers beyond the polygon, as seen from the lamp?
    normal = view.normal[polygon]
    level = np.einsum("nd,nd->n", normal, middle[cluster]) - view.level[polygon]
    spread = np.einsum("nd,nd->n", np.abs(normal), half[cluster])
    keep = level - spread < near
    cluster, polygon, level, spread = cluster[keep], polygon[keep], level[keep], spread[keep]
    # lines of all polygons met
    met = np.zeros(len(view), bool)
    met[polygon] = True
    names = np.flatnonzero(met)
    number = np.empty(len(view), np.intp)
    number[names] = np.arange(len(names))
    lines, begin = view.coefficients(names)
    row = number[polygon]
    count = np.diff(begin)[row]
    first = np.append(0, np.cumsum(count))
    pair = np.repeat(np.arange(len(row)), count)
    line = np.arange(first[-1]) + np.repeat(begin[row] - first[:-1], count)
    lowest, highest = _bounds(
        lines, line, middle.astype(np.float32), half.astype(np.float32), cluster[pair], table.guard
    )
    outside = np.zeros(len(row), bool)
    outside[pair[highest < 0]] = True
    active = lowest < 0
    touching = view.touching[polygon]
    cuts_cluster = level + spread > -near
    covers = ~outside & (np.bincount(pair[active], minlength=len(row)) == 0) & ~cuts_cluster & ~touching
    dark = np.zeros(len(place), bool)
    dark[cluster[covers]] = True
    stays = ~outside & ~dark[cluster]
    use = np.flatnonzero(active & stays[pair])
    pieces = [(pair[use], _coefficients(lines, line[use], middle[cluster[pair[use]]], half[cluster[pair[use]]]))]
    # a line so thin that it is never looked up (see Items.masks): a receiver is on either side of it, or in doubt
    thin = float(ROUNDING) / table.guard
    rows = np.flatnonzero(cuts_cluster & stays)
    plane = np.zeros((len(rows), 3, 4), np.float32)
    plane[:, 0, 0] = thin
    plane[:, 2, 0] = -level[rows] * (thin / near)
    plane[:, 2, 1:] = -view.normal[polygon[rows]] * (thin / near)
    pieces.append((rows, plane))
    rows = np.flatnonzero(touching & stays)
    plane = np.zeros((len(rows), 3, 4), np.float32)
    plane[:, 0, 0] = thin
    pieces.append((rows, plane))
    owner, coefficient = (np.concatenate(p) for p in zip(*pieces, strict=True))
    order = np.argsort(owner, kind="stable")
    rows = np.flatnonzero(stays)
    count = np.bincount(owner, minlength=len(row))[rows]
    return Items(
        cluster=cluster[rows],
        count=count,
        lines=np.bincount(cluster[rows], count, len(place)),
        dark=np.flatnonzero(dark),
        coefficient=coefficient[order],
        middle=middle,
    )


def _bounds(lines, line, middle, half, own, guard):
    """Lowest and highest values (n,) float32 of the lines `line` over their cluster and the whole lamp, wider by the
    guard and by float32's rounding. `own`: (n,) cluster of each."""
    coefficient = lines.astype(np.float32)
    linear = np.ascontiguousarray(coefficient[:, :, 1:].transpose(1, 2, 0))
    constant = np.ascontiguousarray(coefficient[:, :, 0].T)
    around = [middle[own, d] for d in range(3)]
    reach = [half[own, d] for d in range(3)]
    total, size, swing = None, np.zeros(len(line), np.float32), np.zeros(len(line), np.float32)
    for k in range(3):
        value = constant[k][line]
        rough = np.abs(value)
        for d in range(3):
            # ga does not depend on x, gb not on y
            if k == d:
                continue
            slope = linear[k, d][line]
            term = slope * around[d]
            value += term
            rough += np.abs(term, out=term)
            np.abs(slope, out=slope)
            slope *= reach[d]
            swing += slope
        if k == 2:
            slope = linear[2, 2][line]
            term = slope * around[2]
            value += term
            rough += np.abs(term, out=term)
            np.abs(slope, out=slope)
            slope *= reach[2]
            swing += slope
            total = value
        else:
            size += np.abs(value)
        rough *= ROUNDING
        swing += rough
    size += swing
    size *= np.float32(1 + guard)
    return total - size, total + size


def _coefficients(lines, line, middle, half):
    """(n, 3, 4) float32 coefficients of the lines `line` around a cluster's middle (n, 3), half its size (n, 3)."""
    # float64: terms cancel
    chosen = lines[line]
    value = chosen[:, :, 0] + np.einsum("nkd,nd->nk", chosen[:, :, 1:], middle)
    swing = np.einsum("nkd,nd->nk", np.abs(chosen[:, :, 1:]), half)
    chosen[:, :, 0] = value
    scale = (np.abs(value) + swing).max(axis=1)
    return (chosen / np.maximum(scale, 1e-300)[:, None, None]).astype(np.float32)
