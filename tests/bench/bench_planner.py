"""The planner: whether a bake's own error is the true one, and whether budgets by trial meet what was asked for.

The truth is Cycles', under lamps of the kind that bakes judge themselves by, but other ones (judged.py). `PART` in the
environment runs one of the parts alone: estimate, target, larger, time, budget; `SCENE` one scene of the estimate's. Whether
the default bake is a good one is read from the charts (bench_charts.py).
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import cache

import numpy as np
from lightpanes.core import metrics
from lightpanes.core.bake import Bake, Settings, bake
from lightpanes.core.scene import Scene

from . import harness, judged

LOW, HIGH = 0.6, 1.5
"""True error over the estimate."""

PAIRS = (
    ("cornell", 0.1),
    ("pillars", 0.1),
    ("two_rooms", 0.1),
    ("stairs", 0.1),
    ("cornell", 0.05),
    ("pillars", 0.05),
    ("two_rooms", 0.05),
    ("stairs", 0.05),
    ("cornell", 0.02),
    ("stairs", 0.02),
)

HALVES = (
    ("cornell", 0.1, "entries"),
    ("stairs", 0.1, "entries"),
    ("two_rooms", 0.1, "entries"),
    ("stairs", 0.05, "entries"),
    ("cornell", 0.1, "panes"),
    ("stairs", 0.1, "panes"),
    ("two_rooms", 0.1, "panes"),
    ("stairs", 0.05, "panes"),
    ("cornell", 0.1, "points"),
    ("stairs", 0.1, "points"),
)

TIMES = (("stairs", 8.0), ("cornell", 15.0), ("stairs", 25.0))


def rows() -> Iterator[dict]:
    part, scene = os.environ.get("PART", ""), os.environ.get("SCENE", "")
    made = {}
    if part in ("", "estimate"):
        for name in [scene] if scene else judged.NAMES:
            yield _estimate(name, made)
    if part in ("", "target"):
        yield from _targets(made)
    if part in ("", "larger"):
        yield _larger(made)
    if part in ("", "time"):
        yield from _times(made)
    if part in ("", "budget"):
        for name, seconds in TIMES:
            yield _in_time(name, seconds)


def _bake(name: str, made: dict, **settings) -> tuple[Bake, float]:
    """A bake with the planner's budgets, or those given, and its true error."""
    settings = {"error_target": 0.05} | settings
    key = name, tuple(sorted(settings.items()))
    if key not in made:
        scene, known = _judged(name)
        result = bake(scene, Settings(resolution=judged.resolution(name), **settings))
        made[key] = result, metrics.mean_error(judged.judge(scene, result, known))
    return made[key]


@cache
def _judged(name: str) -> tuple[Scene, list[judged.Truth]]:
    """A scene and what Cycles says of it."""
    scene = judged.open_scene(name)
    return scene, judged.truths(name, scene)


def _estimate(name, made):
    result, true = _bake(name, made, error_target=0.05)
    report = result.report
    ratio = true / report["error"]
    detail = f"true {true:.4f}, estimate {report['error']:.4f}, 95 % {report['error_95']:.3f}, {report['error_parts']}"
    return harness.row(f"true error over the bake's own, {name}", ratio, HIGH, ok=LOW <= ratio <= HIGH, detail=detail)


def _targets(made):
    found = []
    for name, target in PAIRS:
        result, true = _bake(name, made, error_target=target)
        found.append(true / target)
        report = result.report
        detail = (
            f"estimate {report['error']:.4f}, {report['entries']} entries, {report['seconds']:.0f} s, {report['bound']}"
        )
        yield harness.row(f"true error over target, {name} at {target}", true / target, detail=detail)
    yield harness.row("targets met of 10", int(np.sum(np.array(found) <= 1)), 9, at_least=True)
    yield harness.row("true error over target at worst", max(found), 1.5)


def _larger(made):
    """Bakes with half of one thing that the planner gave them, whose own error has to miss the target."""
    broken, details = 0, []
    for name, target, what in HALVES:
        exits = {"exits": "points"} if what == "points" else {}
        result, _ = _bake(name, made, error_target=target, **exits)
        budget = result.report["budget"]
        result, true = _bake(name, made, error_target=target, **exits, **budget | {what: budget[what] // 2})
        broken += result.report["error"] > target
        details.append(f"{name} {target} {what}: {result.report['error']:.3f} (true {true:.3f})")
    return harness.row("half of the entries, panes or points misses the target", broken, 8, at_least=True, detail="; ".join(details))  # fmt: skip


def _times(made):
    for name in ("stairs", "cornell"):
        targets = np.array([0.1, 0.05, 0.02])
        seconds = np.array([_bake(name, made, error_target=t)[0].report["seconds"] for t in targets])
        power = -np.polyfit(np.log(targets), np.log(seconds), 1)[0]
        yield harness.row(f"bake time as a power of 1 / target, {name}", power, 2.2, detail=f"{seconds.round(1)} s")


def _in_time(name, seconds):
    """A target out of reach, so that the time binds."""
    settings = Settings(resolution=judged.resolution(name), error_target=0.005, time_budget=seconds)
    report = bake(judged.open_scene(name), settings).report
    away = abs(report["seconds"] - seconds)
    ok = report["bound"] == "time" and away <= max(0.1 * seconds, 1.0)
    detail = f"{report['seconds']:.1f} s of {seconds:.0f}, {report['entries']} entries, bound by {report['bound']}"
    return harness.row(
        f"time used over the time there is, {name}", report["seconds"] / seconds, 1.1, ok=ok, detail=detail
    )
