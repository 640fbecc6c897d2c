"""A bake measures its own error: what it shows at some blocks of texels, against light gathered anew.

Two independent halves of the fresh light cancel out their own noise: E[(s − a)(s − b)] is the square of what is wrong with
s alone, as long as a and b are right on average. So the whole error is measured at once, wherever it comes from; its parts
tell what to spend more on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..panes.entry_light import EntryLight
from ..panes.regions import region_of
from ..planner import RAYS_FALL
from ..surface import SurfaceSamples, Texels
from .fresh_light import entry_fields, even_light, uneven_light
from .live import grey
from .steps import Prepared, own_region
from .stored import Stored

BLOCKS = 256
"""Blocks of 4×4 texels that are looked at, about; single vertices where no object has texels, 16 times as many."""

EVEN_RAYS = 64
"""Rays of a texel in each half, for the light of even entries."""

PATHS = 8
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
    seeing lamps from few places of an entry. panes: that of light that no panes hold. exits: that of the gather's noise, and
    of what lies between points. places: (b, 3) float32 m, normals: (b, 3), and squares: (b,) float32, the blocks and the
    squares of their errors, as far as noise lets know them.
    """

    error: float
    each: np.ndarray
    worst: float
    entries: float
    lamps: float
    panes: float
    exits: float
    places: np.ndarray
    normals: np.ndarray
    squares: np.ndarray


@dataclass(frozen=True)
class Looks:
    """What is known of the places that a bake is judged at, before its exits are. chosen: (n,) rows of `made.exits`, or of
    `made.vertices`; block: (n,) of each; samples: n. value: (regions, panes, 6 l) weights of the panes' light when few places
    of an entry see the lamps, and then when all do. halves: of each what even entries shine on the places, (n, l, 3), what
    panes make of it, (n, 2, l, 3), and what others bring more, (n, l, 3), all float32."""

    chosen: np.ndarray
    block: np.ndarray
    samples: SurfaceSamples
    value: np.ndarray
    halves: list[tuple[np.ndarray, np.ndarray, np.ndarray]]


def judge(
    made: Prepared,
    seed: int,
    show: Show | None = None,
    dark: np.ndarray | None = None,
    tick: Callable[[int], None] | None = None,
) -> Verdict | None:
    """The error of what is shown; None where no held-out lamp lights anything.

    show: None before there are exits: what they would show, had they `budget.exit_rays` rays each. dark: bool of
    `made.exits`, those without light of their own; of `made.vertices` where no object has texels. tick: called now and then with
    a number of rays; an exception that it raises passes through.
    """
    if not made.test_lamps:
        return None
    if made.looks is None:
        made.looks = _look(made, seed, tick)
    looks, lamps = made.looks, len(made.test_lamps)
    mine = np.arange(len(looks.chosen)) if dark is None else np.flatnonzero(~dark[looks.chosen])
    if not len(mine):
        return None
    chosen, block, some = looks.chosen[mine], looks.block[mine], looks.samples.take(mine)
    block = np.unique(block, return_inverse=True)[1]
    halves = [tuple(values[mine] for values in half) for half in looks.halves]
    seen = None if show is None else show(chosen, looks.value[..., : 3 * lamps]).reshape(len(chosen), lamps, 3)
    level = np.abs((halves[0][1][:, 0] if seen is None else seen).mean(axis=(0, 2), dtype=np.float64))
    lit = level > DARK * level.max(initial=0)
    if not lit.any():
        return None
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

    even, few, closely, more = zip(
        *((mean(even), mean(panes[:, 0]), mean(panes[:, 1]), mean(more)) for even, panes, more in halves), strict=True
    )
    if seen is None:
        shown, apart = few, 0.5 * (few[0] - few[1]) ** 2 * (EVEN_RAYS / made.budget.exit_rays) ** (2 * RAYS_FALL)
    else:
        shown = (mean(seen),) * 2
        apart = (shown[0] - few[0]) * (shown[1] - few[1])
    first, second = (s - e - m for s, e, m in zip(shown, even, more, strict=True))
    total = first * second + (apart if seen is None else 0)
    squares = _quiet(total.mean(axis=(1, 2)), (first**2 - second**2).mean(axis=(1, 2)))
    at = order[starts]
    return Verdict(
        error=relative(total),
        each=each(total),
        worst=float(np.sqrt(np.quantile(squares, 0.95))),
        entries=relative(more[0] * more[1]),
        lamps=relative((few[0] - closely[0]) * (few[1] - closely[1])),
        panes=relative((closely[0] - even[0]) * (closely[1] - even[1])),
        exits=relative(apart),
        places=some.position[at],
        normals=some.flat[at],
        squares=squares.astype(np.float32),
    )


def _look(made, seed, tick):
    """Remembered by `judge`, for the last trial is the whole bake's beginning."""
    places = made.exits if len(made.exits) else made.vertices
    chosen, block = some_blocks(made.exits, BLOCKS, seed) if len(made.exits) else _some_vertices(len(places))
    samples = places.samples.take(chosen)
    if made.starts is None:
        # those inside solid things tell nothing
        out = np.flatnonzero(~made.is_buried(samples))
        chosen, block, samples = chosen[out], block[out], samples.take(out)
    eyes = EntryLight(made.surface, made.tracer, seed)
    few = np.stack([grey(eyes.unit(lamp)) for lamp in made.test_lamps], 1)
    value = np.concatenate([made.weights.of_white(few), made.weights.of_white(made.test_direct)], 1)
    value = value.reshape(made.modes.regions, made.modes.panes, -1)
    region, fields, halves = own_region(made, samples), entry_fields(made), []
    for salt in (71, 72):
        even, panes = even_light(made, samples, region, value, EVEN_RAYS, seed + salt, tick)
        more = uneven_light(made, samples, fields, PATHS, seed + salt + 10)
        halves.append((even, panes.reshape(len(samples), 2, *even.shape[1:]), more))
    return Looks(chosen, block, samples, value, halves)


def where_judged(made: Prepared) -> Prepared:
    """The same with no other places than those that were judged."""
    chosen, at = np.unique(made.looks.chosen, return_inverse=True)
    looks = replace(made.looks, chosen=at)
    if len(made.exits):
        return replace(made, exits=made.exits.keep(chosen), vertices=made.vertices.keep([]), looks=looks)
    return replace(made, vertices=made.vertices.keep(chosen), looks=looks)


def shown_by_texels(made: Prepared, rows: np.ndarray, starts: np.ndarray) -> Show:
    """What exits at texels show. rows: (t, c) panes, sorted by region; starts: (regions + 1,)."""
    region = region_of(starts)
    return lambda chosen, value: _blend(made, rows[chosen], region[chosen], value)


def shown_by_points(made: Prepared, stored: Stored) -> Show:
    """What stored points show at texels, or at vertices where there are none."""
    served = stored.texels if len(made.exits) else stored.vertices
    region = region_of(stored.starts)
    return lambda chosen, value: served.take(chosen).apply(_blend(made, stored.rows, region, value))


def _blend(made, rows, region, value):
    """(n, s) float32 of rows (n, c) in the panes of regions (n,)."""
    result = np.empty((len(rows), value.shape[2]), np.float32)
    for r in np.unique(region):
        own = np.flatnonzero(region == r)
        result[own] = rows[own, : made.modes.panes] @ value[r]
    return result


def some_blocks(texels: Texels, blocks: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(n,) of the texels, that make up some blocks of 4×4, and (n,) the block of each; spread evenly over the atlas."""
    size, index = texels.resolution, texels.index
    names, block = np.unique(index // size // 4 * size + index % size // 4, return_inverse=True)
    many = min(blocks, len(names))
    start = np.random.default_rng(seed).random()
    number = np.full(len(names), -1)
    number[((np.arange(many) + start) * len(names) / many).astype(np.int64)] = np.arange(many)
    own = number[block]
    order = np.argsort(own, kind="stable")
    order = order[own[order] >= 0]
    return order, own[order]


def _some_vertices(count):
    chosen = np.unique(np.linspace(0, count - 1, min(count, 16 * BLOCKS)).astype(np.int64))
    return chosen, np.arange(len(chosen))


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
