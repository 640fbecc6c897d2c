"""Panes: eigenpanes against the paper's clusters, same entries and gather, at lamps that neither was trained on.

The truth is the full solve at the entries, with no panes at all: what is measured is what compression loses.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from lightpanes.core.bake import Settings, bake
from lightpanes.core.bake.steps import prepare
from lightpanes.core.panes.clusters import cluster_mean, make_clusters
from lightpanes.core.panes.training import free_air, illuminate, point_lamps, room_around

from . import harness, scenes

LAMPS = 100
CLUSTERS = 256
FAR, NEAR = 0.05, (0.04, 0.25)
"""m: least distance of far lamps from anything; distances of near lamps from the surface below."""
PAPER_BYTES = 128 * 2**20


def rows() -> Iterator[dict]:
    for name in scenes.NAMES:
        yield from sample_rows(name)


def held_out(prepared, near: tuple[float, float] | None, seed: int) -> np.ndarray:
    """(n, LAMPS) float32 irradiance of the entries under point lamps in the air."""
    rng = np.random.default_rng(seed)
    chosen = rng.integers(0, len(prepared.places), 6 * LAMPS)
    air = free_air(prepared.places.take(chosen), prepared.bvh, prepared.scene.extent, seed, near)
    air = air[room_around(air, prepared.gatherer) > (FAR if near is None else NEAR[0])][:LAMPS]
    assert len(air) == LAMPS
    each = len(prepared.places) // len(prepared.entries)
    return illuminate(point_lamps(air), prepared.places, each, prepared.tracer, seed + 5)


def relative_errors(found: np.ndarray, truth: np.ndarray, area: np.ndarray) -> np.ndarray:
    """(s,) relative RMSE over RGB and the whole surface, for (n, s, 3) fields and (n,) areas."""
    share = area / area.sum()
    square = np.einsum("n,nsc->s", share, (found - truth) ** 2) / 3
    return np.sqrt(square) / (np.einsum("n,nsc->s", share, truth) / 3)


def sample_rows(name: str) -> list[dict]:
    scene = scenes.open_sample(name)
    settings = Settings()
    prepared = prepare(scene, settings)
    entries, transport, modes, weights = prepared.entries, prepared.transport, prepared.modes, prepared.weights
    cluster = make_clusters(entries, CLUSTERS, scene.extent)
    root = np.sqrt(entries.area / entries.area.mean()).astype(np.float32)[:, None]

    def solve(direct):
        fields = []
        for c in range(3):
            albedo = entries.albedo[:, c : c + 1]
            fields.append(transport.between @ transport.solve(albedo, albedo * direct))
        return np.stack(fields, 2)

    def through_panes(direct):
        found = np.empty((*direct.shape, 3), np.float32)
        for s in range(direct.shape[1]):
            value = weights.of(np.repeat(direct[:, s : s + 1], 3, axis=1)).reshape(modes.regions, modes.panes, 3)
            found[:, s] = np.einsum("nk,nkc->nc", modes.basis, value[modes.region]) / root
        return found

    result = []
    stored = bake(scene, settings)
    for label, near, bar in (("far", None, 0.05), ("near", NEAR, 0.10)):
        direct = held_out(prepared, near, 4711 if near else 815)
        truth = solve(direct)
        ours = relative_errors(through_panes(direct), truth, entries.area)
        paper = relative_errors(solve(cluster_mean(direct, cluster, entries.area)[cluster]), truth, entries.area)
        detail = f"95 %: {np.quantile(ours, 0.95):.3f}; {CLUSTERS} clusters: {paper.mean():.3f} / {np.quantile(paper, 0.95):.3f}"
        result.append(harness.row(f"eigenpanes, {name}, {label} lamps: error", ours.mean(), bar, detail=detail))
        result.append(
            harness.row(f"eigenpanes, {name}, {label} lamps: over clusters'", ours.mean() / paper.mean(), 1 / 3)
        )
    blended = modes.panes * 4 / (CLUSTERS * 3 * 4)
    result.append(harness.row(f"eigenpanes, {name}: bytes blended a texel over clusters'", blended, 1 / 20))
    result.append(
        harness.row(f"eigenpanes, {name}: all stored bytes", stored.bytes / 2**20, PAPER_BYTES / 2**20, "MiB")
    )
    return result
