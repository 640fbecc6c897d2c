"""Bakes of the chart's ways that can be relit, from small budgets to large ones, with their errors and times.

What takes too long is left out, and said so: a chart that nobody waits for shows nothing.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, replace

import numpy as np

from ..core.bake import Progress, Settings
from ..core.scene import Scene
from . import methods
from .reference import Reference

OURS = next(name for name, way in methods.METHODS.items() if way is methods.eigenpanes)

DEFAULT = {"error_target": 0.05}
"""What a bake has that nobody set anything for."""

LADDER = (
    {"entries": 256, "entry_rays": 128, "exit_rays": 32, "regions": 16, "lamps": 200},
    {"entries": 600, "entry_rays": 256, "exit_rays": 64, "regions": 32, "lamps": 400},
    {"error_target": 0.1},
    DEFAULT,
    {"error_target": 0.025},
)
"""Settings of the bake, small to large: two below what the planner gives, then the planner's own."""

GATHERED = (LADDER[0], LADDER[1], {"error_target": 0.2}, DEFAULT)
"""The same for clusters, whose error does not fall with more."""

WALKS = (256, 1024, 4096)
"""Entries of the virtual lights."""

PATIENCE = 60.0
"""s that one bake may take; what takes longer is left out, but for the smallest of a way and the default bake, and the chart
says so."""

SLOWER = 3.0
"""The same for other bakes that can be relit, in times of the slowest of ours."""

LONG = 6.0
"""s from which a bake of a way is made again only where a larger budget took less, which shows that it was disturbed, and
the default one."""

TURNS = 12
"""Times that each lamp position is relit after a bake, where the best counts too. No two in a row are the same, so
nothing is reused."""


class Steps:
    """Progress over steps whose cost is known before, in units of about a second."""

    TOTAL = 280

    def __init__(self, progress):
        self.progress = progress
        self.done, self.cost, self.stage, self.told = 0.0, 0.0, "", 0.0
        self.lock = threading.Lock()

    def begin(self, stage: str, cost: float) -> None:
        """End the step before and begin one."""
        self.done, self.cost, self.stage = self.done + self.cost, cost, stage
        self.tick(0.0)

    def tick(self, part: float) -> None:
        """part: of the step, in [0, 1]."""
        # tends to the end where more was to do than thought
        spent = (self.done + self.cost * part) / self.TOTAL
        # a bake that finds out that it has more to do falls back, and of its threads the last to tell must tell the most
        with self.lock:
            self.told = max(self.told, spent if spent < 0.9 else 1 - 0.1 * np.exp(9 - 10 * spent))
            self.progress(Progress(self.stage, self.told, 0))


def point(errors, bake, each, **budget) -> dict:
    """A point of the chart: errors under each lamp, s of a bake and of each relight."""
    return {
        "error": round(float(np.mean(errors)), 5),
        "errors": [round(float(e), 5) for e in errors],
        "bake_s": round(float(bake), 4),
        "relight_s": round(float(each), 6),
        **budget,
    }


class Rung:
    """One budget of a way: its errors, and the best times so far."""

    def __init__(
        self, given: dict, settings: Settings, made: methods.Baked, shining: list[tuple], truths: list[Reference]
    ):
        self.given, self.settings, self.planned = given, settings, made.budget
        self.budget = {"entries": made.entries, "rays": made.rays, "bytes": made.bytes}
        self.errors = [
            truth.compare(made.relight(lights), made.valid).error for lights, truth in zip(shining, truths, strict=True)
        ]
        self.seconds = np.inf
        self.relights = np.full(len(shining), np.inf)
        self.time(made, shining)

    def time(self, made: methods.Baked, shining: list[tuple]) -> None:
        """Take the times of another bake with these settings, where they are better."""
        self.seconds = min(self.seconds, made.seconds)
        for _ in range(TURNS):
            for row, lights in enumerate(shining):
                started = time.perf_counter()
                made.relight(lights)
                self.relights[row] = min(self.relights[row], time.perf_counter() - started)

    def point(self, extracting: float) -> dict:
        """extracting: s that reading the scene takes every way."""
        return point(self.errors, extracting + self.seconds, self.relights.mean(), **self.budget)


class _TooLong(Exception):
    """A bake took longer than it may."""


@dataclass
class Bakes:
    """Makes the rungs of the ways that can be relit. slowest: s of the longest bake of ours that was made."""

    scene: Scene
    base: Settings
    shining: list[tuple]
    truths: list[Reference]
    steps: Steps
    notes: list[str]
    slowest: float = 0.0

    def ladder(self, name: str) -> list[Rung]:
        """A way's budgets, from small to large, up to the first that takes longer than it may."""
        paper, ours = methods.METHODS[name] is methods.virtual_lights, name == OURS
        budgets = [{"entries": entries} for entries in WALKS] if paper else LADDER if ours else GATHERED
        limit = PATIENCE if ours or not self.slowest else min(SLOWER * self.slowest, PATIENCE)
        found: list[Rung] = []
        late = False
        for number, given in enumerate(budgets, 1):
            # virtual lights take time with their number
            before = found[-1].seconds / found[-1].given["entries"] if paper and found else 0.0
            free = not found or (ours and given == DEFAULT)
            self.steps.begin(
                f"{name}, {number} of {len(budgets)}", given.get("entries", 1) / 60 if paper else 3 * number
            )
            try:
                if before * given.get("entries", 0) > limit or (late and not free):
                    raise _TooLong
                found.append(self.rung(name, given, np.inf if free else limit))
            except _TooLong:
                late, default_follows = True, ours and DEFAULT in budgets[number:]
                more = " and more" if number < len(budgets) and not default_follows else ""
                self.notes.append(f"{name}: {_named(given)}{more} left out, a bake takes over {limit:.3g} s.")
                if not default_follows:
                    break
            else:
                self.slowest = max(self.slowest, found[-1].seconds) if ours else self.slowest
        return found

    def rung(self, name: str, given: dict, limit: float = np.inf) -> Rung:
        """One bake and its errors. Raises _TooLong where it takes over `limit` s."""
        settings, started = replace(self.base, **given), time.perf_counter()

        def tick(part):
            if time.perf_counter() - started > limit:
                raise _TooLong
            self.steps.tick(part)

        made = methods.METHODS[name](self.scene, settings, tick)
        return Rung(given, settings, made, self.shining, self.truths)

    def by_hand(self, rung: Rung) -> Rung | None:
        """Another bake of ours, without trials: with the budgets that they led to; None where it takes longer than it may."""
        self.steps.begin("Budgets by hand", rung.seconds)
        try:
            if rung.seconds > 2 * PATIENCE:
                raise _TooLong
            return self.rung(OURS, rung.planned, PATIENCE)
        except _TooLong:
            self.notes.append(f"{OURS}: the default's budgets by hand left out, a bake takes over {PATIENCE:.3g} s.")
            return None

    def again(self, ladders: dict[str, list[Rung]], by_hand: Rung | None) -> None:
        """Time those once more that are short, were disturbed or are the default bake, but none that take very long."""
        for name, ladder in ladders.items():
            for number, rung in enumerate(ladder, 1):
                disturbed = any(larger.seconds < rung.seconds for larger in ladder[number:])
                own = name == OURS and rung.given == DEFAULT
                if (disturbed or own or rung.seconds < LONG) and rung.seconds < PATIENCE / 2:
                    self._time(f"{name}, {number} of {len(ladder)} again", name, rung)
        if by_hand is not None and by_hand.seconds < PATIENCE / 2:
            self._time("Budgets by hand again", OURS, by_hand)

    def _time(self, stage, name, rung):
        self.steps.begin(stage, rung.seconds)
        rung.time(methods.METHODS[name](self.scene, rung.settings, self.steps.tick), self.shining)


def _named(given: dict) -> str:
    """A budget in words."""
    return f"{given['entries']:,} entries" if "entries" in given else f"an error of {given['error_target']:g}"
