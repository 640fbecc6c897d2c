"""The paper's compression: entries that lie and face alike share one pane and its weight, the mean of theirs
(Szécsi & Szirmay-Kalos, section 3). Kept for comparison with the eigenpanes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..rays import CHUNK
from ..surface import SurfaceSamples
from ..transfer import Entries, Gatherer, Transport
from ..transfer.gather import ROWS
from .regions import features, make_regions


@dataclass(frozen=True)
class ClusterPanes:
    """cluster: (n,) int32 of each entry. panes: (clusters, t, 3) float32 irradiance of the exits for unit
    irradiance of the cluster's entries. area: (n,) weights of the mean."""

    cluster: np.ndarray
    panes: np.ndarray
    area: np.ndarray

    def texels(self, direct: np.ndarray, top: int | None = None) -> np.ndarray:
        """(t, 3) float32 irradiance under lamps whose direct irradiance of the entries is `direct` (n, 3).

        top: blend only the panes with the highest weights (the paper used 32 of 256).
        """
        weights = cluster_mean(direct, self.cluster, self.area)
        if top is not None and top < len(weights):
            weak = np.argsort(-weights.sum(axis=1), kind="stable")[top:]
            weights[weak] = 0
        return np.einsum("ktc,kc->tc", self.panes, weights)


def make_clusters(entries: Entries, count: int, extent: float, seed: int = 0) -> np.ndarray:
    """(n,) int32 cluster of each entry, by place and normal."""
    return make_regions(features(entries.position, entries.normal, extent), entries.area, count, seed)


def cluster_mean(direct: np.ndarray, cluster: np.ndarray, area: np.ndarray) -> np.ndarray:
    """(clusters, c) float32 mean of `direct` (n, c) over each cluster, weighted by area."""
    count = int(cluster.max()) + 1
    weight = np.bincount(cluster, area, count)
    sums = np.stack([np.bincount(cluster, area * direct[:, k], count) for k in range(direct.shape[1])], 1)
    return (sums / np.maximum(weight, 1e-30)[:, None]).astype(np.float32)


def gather_clusters(
    entries: Entries,
    transport: Transport,
    gatherer: Gatherer,
    exits: SurfaceSamples,
    cluster: np.ndarray,
    rays: int,
    seed: int,
    tick: Callable[[int], None] | None = None,
) -> ClusterPanes:
    """Panes of clusters from the same gather and solve as the eigenpanes."""
    count = int(cluster.max()) + 1
    member = np.zeros((len(entries), count), np.float32)
    member[np.arange(len(entries)), cluster] = 1
    radiosity = [transport.solve(entries.albedo[:, c : c + 1], entries.albedo[:, c : c + 1] * member) for c in range(3)]
    table = np.concatenate(radiosity, 1)
    panes = np.zeros((count, len(exits), 3), np.float32)
    pending: dict[int, list[np.ndarray]] = {}
    size, blocks = gatherer.size, -(-rays // ROWS)

    def consume(piece, ids):
        here = pending.setdefault(piece.start, [])
        here.append(ids)
        if len(here) < blocks:
            return
        landed = np.concatenate(pending.pop(piece.start))
        step = CHUNK // 8
        for start in range(0, landed.shape[1], step):
            part = landed[:, start : start + step]
            keys = part + np.arange(part.shape[1], dtype=np.int64) * size
            share = np.bincount(keys.reshape(-1), minlength=part.shape[1] * size).reshape(-1, size)
            found = (share[:, : len(entries)].astype(np.float32) / rays) @ table
            at = piece.start + start
            panes[:, at : at + part.shape[1]] = found.reshape(-1, 3, count).transpose(2, 0, 1)

    gatherer.gather(exits, rays, seed, consume, tick)
    return ClusterPanes(cluster, panes, entries.area)
