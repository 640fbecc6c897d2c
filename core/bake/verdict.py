"""A bake measures its own error: what it shows at some blocks of texels, against light gathered anew.

Two independent halves of the fresh light cancel out their own noise: E[(s − a)(s − b)] is the square of what is wrong with
s alone, as long as a and b are right on average. So the whole error is measured at once, wherever it comes from; its parts
tell what to spend more on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..panes.entry_light import EntryLight
from ..panes.exits import gather_panes
from ..panes.regions import region_of, starts_of
from .fresh_light import entry_fields, even_light, uneven_light
from .steps import Prepared, grey, own_region
from .stored import Stored

BLOCKS = 256
"""Blocks of 4×4 texels that are looked at, about; single vertices where no object has texels, 16 times as many."""

EVEN_RAYS = 256
"""Rays of a texel in each half, for the light of even entries."""

PATHS = 12
"""Paths of a texel in each half, for what entries hide."""

DARK = 1e-6
"""Lamps that light less than this part of what the brightest one does count for nothing."""

Show = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(places (n,), pane weights (regions, panes, s) float32) → (n, s) float32 irradiance that a bake shows there."""


@dataclass(frozen=True)
class Verdict:
    """Relative errors of what a bake shows under lamps held out of its training (panes/held_out.py).

    error: RMSE over RGB divided by the mean, on blocks of 4×4 texels; mean over the lamps, of
    which `each` (l,) has its own. worst: of the blocks' own RMS
    errors the 95th percentile. entries: the part of `error` that comes from light leaving entries evenly. lamps: that of
    seeing lamps from few places of an entry. shown: all that panes, the gather's noise and points add; noise: that of
    exits at texels alone. places: (b, 3) float32 m, normals: (b, 3), and squares: (b,) float32, the blocks and the squares
    of their errors, as far as noise lets know them.
    """

    error: float
    each: np.ndarray
    worst: float
    entries: float
    lamps: float
    shown: float
    noise: float
    places: np.ndarray
    normals: np.ndarray
    squares: np.ndarray


def judge(
    made: Prepared,
    rows: np.ndarray,
    seed: int,
    show: Show | None = None,
    tick: Callable[[int], None] | None = None,
) -> Verdict | None:
    """The error of what is shown at some of `rows`; None where no held-out lamp lights anything.

    show: None for what exits at texels would show, gathered for the places that are looked at alone. tick: called now and
    then with a number of rays; an exception that it raises passes through.

    rows: of `made.exits`, texels with light of their own; of `made.vertices` where no object has texels.
    """
    chosen, block = _some(made, rows, seed)
    if not len(chosen) or not made.test_lamps:
        return None
    lamps = len(made.test_lamps)
    eyes = EntryLight(made.surface, made.tracer, seed)
    few = np.stack([grey(eyes.unit(lamp)) for lamp in made.test_lamps], 1)
    value = np.concatenate([_weights(made, few), _weights(made, made.test_direct)], 2)
    # of exits at texels, two gathers tell the noise
    gathered = (
        [_gathered(made, chosen, value, seed + k) for k in (43, 44)] if show is None or made.starts is not None else []
    )
    seen = (gathered[0] if show is None else show(chosen, value)).reshape(len(chosen), 2, lamps, 3)
    level = np.abs(seen[:, 0].mean(axis=(0, 2), dtype=np.float64))
    lit = level > DARK * level.max(initial=0)
    if not lit.any():
        return None
    some = (made.exits if len(made.exits) else made.vertices).samples.take(chosen)
    count = np.bincount(block)
    order = np.argsort(block, kind="stable")
    starts = np.cumsum(count) - count

    def mean(values):
        """(b, l, 3) float64 means over blocks of values (n, l, 3), relative to the lamps' mean."""
        sums = np.add.reduceat(values[order], starts, axis=0, dtype=np.float64)
        return (sums / count[:, None, None])[:, lit] / level[lit, None]

    def each(square):
        """(l,) root of the mean squares (b, l, 3) of each lamp."""
        found = np.einsum("b,blc->l", count / count.sum(), square) / 3
        return np.sqrt(np.maximum(found, 0))

    def relative(square):
        """Mean over lamps."""
        return float(each(square).mean())

    found, closely = mean(seen[:, 0]), mean(seen[:, 1])
    even, more = ([mean(values) for values in halves] for halves in _fresh(made, some, chosen, seed, tick))
    first, second = (found - e - m for e, m in zip(even, more, strict=True))
    squares = _quiet((first * second).mean(axis=(1, 2)), (first**2 - second**2).mean(axis=(1, 2)))
    at = order[starts]
    return Verdict(
        error=relative(first * second),
        each=each(first * second),
        worst=float(np.sqrt(np.quantile(squares, 0.95))),
        entries=relative(more[0] * more[1]),
        lamps=relative((found - closely) ** 2),
        shown=relative((closely - even[0]) * (closely - even[1])),
        noise=relative(0.5 * mean(_few(gathered[0] - gathered[1], lamps)) ** 2) if gathered else 0.0,
        places=some.position[at],
        normals=some.flat[at],
        squares=squares.astype(np.float32),
    )


def _fresh(made, places, chosen, seed, tick):
    """Two halves of what even entries shine on places, and two of what others bring more; remembered, for the last trial
    is the whole bake's beginning."""
    key = chosen.tobytes(), seed
    if key not in made.fresh:
        fields = entry_fields(made)
        made.fresh.clear()
        made.fresh[key] = (
            [even_light(made, places, fields, EVEN_RAYS, seed + salt, tick) for salt in (71, 72)],
            [uneven_light(made, places, fields, PATHS, seed + salt) for salt in (81, 82)],
        )
    return made.fresh[key]


def shown_by_texels(made: Prepared, rows: np.ndarray, starts: np.ndarray) -> Show:
    """What exits at texels show. rows: (t, c) panes, sorted by region; starts: (regions + 1,)."""
    region = region_of(starts)
    return lambda chosen, value: _blend(made, rows[chosen], region[chosen], value)


def shown_by_points(made: Prepared, stored: Stored) -> Show:
    """What stored points show at texels, or at vertices where there are none."""
    served = stored.texels if len(made.exits) else stored.vertices
    region = region_of(stored.starts)
    return lambda chosen, value: served.take(chosen).apply(_blend(made, stored.rows, region, value))


def _few(values, lamps):
    return values.reshape(len(values), 2, lamps, 3)[:, 0]


def _gathered(made, chosen, value, seed):
    """(n, s) float32 of what exits at the chosen places would show."""
    samples = (made.exits if len(made.exits) else made.vertices).samples.take(chosen)
    region = own_region(made, samples)
    order = np.argsort(region, kind="stable")
    starts = starts_of(region[order], made.modes.regions)
    rows = gather_panes(made.gatherer, samples.take(order), starts, made.tables, made.budget.exit_rays, seed)
    found = np.empty((len(chosen), value.shape[2]), np.float32)
    found[order] = _blend(made, rows, region[order], value)
    return found


def _weights(made, direct):
    """(regions, panes, 3 l) float32 pane weights of white lamps with irradiance (n, l)."""
    found = [made.weights.of(np.repeat(direct[:, k : k + 1], 3, axis=1)) for k in range(direct.shape[1])]
    return np.concatenate(found, 1).reshape(made.modes.regions, made.modes.panes, -1)


def _blend(made, rows, region, value):
    """(n, s) float32 of rows (n, c) in the panes of regions (n,)."""
    result = np.empty((len(rows), value.shape[2]), np.float32)
    for r in np.unique(region):
        own = np.flatnonzero(region == r)
        result[own] = rows[own, : made.modes.panes] @ value[r]
    return result


def _some(made, rows, seed):
    """(n,) of `rows` that make up some blocks, and (n,) the block of each; spread evenly over the atlas."""
    if not len(made.exits):
        chosen = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), 16 * BLOCKS)).astype(np.int64))
        return rows[chosen], np.arange(len(chosen))
    size, index = made.exits.resolution, made.exits.index[rows]
    names, block = np.unique(index // size // 4 * size + index % size // 4, return_inverse=True)
    many = min(BLOCKS, len(names))
    start = np.random.default_rng(seed).random()
    number = np.full(len(names), -1)
    number[((np.arange(many) + start) * len(names) / many).astype(np.int64)] = np.arange(many)
    own = number[block]
    order = np.argsort(own, kind="stable")
    order = order[own[order] >= 0]
    return rows[order], own[order]


def _quiet(squares: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """(b,) squares of errors, of estimates (b,) that are right on average but noisy: drawn towards their mean by as much
    of their spread as is noise, and not below nothing.

    noise: (b,) differences of the squares of the halves, a and b. With s and d half their sum and difference, ab = s² − d²
    and a² − b² = 4sd. With d pure noise and s as noisy about the error, noise makes both vary alike, the latter twice as
    much.
    """
    mean, spread = squares.mean(), squares.var()
    kept = max(spread - 0.25 * (noise**2).mean(), 0.0) / max(spread, 1e-30)
    return np.maximum(mean + kept * (squares - mean), 0)
