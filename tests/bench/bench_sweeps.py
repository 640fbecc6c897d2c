"""Lamps that pass where panes are bad: 200 frames of each sweep, eigenpanes against clusters against Cycles.

Error is against Cycles at many samples on every twentieth frame; flicker is against the uncompressed solve of more entries, on
all frames. `Cycles at its usual samples` is that of one path traced bake a frame, on the same frames, its flicker on some in
a row. The detector's word on each frame is held against the error.
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

from . import cycles, harness, sweep_charts, sweep_scene, sweeps

FRAMES, FIRST, STEP = 200, 5, 20
SIZE = 64
"""Texels a side of the atlas: 6 to 16 cm each."""

TARGET = 0.1
"""Error asked for."""

TRUTH = {"entries": 6000, "entry_rays": 512, "lamps": 50, "regions": 48, "panes": 4}
TRUTH_RAYS = 256

SPP = {"surface at 1 cm": 768}
"""Samples of each half of Cycles' reference."""
SPP_ELSE = 192

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
    figures = {"target": TARGET, "estimate": all_sweeps.baked.report["error"], "frames": FRAMES, "sweeps": {}}
    for name in sweeps.PATHS:
        found = all_sweeps.sweep(name, FRAMES)
        figures["sweeps"][name] = _held_to_cycles(name, found)
        yield from _rows(name, figures["sweeps"][name])
    yield from _detector(figures)
    harness.OUT.mkdir(parents=True, exist_ok=True)
    (harness.OUT / "sweeps.json").write_text(json.dumps(figures, indent=1) + "\n", "utf-8")
    sweep_charts.draw(figures)


def _held_to_cycles(name, found: sweeps.Swept) -> dict:
    """JSON-able figures of a sweep."""
    places = np.linspace(*sweeps.PATHS[name], FRAMES)
    at = np.arange(FIRST, FRAMES, STEP)
    spp = SPP.get(name, SPP_ELSE)
    dark = np.isnan(found.errors["eigenpanes"])
    errors = {key: np.full(len(at), np.nan) for key in (*found.images, "Cycles", "uncompressed")}
    for k, frame in enumerate(at):
        if dark[frame]:
            continue
        sweep_scene.move_lamp(places[frame])
        reference = cycles.reference_indirect(bpy.context, SIZE, spp, seed=1)
        mask = reference.mask & found.mask
        one, _, _ = cycles_bake(bpy.context, {"INDIRECT"}, SIZE, USUAL, 50 + frame)
        images = {key: values[frame] for key, values in found.images.items()}
        images |= {"Cycles": one[..., 0], "uncompressed": found.halves[:, frame].mean(axis=0)}
        for key, image in images.items():
            halves = tuple(reference.halves[..., 0])
            errors[key][k] = metrics.compare(image, reference.image[..., 0], mask, reference_halves=halves).error
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
        "flicker": {key: round(float(value), 5) for key, value in flicker.items()},
        "expected": [None if one.error is None else round(one.error, 4) for one in found.trusts],
        "nowhere": [bool(one.nowhere) for one in found.trusts],
        "dark": dark.tolist(),
    }


def _mean(values):
    return float(np.mean([v for v in values if v is not None]))


def _rows(name, figures) -> Iterator[dict]:
    means = {key: _mean(values) for key, values in figures["errors"].items()}
    detail = ", ".join(f"{key} {value:.3f}" for key, value in means.items())
    label = f"sweeps, {name}"
    yield harness.row(
        f"{label}: error against Cycles over clusters'", means["eigenpanes"] / means["256 clusters"], 1.0, detail=detail
    )
    detail = ", ".join(f"{key} {value:+.4f}" for key, value in figures["flicker"].items())
    yield harness.row(f"{label}: flicker", figures["flicker"]["eigenpanes"], 0.02, detail=detail)


def _detector(figures) -> Iterator[dict]:
    """How often the warning is right, on the frames that Cycles judged."""
    counts = {"right": 0, "silent": 0, "false": 0, "missed": 0}
    dark = [0, 0]
    for sweep in figures["sweeps"].values():
        for frame, error in zip(sweep["frames"], sweep["errors"]["eigenpanes"], strict=True):
            if error is None:
                continue
            warns, wrong = sweep["expected"][frame] > TARGET, error > TARGET
            counts[("right" if wrong else "false") if warns else ("missed" if wrong else "silent")] += 1
        dark[0] += sum(sweep["dark"])
        dark[1] += sum(told for told, is_dark in zip(sweep["nowhere"], sweep["dark"], strict=True) if is_dark)
    figures["detector"] = counts
    total = sum(counts.values())
    detail = f"{total} frames: {counts['right']} warned of rightly, {counts['silent']} rightly not, {counts['false']} false alarms, {counts['missed']} missed; of {dark[0]} frames in the dark {dark[1]} told"
    yield harness.row(
        "sweeps, detector: frames misjudged", (counts["false"] + counts["missed"]) / total, 0.1, detail=detail
    )
