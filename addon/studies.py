"""Charts of single parts beside the one of error against time: points, panes, soft shadows, caustics, preview.

Each study takes a scene that was read and returns its figures, JSON-able: "title", "x" and "y" (what the axes show),
"log" (which of them), "lines" (label → [[x, y], …]) and "note"; or "title" and "skipped", why there is nothing to measure.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..core import metrics
from ..core.bake import Settings
from ..core.bake.check import compression_error, interpolation_error
from ..core.bake.clock import Clock
from ..core.bake.kept import Kept
from ..core.bake.steps import Prepared, prepare
from ..core.bake.stored import bake_points
from ..core.caustics import CausticAtlas, casters
from ..core.panes.clusters import cluster_mean, make_clusters
from ..core.penumbra import Occluders, Receivers, cast, cast_rays, sample_lamp
from ..core.point_cache import guides
from ..core.rays import Tracer
from ..core.scene import Light, Scene
from ..core.surface import make_texels

BASE = {"error_target": 0.1, "entry_rays": 1024}
"""Settings of the bakes that are studied: noise of the transport would drown what panes lose."""

POINTS = (500, 1400, 4000)
POINT_RAYS = 256

PANES = (2, 8, 32)
REGIONS = (16, 64)
CLUSTERS = (16, 64, 256)

SAMPLES = (16, 64, 256, 1024)
LAMP = 0.05
"""Width of the area lamp whose shadows are timed, in parts of the scene's extent."""
ROUNDS = 3

PHOTONS = (2_500, 5_000, 10_000, 20_000, 40_000, 80_000)
MANY = 8
"""The reference has so many times the most photons."""


@dataclass(frozen=True)
class Subject:
    """What studies are of. places: (n, 3) m, in the open air, far from surfaces first. lamps: the scene's own."""

    scene: Scene
    resolution: int
    seed: int
    places: tuple[tuple[float, float, float], ...]
    lamps: tuple[Light, ...]

    def settings(self, **more) -> Settings:
        return Settings(**({"resolution": self.resolution, "seed": self.seed} | BASE | more))


def points(subject: Subject) -> dict:
    """Number of gathered points against the error between them, by what guides their density."""
    base = prepare(subject.scene, subject.settings(exits="points", point_rays=POINT_RAYS))
    ways = {
        "lamps (default)": None,
        "uniform": lambda ground: guides.uniform(ground.coarse),
        "ambient occlusion (the paper)": lambda ground: guides.by_occlusion(ground.ao),
    }
    lines = {name: [] for name in ways}
    for count in POINTS:
        for name, guide in ways.items():
            made = replace(base, budget=replace(base.budget, points=count))
            stored = bake_points(made, subject.settings(exits="points", point_rays=POINT_RAYS), Clock(), guide)
            lines[name].append([stored.gathered, round(interpolation_error(made, stored, subject.seed), 5)])
    note = "Against fresh gathers whose noise cancels out; lamps that no guide knows."
    return _figures("Points against error, by guide", "gathered points", "error between points", lines, note)


def compression(subject: Subject) -> dict:
    """Panes that a texel blends against what compression loses, eigenpanes and the paper's clusters."""
    kept = Kept()
    settings = subject.settings(exits="texels")
    lines: dict[str, list] = {}
    made: Prepared | None = None
    for regions in REGIONS:
        found = lines.setdefault(f"{regions} regions of eigenpanes", [])
        for panes in PANES:
            # the transport and the lamps are the same each time
            made = prepare(subject.scene, replace(settings, regions=regions, panes=panes), kept=kept)
            error = compression_error(made.entries, made.transport, made.modes, made.weights, made.test_direct)
            found.append([panes, round(error, 5)])
    lines["clusters (the paper)"] = [[3 * count, round(_clusters(made, count), 5)] for count in CLUSTERS]
    note = "Against the full solve at the entries, held-out lamps; a cluster's pane has red, green and blue."
    return _figures(
        "Panes against error, by compression", "panes that a texel blends", "error of compression", lines, note
    )


def _clusters(made: Prepared, count: int) -> float:
    """Error as `compression_error` has it, of the paper's clusters."""
    entries, direct = made.entries, made.test_direct
    area = (entries.area / entries.area.sum()).astype(np.float32)
    cluster = make_clusters(entries, count, made.scene.extent)
    albedo = entries.albedo[:, np.arange(direct.shape[1]) % 3]
    mean = cluster_mean(direct, cluster, entries.area)[cluster]
    truth, found = (made.transport.between @ made.transport.solve(albedo, albedo * b, 1e-3) for b in (direct, mean))
    level = area @ truth
    lit = level > 1e-6 * level.max(initial=0)
    return float(np.mean(np.sqrt(area @ (found - truth) ** 2)[lit] / level[lit])) if lit.any() else 0.0


def penumbra(subject: Subject) -> dict:
    """Samples of an area lamp against the speed of penumbra casting over that of rays."""
    tracer = Tracer(subject.scene)
    samples = make_texels(subject.scene, subject.resolution).samples
    lift = samples.position + samples.flat * np.float32(tracer.offset)
    receivers, occluders = Receivers(lift.astype(np.float32), samples.normal), Occluders.of(tracer, True)
    matrix, size = np.eye(4), LAMP * subject.scene.extent
    matrix[:3, 3] = subject.places[0]
    light = Light("Study", "AREA", matrix, np.ones(3), size=(size, size))
    line = []
    for count in SAMPLES:
        lamp = sample_lamp(light, count)
        best = [np.inf, np.inf]
        for _ in range(ROUNDS):
            for k, run in enumerate(
                (lambda: cast(receivers, lamp, occluders), lambda: cast_rays(receivers, lamp, tracer.blocked))  # noqa: B023
            ):
                started = time.perf_counter()
                run()
                best[k] = min(best[k], time.perf_counter() - started)
        line.append([count, round(best[1] / best[0], 3)])
    note = f"A lamp of {size:.2g} m in open air, {len(samples):,} texels; both in turns, the best of {ROUNDS}."
    return _figures(
        "Soft shadows: speed over rays",
        "samples of the lamp",
        "times as fast as rays",
        {"penumbra casting": line},
        note,
    )


def caustics(subject: Subject) -> dict:
    """Photons of a lamp against the error of the caustics."""
    title = "Caustics: photons against error"
    if casters(subject.scene) is None:
        return {"title": title, "skipped": "Nothing in the scene is of smooth glass or metal."}
    lamps = [light for light in subject.lamps if light.casts_shadow and light.power.any()]
    atlas = CausticAtlas(subject.scene, subject.resolution)
    truth = atlas.image(lamps, MANY * PHOTONS[-1])[..., :3].copy() if lamps else np.zeros(1)
    if not truth.any():
        return {"title": title, "skipped": "No lamp of the scene's makes caustics."}
    line = []
    for count in PHOTONS:
        image = CausticAtlas(subject.scene, subject.resolution).image(lamps, count)[..., :3]
        line.append([count, round(metrics.relative_rmse(image, truth, block=4), 5)])
    note = f"Against {MANY * PHOTONS[-1]:,} photons of the same kind, not against Cycles, whose noise is larger; 4×4 texels."
    return _figures(title, "photons of a lamp", "RMSE over the mean", {"adaptive photons": line}, note)


def _figures(title, x, y, lines, note, log="xy") -> dict:
    return {"title": title, "x": x, "y": y, "log": log, "lines": lines, "note": note}


STUDIES: dict[str, Callable[[Subject], dict]] = {
    "points": points,
    "compression": compression,
    "penumbra": penumbra,
    "caustics": caustics,
}
"""By the names that `lightpanes chart --methods` knows. Of the preview see `preview_study`."""
