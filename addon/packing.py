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


@dataclass
class Charts:
    """Flat charts, in metres.

    points: (P, 2) float64, every chart's minimum corner at the origin.
    edges: (E, 2) int, pairs of points. edge_chart: (E,) int. count: number of charts.
    turnable: (count,) bool, whether quarter turns are allowed.
    """

    points: np.ndarray
    edges: np.ndarray
    edge_chart: np.ndarray
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
        x, y = points[:, 0], points[:, 1]
        w, h = self.extent[chart, 0], self.extent[chart, 1]
        turn = self.turn[chart]
        turned = np.stack(
            [np.choose(turn, [x, h - y, w - x, y]), np.choose(turn, [y, x, h - y, w - x])],
            axis=1,
        )
        return turned + self.offset[chart]


def _profiles(points, edges, edge_chart, count, axis, extent):
    """Per chart the lowest and highest cell touched in each column: two flat int arrays and their starts."""
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    swap = a[:, axis] > b[:, axis]
    a, b = np.where(swap[:, None], b, a), np.where(swap[:, None], a, b)
    x0, y0, x1, y1 = a[:, axis], a[:, 1 - axis], b[:, axis], b[:, 1 - axis]
    first = np.floor(x0).astype(np.int64)
    last = np.minimum(np.maximum(np.ceil(x1).astype(np.int64) - 1, first), extent[edge_chart, axis] - 1)
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
    widths = extent[:, axis]
    starts = np.concatenate([[0], np.cumsum(widths)])
    bottom = np.full(starts[-1], np.iinfo(np.int32).max, np.int64)
    top = np.full(starts[-1], -1, np.int64)
    cell = starts[edge_chart[owner]] + column
    np.minimum.at(bottom, cell, np.floor(low + 1e-6).astype(np.int64))
    np.maximum.at(top, cell, np.ceil(high - 1e-6).astype(np.int64))
    return np.maximum(bottom, 0), np.maximum(top, bottom + 1), starts


def _grow(bottom, top):
    """A chart's profile with MARGIN cells all round, its lowest cell at 0."""
    padded_bottom = np.pad(bottom, 2 * MARGIN, constant_values=np.iinfo(np.int32).max)
    padded_top = np.pad(top, 2 * MARGIN, constant_values=-1)
    window = 2 * MARGIN + 1
    return (
        np.lib.stride_tricks.sliding_window_view(padded_bottom, window).min(axis=1),
        np.lib.stride_tricks.sliding_window_view(padded_top, window).max(axis=1) + 2 * MARGIN,
    )


def pack(charts: Charts, density: float | np.ndarray, width: int, height: int | None = None) -> Placement | None:
    """Pack at `density` cells per metre ((count,) or scalar) into width × height cells.

    None when the charts don't fit; without height the strip is as high as it needs to be.
    """
    scale = np.broadcast_to(density, charts.count)
    points = charts.points * scale[_point_chart(charts)][:, None]
    extent = np.ones((charts.count, 2), np.int64)
    ends = points[charts.edges].max(axis=1)
    np.maximum.at(extent, charts.edge_chart, np.ceil(ends - 1e-6).astype(np.int64))
    grown = extent + 2 * MARGIN
    if (grown.min(axis=1) > width).any() or (height and (grown.max(axis=1) > max(width, height)).any()):
        return None
    columns = _profiles(points, charts.edges, charts.edge_chart, charts.count, 0, extent)
    rows = _profiles(points, charts.edges, charts.edge_chart, charts.count, 1, extent)
    skyline = np.zeros(width, np.int64)
    offset, turn = np.zeros((charts.count, 2), np.int64), np.zeros(charts.count, np.int64)
    for k in np.argsort(-(extent.max(axis=1) * 4 + extent.sum(axis=1)), kind="stable"):
        best = None
        for turned, bottom, top in _turns(k, columns, rows, extent[k], charts.turnable[k]):
            bottom, top = _grow(bottom, top)
            if len(bottom) > width:
                continue
            windows = np.lib.stride_tricks.sliding_window_view(skyline, len(bottom))
            place = np.maximum((windows - bottom).max(axis=1), 0)
            peak = place + top.max()
            waste = place * len(bottom) + bottom.sum() - windows.sum(axis=1)
            score = waste + peak * len(bottom) // 2
            if height:
                score = np.where(peak > height, np.iinfo(np.int64).max, score)
            x = int(np.argmin(score))
            if height and peak[x] > height:
                continue
            if best is None or score[x] < best[0]:
                best = (score[x], turned, x, int(place[x]), top)
        if best is None:
            return None
        _, turn[k], x, y, top = best
        skyline[x : x + len(top)] = y + top
        offset[k] = x + MARGIN, y + MARGIN
    return Placement(offset, turn, extent, int(skyline.max()))


def _point_chart(charts):
    chart = np.zeros(len(charts.points), np.int64)
    chart[charts.edges] = charts.edge_chart[:, None]
    return chart


def _turns(k, columns, rows, extent, turnable):
    """The chart's bottom and top profiles in each allowed quarter turn (counted as in Placement)."""
    bottom, top, starts = columns
    bottom, top = bottom[starts[k] : starts[k + 1]], top[starts[k] : starts[k + 1]]
    yield 0, bottom, top
    if not turnable:
        return
    left, right, starts = rows
    left, right = left[starts[k] : starts[k + 1]], right[starts[k] : starts[k + 1]]
    yield 1, left[::-1], right[::-1]
    yield 2, extent[1] - top[::-1], extent[1] - bottom[::-1]
    yield 3, extent[0] - right, extent[0] - left
