"""Power spread into texels: patches of light as many small boxes, each shared exactly by the texels that it covers."""

from __future__ import annotations

from functools import cache

import numpy as np

from ..sampling import GOLDEN
from ..threads import in_threads

PER_TEXEL = (1.0, 2.0, 4.0, 8.0)
"""Sub-samples of a patch for each texel of its length, a side: of dim patches, and of ever brighter ones."""

BRIGHT = (0.5, 4.0, 30.0)
"""Irradiance over the mean where light is, from which on the next number counts."""

MOST = 128
"""Sub-samples of a patch a side, at most."""

BATCH = 32_768
"""Sub-samples that are spread together, at least."""

_F = np.float32


def box_samples(sums, x, y, wide, high, power, size: int) -> None:
    """Add samples to `sums` (size², c) float64, each a box that up to 2 × 2 texels share.

    x, y: (n,) float32 middles, in texels. wide, high: (n,) float32 extents, in (0, 1] texel. power: (c, n) float32.
    """
    for target, value in zip(sums.T, _spread(x, y, wide, high, power, size), strict=True):
        target += value


def _spread(x, y, wide, high, power, size):
    """(c, size²) float64."""
    column, right = _shares(x, wide, size)
    row, above = _shares(y, high, size)
    at = row * size + column
    # the last column's and row's right and upper neighbours get nothing, by their share
    texel = np.concatenate([at, at + 1, at + size, at + size + 1])
    left, below = 1 - right, 1 - above
    share = np.concatenate([left * below, right * below, left * above, right * above])
    total = []
    for channel in power:
        weight = (share.reshape(4, -1) * channel).reshape(-1)
        total.append(np.bincount(texel, weight, size * size + size + 1)[: size * size])
    return np.stack(total)


def _shares(place, extent, size):
    """First texel of boxes along one axis, int64, and the part of them in the next, float32."""
    low = place - extent * _F(0.5)
    first = np.floor(low)
    part = np.clip((low + extent - first - 1) / np.maximum(extent, _F(1e-6)), 0, 1)
    index = first.astype(np.int64)
    beyond = (index < 0) | (index >= size - 1)
    if beyond.any():
        part = np.where(index < 0, 1, np.where(index >= size - 1, 0, part)).astype(np.float32)
        # a box below the first texel lies in it whole
        index = np.where(index < 0, 0, np.minimum(index, size - 1))
        part = np.where(low < 0, 0, part).astype(np.float32)
    return index, part


@cache
def _biquadratic(across: int, along: int) -> np.ndarray:
    """(across · along, 9) float32 weights of a patch's 3 × 3 vertices at the middles of its sub-samples."""

    def line(count):
        t = (np.arange(count) + 0.5) / count
        return np.stack([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)], 1)

    return np.einsum("ai,bj->abij", line(across), line(along)).reshape(across * along, 9).astype(np.float32)


def counts(patches: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sub-samples of patches along their two sides, powers of two; patches: as in `splat`."""
    grid = patches[:, :, :2].reshape(3, 3, -1, 2)
    lengths = []
    for axis in (0, 1):
        step = np.diff(grid, axis=axis)
        lengths.append(2 * np.sqrt((step * step).sum(axis=-1).max(axis=(0, 1))))
    # W per texel, the patch spread over the rectangle of its lengths
    power = patches[4, :, 2:].mean(axis=1)
    area = np.maximum(lengths[0], 0.25) * np.maximum(lengths[1], 0.25)
    typical = power.sum() / max(area.sum(), 1e-30)
    rate = np.array(PER_TEXEL)[np.searchsorted(np.array(BRIGHT) * typical, power / area)]
    sides = []
    for length in lengths:
        exponent = np.ceil(np.log2(np.maximum(length * rate, 1)))
        sides.append(np.minimum(np.exp2(exponent), MOST).astype(np.int64))
    return sides[0], sides[1]


def splat(patches: np.ndarray, chart: np.ndarray, receivers, threads: int | None = None) -> np.ndarray:
    """(size², c) float64 W that patches bring to each texel.

    patches: (9, m, 2 + c) float32: place in texels and power in W at the 3 × 3 vertices, as if all of the patch were
    like it. chart: (m,) int32 of each patch, on which its samples are kept.
    """
    size = receivers.resolution
    channels = patches.shape[2] - 2
    total = np.zeros((channels, size * size))
    if not patches.shape[1]:
        return total.T
    across, along = counts(patches)
    order = np.lexsort((along, across))
    across, along = across[order], along[order]
    starts = np.flatnonzero(np.append(True, (np.diff(across) != 0) | (np.diff(along) != 0)))
    ends = np.append(starts[1:], len(order))
    # as many samples together as make the sum over all texels cheap
    batch = max(BATCH, size * size // 2)
    tasks, task, samples = [], [], 0
    for start, end in zip(starts, ends, strict=True):
        each = int(across[start] * along[start])
        at = start
        while at < end:
            stop = min(end, at + max(1, (batch - samples) // each))
            task.append((int(across[start]), int(along[start]), order[at:stop]))
            samples += each * (stop - at)
            at = stop
            if samples >= batch:
                tasks.append(task)
                task, samples = [], 0
    tasks.append(task)

    def run(task):
        parts = [_samples(patches[:, rows], na, nb, chart[rows], receivers) for na, nb, rows in task]
        x, y, wide, high = (np.concatenate([p[k] for p in parts]) for k in range(4))
        return _spread(x, y, wide, high, np.concatenate([p[4] for p in parts], axis=1), size)

    # a few at a time: each result is as large as the atlas
    group = 8
    for start in range(0, len(tasks), group):
        for part in in_threads(run, [t for t in tasks[start : start + group] if t], threads):
            total += part
    return total.T


def _samples(patches, na, nb, chart, receivers):
    """x, y, wide, high (n,) and power (c, n) of the sub-samples of patches that have na × nb of them each."""
    m, columns = patches.shape[1:]
    weights = _biquadratic(na, nb)
    values = weights @ np.ascontiguousarray(patches.transpose(0, 2, 1)).reshape(9, -1)
    values = values.reshape(na * nb, columns, m)
    x, y = values[:, 0].reshape(-1), values[:, 1].reshape(-1)
    power = np.ascontiguousarray(values[:, 2:].transpose(1, 0, 2)).reshape(columns - 2, -1) * _F(1 / (na * nb))
    grid = patches.reshape(3, 3, m, columns)
    # how far neighbouring samples are apart, along x and y: as wide a box has their parallelogram's variance
    variance = sum(
        ((np.diff(grid[..., :2], axis=axis) * _F(2 / n)) ** 2).mean(axis=(0, 1)) for axis, n in ((0, na), (1, nb))
    )
    extent = np.clip(np.sqrt(variance), 1e-3, 1)
    wide, high = (np.tile(extent[:, k], na * nb) for k in (0, 1))
    return (*_kept(x, y, wide, high, patches, chart, na * nb, receivers), power)


def _kept(x, y, wide, high, patches, chart, each, receivers):
    """The same samples, those near a chart's border kept on their patch's own chart."""
    size = receivers.resolution
    texel = _texel(x, y, size)
    outer = np.flatnonzero(~receivers.inner[texel])
    if not len(outer):
        return x, y, wide, high
    x, y, wide, high = x.copy(), y.copy(), wide.copy(), high.copy()
    patch = outer % len(chart)
    mine = chart[patch]
    # what lies off the chart: back to the texel beside it, or somewhere between there and the patch's first photon
    off = receivers.owner(texel[outer]) != mine
    if off.any():
        rows, patch, mine_off = outer[off], patch[off], mine[off]
        near = receivers.fill[texel[rows]]
        apart = np.maximum(np.abs(near % size - texel[rows] % size), np.abs(near // size - texel[rows] // size))
        beside = (near >= 0) & (apart <= 1) & (receivers.owner(np.maximum(near, 0)) == mine_off)
        fx, fy = patches[0, patch, 0], patches[0, patch, 1]
        part = (rows * GOLDEN % 1).astype(np.float32)
        bx, by = fx + (x[rows] - fx) * part, fy + (y[rows] - fy) * part
        kept = receivers.owner(_texel(bx, by, size)) == mine_off
        x[rows] = np.where(beside, near % size + _F(0.5), np.where(kept, bx, fx))
        y[rows] = np.where(beside, near // size + _F(0.5), np.where(kept, by, fy))
    spills = np.zeros(len(outer), bool)
    for side in (-0.5, 0.5):
        for end in (-0.5, 0.5):
            at = _texel(x[outer] + wide[outer] * _F(side), y[outer] + high[outer] * _F(end), size)
            spills |= receivers.owner(at) != mine
    wide[outer[spills]] = high[outer[spills]] = 1e-3
    return x, y, wide, high


def _texel(x, y, size):
    """(n,) int64 texel of places (n,) in the atlas."""
    column = np.clip(x, 0, size - 1).astype(np.int64)
    row = np.clip(y, 0, size - 1).astype(np.int64)
    return row * size + column
