"""Budgets by trial: a small bake measures its own error, and larger ones follow until the error is what was asked for.

Only what comes before the exits is tried, and judged at a few texels: gathering at all of them would take longer than the
rest. A round costs a few times less than the one after it, so all of them together cost little more than the last.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..footprint import within
from ..planner import Budget, Judged, Settings, Took, fit, needs_panes, part_of, plan, refine
from ..scene import Light, Scene
from .clock import Clock
from .kept import Kept
from .steps import KEPT_BACK, Prepared, Surfaces, find_surfaces, prepare_with, time_left, transport_parts
from .verdict import judge

ROUNDS = 5

STAGES = ("Entries", "Transport", "Lamps", "Panes", "Check")


@dataclass(frozen=True)
class Settled:
    """made: ready for its exits. bound: what ended the trials: "error", its target is met; "time", a better bake would not
    have fitted; "most", a better one would be too large; "given", the budgets were set by hand or nothing can be judged.
    judged: the trials."""

    made: Prepared
    bound: str
    judged: list[Judged]


def settle(scene: Scene, settings: Settings, clock: Clock, kept: Kept) -> Settled:
    """Run all stages up to the exits' gather, with the least budgets that meet the error target, or the largest that fit
    into the time. Raises SceneError for scenes that cannot be baked."""
    surfaces = find_surfaces(scene, settings, clock)
    budget = _within(plan(scene, settings), settings, surfaces)
    given = settings.entries is not None or not needs_panes(scene)
    if given and not settings.time_budget:
        return Settled(prepare_with(surfaces, settings, budget, clock, kept), "given", [])
    least = part_of(budget, settings, 0.0)
    if not given:
        least = replace(
            least, exit_rays=budget.exit_rays, point_rays=budget.point_rays, points=max(budget.points // 2, 1)
        )
    clock.start("Pilot")
    pilot = clock.pilot()
    made, found = _try(surfaces, settings, least, pilot, Kept() if settings.time_budget else kept)
    clock.stop()
    # the hurried bake may be the whole one
    clock.seconds |= pilot.seconds
    clock.traced |= pilot.traced
    took = _took(made, pilot.seconds, pilot.traced)
    judged = [found] if found is not None else []
    places = 0 if surfaces.at_points else len(surfaces.texels)
    if not judged:
        wanted = budget
        better = _in_time(wanted, settings, took, places, clock)
        if better is not None:
            made = prepare_with(surfaces, settings, better, clock, kept)
        made.budget = replace(made.budget, exit_rays=budget.exit_rays, point_rays=budget.point_rays)
        return Settled(made, "given" if better == wanted else "time", [])
    for _ in range(ROUNDS):
        wanted = _within(refine(settings, judged, surfaces.at_points), settings, surfaces)
        if wanted.entries <= made.budget.entries:
            break
        better = _in_time(wanted, settings, took, places, clock)
        if better is None:
            made.budget = replace(made.budget, exit_rays=wanted.exit_rays)
            return Settled(made, "time", judged)
        before, traced = dict(clock.seconds), dict(clock.traced)
        kept.drop(*transport_parts(made.budget.entries))
        rays = wanted.exit_rays, wanted.point_rays, wanted.points
        better = replace(better, exit_rays=rays[0], point_rays=rays[1], points=rays[2])
        made, found = _try(surfaces, settings, better, clock, kept, made.test_lamps)
        clock.stop()
        judged.append(found)
        if better.entries < wanted.entries:
            return Settled(made, "time", judged)
        spent = {name: clock.seconds[name] - before.get(name, 0.0) for name in STAGES}
        took = _took(made, spent, {name: clock.traced[name] - traced.get(name, 0) for name in STAGES})
    wanted = refine(settings, judged, surfaces.at_points)
    made.budget = replace(made.budget, exit_rays=wanted.exit_rays)
    last = judged[-1]
    met = last.error**2 - last.noise**2 <= settings.error_target**2
    return Settled(made, "error" if met else "most", judged)


def _within(budget: Budget, settings: Settings, surfaces: Surfaces) -> Budget:
    """As much of a budget as there is memory for."""
    return within(budget, settings, len(surfaces.scene.triangles), surfaces.at_points)


def _try(
    surfaces: Surfaces,
    settings: Settings,
    budget: Budget,
    clock: Clock,
    kept: Kept,
    judges: list[Light] | None = None,
) -> tuple[Prepared, Judged | None]:
    """A bake up to its panes and what it is found to be, None where nothing can be judged."""
    made = prepare_with(surfaces, settings, budget, clock, kept, judges)
    clock.start("Check")
    if not made.test_lamps:
        clock.stop()
        return made, None
    rows = np.arange(len(made.exits) or len(made.vertices))
    if made.starts is None:
        # those inside solid things tell nothing
        rows = rows[~made.is_buried((made.exits if len(made.exits) else made.vertices).samples)]
    verdict = judge(made, rows, settings.seed, tick=clock.pulse)
    clock.stop()
    return made, None if verdict is None else Judged(made.budget, verdict.error, verdict.noise)


def _in_time(wanted: Budget, settings: Settings, took: Took, places: int, clock: Clock) -> Budget | None:
    """As much of a budget as there is time for, None where that is no more than what is there already."""
    if not settings.time_budget:
        return wanted
    return fit(wanted, settings, took, places, KEPT_BACK * time_left(settings, clock))


def _took(made: Prepared, seconds: dict[str, float], traced: dict[str, int]) -> Took:
    return Took(
        replace(made.budget, entries=len(made.entries)),
        *(seconds.get(stage, 0.0) for stage in ("Entries", "Transport", "Lamps", "Panes")),
        traced["Transport"],
        seconds.get("Check", 0.0),
    )
