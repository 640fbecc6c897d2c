"""Budgets by trial: a small bake measures its own error, and larger ones follow until the error is what was asked for.

Only what comes before the exits is tried, and judged at a few texels: gathering at all of them would take longer than the
rest. A round costs a few times less than the one after it, so all of them together cost little more than the last.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..footprint import within
from ..planner import (
    MOST_RAYS,
    SURE,
    Budget,
    Judged,
    Settings,
    Took,
    beyond_noise,
    cheap_rays,
    first_try,
    fit,
    needs_panes,
    part_of,
    plan,
    refine,
)
from ..scene import Light, Scene
from .clock import Clock
from .kept import Kept
from .steps import KEPT_BACK, Prepared, Surfaces, find_surfaces, prepare_with, time_left, transport_parts
from .verdict import BLOCKS, judge, some_blocks

ROUNDS = 5

USUAL_RAYS = 192
"""Of an exit."""

STAGES = ("Entries", "Transport", "Lamps", "Panes", Clock.JUDGING)


@dataclass(frozen=True)
class Settled:
    """made: ready for its exits. bound: what ended the trials: "error", its target is met; "time", a better bake would not
    have fitted; "memory", nor into that; "most", a better one would be too large; "given", the budgets were set by hand
    or nothing can be judged. judged: the trials."""

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
    clock.start("Pilot")
    pilot = clock.pilot()
    if settings.time_budget:
        # it may be the whole bake
        least = part_of(budget, settings, 0.0)
        if not given:
            points = max(budget.points // 2, 1)
            least = replace(least, exit_rays=budget.exit_rays, point_rays=budget.point_rays, points=points)
        made, found = _try(surfaces, settings, least, pilot, Kept())
    else:
        small = _within(first_try(settings, budget), settings, surfaces)
        made, found = _try(_where_looked_at(surfaces, settings), settings, small, pilot, kept)
    clock.stop()
    if settings.time_budget:
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
    whole = bool(settings.time_budget)
    for _ in range(ROUNDS):
        wanted = _within(refine(settings, judged, surfaces.at_points, whole), settings, surfaces)
        if whole and wanted.entries <= made.budget.entries:
            break
        better = _in_time(wanted, settings, took, places, clock)
        if better is None:
            return _out_of_time(made, settings, judged)
        before, traced = dict(clock.seconds), dict(clock.traced)
        kept.drop(*transport_parts(made.budget.entries))
        rays = wanted.exit_rays, wanted.point_rays, wanted.points
        better = replace(better, exit_rays=rays[0], point_rays=rays[1], points=rays[2])
        made, found = _try(surfaces, settings, better, clock, kept, made.test_lamps)
        whole = True
        clock.stop()
        judged.append(found)
        spent = {name: clock.seconds[name] - before.get(name, 0.0) for name in STAGES}
        took = _took(made, spent, {name: clock.traced[name] - traced.get(name, 0) for name in STAGES})
    wanted = refine(settings, judged, surfaces.at_points)
    made.budget = replace(made.budget, exit_rays=wanted.exit_rays)
    if made.starts is not None:
        made.budget = cheap_rays(settings, made.budget, len(made.exits))
    last = judged[-1]
    met = beyond_noise(last) <= SURE * settings.error_target
    tight = _within(wanted, settings, surfaces).entries < wanted.entries
    return Settled(made, "error" if met else "memory" if tight else "most", judged)


def _out_of_time(made: Prepared, settings: Settings, judged: list[Judged]) -> Settled:
    """What time is left goes to rays at the exits."""
    given = {name: value for name in MOST_RAYS if (value := getattr(settings, name)) is not None}
    made.budget = replace(made.budget, **(MOST_RAYS | given))
    return Settled(made, "time", judged)


def _where_looked_at(surfaces: Surfaces, settings: Settings) -> Surfaces:
    """The surfaces of a bake that is but judged."""
    texels = surfaces.texels
    if len(texels):
        texels = texels.keep(np.sort(some_blocks(texels, BLOCKS, settings.seed)[0]))
    return replace(surfaces, texels=texels, hurried=True)


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
    clock.start(Clock.JUDGING)
    if not made.test_lamps:
        clock.stop()
        return made, None
    verdict = judge(made, settings.seed, tick=clock.pulse)
    clock.stop()
    return made, None if verdict is None else Judged(made.budget, verdict.error, verdict.exits)


def _in_time(wanted: Budget, settings: Settings, took: Took, places: int, clock: Clock) -> Budget | None:
    """As much of a budget as there is time for, None where that is no more than what is there already."""
    if not settings.time_budget:
        return wanted
    # rays at exits get what time is left at the end, if there is any
    lean = replace(wanted, exit_rays=min(wanted.exit_rays, USUAL_RAYS))
    better = fit(lean, settings, took, places, KEPT_BACK * time_left(settings, clock))
    return wanted if better == lean else better


def _took(made: Prepared, seconds: dict[str, float], traced: dict[str, int]) -> Took:
    return Took(
        replace(made.budget, entries=len(made.entries)),
        *(seconds.get(stage, 0.0) for stage in ("Entries", "Transport", "Lamps", "Panes")),
        traced["Transport"],
        seconds.get(Clock.JUDGING, 0.0),
    )
