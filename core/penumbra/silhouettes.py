"""The lines that a cluster's candidates draw across the lamp, and the masks that follow from them.

An edge which all receivers of a cluster and all samples see on its inner side is left out (the paper's active plane
sets); a polygon without any edge left hides the whole lamp from the whole cluster (its umbra); one of whose edges all
are outside hides nothing. The same three cases are then told apart for each receiver, before any sample is looked at.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from .lines import ROUNDING, LineTable
from .masks import full_mask
from .occluders import LampView
from .receivers import CLUSTER, Receivers


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

        place: (clusters, CLUSTER, 3) float64 in the lamp's frame. rows: (clusters, CLUSTER) of the receivers.
        """
        cluster, count = self.cluster[first:last], self.count[first:last]
        begin = np.flatnonzero(np.append(True, cluster[1:] != cluster[:-1]))
        which = cluster[begin]
        pairs = np.append(begin, len(cluster))
        lines = self.first[first + pairs]
        ga, gb, g0 = self._values(lines, place[which] - self.middle[which][:, None])
        # lines that miss the lamp have it on one side as a whole
        size = np.abs(ga)
        size += np.abs(gb)
        edge = size * np.float32(1 + table.guard)
        edge += 2 * ROUNDING
        inside = g0 > edge
        edge += g0
        outside = edge < 0
        crossing, need, dark = _undecided(inside, outside, pairs, lines - lines[0], count)
        place_of = np.flatnonzero(crossing)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            index = table.index(ga[place_of], gb[place_of], g0[place_of])
        # too close to a receiver for float32; planes through the cluster are made so that they end here too
        index[size[place_of] < np.float32(2 * ROUNDING / table.guard)] = table.unknown
        if table.sets > 1:
            index += self._sets(place_of, lines - lines[0], receivers, rows[which], table, index == table.unknown)
        sure = np.zeros((len(which) * CLUSTER, table.words), np.uint64)
        maybe = np.zeros_like(sure)
        self._combine(index, need, table, sure, maybe)
        sure[dark] = maybe[dark] = full_mask(table.samples)
        return which, sure, maybe

    def _values(self, lines, local):
        """ga, gb and g0, three (e,) float32: for each cluster a block of CLUSTER rows, a value for each of its lines."""
        coefficient = self.coefficient[lines[0] : lines[-1]]
        value = np.empty((3, CLUSTER * len(coefficient)), np.float32)
        around = np.ones((len(local), CLUSTER, 4), np.float32)
        around[:, :, 1:] = local
        lines = lines - lines[0]
        for k in range(3):
            part = np.ascontiguousarray(coefficient[:, k].T)
            for a, b, place in zip(lines[:-1], lines[1:], around, strict=True):
                # small enough for BLAS to stay on this thread
                np.matmul(place, part[:, a:b], out=value[k, CLUSTER * a : CLUSTER * b].reshape(CLUSTER, b - a))
        return value

    def _sets(self, place_of, lines, receivers, rows, table, unknown):
        """(n,) rows by which the tables of other sets lie further on, for values at `place_of` of the blocks."""
        block = np.repeat(np.arange(len(rows)), np.diff(np.searchsorted(place_of, CLUSTER * lines)))
        receiver = (place_of - CLUSTER * lines[block]) // np.diff(lines)[block]
        sets = receivers.sets(rows.ravel()).reshape(rows.shape)
        return np.where(unknown, 0, sets[block, receiver] * table.rows_per_set)

    def _combine(self, index, need, table, sure, maybe):
        """Polygons hide what all their edges have inside, receivers lose what any polygon hides."""
        receiver, count = need
        if not len(receiver):
            return
        begin = np.cumsum(count) - count
        mask = np.empty((len(count), 2 * table.words), np.uint64)
        for size in range(1, int(count.max()) + 1):
            own = np.flatnonzero(count == size)
            for part in range(0, len(own), 4096):
                some = own[part : part + 4096]
                at = begin[some]
                hidden = table.rows.take(index[at], axis=0)
                for k in range(1, size):
                    hidden &= table.rows.take(index[at + k], axis=0)
                mask[some] = hidden
        starts = np.flatnonzero(np.append(True, receiver[1:] != receiver[:-1]))
        total = np.bitwise_or.reduceat(mask, starts, axis=0)
        sure[receiver[starts]], maybe[receiver[starts]] = total[:, : table.words], total[:, table.words :]


def _undecided(inside, outside, pairs, lines, count):
    """What is left to the table: crossing (e,) bool, lines that cut the lamp and matter; ((n,) receiver, (n,) lines) of
    each pair and receiver with such lines, in their order; (c · CLUSTER,) bool receivers that see nothing at all."""
    crossing = np.empty(len(inside), bool)
    receiver, left = [], []
    dark = np.zeros((len(pairs) - 1, CLUSTER), bool)
    for block, (a, b, p, q) in enumerate(zip(lines[:-1], lines[1:], pairs[:-1], pairs[1:], strict=True)):
        part = slice(CLUSTER * a, CLUSTER * b)
        starts = np.cumsum(count[p:q]) - count[p:q]
        # in one sum: lines that cut the lamp, and by 256s those that have it outside
        state = (~inside[part]).reshape(CLUSTER, b - a).astype(np.uint16)
        state += outside[part].reshape(CLUSTER, b - a) * np.uint16(255)
        need = np.add.reduceat(state, starts, axis=1)
        dark[block] = (need == 0).any(axis=1)
        alive = (need < 256) & ~dark[block][:, None]
        crossing[part] = ((state == 1) & np.repeat(alive, count[p:q], axis=1)).ravel()
        some = np.flatnonzero(alive)
        receiver.append(some // (q - p) + block * CLUSTER)
        left.append(need.ravel()[some])
    return crossing, (np.concatenate(receiver), np.concatenate(left).astype(np.intp)), dark.ravel()


def line_items(view: LampView, place: np.ndarray, cluster: np.ndarray, polygon: np.ndarray, table: LineTable) -> Items:
    """Lines of candidate pairs (cluster, polygon), two (n,) sorted by cluster.

    place: (c, CLUSTER, 3) float64 receivers in the lamp's frame.
    """
    low, high = place.min(axis=1), place.max(axis=1)
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
