"""A bake measures itself: what its panes lose, how much noise its gather left, and what points lose between them."""

from __future__ import annotations

import numpy as np

from ..panes.exits import gather_panes
from ..panes.modes import Modes
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
    truth = transport.between @ transport.solve(albedo, albedo * direct, 1e-3)
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
    first, second = (_fresh(made, some, region, made.budget.exit_rays, seed + salt) for salt in (71, 72))
    mean = 0.5 * float((first + second).mean())
    return float(np.sqrt(0.5 * ((first - second) ** 2).mean()) / 4 / mean) if mean > 0 else 0.0


def interpolation_error(made: Prepared, stored: Stored, seed: int) -> float:
    """Relative RMSE at single texels of what the points give, their own noise included, against two fresh gathers whose
    noise cancels out."""
    places, shown = (made.exits, stored.texels) if len(made.exits) else (made.vertices, stored.vertices)
    chosen = np.flatnonzero(~shown.orphan)
    chosen = np.sort(np.random.default_rng(seed).permutation(chosen)[:PROBES])
    some = places.samples.take(chosen)
    region = own_region(made, some)
    order = np.argsort(region, kind="stable")
    some, region, chosen = some.take(order), region[order], chosen[order]
    first, second = (_fresh(made, some, region, PROBE_RAYS, seed + salt) for salt in (71, 72))
    known = np.repeat(np.arange(len(stored.starts) - 1), np.diff(stored.starts))
    values = _values(made, stored.rows, known)
    found = type(shown)(shown.point[chosen], shown.weight[chosen]).apply(values)
    mean = 0.5 * float((first + second).mean())
    return float(np.sqrt(max(float(((found - first) * (found - second)).mean()), 0)) / mean) if mean > 0 else 0.0


def _fresh(made: Prepared, some: SurfaceSamples, region: np.ndarray, rays: int, seed: int) -> np.ndarray:
    """(n, 3) irradiance of samples, sorted by region, from a gather of their own."""
    starts = np.concatenate([[0], np.cumsum(np.bincount(region, minlength=made.modes.regions))])
    rows = gather_panes(made.gatherer, some, starts, made.tables, rays, seed)
    return _values(made, rows, region)


def _values(made, rows, region):
    """(n, 3) irradiance that rows (n, c) of regions (n,) show under all test lamps at once; without any, that of the
    light that no lamp changes."""
    k = made.modes.panes
    if made.test_direct is None:
        return rows[:, k : k + 3]
    light = np.repeat(made.test_direct.mean(axis=1, keepdims=True), 3, axis=1)
    value = made.weights.of(light).reshape(-1, k, 3)[region]
    return np.einsum("nk,nkc->nc", rows[:, :k], value)
