"""Charts packed into a square of cells, at least two empty cells apart.

Falling-block packing after Lévy et al., *Least Squares Conformal Maps* (2002): every chart drops
onto the skyline of those before it, in whichever quarter turn and column suits it best. Profiles
are conservative (each cell that a chart touches is its own), so the distance between charts is
exact by construction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MARGIN = 1  # cells around each chart; two neighbours make two cells
FEW = 250  # charts
COLUMNS = 16  # cells; a wider chart is not tried in every column
INSET = 0.01  # cells that a chart stays off its cells' borders, so that float32 UVs don't cross them
EMPTY = np.iinfo(np.int32).max // 2


@dataclass
class Charts:
    """Flat charts, in metres.

    points: (P, 2) float64, every chart's minimum corner at the origin. chart: (P,) int, of each point.
    edges: (E, 2) int, pairs of points, at least every chart's outline. count: number of charts.
    turnable: (count,) bool, whether quarter turns are allowed.
    """

    points: np.ndarray
    chart: np.ndarray
    edges: np.ndarray
    count: int
    turnable: np.ndarray


@dataclass
class Placement:
    """Where each chart went: point · density, turned by `turn` quarter turns, plus `offset`, in cells.

    offset: (count, 2) int. turn: (count,) int. extent: (count, 2) int, cells before the turn.
    height: highest cell in use.
    """

    offset: np.ndarray
    turn: np.ndarray
    extent: np.ndarray
    height: int

    def apply(self, points: np.ndarray, chart: np.ndarray) -> np.ndarray:
        """(P, 2) points already in cells, (P,) chart of each → (P, 2) places in cells."""
        x, y = points[:, 0] + INSET, points[:, 1] + INSET
        w, h = self.extent[chart, 0], self.extent[chart, 1]
        turn = self.turn[chart]
        turned = np.stack(
            [np.choose(turn, [x, h - y, w - x, y]), np.choose(turn, [y, x, h - y, w - x])],
            axis=1,
        )
        return turned + self.offset[chart]


def _profiles(points, edges, edge_chart, count, axis, extent):
    """Lowest and highest cell touched in each column, of all charts in a row: two int arrays, and the starts."""
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    swap = a[:, axis] > b[:, axis]
    a, b = np.where(swap[:, None], b, a), np.where(swap[:, None], a, b)
    x0, y0, x1, y1 = a[:, axis], a[:, 1 - axis], b[:, axis], b[:, 1 - axis]
    first = np.floor(x0 - INSET + 1e-6).astype(np.int64)
    last = np.minimum(np.maximum(np.ceil(x1 + INSET - 1e-6).astype(np.int64) - 1, first), extent[edge_chart, axis] - 1)
    first = np.minimum(first, last)
    spans = last - first + 1
    owner = np.repeat(np.arange(len(edges)), spans)
    column = np.arange(spans.sum()) - np.repeat(np.cumsum(spans) - spans, spans) + first[owner]
    run = np.maximum(x1 - x0, 1e-12)[owner]
    slope = (y1 - y0)[owner] / run
    left = np.clip(column, x0[owner], x1[owner])
    right = np.clip(column + 1, x0[owner], x1[owner])
    low = y0[owner] + slope * (left - x0[owner])
    high = y0[owner] + slope * (right - x0[owner])
    # an upright edge has no slope to follow: it covers its whole height
    upright = (x1 - x0)[owner] < 1e-9
    low, high = np.where(upright, y0[owner], low), np.where(upright, y1[owner], high)
    low, high = np.minimum(low, high), np.maximum(low, high)
    # every chart has its columns and 2·MARGIN empty ones to each side, so that shifts stay within it
    widths = extent[:, axis] + 4 * MARGIN
    starts = np.concatenate([[0], np.cumsum(widths)])
    bottom, top = np.full(starts[-1], EMPTY, np.int32), np.full(starts[-1], -1, np.int32)
    cell = starts[edge_chart[owner]] + column + 2 * MARGIN
    np.minimum.at(bottom, cell, np.maximum(np.floor(low - INSET + 1e-6), 0).astype(np.int32))
    np.maximum.at(top, cell, np.ceil(high + INSET - 1e-6).astype(np.int32))
    top = np.where(bottom == EMPTY, top, np.maximum(top, bottom + 1))
    return bottom, top, starts


def _grow(bottom, top, starts):
    """Profiles with MARGIN cells all round, their lowest cell at 0: per chart (bottom, top)."""
    shifts = range(-MARGIN, MARGIN + 1)
    bottom = np.minimum.reduce([np.roll(bottom, shift) for shift in shifts])
    top = np.maximum.reduce([np.roll(top, shift) for shift in shifts]) + 2 * MARGIN
    ends = zip(starts[:-1] + MARGIN, starts[1:] - MARGIN, strict=True)
    return [(bottom[first:last], top[first:last]) for first, last in ends]


def pack(charts: Charts, density: float, width: int, height: int | None = None) -> Placement | None:
    """Pack at `density` cells per metre into width × height cells.

    None when the charts don't fit; without height the strip is as high as it needs to be. Few charts
    are tried in two orders, for luck matters with them and time does not.
    """
    points = charts.points * density + INSET
    edge_chart = charts.chart[charts.edges[:, 0]]
    extent = np.ones((charts.count, 2), np.int64)
    ends = points[charts.edges].max(axis=1)
    np.maximum.at(extent, edge_chart, np.ceil(ends + INSET - 1e-6).astype(np.int64))
    grown = extent + 2 * MARGIN
    if (grown.min(axis=1) > width).any() or (height and (grown.max(axis=1) > max(width, height)).any()):
        return None
    edges = charts.edges, edge_chart, charts.count
    columns = _grow(*_profiles(points, *edges, 0, extent))
    rows = _grow(*_profiles(points, *edges, 1, extent))
    orders = [extent.prod(axis=1), extent.max(axis=1)]
    for size in orders[: 2 if height and charts.count <= FEW else 1]:
        placed = _drop(columns, rows, extent, charts.turnable, np.argsort(-size, kind="stable"), width, height)
        if placed is not None:
            return placed
    return None


def _drop(columns, rows, extent, turnable, order, width, height) -> Placement | None:
    """Drop the charts in the given order, each where it rests lowest and covers least empty space."""
    grown = extent + 2 * MARGIN
    skyline = np.zeros(width, np.int32)
    windows: dict[int, np.ndarray] = {}
    offset, turn = np.zeros_like(extent), np.zeros(len(extent), np.int64)
    for k in order:
        sums = np.concatenate([[0], np.cumsum(skyline)])
        steps = np.flatnonzero(np.diff(skyline)) + 1
        best = None
        for turned, bottom, top in _turns(columns[k], rows[k], grown[k], turnable[k]):
            n = len(bottom)
            if n > width:
                continue
            if n not in windows:
                # a view of the skyline, which changes with it
                windows[n] = np.lib.stride_tricks.sliding_window_view(skyline, n)
            view, at = windows[n], np.arange(width - n + 1)
            if n > COLUMNS:
                # flush with a step to its left or right, or at even distances
                at = np.concatenate([at[:: n // COLUMNS], steps, steps - n, [width - n]])
                at = at[(at >= 0) & (at <= width - n)]
                view = view[at]
            place = np.maximum((view - bottom).max(axis=1), 0)
            peak = place + int(top.max())
            waste = place * n + int(bottom.sum()) - (sums[at + n] - sums[at])
            score = waste + peak * (n // 2)
            if height:
                score = np.where(peak > height, np.iinfo(np.int64).max, score)
            i = int(np.argmin(score))
            if height and peak[i] > height:
                continue
            if best is None or score[i] < best[0]:
                best = score[i], turned, int(at[i]), int(place[i]), top
        if best is None:
            return None
        _, turn[k], x, y, top = best
        skyline[x : x + len(top)] = y + top
        offset[k] = x + MARGIN, y + MARGIN
    return Placement(offset, turn, extent, int(skyline.max()))


def _turns(column, row, extent, turnable):
    """The chart's bottom and top profiles in each quarter turn (counted as in Placement) that is allowed and new."""
    bottom, top = column
    yield 0, bottom, top
    if not turnable:
        return
    left, right = row
    yield 1, left[::-1], right[::-1]
    if bottom.any() or (top != extent[1]).any():
        yield 2, extent[1] - top[::-1], extent[1] - bottom[::-1]
        yield 3, extent[0] - right, extent[0] - left
