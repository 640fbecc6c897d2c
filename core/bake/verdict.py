"""A bake measures its own error: what it shows at some blocks of texels, against light gathered anew.

Two independent halves of the fresh light cancel out their own noise: E[(s − a)(s − b)] is the square of what is wrong with
s alone, as long as a and b are right on average. So the whole error is measured at once, wherever it comes from; its parts
tell what to spend more on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..panes import Panes, Relighter
from ..panes.entry_light import EntryLight
from ..transfer.entries import PLACES
from .fresh_light import entry_fields, even_light, uneven_light
from .steps import Prepared

BLOCKS = 320
"""Blocks of 4×4 texels that are looked at, about; single vertices where no object has texels: 16 times as many."""

EVEN_RAYS = 384
"""Rays of a texel in each half, for the light of even entries."""

PATHS = 12
"""Paths of a texel in each half, for what entries hide."""

DARK = 1e-6
"""Lamps that light less than this part of what the brightest one does count for nothing."""


@dataclass(frozen=True)
class Verdict:
    """Relative errors of what the bake shows under lamps held out of its training (panes/held_out.py).

    error: RMSE over RGB divided by the mean, on blocks of 4×4 texels; mean over the lamps. worst: of the blocks' own RMS
    errors the 95th percentile. entries: the part of `error` that comes from light leaving entries evenly. lamps: that of
    seeing them from few places of an entry. places: (b, 3) float32 m, normals: (b, 3), and squares: (b,) float32, the
    blocks and the squares of their errors, as far as noise lets know them.
    """

    error: float
    worst: float
    entries: float
    lamps: float
    places: np.ndarray
    normals: np.ndarray
    squares: np.ndarray


def judge(made: Prepared, panes: Panes, rows: np.ndarray, seed: int) -> Verdict | None:
    """The error of what `panes` show; None where no held-out lamp lights anything.

    rows: of `made.exits`, the texels with light of their own; of `made.vertices` where no object has texels.
    """
    at_texels = len(made.exits) > 0
    lamps = made.test_lamps
    shown, closely = _shown(made, panes, seed)
    source = made.exits if at_texels else made.vertices
    chosen, block = _some(made, rows, seed)
    if not len(chosen):
        return None
    index = made.exits.index if at_texels else np.arange(len(made.vertices))
    level = shown[index[rows]].mean(axis=(0, 2), dtype=np.float64)
    lit = level > DARK * level.max(initial=0)
    if not lit.any():
        return None
    some = source.samples.take(chosen)
    fields = entry_fields(made, made.test_direct)
    count = np.bincount(block)

    def mean(values):
        """(b, l, 3) means over blocks of values (n, l, 3), relative to the lamps' mean."""
        sums = np.zeros((len(count), *values.shape[1:]))
        np.add.at(sums, block, values)
        return (sums / count[:, None, None])[:, lit] / level[lit, None]

    def relative(square):
        """Mean over lamps of the root of squares (b, l, 3)."""
        found = np.einsum("b,blc->l", count / count.sum(), square) / 3
        return float(np.sqrt(np.maximum(found, 0)).mean())

    found = mean(shown[index[chosen]])
    more = [mean(uneven_light(made, some, lamps, fields, PATHS, seed + salt)) for salt in (81, 82)]
    fresh = [mean(even_light(made, some, fields, EVEN_RAYS, seed + salt)) for salt in (71, 72)]
    first, second = (found - even - extra for even, extra in zip(fresh, more, strict=True))
    squares = _quiet((first * second).mean(axis=(1, 2)), ((first - second) ** 2).mean(axis=(1, 2)))
    at = np.unique(block, return_index=True)[1]
    return Verdict(
        error=relative(first * second),
        worst=float(np.sqrt(np.quantile(squares, 0.95))),
        entries=relative(more[0] * more[1]),
        lamps=relative((found - mean(closely[index[chosen]])) ** 2),
        places=some.position[at],
        normals=some.flat[at],
        squares=squares.astype(np.float32),
    )


def _shown(made, panes, seed):
    """Two (places, l, 3) float32: what the lamps show, each alone, and what they would if every entry saw them from all of
    its places."""
    relighter = Relighter(panes, made.tracer, seed)
    few, all_places = relighter.entry_light, EntryLight(panes.surface, made.tracer, seed, few=PLACES)

    def values(lights):
        light = relighter.light(lights)
        if not len(made.exits):
            return relighter.vertices(light)
        return relighter.image(light)[..., :3].reshape(-1, 3).copy()

    steady = values(())
    result = []
    for eyes in (few, all_places):
        relighter.entry_light = eyes
        # without lamps in between nothing is remembered
        values(())
        result.append(np.stack([values((lamp,)) - steady for lamp in made.test_lamps], 1))
    return result


def _some(made, rows, seed):
    """(n,) of `rows` that make up some blocks, and (n,) the block of each; blocks spread evenly over the rows' order."""
    if not len(made.exits):
        chosen = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), 16 * BLOCKS)).astype(np.int64))
        return rows[chosen], np.arange(len(chosen))
    size, index = made.exits.resolution, made.exits.index[rows]
    names, first, block = np.unique(index // size // 4 * size + index % size // 4, return_index=True, return_inverse=True)
    start = np.random.default_rng(seed).random()
    pick = (np.arange(min(BLOCKS, len(names))) + start) * len(names) / min(BLOCKS, len(names))
    number = np.full(len(names), -1)
    # in the order of their first rows, which are sorted by region
    number[np.argsort(first, kind="stable")[pick.astype(np.int64)]] = np.arange(len(pick))
    own = number[block]
    order = np.argsort(own, kind="stable")
    order = order[own[order] >= 0]
    return rows[order], own[order]


def _quiet(squares, noise):
    """(b,) squares of errors, of estimates (b,) that are right on average but noisy: drawn towards their mean by as much
    of their spread as is noise, and not below nothing.

    noise: (b,) mean squares of the halves' difference. With independent halves of variance v about an error e the product's
    variance is 2 e² v + v², which the halves' difference, 2 v, tells.
    """
    mean = squares.mean()
    v = 0.5 * noise.mean()
    spread = squares.var()
    kept = max(spread - 2 * max(mean, 0) * v - v * v, 0.0) / max(spread, 1e-30)
    return np.maximum(mean + kept * (squares - mean), 0)
