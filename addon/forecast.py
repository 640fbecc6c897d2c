"""What a bake will take, from counts alone: where its light will be known, the seconds and the memory.

The planner's own budgets go into a model of few terms. Its factors were fitted (least squares of the relative error,
none below 0) to the processor's time and the largest memory of bakes of the sample scenes. Times are the processor's over
the number of threads; a scene that was baked before is forecast by how far its last bake was from the model.
`python -m tests.bench forecast` measures both on the samples at 256² texels. The planner's trials came after the fit: a
bake that needs several takes longer than the bare model says.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import bpy

from ..core import footprint
from ..core.bake.stored import DENSER
from ..core.memory import GIB
from ..core.planner import Budget, Settings, needs_panes, plan
from ..core.threads import thread_count
from . import store
from .obstacles import Facts

COVERED = 0.85
"""Part of an atlas that charts fill, about."""

# s on one thread
LIVE_PAIR, STILL_PAIR = 5.3e-7, 4.7e-7  # of entries, with panes and without
TRIANGLE = 1.7e-4
PLACE = 6.2e-6
PLACE_RAY = 2.9e-7
POINT = 2.3e-5
POINT_RAY = 5.4e-7

# bytes
LEAST = 70e6
IN_LIVE_PAIR, IN_STILL_PAIR = 23, 9
IN_TRIANGLE = 5000
IN_PLACE = 400
IN_POINT = 600

FURTHEST = 5.0
"""The last bake corrects the model by this factor at most: it may have been on another machine."""


@dataclass(frozen=True)
class Forecast:
    """texels, points: where light will be stored; no points where texels are the exits. seconds: of the whole bake.
    bytes: that it takes at its height, beside what Blender has already."""

    texels: int
    points: int
    seconds: float
    bytes: float


def predict(facts: Facts) -> Forecast:
    """For the scene as it is and its settings."""
    settings, scene = _asked(facts)
    triangles = len(scene.triangles)
    budget = plan(scene, settings)
    textured = len(facts.receivers) > len(facts.at_vertices)
    texels = int(COVERED * settings.resolution**2) if textured else 0
    corners = sum(len(item.data.vertices) for item in facts.at_vertices)
    at_points = footprint.takes_points(settings, budget, triangles, texels, corners)
    budget = footprint.within(budget, settings, triangles, at_points)
    seconds, held = model(budget, triangles, texels + corners, at_points, needs_panes(scene))
    seconds *= _correction(facts)
    limit = facts.scene.lightpanes.time_budget
    if limit > 0:
        seconds = min(seconds, limit)
    stored = DENSER * budget.points if at_points and settings.exits != "atlas" else 0
    return Forecast(texels, stored, seconds, min(held, settings.memory * GIB))


def shortage(facts: Facts) -> str:
    """Why the bake would not fit into the memory that it may take, as far as counts tell; "" where it does."""
    settings, scene = _asked(facts)
    heaviest = max(facts.shown, key=_triangles, default=None)
    triangles = len(scene.triangles)
    if heaviest is None or (settings.exits == "atlas" and facts.at_vertices):
        return ""
    budget = plan(scene, settings)
    at_points = footprint.takes_points(settings, budget, triangles, settings.resolution**2, len(facts.at_vertices))
    return footprint.shortage(settings, budget, triangles, at_points, heaviest.name)


def _asked(facts: Facts) -> tuple[Settings, SimpleNamespace]:
    """The settings, and all that the planner asks of a scene."""
    asked = facts.scene.lightpanes
    settings = Settings(
        error_target=asked.error_target,
        resolution=asked.resolution,
        exits=asked.exits.lower(),
        seed=asked.seed,
        memory=asked.memory_budget,
    )
    triangles = sum(_triangles(item) for item in facts.shown)
    lamps = [SimpleNamespace(live=item.data.lightpanes.live) for item in facts.lamps]
    return settings, SimpleNamespace(triangles=range(triangles), lights=lamps)


def model(budget: Budget, triangles: int, places: int, at_points: bool, live: bool) -> tuple[float, float]:
    """Seconds and bytes of a bake. places: texels and vertices; live: whether any lamp is."""
    pairs = budget.entries**2
    seconds = (LIVE_PAIR if live else STILL_PAIR) * pairs + TRIANGLE * triangles + PLACE * places
    held = LEAST + (IN_LIVE_PAIR if live else IN_STILL_PAIR) * pairs + IN_TRIANGLE * triangles + IN_PLACE * places
    if at_points:
        seconds += POINT * DENSER * budget.points + POINT_RAY * budget.points * budget.point_rays
        held += IN_POINT * DENSER * budget.points
    else:
        seconds += PLACE_RAY * places * budget.exit_rays
    return seconds / thread_count(), held


def _triangles(item: bpy.types.Object) -> int:
    """Of an object as it renders, about: subdivision is counted, other modifiers are not."""
    if item.type != "MESH":
        return 0
    count = len(item.data.loops) - 2 * len(item.data.polygons)
    for modifier in item.modifiers:
        if modifier.type == "SUBSURF" and modifier.show_render:
            count *= 4**modifier.render_levels
    return count


def _correction(facts) -> float:
    """Seconds of the scene's last bake, cancelled goes at it included, over those that the model gives for it; 1 without
    one."""
    report = (store.read_meta(facts.scene) or {}).get("report", {})
    try:
        budget, places = Budget(**report["budget"]), report["texels"] + report.get("vertices", 0)
        live = "panes" not in report["skipped"]
        said, _ = model(budget, report["triangles"], places, report["exits"] != "texels", live)
        took = report["total_seconds"] + report.get("earlier_seconds", 0.0)
        return min(max(took / said, 1 / FURTHEST), FURTHEST)
    except (KeyError, TypeError):
        return 1.0
