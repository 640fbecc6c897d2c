"""Power spread into texels: patches of light as many small boxes, each shared exactly by the texels that it covers."""

from __future__ import annotations

from functools import cache

import numpy as np

from ..sampling import GOLDEN, hash_uint32
from .blur import REACH, WIDTHS, blurred, softened

SAMPLES = 6.0
"""Sub-samples for each texel of the atlas, about, that all patches together get on top of the fewest that they need."""

FEWEST, MOST = 1.0, 16.0
"""Sub-samples of a patch for each texel of its length, a side."""

ROUGH = 0.5
"""The same of patches that photons of several ways make, which are many and on top of each other."""

DIM = 0.04
"""Of the mean irradiance: dimmer patches do with fewer sub-samples, each of which brings a texel no more than that."""

SPARSE = 0.12
"""The fewest even of those."""

SIDES = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128])
"""Numbers of sub-samples that a patch may have along a side."""

LONGEST = 128.0
"""Texels that a patch may be long, or its sub-samples would leave gaps: longer ones are divided."""

BATCH = 32_768
"""Sub-samples that are spread together, at least."""

_F = np.float32


def box_samples(sums, x, y, wide, high, power, size: int) -> None:
    """Add samples to `sums` (size², c) float64, each a box that up to 2 × 2 texels share.

    x, y: (n,) float32 middles, in texels. wide, high: (n,) float32 extents, in (0, 1] texel. power: (c, n) float32.
    """
    for target, value in zip(sums.T, _spread(_shares(x, wide, size), _shares(y, high, size), power, size), strict=True):
        target += value


def _spread(columns, rows, power, size):
    """c arrays of (size²,) float64."""
    (column, right), (row, above) = columns, rows
    at, texels = row * size + column, size * size
    total = []
    for channel in power:
        on_right = channel * right
        on_left = channel - on_right
        upper_right, upper_left = on_right * above, on_left * above
        sums = np.zeros(texels + size + 1)
        # one index for all four, moved afterwards; the last column's and row's neighbours get nothing, by their share
        sums[:texels] = np.bincount(at, on_left - upper_left, texels)
        sums[1 : texels + 1] += np.bincount(at, on_right - upper_right, texels)
        sums[size : texels + size] += np.bincount(at, upper_left, texels)
        sums[size + 1 :] += np.bincount(at, upper_right, texels)
        total.append(sums[:texels])
    return total


def _shares(place, extent, size):
    """First texel of boxes along one axis, int64, and the part of them in the next, float32."""
    low = place - extent * _F(0.5)
    first = np.floor(low)
    part = (low + extent - first - 1) / np.maximum(extent, _F(1e-6))
    np.minimum(np.maximum(part, 0, out=part), 1, out=part)
    index = first.astype(np.int64)
    if len(first) and (first.min() < 0 or first.max() >= size - 1):
        part = np.where(index < 0, 1, np.where(index >= size - 1, 0, part)).astype(np.float32)
        # a box below the first texel lies in it whole
        index = np.where(index < 0, 0, np.minimum(index, size - 1))
        part = np.where(low < 0, 0, part).astype(np.float32)
    return index, part


@cache
def biquadratic(across: int, along: int) -> np.ndarray:
    """(across · along, 9) float32 weights of a patch's 3 × 3 vertices at the middles of its sub-samples."""
    return _weights((np.arange(across) + 0.5) / across, (np.arange(along) + 0.5) / along)


def _weights(s, t):
    """(s · t, 9) float32 weights of a patch's 3 × 3 vertices at places s and t, in [0, 1], along its two sides."""
    s, t = (np.stack([(1 - x) * (1 - 2 * x), 4 * x * (1 - x), x * (2 * x - 1)], 1) for x in (s, t))
    return np.einsum("ai,bj->abij", s, t).reshape(-1, 9).astype(np.float32)


_QUARTERS = np.concatenate([_weights(np.arange(3) / 4 + i, np.arange(3) / 4 + j) for i in (0, 0.5) for j in (0, 0.5)])
"""(36, 9): a quarter's vertices from its patch's, one quarter after another."""


def _steps(patches):
    """(2, 2, m) mean squared steps between the vertices of patches (9, m, …) along each side, in x and y; (2, m) lengths of
    the sides, texels."""
    grid = np.ascontiguousarray(patches[:, :, :2].transpose(2, 0, 1)).reshape(2, 3, 3, -1)
    m = grid.shape[3]
    mean, lengths = np.empty((2, 2, m), np.float32), np.empty((2, m), np.float32)
    for side, step in enumerate((grid[:, 1:] - grid[:, :-1], grid[:, :, 1:] - grid[:, :, :-1])):
        step *= step
        step = step.reshape(2, 6, m)
        mean[side] = step.mean(axis=1)
        lengths[side] = 2 * np.sqrt((step[0] + step[1]).max(axis=0))
    return mean, lengths


def divided(patches: np.ndarray, lead: int = 2) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The same patches, those longer than LONGEST as their quarters: (9, k, 2 + c), and (k,) rows of what each is part of;
    and their steps and lengths (see `_steps`)."""
    row, kept = np.arange(patches.shape[1]), []
    while True:
        steps, lengths = _steps(patches)
        long = lengths.max(axis=0) > LONGEST
        if not long.any():
            kept.append((patches, row, steps, lengths))
            break
        short = ~long
        kept.append((patches[:, short], row[short], steps[:, :, short], lengths[:, short]))
        parts = (_QUARTERS @ patches[:, long].reshape(9, -1)).reshape(4, 9, -1, patches.shape[2])
        parts[..., lead:] *= _F(0.25)
        patches, row = np.concatenate([*parts], axis=1), np.concatenate(4 * [row[long]])
    if len(kept) == 1:
        return kept[0]
    return tuple(np.concatenate([k[i] for k in kept], axis=axis) for i, axis in enumerate((1, 0, 2, 1)))


def splat(
    patches: np.ndarray,
    chart: np.ndarray,
    rough: np.ndarray,
    receivers,
    samples: float = SAMPLES,
    soft: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """(size², c) float64 W that patches bring to each texel.

    patches: (9, m, 2 + c) float32: place in texels and power in W at the 3 × 3 vertices, as if all of the patch were
    like it. chart: (m,) int32 of each patch, on which its samples are kept. rough: (m,) bool, see `counts`. samples: for
    each texel, about. soft: of a soft lamp, the part of it that each patch stands for, (m,) int, and places in every part
    (see `softness.cells`); four columns between place and power then tell how the place moves with these.
    """
    size, lead = receivers.resolution, 2 if soft is None else 6
    total = np.zeros((patches.shape[2] - lead, size * size))
    if not patches.shape[1]:
        return total.T
    # near a chart's border samples are drawn towards their patch's first photon, which is on it
    home = patches[0, :, :2]
    patches, row, steps, lengths = divided(patches, lead)
    home, chart, rough = home[row].T, chart[row], rough[row]
    power = patches[4, :, lead:].mean(axis=1)
    level, wider = np.zeros(patches.shape[1], np.int64), 0.0
    if soft is not None:
        cell, offset = soft[0][row], soft[1]
        level, wider, jitter = softened(patches[4, :, 2:6].T, (offset**2).mean(axis=1)[cell].T, lengths)
        patches[:, :, 2:6] *= jitter[None, :, None]
        lengths = np.sqrt(lengths**2 + wider.sum(axis=0) / 2)
    # a picture on the way, of few samples, may show them
    dim = DIM * max(SAMPLES / samples, 1.0) * float(power.sum(dtype=np.float64)) / size**2
    across, along = counts(lengths, power, rough, samples * size * size, dim)
    # how far neighbouring samples are apart, along x and y: as wide a box has their parallelogram's variance
    variance = sum(step * (4 / (n * n)).astype(np.float32) for step, n in zip(steps, (across, along), strict=True))
    if soft is not None:
        variance += np.where(jitter > 0, wider / (across * along), wider).astype(np.float32)
    order = np.lexsort((along, across, level))
    across, along = across[order], along[order]
    # one number after another: the samples of all patches of a size are one product
    values = np.ascontiguousarray(patches.transpose(0, 2, 1)[:, :, order])
    wide, high = np.clip(np.sqrt(variance), 1e-3, 1)[:, order]
    level = level[order]
    breaks = (np.diff(across) != 0) | (np.diff(along) != 0) | (np.diff(level) != 0)
    starts = np.flatnonzero(np.append(True, breaks))
    ends = np.append(starts[1:], len(order))
    home, chart = home[:, order], chart[order]
    places = None if soft is None else (cell[order], offset)
    # as many samples together as make the sum over all texels cheap, at a hundred bytes each
    batch = max(BATCH, size * size // 4)
    # what waits for its filter: of one filter at a time, for there can be many
    waiting = {}

    def run(task):
        parts = [_samples(values[:, :, part], na, nb, part.start, places) for na, nb, part in task]
        x, y, patch = (np.concatenate([p[k] for p in parts]) for k in range(3))
        columns, rows = _kept(x, y, wide.take(patch), high.take(patch), patch, home, chart, receivers)
        power = np.concatenate([p[3] for p in parts], axis=1)
        filtered = int(level[task[0][2].start])
        if filtered not in waiting:
            finish()
        if filtered:
            # near another chart's texels light is not blurred
            deep = receivers.depth.take(rows[0] * size + columns[0]) >= REACH[filtered]
            some = [[(index[which], part[which]) for index, part in (columns, rows)] for which in (deep, ~deep)]
            add(filtered, *some[0], power[:, deep])
            columns, rows, power = *some[1], power[:, ~deep]
        add(0, columns, rows, power)

    def add(number, columns, rows, power):
        if not len(columns[0]):
            return
        if number and number not in waiting:
            waiting[number] = np.zeros_like(total)
        for target, value in zip(
            waiting[number] if number else total, _spread(columns, rows, power, size), strict=True
        ):
            target += value

    def finish():
        for number, found in waiting.items():
            for target, value in zip(total, found, strict=True):
                target += blurred(value.reshape(size, size), WIDTHS[number]).reshape(-1)
        waiting.clear()

    task, count = [], 0
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        na, nb = int(across[start]), int(along[start])
        at = start
        if task and level[start] != level[task[0][2].start]:
            run(task)
            task, count = [], 0
        while at < end:
            stop = min(end, at + max(1, (batch - count) // (na * nb)))
            task.append((na, nb, slice(at, stop)))
            count += na * nb * (stop - at)
            at = stop
            if count >= batch:
                run(task)
                task, count = [], 0
    if task:
        run(task)
    finish()
    return total.T


def counts(lengths, power: np.ndarray, rough: np.ndarray, budget: float, dim: float) -> tuple[np.ndarray, np.ndarray]:
    """Sub-samples of patches along their two sides, two (m,) int out of SIDES, some `budget` in all beside the fewest.

    lengths: two (m,) of the sides, in texels. power: (m,) W. rough: (m,) bool, as few as ROUGH will do. dim: W a texel, see
    DIM. What a patch blurs by is its power over its number of samples, so for the least blur in all that number follows
    the root of its irradiance.
    """
    area = np.maximum(lengths[0], 0.25) * np.maximum(lengths[1], 0.25)
    lit = np.maximum(power, 0) / area
    wanted = np.sqrt(np.sqrt(lit))
    least = np.clip(np.sqrt(lit / max(dim, 1e-300)), SPARSE, np.where(rough, ROUGH, FEWEST))
    budget = budget + float((area * least * least).sum())
    low, high = 0.0, MOST / max(float(wanted.max()), 1e-30) * 64
    for _ in range(16):
        middle = (low + high) / 2
        rate = np.clip(wanted * middle, least, MOST)
        low, high = (low, middle) if float((area * rate * rate).sum()) > budget else (middle, high)
    rate = np.clip(wanted * low, least, MOST)
    return tuple(SIDES[np.minimum(np.searchsorted(SIDES, length * rate * 0.999), len(SIDES) - 1)] for length in lengths)


def _samples(values, na, nb, first, soft):
    """x, y (n,), patch (n,) and power (c, n) of the sub-samples of patches that have na × nb of them each."""
    columns, m = values.shape[1:]
    found = biquadratic(na, nb) @ values.reshape(9, -1)
    found = found.reshape(na * nb, columns, m).transpose(1, 0, 2)
    patch = np.tile(np.arange(first, first + m), na * nb)
    # a parabola between photons may dip below nothing
    lead = 2 if soft is None else 6
    power = np.maximum(found[lead:].reshape(columns - lead, -1), 0) * _F(1 / (na * nb))
    if soft is not None:
        cell, offset = soft
        index = np.arange(na * nb)[:, None] + hash_uint32(first + np.arange(m), 0)
        a, b = offset[cell[first : first + m], index & (offset.shape[1] - 1)].transpose(2, 0, 1)
        found[0] += found[2] * a + found[4] * b
        found[1] += found[3] * a + found[5] * b
    return found[0].reshape(-1), found[1].reshape(-1), patch, power


def _kept(x, y, wide, high, patch, start, chart, receivers):
    """`_shares` of samples along x and y, those near a chart's border kept on their patch's own chart.

    start: (2, m) place of each patch's first photon.
    """
    size = receivers.resolution
    (column, right), (row, above) = _shares(x, wide, size), _shares(y, high, size)
    outer = np.flatnonzero(~receivers.inner.take(row * size + column))
    if len(outer):
        some = [values[outer] for values in (x, y, wide, high, patch)]
        _keep(*some, start, chart, receivers)
        column[outer], right[outer] = _shares(some[0], some[2], size)
        row[outer], above[outer] = _shares(some[1], some[3], size)
    return (column, right), (row, above)


def _keep(x, y, wide, high, patch, start, chart, receivers):
    """Keep samples near a chart's border on their patch's own chart, in place."""
    size = receivers.resolution
    texel = _texel(x, y, size)
    mine = chart[patch]
    # what lies off the chart: back to the texel beside it, or somewhere between there and the patch's first photon
    rows = np.flatnonzero(receivers.owner(texel) != mine)
    if len(rows):
        own = mine[rows]
        near = receivers.fill[texel[rows]]
        apart = np.maximum(np.abs(near % size - texel[rows] % size), np.abs(near // size - texel[rows] // size))
        beside = (near >= 0) & (apart <= 1) & (receivers.owner(np.maximum(near, 0)) == own)
        fx, fy = start[:, patch[rows]]
        part = (rows * GOLDEN % 1).astype(np.float32)
        bx, by = fx + (x[rows] - fx) * part, fy + (y[rows] - fy) * part
        kept = receivers.owner(_texel(bx, by, size)) == own
        x[rows] = np.where(beside, near % size + _F(0.5), np.where(kept, bx, fx))
        y[rows] = np.where(beside, near // size + _F(0.5), np.where(kept, by, fy))
    spills = np.zeros(len(x), bool)
    for side in (-0.5, 0.5):
        for end in (-0.5, 0.5):
            spills |= receivers.owner(_texel(x + wide * _F(side), y + high * _F(end), size)) != mine
    wide[spills] = high[spills] = 1e-3


def _texel(x, y, size):
    """(n,) int64 texel of places (n,) in the atlas."""
    column = np.clip(x, 0, size - 1).astype(np.int64)
    row = np.clip(y, 0, size - 1).astype(np.int64)
    return row * size + column
