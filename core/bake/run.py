"""Run a bake from start to end, with progress; an exception raised in the progress callback cancels it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace

import numpy as np

from ..footprint import refusal
from ..memory import allowing
from ..panes import Panes
from ..panes.exits import gather_panes, joined, smooth_panes
from ..panes.regions import region_of
from ..panes.trust import concentration
from ..planner import MOST_ENTRIES, SURE, Budget, Settings, few_points, more_points, no_more_points
from ..rays import CHUNK
from ..scene import Scene, SceneError
from ..transfer import Begun
from .check import gather_noise, interpolation_error
from .clock import Clock, Progress
from .error_map import encode, error_map
from .fresh_light import entry_fields
from .kept import Cancelled, Kept, digest
from .record import Bake, point_arrays
from .rounds import settle
from .steps import Prepared, gather_in_time, transport_parts
from .stored import Stored, bake_points, spread_to_texels
from .verdict import Verdict, judge, shown_by_points, shown_by_texels, where_judged

MISSED = 1.5
"""Error over the one asked for from which on the user is told."""

WORTH_A_TRIAL = 0.75
"""Points over those that were tried above which it is not tried whether they are enough, too."""

HARDLY_MORE = 1.1
"""Error over that with more points, up to which fewer do where most of it comes from elsewhere."""

PARTS = {
    "panes": "in the panes",
    "gather noise": "noise",
    "points": "between points",
    "entries": "in the size of the entries",
    "lamps": "in how few places of an entry see a lamp",
}
"""Where the parts of an error are, in words."""


def bake(
    scene: Scene,
    settings: Settings | None = None,
    progress: Callable[[Progress], None] | None = None,
    kept: Kept | None = None,
    spent: float = 0.0,
) -> Bake:
    """Bake how `scene` passes light around.

    progress is called every few thousand rays; an exception that it raises cancels the bake. kept: takes what is
    finished when that is a `Cancelled`; given to the next bake of the same scene with the same settings, the bake goes
    on from there. A bake that is done is kept, too, until `kept` is cleared. spent: s of the time budget that reading the
    scene, say, has taken already. Same scene and settings, same bake, on any number of threads and in any number of goes
    (a time budget excepted, under which nothing is kept). Raises SceneError for scenes that cannot be baked.
    """
    settings = settings or Settings()
    kept = Kept() if kept is None or settings.time_budget else kept
    if sentence := refusal(scene, settings):
        raise SceneError(sentence)
    kept.open(scene, settings)
    clock = Clock(progress, kept.seconds, kept.reached, spent)
    try:
        with allowing(settings.memory):
            result = kept.part("bake", lambda: _bake(scene, settings, clock, kept))
    except Cancelled:
        kept.seconds, kept.reached = clock.earlier + clock.spent, clock.reached
        kept.save()
        raise
    except BaseException:
        # it may have ended in the middle of a chunk
        kept.clear()
        raise
    kept.only("bake")
    return result


def _bake(scene, settings, clock, kept):
    settled = kept.part("prepared", lambda: settle(scene, settings, clock, kept))
    if settled.made.test_lamps:
        # by the transport, which is let go below
        entry_fields(settled.made)
    # a copy: what follows changes it
    made = replace(settled.made)
    kept.drop(*transport_parts(made.budget.entries))
    seed = settings.seed
    parts = {"panes": 0.0} if made.test_lamps else {}
    if settled.judged:
        clock.error = settled.judged[-1].error
    # what follows reads the panes alone, and needs the memory
    made.transport = settled.made.transport = None
    at_points = made.starts is None and settings.exits != "atlas"
    if at_points:
        stored, verdict = _enough_points(made, settings, settled.bound, clock)
        panes, first_hit = _at_points(made, stored)
    elif made.starts is None:
        wanted = len(made.exits)
        made.exits, stored = spread_to_texels(made, settings, clock)
        made.buried += wanted - len(made.exits)
        # of other rows
        made.looks = None
        panes, first_hit = _atlas(made, stored.rows, stored.starts, joined(made.exits))
    else:
        stored = None
        panes, first_hit = _at_texels(made, settings, clock)

    clock.start("Check")
    if not at_points:
        verdict = judge(made, seed, shown_by_texels(made, panes.rows, panes.starts), tick=clock.pulse)
    at_exits = "gather noise" if stored is None else "points"
    if verdict is None:
        parts[at_exits] = gather_noise(made, seed) if stored is None else interpolation_error(made, stored, seed)
    clock.stop()
    # without live lamps, or where none lights anything
    error, worst = float(np.sqrt(sum(part**2 for part in parts.values()))), None
    if verdict is not None:
        error, worst = verdict.error, verdict.worst
        parts = {
            "panes": verdict.panes,
            at_exits: verdict.exits,
            "entries": verdict.entries,
            "lamps": verdict.lamps,
        }
    warnings = made.warnings + (_late(made, settings, clock) or _missed(made, settings, settled.bound, error, parts))
    report = {
        "error": error,
        "error_95": worst,
        "error_parts": parts,
        "concentration": 0.0
        if made.test_direct is None
        else concentration(made.weights, made.entries.area, made.test_direct),
        "skipped": {} if made.test_direct is not None else {"panes": "no lamp is live"},
        "error_target": settings.error_target,
        "bound": settled.bound,
        "rounds": [{"entries": j.budget.entries, "error": j.error} for j in settled.judged],
        "seconds": round(clock.spent, 3),
        "earlier_seconds": round(clock.earlier, 3),
        "stages": clock.seconds,
        "rays": clock.rays,
        "exits": "points" if at_points else "texels" if stored is None else "atlas",
        "texels": int(panes.own.sum()) if at_points else len(made.exits),
        "buried_texels": made.buried + (int(stored.texels.orphan.sum()) if at_points else 0),
        "triangles": len(scene.triangles),
        "entries": len(made.entries),
        "regions": made.modes.regions,
        "panes_per_texel": made.modes.panes,
        "budget": asdict(made.budget),
        "warnings": warnings,
    }
    points = None
    if stored is not None:
        report["gathered_points"] = stored.gathered
    if at_points:
        report["stored_points"] = len(stored.points)
        report |= {"vertices": len(made.vertices), "objects": [item.name for item in scene.objects]}
        points = point_arrays(stored.points, region_of(stored.starts), scene.triangle_object)
    meta = {"report": report, "seed": seed}
    if verdict is not None and len(made.exits):
        own = slice(None) if not at_points else np.flatnonzero(~stored.texels.orphan)
        meta["error_map"] = encode(error_map(verdict, made.exits, scene.extent, own))
    result = Bake.from_panes(panes, first_hit, meta, points)
    report["bytes"] = result.bytes
    if clock.progress is not None:
        clock.progress(Progress("Done", 1.0, clock.rays))
    return result


def _enough_points(made: Prepared, settings: Settings, bound: str, clock: Clock) -> tuple[Stored, Verdict | None]:
    """Exits at as many points as the error that was asked for takes, and what it is.

    How many is tried at the judged places alone: to find the points that serve all places takes longer than to gather.
    """
    if made.looks is None or bound in ("given", "time") or settings.time_budget or settings.points is not None:
        return _judged_points(made, settings, clock)
    looked_at, planned = where_judged(made), made.budget

    def tried(budget):
        looked_at.budget = budget
        clock.start(Clock.JUDGING)
        verdict = _judged_points(looked_at, settings, clock.pilot())[1]
        clock.stop()
        return verdict

    def more(verdict):
        return None if verdict is None else more_points(settings, made.budget, verdict.error, verdict.exits)

    made.budget = few_points(planned)
    found = tried(made.budget)
    wanted = more(found)
    if found is None:
        made.budget = planned
    elif wanted is None:
        made.budget = _fewest_points(settings, made.budget, found, tried)
    while True:
        while wanted is not None:
            made.budget = wanted
            wanted = more(tried(wanted))
        stored, verdict = _judged_points(made, settings, clock)
        wanted = more(verdict)
        if wanted is None:
            return stored, verdict


def _fewest_points(
    settings: Settings, budget: Budget, found: Verdict, tried: Callable[[Budget], Verdict | None]
) -> Budget:
    """The budget, whose points are enough, with the fewest that are. tried: what a bake with others is found to be."""
    most = max(SURE * settings.error_target, HARDLY_MORE * _doubtful(found))
    while found is not None and _doubtful(found) <= most:
        enough = budget
        errors = found.error, _doubtful(found)
        cuts = [no_more_points(settings, enough, error, found.exits) for error in errors]
        budget = max(cuts, key=lambda cut: cut.points)
        if budget.points > WORTH_A_TRIAL * enough.points:
            break
        found = tried(budget)
    return enough


def _doubtful(found: Verdict) -> float:
    """An error, or what it is where parts that make up for each other at the judged places do not."""
    return max(found.error, float(np.linalg.norm([found.panes, found.exits, found.entries])))


def _judged_points(made, settings, clock):
    stored = bake_points(made, settings, clock)
    clock.start(Clock.JUDGING)
    orphan = (stored.texels if len(made.exits) else stored.vertices).orphan
    verdict = judge(made, settings.seed, shown_by_points(made, stored), orphan, clock.pulse)
    clock.stop()
    return stored, verdict


def _late(made: Prepared, settings: Settings, clock: Clock) -> list[str]:
    """A warning where the time budget was less than the least that the scene takes."""
    asked, took = settings.time_budget, clock.ahead + clock.spent
    if not asked or took <= max(1.1 * asked, asked + 1):
        return []
    return [f"The time budget of {asked:.3g} s is too short: at the least quality the bake took {took:.3g} s."]


def _missed(made: Prepared, settings: Settings, bound: str, error: float, parts: dict[str, float]) -> list[str]:
    """A warning where the error is far from the one asked for, by budgets that nobody set by hand."""
    by_hand = any(getattr(settings, name) is not None for name in asdict(made.budget))
    if by_hand or error <= MISSED * settings.error_target:
        return []
    worst = max(parts, key=parts.get)
    if settings.time_budget:
        remedy = "allow more Time"
    elif worst == "points" and not len(made.vertices):
        remedy = "set Light At to Texels"
    elif bound == "memory":
        remedy = "allow more Memory"
    elif bound == "most" and made.budget.entries >= MOST_ENTRIES:
        remedy = "larger bakes are not made; keep lamps away from surfaces"
    else:
        remedy = "ask for a lower Error"
    return [
        f"The error is {100 * error:.1f} % where {100 * settings.error_target:.1f} % was asked for, most of it "
        f"{PARTS[worst]}: {remedy}."
    ]


def _at_texels(made: Prepared, settings: Settings, clock: Clock) -> tuple[Panes, np.ndarray | None]:
    """Panes whose exits are the atlas' texels, and the first hit of sky and faces, (H, W, 3)."""
    exits, starts = made.exits, made.starts

    def gather(rays, seed):
        # as points do: rows of other regions would not fit
        begun = made.kept.part(f"exits {rays} {digest(made.exits.index, starts).hex()}", Begun)
        clock.skip(rays * len(begun.done) * CHUNK)
        return gather_panes(made.gatherer, exits.samples, starts, made.tables, rays, seed, clock.tick, begun)

    rows = gather_in_time(made, settings, clock, "exit_rays", len(exits), gather)
    beside = joined(exits)
    return _atlas(made, smooth_panes(rows, exits, starts, beside), starts, beside)


def _atlas(made: Prepared, rows: np.ndarray, starts: np.ndarray, beside: np.ndarray) -> tuple[Panes, np.ndarray | None]:
    """Panes of rows (t, c) that are the texels' own, and the first hit of sky and faces, (H, W, 3)."""
    exits = made.exits
    fill = exits.fill()
    panes = _panes(made, rows, starts, fill=fill, texel=exits.index, beside=beside)
    first_hit = None
    if made.has_first_hit:
        shown = np.concatenate([rows[:, made.modes.panes + 3 :], np.zeros((1, 3), np.float32)])[fill]
        # smoothing undershoots beside edges of light
        first_hit = np.maximum(shown, 0).reshape(exits.resolution, exits.resolution, 3)
    return panes, first_hit


def _at_points(made: Prepared, stored: Stored) -> tuple[Panes, np.ndarray | None]:
    """Panes whose exits are points, and the first hit of sky and faces, (H, W, 3)."""
    exits, kept = made.exits, np.flatnonzero(~stored.texels.orphan)
    fill = exits.fill(kept)
    own = np.zeros(len(fill), bool)
    own[exits.index[kept]] = True
    shown = stored.texels.named(fill)
    panes = _panes(made, stored.rows, stored.starts, shown=shown, own=own, vertices=stored.vertices)
    first_hit = None
    if made.has_first_hit:
        values = np.ascontiguousarray(stored.rows[:, made.modes.panes + 3 :])
        first_hit = np.maximum(shown.apply(values), 0).reshape(exits.resolution, exits.resolution, 3)
    return panes, first_hit


def _panes(made, rows, starts, **more) -> Panes:
    k = made.modes.panes
    steady = np.zeros((len(rows), 3), np.float32)
    if made.has_steady_light:
        steady = np.ascontiguousarray(rows[:, k : k + 3])
    return Panes(
        rows=np.ascontiguousarray(rows[:, :k]),
        starts=starts,
        steady=steady,
        resolution=made.exits.resolution,
        surface=made.surface,
        weights=made.weights,
        **more,
    )
