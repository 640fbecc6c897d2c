"""Seconds until an image is as good as wanted: the preview's, Cycles' and Cycles' with its denoiser, as rows and as docs/race.png.

Cycles' images are kept with its other references. Its seconds are measured at each run, from two short renders of each kind
(what a render takes before its first sample, and what a sample takes), for those of another day say nothing about this
machine. Ours begin with reading the scene, as Cycles' do.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import numpy as np

from . import harness, views

WANTED = 0.95
OURS = (1, 2, 4, 8, 16, 32, 64)
KINDS = {"Cycles": (False, (4, 16, 64, 128), (2, 8)), "Cycles, denoised": (True, (1, 4, 16, 64), (1, 4))}
"""Denoised or not; samples of the curve's images; samples of the renders whose seconds are measured."""

SEED = 7


def rows(scene, bounces: int, begin: Callable, similar: Callable) -> Iterator[dict]:
    """The rows. begin(): reads the scene and makes a preview. similar(image): SSIM of a Combined pass."""
    curves = {"Lightpanes": _ours(begin, similar)}
    for label, (denoise, samples, short) in KINDS.items():
        seconds = _pace(scene, bounces, denoise, short)
        images = (views.cycles_view(scene, n, seed=SEED, bounces=bounces, denoise=denoise) for n in samples)
        curves[label] = [
            (float(seconds(n)), similar(image.passes["Combined"])) for n, image in zip(samples, images, strict=True)
        ]
    _chart(curves, Path(bpy.data.filepath).stem)
    reached = {label: until(curve, WANTED) for label, curve in curves.items()}
    for label, value in reached.items():
        detail = ", ".join(f"{s:.2f} s {quality:.3f}" for s, quality in curves[label])
        row = f"preview, time to SSIM {WANTED}: {label}"
        if label == "Lightpanes":
            # where Cycles does not get there, the bar is what it took to its last image
            yield harness.row(row, value, min(reached["Cycles"], curves["Cycles"][-1][0]), "s", detail=detail)
        else:
            yield harness.row(row, value, unit="s", ok=True, detail=detail)


def until(curve, wanted: float) -> float:
    """Seconds at which a curve of (seconds, SSIM) reaches a value, between its points by the logarithm of time."""
    seconds, values = (np.array(column) for column in zip(*curve, strict=True))
    above = np.flatnonzero(values >= wanted)
    if not len(above):
        return float("inf")
    k = above[0]
    if k == 0:
        return float(seconds[0])
    return float(np.exp(np.interp(wanted, values[k - 1 : k + 1], np.log(seconds[k - 1 : k + 1]))))


def _ours(begin, similar):
    curve, started = [], time.perf_counter()
    preview = begin()
    spent = time.perf_counter() - started
    for frame in range(1, OURS[-1] + 1):
        started = time.perf_counter()
        preview.frame()
        spent += time.perf_counter() - started
        if frame in OURS:
            curve.append((spent, similar(preview.image())))
    return curve


def _pace(scene, bounces, denoise, short):
    """Cycles' seconds by samples."""
    taken = [
        views.cycles_view(scene, n, seed=SEED, bounces=bounces, denoise=denoise, keep=False).seconds for n in short
    ]
    each = max(taken[1] - taken[0], 0.0) / (short[1] - short[0])
    return lambda samples: taken[0] + each * (samples - short[0])


def _chart(curves, name) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4))
    for label, curve in curves.items():
        axes.semilogx(*zip(*curve, strict=True), "o-", label=label)
    axes.axhline(WANTED, color="grey", linewidth=0.5)
    axes.set(xlabel="seconds", ylabel="SSIM of the image with Cycles' reference", title=name, ylim=(None, 1))
    axes.legend(frameon=False)
    figure.tight_layout()
    harness.OUT.mkdir(parents=True, exist_ok=True)
    figure.savefig(harness.OUT / "race.png", dpi=100)
    plt.close(figure)
    shutil.copy(harness.OUT / "race.png", harness.ROOT / "docs" / "race.png")
