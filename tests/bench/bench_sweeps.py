"""Lamps that pass where panes are bad: 200 frames of each sweep, eigenpanes against clusters against Cycles.

Error is against brute-force Embree (`brute_force.truth`, two halves whose noise is taken off) on every twentieth frame, for
path tracing finds a lamp 1 cm above a floor too rarely: where Cycles' own noise allows, it checks the brute force. Flicker is
against the uncompressed solve of more entries, on all frames. `Cycles` as a way is one bake at its usual samples a frame, its
flicker on some frames in a row. The detector's word on each frame is held against the error, here and in sweeps of three
other scenes, by which nothing was made (`sweep_detector`).
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import bpy
import lightpanes
import numpy as np
from lightpanes.addon.reference import cycles_bake
from lightpanes.core import metrics
from lightpanes.core.bake import Settings
from lightpanes.core.bake.steps import Prepared

from . import brute_force, cycles, harness, sweep_charts, sweep_detector, sweep_scene, sweeps

FRAMES, FIRST, STEP = 200, 5, 20
SIZE = 64
"""Texels a side of the atlas: 6 to 16 cm each."""

TARGET = 0.1
"""Error asked for."""

TRUTH = {"entries": 6000, "entry_rays": 512, "lamps": 50, "regions": 48, "panes": 4}
TRUTH_RAYS = 256

LARGE = {"entries": 6000, "entry_rays": 256, "exit_rays": 32, "lamps": 400, "regions": 192, "panes": 16}
"""A bake whose relights are timed."""

SPP = 192
"""Samples of each half of Cycles' references, which check the brute force."""

CHECKABLE = 0.05
"""Noise of a reference that is a check."""

UNFIT = ("surface at 1 cm",)
"""Sweeps in which no affordable number of samples would be one."""

USUAL = 96
"""Samples a texel of a bake as users make it."""

ROW = range(40, 48)
"""Frames in a row for Cycles' own flicker."""


def rows() -> Iterator[dict]:
    # Cycles is asked with lamps as scenes hold them
    lightpanes.register()
    try:
        yield from _all_rows()
    finally:
        lightpanes.unregister()


def _all_rows():
    made = sweep_scene.open_rooms(SIZE)
    settings = Settings(error_target=TARGET, resolution=SIZE, exits="texels")
    truth = Settings(error_target=TARGET, resolution=SIZE, exits="texels", **TRUTH)
    all_sweeps = sweeps.Sweeps(made, settings, truth, TRUTH_RAYS)
    figures = {
        "made": sweep_charts.made(),
        "target": TARGET,
        "estimate": all_sweeps.baked.report["error"],
        "frames": FRAMES,
        "sweeps": {},
    }
    yield sweep_detector.cost(made, Settings(error_target=TARGET, resolution=SIZE, exits="texels", **LARGE))
    for name in sweeps.PATHS:
        found = all_sweeps.sweep(name, FRAMES)
        figures["sweeps"][name] = _judged(name, found, all_sweeps.fine)
        yield from _rows(name, figures["sweeps"][name])
    figures["detector"] = [frame for sweep in figures["sweeps"].values() for frame in _told(sweep)]
    yield from sweep_detector.rows("sweeps", figures["detector"])
    figures["held out"] = []
    for name in sweeps.HELD_OUT:
        found = sweep_detector.watch(name, SIZE, TARGET, truth)
        figures["held out"] += found
        yield from sweep_detector.rows(f"held-out sweeps, {name}", found)
    yield from sweep_detector.rows("held-out sweeps", figures["held out"])
    harness.OUT.mkdir(parents=True, exist_ok=True)
    (harness.OUT / "sweeps.json").write_text(json.dumps(figures, indent=1) + "\n", "utf-8")
    sweep_charts.draw(figures)


def _told(sweep) -> list[dict]:
    """What the detector said of the frames that were judged."""
    pairs = zip(sweep["frames"], sweep["errors"]["eigenpanes"], strict=True)
    return [
        sweep_detector.frame(sweep["expected"][k], sweep["warns"][k], sweep["nowhere"][k], error, TARGET)
        for k, error in pairs
    ]


def _judged(name, found: sweeps.Swept, ready: Prepared) -> dict:
    """JSON-able figures of a sweep; ready: entries of the truth."""
    places = np.linspace(*sweeps.PATHS[name], FRAMES)
    at = np.arange(FIRST, FRAMES, STEP)
    dark = np.isnan(found.errors["eigenpanes"])
    errors = {key: np.full(len(at), np.nan) for key in (*found.images, "Cycles", "uncompressed")}
    checks = []
    for k, frame in enumerate(at):
        if dark[frame]:
            continue
        light = sweeps.lamp(places[frame])
        halves = brute_force.truth(ready, light, SIZE)
        truth = halves.mean(axis=0)
        sweep_scene.move_lamp(places[frame])
        one, written, _ = cycles_bake(bpy.context, {"INDIRECT"}, SIZE, USUAL, 50 + frame)
        mask = written & found.mask
        images = {key: values[frame] for key, values in found.images.items()}
        images |= {"Cycles": one[..., 0], "uncompressed": found.halves[:, frame].mean(axis=0)}
        for key, image in images.items():
            errors[key][k] = metrics.compare(image, truth, mask, reference_halves=tuple(halves)).error
        if name not in UNFIT:
            reference = cycles.reference_indirect(bpy.context, SIZE, SPP, seed=1)
            seen = tuple(reference.halves[..., 0])
            check = metrics.compare(truth, reference.image[..., 0], mask, reference_halves=seen)
            if check.noise < CHECKABLE:
                checks.append([check.error, check.bias])
    usual = []
    for frame in ROW:
        sweep_scene.move_lamp(places[frame])
        usual.append(cycles_bake(bpy.context, {"INDIRECT"}, SIZE, USUAL, 50 + frame)[0][..., 0])
    row = slice(ROW.start, ROW.stop)
    flicker = found.flicker | {"Cycles": sweeps.extra_change(np.stack(usual), found.halves[:, row], found.mask)}
    return {
        "frames": at.tolist(),
        "errors": {
            key: [None if np.isnan(v) else round(float(v), 4) for v in values] for key, values in errors.items()
        },
        "against uncompressed": {key: np.nan_to_num(v, nan=-1).round(4).tolist() for key, v in found.errors.items()},
        "Cycles against the truth": np.mean(checks, axis=0).round(4).tolist() if checks else None,
        "flicker": {key: round(float(value), 5) for key, value in flicker.items()},
        "expected": [None if one.error is None else round(one.error, 4) for one in found.trusts],
        "warns": found.warned,
        "nowhere": [bool(one.nowhere) for one in found.trusts],
        "dark": dark.tolist(),
    }


def _mean(values):
    return float(np.mean([v for v in values if v is not None]))


def _rows(name, figures) -> Iterator[dict]:
    means = {key: _mean(values) for key, values in figures["errors"].items()}
    detail = ", ".join(f"{key} {value:.3f}" for key, value in means.items())
    check = figures["Cycles against the truth"]
    if check:
        detail += f"; the truth against Cycles {check[0]:.3f}, bias {check[1]:+.3f}"
    label = f"sweeps, {name}"
    yield harness.row(f"{label}: error over clusters'", means["eigenpanes"] / means["256 clusters"], 1.0, detail=detail)
    detail = ", ".join(f"{key} {value:+.4f}" for key, value in figures["flicker"].items())
    yield harness.row(f"{label}: flicker", figures["flicker"]["eigenpanes"], 0.02, detail=detail)
