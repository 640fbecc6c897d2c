"""Whether the panel is right about the light of the present lamp (core/panes/trust.py): expected against true error."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import bpy
import numpy as np
from lightpanes.addon.atlas import make_atlas
from lightpanes.addon.extract import extract
from lightpanes.core import metrics
from lightpanes.core.bake import Settings, bake
from lightpanes.core.bake.steps import prepare
from lightpanes.core.panes import Relighter
from lightpanes.core.panes.trust import expected_of, trust
from lightpanes.core.panes.unevenness import unevenness
from lightpanes.core.rays import Tracer
from lightpanes.core.scene import Scene

from . import brute_force, harness, judged, sweeps

LOW, HIGH = 0.6, 1.5
"""True error over the expected one, as for the estimate of a bake."""

FRAMES = 8
"""Of a held-out sweep."""

TURNS = 200
MILLISECONDS = 1.0


def frame(expected: float | None, warns: bool, nowhere: bool, true: float | None, target: float) -> dict:
    """JSON-able. true: None where the truth is black."""
    dark = true is None or np.isnan(true)
    return {
        "expected": expected and round(float(expected), 4),
        "true": None if dark else round(float(true), 4),
        "warns": bool(warns),
        "nowhere": bool(nowhere),
        "wrong": not dark and bool(true > target),
    }


def watch(name: str, size: int, target: float, truth: Settings) -> list[dict]:
    """Frames of the held-out sweeps of a scene of judged.py, as `frame` makes them.

    Of all texels that show, those that a surface only touches as well: Cycles leaves these black, brute force does not.
    """
    judged.open_scene(name)
    make_atlas(bpy.context, [item for item in bpy.context.scene.objects if item.type == "MESH"], size)
    made = extract(bpy.context, resolution=size)
    baked, fine = bake(made, Settings(error_target=target, resolution=size)), prepare(made, truth)
    relighter, expected = Relighter(baked.panes(), Tracer(made)), expected_of(baked.report)
    mask = np.zeros(size * size, bool)
    mask[fine.exits.index] = True
    mask = mask.reshape(size, size) & baked.own & ~judged.half_buried(made, baked.resolution)
    found = []
    for path in sweeps.HELD_OUT[name].values():
        for lamp in sweeps.lamps(path, FRAMES):
            image = relighter.relight([lamp])[..., 0].copy()
            told = trust(relighter, [lamp], expected)
            halves = brute_force.truth(fine, lamp, size)
            lit = halves[:, mask].mean() > DARK * lamp.power[0]
            true = (
                metrics.compare(image, halves.mean(axis=0), mask, reference_halves=tuple(halves)).error if lit else None
            )
            found.append(frame(told.error, told.warns(expected), bool(told.nowhere), true, target))
    return found


DARK = 1e-6
"""Irradiance, W/m², of a lamp's power, W, below which there is none."""


def rows(name: str, frames: Sequence[dict]) -> Iterator[dict]:
    """How often warnings are right, and how near expected errors are to true ones."""
    lit = [one for one in frames if one["true"] is not None]
    count = {
        (warns, wrong): sum(one["warns"] == warns and one["wrong"] == wrong for one in lit)
        for warns in (True, False)
        for wrong in (True, False)
    }
    dark = [one["nowhere"] for one in frames if one["true"] is None]
    detail = (
        f"{len(lit)} frames: {count[True, True]} warned of rightly, {count[False, False]} rightly not, "
        f"{count[True, False]} false alarms, {count[False, True]} missed; of {len(dark)} frames in the dark {sum(dark)} told"
    )
    misjudged = (count[True, False] + count[False, True] + len(dark) - sum(dark)) / len(frames)
    yield harness.row(f"{name}, detector: frames misjudged", misjudged, 0.1, detail=detail)
    ratio = np.array([one["true"] / one["expected"] for one in lit])
    near = float(((ratio >= LOW) & (ratio <= HIGH)).mean())
    detail = f"true over expected: median {np.median(ratio):.2f}, {ratio.min():.2f} to {ratio.max():.2f}"
    yield harness.row(f"{name}, detector: frames within {LOW} to {HIGH}", near, 0.9, at_least=True, detail=detail)


def cost(made: Scene, settings: Settings) -> dict:
    """What the detector adds to a relight of one lamp that moved, in turns with the relight itself."""
    baked = bake(made, settings)
    relighter, expected = Relighter(baked.panes(), Tracer(made)), expected_of(baked.report)
    weights = relighter.panes.weights
    found = []
    for place in np.linspace(*sweeps.PATHS["the open room"], TURNS):
        light = sweeps.lamp(place)
        started = [time.perf_counter()]
        relighter.relight([light])
        started.append(time.perf_counter())
        trust(relighter, [light], expected)
        started.append(time.perf_counter())
        # parts of the relight
        unit, moment = relighter.entry_light.look(light)
        direct = (unit[:, None] * light.power).astype(np.float32)
        started.append(time.perf_counter())
        weights.sketch @ direct
        unevenness(moment, relighter.sensitive)
        found.append(np.diff([*started, time.perf_counter()]))
    relight, word, _, parts = 1000 * np.median(found, axis=0)
    detail = (
        f"{parts:.2f} of it within a relight of {relight:.1f} ms, which looks at {len(relighter.panes.surface)} entries"
    )
    return harness.row("sweeps, detector: time a relight, median", parts + word, MILLISECONDS, "ms", detail=detail)
