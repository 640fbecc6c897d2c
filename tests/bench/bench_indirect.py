"""Indirect irradiance at the default settings against Cycles: four samples, four lamps each that no bake trained on.

One lamp shines at a time, so that no bright steady light hides its error; the sun shines together with the sky.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np
from lightpanes.core import metrics
from lightpanes.core.bake import Settings, bake
from lightpanes.core.panes import Relighter
from lightpanes.core.rays import Tracer

from . import cycles, harness, scenes

RESOLUTION = Settings().resolution
ERROR, BIAS = 0.05, 0.02


def rows() -> Iterator[dict]:
    for name in scenes.NAMES:
        yield from sample_rows(name)


def sample_rows(name: str) -> list[dict]:
    """The two rows of one sample: mean error over its lamps, largest bias among them."""
    scene = scenes.open_sample(name, RESOLUTION)
    result = bake(scene, Settings(resolution=RESOLUTION))
    found = compare_sample(name, scene, result)
    parts = [
        f"{setting.lamp} {setting.frame}: {c.error:.3f} bias {c.bias:+.3f} noise {c.noise:.3f}" for setting, c in found
    ]
    report = result.meta["report"]
    detail = f"{'; '.join(parts)}; bake {report['seconds']:.1f} s, its own estimate {report['error']:.3f}"
    comparisons = [c for _, c in found]
    worst = max(abs(c.bias) for c in comparisons)
    label = f"indirect irradiance against Cycles, {name}"
    return [
        harness.row(f"{label}: relative RMSE", metrics.mean_error(comparisons), ERROR, detail=detail),
        harness.row(f"{label}: mean bias", worst, BIAS, detail="largest of the four lamps"),
    ]


def compare_sample(name: str, scene, result) -> list[tuple[scenes.Setting, metrics.Comparison]]:
    """Each setting of the open sample, relit by `result`, against Cycles."""
    relighter = Relighter(result.panes(), Tracer(scene))
    steady = relighter.relight(())[..., :3].copy()
    found = []
    for setting, lights in scenes.settings(name):
        ours = relighter.relight(lights)[..., :3].copy()
        if not setting.sky:
            ours -= steady
        reference = cycles.reference_indirect(bpy.context, RESOLUTION, setting.spp)
        found.append((setting, reference.compare(ours, valid_texels(result))))
    return found


def valid_texels(result) -> np.ndarray:
    """(H, W) bool: texels with a value of their own, not filled from neighbours (past a chart, inside an object)."""
    return result.own
