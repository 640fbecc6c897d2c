"""A bake measures itself: what its panes lose, and how much noise its gather left."""

from __future__ import annotations

import numpy as np

from ..panes.exits import gather_panes
from ..panes.modes import Modes
from ..panes.weights import PaneWeights
from ..surface import SurfaceSamples
from ..transfer import Entries, Gatherer, Transport

PROBES = 1536
"""Exits, about, that are gathered twice to measure the noise; as many from each region."""


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


def gather_noise(
    gatherer: Gatherer,
    exits: SurfaceSamples,
    starts: np.ndarray,
    tables: np.ndarray,
    rays: int,
    seed: int,
    weights: PaneWeights,
    direct: np.ndarray | None,
) -> float:
    """Relative RMSE on 4×4-texel blocks that the gather's noise leaves, from exits gathered twice.

    direct: (n, s) irradiance of lamps at the entries; without it the light that no lamp changes is judged. A block
    averages 16 texels whose noise is independent.
    """
    rows, lengths = [], []
    probes = max(PROBES // (len(starts) - 1), 1)
    for r in range(len(starts) - 1):
        count = int(starts[r + 1] - starts[r])
        chosen = starts[r] + np.unique(np.linspace(0, max(count - 1, 0), min(count, probes)).astype(np.int64))[:count]
        rows.append(chosen)
        lengths.append(len(chosen))
    rows = np.concatenate(rows)
    some = exits.take(rows)
    ends = np.concatenate([[0], np.cumsum(lengths)])
    k = weights.first.shape[0] // (len(starts) - 1)
    twice = [gather_panes(gatherer, some, ends, tables, rays, seed + salt) for salt in (71, 72)]
    if direct is None:
        first, second = (t[:, k : k + 3] for t in twice)
    else:
        region = np.repeat(np.arange(len(lengths)), lengths)
        value = weights.of(np.repeat(direct.mean(axis=1, keepdims=True), 3, axis=1)).reshape(-1, k, 3)[region]
        first, second = (np.einsum("nk,nkc->nc", t[:, :k], value) for t in twice)
    mean = 0.5 * float((first + second).mean())
    if mean <= 0:
        return 0.0
    return float(np.sqrt(0.5 * ((first - second) ** 2).mean()) / 4 / mean)
