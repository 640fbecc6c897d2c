"""Power spread into texels: patches of light as many small boxes, each shared exactly by the texels that it covers."""

from __future__ import annotations

from functools import cache

import numpy as np

from ..sampling import GOLDEN
from ..threads import in_threads

SAMPLES = 8.0
"""Sub-samples for each texel of the atlas, about, that all patches together get on top of the fewest that they need."""

FEWEST, MOST = 1.0, 16.0
"""Sub-samples of a patch for each texel of its length, a side."""

ROUGH = 0.5
"""The same of patches that photons of several ways make, which are many and on top of each other."""

DIM = 0.02
"""Of the mean irradiance: dimmer patches do with fewer sub-samples, each of which brings a texel no more than that."""

SPARSE = 0.25
"""The fewest even of those."""

SIDES = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128])
"""Numbers of sub-samples that a patch may have along a side."""

LONGEST = 128.0
"""Texels that a patch may be long, or its sub-samples would leave gaps: longer ones are divided."""

BATCH = 32_768
"""Sub-samples that are spread together, at least."""

ROOM = 1 << 26
"""Bytes for what is spread but not summed yet, where two such sums are no more."""

_F = np.float32


def box_samples(sums, x, y, wide, high, power, size: int) -> None:
    """Add samples to `sums` (size², c) float64, each a box that up to 2 × 2 texels share.

    x, y: (n,) float32 middles, in texels. wide, high: (n,) float32 extents, in (0, 1] texel. power: (c, n) float32.
    """
    for target, value in zip(sums.T, _spread(x, y, wide, high, power, size), strict=True):
        target += value


def _spread(x, y, wide, high, power, size):
    """c arrays of (size²,) float64."""
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
    return total


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
def biquadratic(across: int, along: int) -> np.ndarray:
    """(across · along, 9) float32 weights of a patch's 3 × 3 vertices at the middles of its sub-samples."""
    return _weights((np.arange(across) + 0.5) / across, (np.arange(along) + 0.5) / along)


def _weights(s, t):
    """(s · t, 9) float32 weights of a patch's 3 × 3 vertices at places s and t, in [0, 1], along its two sides."""
    s, t = (np.stack([(1 - x) * (1 - 2 * x), 4 * x * (1 - x), x * (2 * x - 1)], 1) for x in (s, t))
    return np.einsum("ai,bj->abij", s, t).reshape(-1, 9).astype(np.float32)


_QUARTERS = np.concatenate([_weights(np.arange(3) / 4 + i, np.arange(3) / 4 + j) for i in (0, 0.5) for j in (0, 0.5)])
"""(36, 9): a quarter's vertices from its patch's, one quarter after another."""


def _lengths(patches):
    """Two lists of (2 or 3, m, 2) squared steps between vertices along each side, and two (m,) lengths, texels."""
    grid = patches[:, :, :2].reshape(3, 3, -1, 2)
    squares = [step * step for step in (grid[1:] - grid[:-1], grid[:, 1:] - grid[:, :-1])]
    return squares, [2 * np.sqrt(square.sum(axis=-1).max(axis=(0, 1))) for square in squares]


def divided(patches: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same patches, those longer than LONGEST as their quarters: (9, k, 2 + c), and (k,) rows of what each is part of."""
    row = np.arange(patches.shape[1])
    while True:
        long = np.maximum(*_lengths(patches)[1]) > LONGEST
        if not long.any():
            return patches, row
        parts = (_QUARTERS @ patches[:, long].reshape(9, -1)).reshape(4, 9, -1, patches.shape[2])
        parts[..., 2:] *= _F(0.25)
        patches = np.concatenate([patches[:, ~long], *parts], axis=1)
        row = np.concatenate([row[~long], *4 * [row[long]]])


def splat(
    patches: np.ndarray,
    chart: np.ndarray,
    rough: np.ndarray,
    receivers,
    samples: float = SAMPLES,
    threads: int | None = None,
) -> np.ndarray:
    """(size², c) float64 W that patches bring to each texel.

    patches: (9, m, 2 + c) float32: place in texels and power in W at the 3 × 3 vertices, as if all of the patch were
    like it. chart: (m,) int32 of each patch, on which its samples are kept. rough: (m,) bool, see `counts`. samples: for
    each texel, about.
    """
    size = receivers.resolution
    total = np.zeros((patches.shape[2] - 2, size * size))
    if not patches.shape[1]:
        return total.T
    # near a chart's border samples are drawn towards their patch's first photon, which is on it
    home = patches[0, :, :2]
    patches, row = divided(patches)
    home, chart, rough = home[row].T, chart[row], rough[row]
    squares, lengths = _lengths(patches)
    power = patches[4, :, 2:].mean(axis=1)
    # a picture on the way, of few samples, may show them
    dim = DIM * max(SAMPLES / samples, 1.0) * float(power.sum(dtype=np.float64)) / size**2
    across, along = counts(lengths, power, rough, samples * size * size, dim)
    # how far neighbouring samples are apart, along x and y: as wide a box has their parallelogram's variance
    variance = sum(
        square.mean(axis=(0, 1)) * (4 / (n * n))[:, None].astype(np.float32)
        for square, n in zip(squares, (across, along), strict=True)
    )
    order = np.lexsort((along, across))
    across, along = across[order], along[order]
    # one number after another: the samples of all patches of a size are one product
    values = np.ascontiguousarray(patches.transpose(0, 2, 1)[:, :, order])
    extent = np.clip(np.sqrt(variance), 1e-3, 1)[order]
    starts = np.flatnonzero(np.append(True, (np.diff(across) != 0) | (np.diff(along) != 0)))
    ends = np.append(starts[1:], len(order))
    home, chart = home[:, order], chart[order]
    # as many samples together as make the sum over all texels cheap, at a hundred bytes each
    batch = max(BATCH, size * size // 4)
    tasks, task, count = [], [], 0
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        na, nb = int(across[start]), int(along[start])
        at = start
        while at < end:
            stop = min(end, at + max(1, (batch - count) // (na * nb)))
            task.append((na, nb, slice(at, stop)))
            count += na * nb * (stop - at)
            at = stop
            if count >= batch:
                tasks.append(task)
                task, count = [], 0
    if task:
        tasks.append(task)

    def run(task):
        parts = [_samples(values[:, :, part], na, nb, part.start) for na, nb, part in task]
        x, y, patch = (np.concatenate([p[k] for p in parts]) for k in range(3))
        wide, high = extent[patch].T
        kept = _kept(x, y, wide, high, patch, home, chart, receivers)
        return _spread(*kept, np.concatenate([p[3] for p in parts], axis=1), size)

    # a few at a time, for each result is as large as the atlas; summed in order, whichever is ready first
    group = int(np.clip(ROOM // total.nbytes, 2, 8))
    for start in range(0, len(tasks), group):
        for part in in_threads(run, tasks[start : start + group], threads):
            for target, value in zip(total, part, strict=True):
                target += value
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


def _samples(values, na, nb, first):
    """x, y (n,), patch (n,) and power (c, n) of the sub-samples of patches that have na × nb of them each."""
    columns, m = values.shape[1:]
    found = biquadratic(na, nb) @ values.reshape(9, -1)
    found = found.reshape(na * nb, columns, m).transpose(1, 0, 2)
    patch = np.tile(np.arange(first, first + m), na * nb)
    # a parabola between photons may dip below nothing
    power = np.maximum(found[2:].reshape(columns - 2, -1), 0) * _F(1 / (na * nb))
    return found[0].reshape(-1), found[1].reshape(-1), patch, power


def _kept(x, y, wide, high, patch, start, chart, receivers):
    """x, y, wide and high of the same samples, those near a chart's border kept on their patch's own chart.

    start: (2, m) place of each patch's first photon.
    """
    size = receivers.resolution
    texel = _texel(x, y, size)
    outer = np.flatnonzero(~receivers.inner[texel])
    if not len(outer):
        return x, y, wide, high
    x, y, wide, high = x.copy(), y.copy(), wide.copy(), high.copy()
    patch = patch[outer]
    mine = chart[patch]
    # what lies off the chart: back to the texel beside it, or somewhere between there and the patch's first photon
    off = receivers.owner(texel[outer]) != mine
    if off.any():
        rows, own = outer[off], mine[off]
        near = receivers.fill[texel[rows]]
        apart = np.maximum(np.abs(near % size - texel[rows] % size), np.abs(near // size - texel[rows] // size))
        beside = (near >= 0) & (apart <= 1) & (receivers.owner(np.maximum(near, 0)) == own)
        fx, fy = start[:, patch[off]]
        part = (rows * GOLDEN % 1).astype(np.float32)
        bx, by = fx + (x[rows] - fx) * part, fy + (y[rows] - fy) * part
        kept = receivers.owner(_texel(bx, by, size)) == own
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
