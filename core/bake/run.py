"""Run a bake from start to end, with progress; an exception raised in the progress callback cancels it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from ..panes import Panes
from ..panes.exits import gather_panes, joined, smooth_panes
from ..planner import Settings, limit_rays
from ..scene import Scene
from .check import compression_error, gather_noise
from .clock import Clock, Progress
from .record import Bake
from .steps import prepare


def bake(scene: Scene, settings: Settings | None = None, progress: Callable[[Progress], None] | None = None) -> Bake:
    """Bake how `scene` passes light around.

    progress is called every few thousand rays; an exception that it raises cancels the bake. Same scene and
    settings, same bake, on any number of threads (a time budget excepted). Raises SceneError for scenes that
    cannot be baked.
    """
    settings = settings or Settings()
    clock = Clock(progress)
    made = prepare(scene, settings, clock)
    exits, starts, tables, seed = made.exits, made.starts, made.tables, settings.seed
    budget = made.budget
    if settings.time_budget:
        traced = len(made.entries) * budget.entry_rays
        rate = traced / max(clock.seconds["Transport"], 1e-3)
        budget = limit_rays(budget, len(exits), rate, 0.9 * (settings.time_budget - clock.spent))

    clock.start("Exits", len(exits) * budget.exit_rays)
    found = gather_panes(made.gatherer, exits.samples, starts, tables, budget.exit_rays, seed + 41, clock.tick)
    beside = joined(exits)
    found = smooth_panes(found, exits, starts, beside)
    k = made.modes.panes
    fill = exits.fill()
    steady, first_hit = np.zeros((len(exits), 3), np.float32), None
    if made.has_steady_light:
        steady = np.ascontiguousarray(found[:, k : k + 3])
    if made.has_first_hit:
        shown = np.concatenate([found[:, k + 3 :], np.zeros((1, 3), np.float32)])[fill]
        first_hit = shown.reshape(settings.resolution, settings.resolution, 3)
    panes = Panes(
        rows=np.ascontiguousarray(found[:, :k]),
        starts=starts,
        steady=steady,
        fill=fill,
        texel=exits.index,
        beside=beside,
        resolution=settings.resolution,
        surface=made.surface,
        weights=made.weights,
    )

    clock.start("Check")
    parts = {}
    if made.test_direct is not None:
        parts["panes"] = compression_error(made.entries, made.transport, made.modes, made.weights, made.test_direct)
    parts["gather noise"] = gather_noise(
        made.gatherer, exits.samples, starts, tables, budget.exit_rays, seed, made.weights, made.test_direct
    )
    clock.stop()
    report = {
        "error": float(np.sqrt(sum(part**2 for part in parts.values()))),
        "error_parts": parts,
        "skipped": {} if made.test_direct is not None else {"panes": "no lamp is live"},
        "error_target": settings.error_target,
        "seconds": round(clock.spent, 3),
        "stages": clock.seconds,
        "rays": clock.rays,
        "texels": len(exits),
        "buried_texels": made.buried,
        "triangles": len(scene.triangles),
        "entries": len(made.entries),
        "regions": made.modes.regions,
        "panes_per_texel": k,
        "budget": asdict(budget),
        "warnings": made.warnings,
    }
    result = Bake.from_panes(panes, first_hit, {"report": report, "seed": seed})
    report["bytes"] = result.bytes
    if progress is not None:
        progress(Progress("Done", 1.0, clock.rays))
    return result
