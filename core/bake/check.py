"""A bake measures itself: what its panes lose, how much noise its gather left, and what points lose between them."""

from __future__ import annotations

import numpy as np

from ..panes.exits import gather_panes
from ..panes.modes import Modes
from ..panes.regions import region_of, starts_of
from ..panes.weights import PaneWeights
from ..surface import SurfaceSamples
from ..transfer import Entries, Transport
from .steps import Prepared, own_region
from .stored import Stored

PROBES = 1536
"""Exits, about, that are gathered twice to measure the noise; as many from each region."""

PROBE_RAYS = 512
"""Rays of a fresh gather at a texel between points."""


def compression_error(
    entries: Entries, transport: Transport, modes: Modes, weights: PaneWeights, direct: np.ndarray
) -> float:
    """Relative RMSE at the entries of the panes against the full solve, mean over lamps not trained on.

    direct: (n, 3 s) irradiance of lamps at the entries; three lamps at a time take red, green and blue.
    """
    area = (entries.area / entries.area.sum()).astype(np.float32)
    root = np.sqrt(entries.area / entries.area.mean()).astype(np.float32)[:, None]
    albedo = entries.albedo[:, np.arange(direct.shape[1]) % 3]
    truth = transport.arriving(transport.solve(albedo, albedo * direct, 1e-3))
    values = [weights.of(direct[:, s : s + 3]) for s in range(0, direct.shape[1], 3)]
    value = np.concatenate(values, 1).reshape(modes.regions, modes.panes, -1)[modes.region]
    found = np.einsum("nk,nks->ns", modes.basis, value) / root
    mean = area @ truth
    lit = mean > 1e-6 * mean.max(initial=0)
    if not lit.any():
        return 0.0
    return float(np.mean(np.sqrt(area @ (found - truth) ** 2)[lit] / mean[lit]))


def gather_noise(made: Prepared, seed: int) -> float:
    """Relative RMSE on 4×4-texel blocks that the gather's noise leaves at texels, from some gathered twice.

    A block averages 16 texels whose noise is independent.
    """
    starts = made.starts
    chosen = []
    probes = max(PROBES // (len(starts) - 1), 1)
    for first, count in zip(starts[:-1], np.diff(starts), strict=True):
        some = np.linspace(0, max(count - 1, 0), min(count, probes)).astype(np.int64)
        chosen.append(first + np.unique(some)[:count])
    rows = np.concatenate(chosen)
    region = np.repeat(np.arange(len(chosen)), [len(c) for c in chosen])
    some = made.exits.samples.take(rows)
    first, second = (fresh_values(made, some, region, made.budget.exit_rays, seed + salt) for salt in (71, 72))
    first, second = first.sum(axis=1), second.sum(axis=1)
    mean = 0.5 * float((first + second).mean())
    return float(np.sqrt(0.5 * ((first - second) ** 2).mean()) / 4 / mean) if mean > 0 else 0.0


def interpolation_error(made: Prepared, stored: Stored, seed: int) -> float:
    """Relative RMSE on 4×4-texel blocks of what the points give, their own noise included, against two fresh gathers
    whose noise cancels out; mean over lamps not trained on. Without texels, at single vertices."""
    at_texels = len(made.exits) > 0
    places, shown = (made.exits, stored.texels) if at_texels else (made.vertices, stored.vertices)
    chosen = np.flatnonzero(~shown.orphan)
    if at_texels:
        size = made.exits.resolution
        block = made.exits.index[chosen] // size // 4 * size + made.exits.index[chosen] % size // 4
    else:
        block = chosen
    names, block = np.unique(block, return_inverse=True)
    picked = np.random.default_rng(seed).permutation(len(names))[: PROBES // 16 if at_texels else PROBES]
    mine = np.isin(block, picked)
    chosen, block = chosen[mine], np.unique(block[mine], return_inverse=True)[1]
    some = places.samples.take(chosen)
    region = own_region(made, some)
    order = np.argsort(region, kind="stable")
    some, region, chosen, block = some.take(order), region[order], chosen[order], block[order]
    found = shown.take(chosen).apply(pane_values(made, stored.rows, region_of(stored.starts)))
    fresh = [fresh_values(made, some, region, PROBE_RAYS, seed + salt) for salt in (71, 72)]
    found, first, second = (_block_means(values, block) for values in (found, *fresh))
    mean = 0.5 * (first + second).mean(axis=0)
    lit = mean > 1e-6 * mean.max(initial=0)
    square = ((found - first) * (found - second)).mean(axis=0)
    return float(np.mean(np.sqrt(np.maximum(square[lit], 0)) / mean[lit])) if lit.any() else 0.0


def _block_means(values, block):
    """(blocks, s) means of values (n, s)."""
    sums = np.zeros((int(block.max(initial=-1)) + 1, values.shape[1]), np.float32)
    np.add.at(sums, block, values)
    return sums / np.bincount(block)[:, None]


def fresh_values(made: Prepared, some: SurfaceSamples, region: np.ndarray, rays: int, seed: int) -> np.ndarray:
    """(n, s) irradiance of samples, sorted by region, from a gather of their own; see `pane_values`."""
    starts = starts_of(region, made.modes.regions)
    rows = gather_panes(made.gatherer, some, starts, made.tables, rays, seed)
    return pane_values(made, rows, region)


def pane_values(made: Prepared, rows: np.ndarray, region: np.ndarray) -> np.ndarray:
    """(n, s) irradiance that rows (n, c) of regions (n,) show under the test lamps, three of which take red, green and
    blue; without any, that of the light that no lamp changes."""
    k = made.modes.panes
    if made.test_direct is None:
        return rows[:, k : k + 3]
    lamps = made.test_direct
    values = [made.weights.of(np.ascontiguousarray(lamps[:, s : s + 3])) for s in range(0, lamps.shape[1], 3)]
    value = np.concatenate(values, 1).reshape(made.modes.regions, k, -1)
    result = np.empty((len(rows), lamps.shape[1]), np.float32)
    for r in np.unique(region):
        own = np.flatnonzero(region == r)
        result[own] = rows[own, :k] @ value[r]
    return result
