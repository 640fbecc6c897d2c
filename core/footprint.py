"""What a bake holds in memory at its height, counted before it begins, and the forms and budgets of it that fit.

Chunks take care of passing arrays (memory.py). What stays is counted here: bytes for each triangle, texel, pair of entries
and the like, fitted from above to the largest memory of bakes of very different shapes (`python -m tests.bench scaling`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .memory import GIB
from .planner import LEAST, Budget, Settings, plan, uses_points
from .scene import Scene

# bytes
BASE = 150e6
IN_TRIANGLE = 850
IN_TEXEL = 60
AT_POINTS, IN_ROW = 100, 18  # of a texel: where points are the exits; where it has a row, for each of its numbers
IN_POINT = 2500
IN_PAIR = 12.5
"""Of a matrix between entries while it is made."""

IN_ELEMENT = 1500

BALANCED = 4096
"""Entries between which light is balanced, at most: matrices are of their square. Where more are asked for, they are
elements of so many."""

ELEMENTS_PAY = 2.45
"""Entries asked for over BALANCED up to which all are balanced with each other: far light is as coarse as entries, not
as their elements, so the planner's own bakes do without."""

ELEMENTS = 6
"""Elements of an entry above which there are more entries after all: near entries have the square of it in pairs."""

MATRICES = 0.4
"""Part of the memory that matrices between entries may take."""


def balanced(entries: int, memory: float) -> int:
    """Between how many entries light is balanced, where so many are asked for: all of them, or fewer, of which they are
    elements. memory: GiB."""
    most = int(np.sqrt(MATRICES * memory * GIB / IN_PAIR))
    if entries <= min(ELEMENTS_PAY * BALANCED, most):
        return entries
    return min(round(BALANCED * max(1.0, entries / (ELEMENTS * BALANCED)) ** 0.5), most, entries)


@dataclass(frozen=True)
class Footprint:
    """Bytes at a bake's height. triangles: of the scene's shapes; texels: of the atlas; rest: of entries, panes and
    points."""

    triangles: float
    texels: float
    rest: float

    @property
    def whole(self) -> float:
        return BASE + self.triangles + self.texels + self.rest


def footprint(budget: Budget, settings: Settings, triangles: int, at_points: bool) -> Footprint:
    """Of a bake with a budget. at_points: whether points are the exits."""
    count, modes = budget.entries, budget.regions * budget.panes
    matrix = balanced(count, settings.memory)
    held = 4.0 * matrix**2
    if matrix < count:
        held += held + IN_ELEMENT * count
    fields = 4.0 * count * (4 * modes + 3 * (budget.lamps + 200))
    rest = max(IN_PAIR * matrix**2, held + fields)
    rows = budget.panes + 6
    texel = IN_TEXEL + (AT_POINTS if at_points and settings.exits != "atlas" else IN_ROW * rows)
    if at_points:
        rest += IN_POINT * budget.points
    return Footprint(IN_TRIANGLE * triangles, texel * settings.resolution**2, rest)


def takes_points(settings: Settings, budget: Budget, triangles: int, texels: int, vertices: int) -> bool:
    """Whether exits are points: where they are cheaper, and where a row for each texel does not fit."""
    if uses_points(settings, budget, texels, vertices):
        return True
    least = within(budget, settings, triangles, False)
    return settings.exits == "auto" and footprint(least, settings, triangles, False).whole > settings.memory * GIB


def within(budget: Budget, settings: Settings, triangles: int, at_points: bool) -> Budget:
    """The budget with as many entries, regions, training lamps and points of it as fit; those that the settings give stay."""
    smaller = budget
    for part in np.geomspace(1, 0.02, 60):
        scaled = {"entries": part, "lamps": part**0.7, "regions": part, "points": part**0.5}
        cut = {
            name: max(round(getattr(budget, name) * scale), min(LEAST[name], getattr(budget, name)))
            for name, scale in scaled.items()
            if getattr(settings, name) is None
        }
        smaller = replace(budget, **cut)
        if footprint(smaller, settings, triangles, at_points).whole <= settings.memory * GIB:
            break
    return smaller


def shortage(settings: Settings, budget: Budget, triangles: int, at_points: bool, heaviest: str) -> str:
    """Why the least bake does not fit into its memory and what to do, "" where it fits. heaviest: name of the object with
    most triangles."""
    needs = footprint(within(budget, settings, triangles, at_points), settings, triangles, at_points)
    if needs.whole <= settings.memory * GIB:
        return ""
    ways = [f"raise Memory to {np.ceil(10 * needs.whole / GIB) / 10:.1f} GiB"]
    spare = settings.memory * GIB - (needs.whole - needs.texels)
    side = 1 << max(int(np.log2(max(settings.resolution * np.sqrt(max(spare, 0) / needs.texels), 1))), 0)
    if 64 <= side < settings.resolution:
        ways.append(f"lower Resolution to {side}")
    if not at_points and settings.exits != "auto":
        ways.append("set Light At to Automatic")
    if needs.triangles > 0.3 * needs.whole:
        ways.append(f"simplify '{heaviest}', which has most of the {triangles:,} triangles, or hide it from renders")
    if needs.rest > 0.3 * needs.whole and any(getattr(settings, n) for n in ("entries", "regions", "panes", "lamps")):
        ways.append("ask for fewer entries, regions or panes")
    return (
        f"This bake takes about {needs.whole / GIB:.1f} GiB of memory, and {settings.memory:.3g} GiB are allowed: "
        + ", or ".join(ways)
        + "."
    )


def crowded(entries: int, memory: float) -> str:
    """Why a matrix between so many entries is not made, "" where it is: there can be more than were asked for."""
    if IN_PAIR * entries**2 <= memory * GIB:
        return ""
    return (
        f"Light cannot be balanced between the {entries:,} sides of surfaces that it reaches in the {memory:.3g} GiB of "
        "memory that are allowed: raise Memory, join small objects, or hide some from renders."
    )


def refusal(scene: Scene, settings: Settings) -> str:
    """The same for a scene."""
    budget = plan(scene, settings)
    counts = np.bincount(scene.triangle_object, minlength=len(scene.objects))
    heaviest = scene.objects[int(counts.argmax())].name
    vertices = sum(item.at_vertices for item in scene.objects)
    triangles = len(scene.triangles)
    at_points = takes_points(settings, budget, triangles, settings.resolution**2, vertices)
    return shortage(settings, budget, triangles, at_points, heaviest)
