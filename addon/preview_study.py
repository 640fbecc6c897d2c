"""The chart of the preview engine: how like Cycles it is after how long, beside Cycles itself with few samples."""

from __future__ import annotations

import os
import tempfile
import time

import bpy
import numpy as np

from ..core import metrics
from ..core.preview import Preview, Settings
from . import shown, view
from .pixels import read_pixels
from .reference import BOUNCES, UNBIASED

WIDTH = 128
"""Pixels across; the height is as the scene's camera has it."""

FRAMES = (1, 4, 16, 32)
SPP = (1, 4, 16)
REFERENCE_SPP = 512
DEPTH = 8
"""Bounces of both."""

TITLE = "Preview: likeness against time"


def measure(context: bpy.types.Context) -> dict:
    """Figures as studies have them (addon/studies.py), of the scene as it stands, with its own lamps and no bake."""
    scene = context.scene
    if scene.camera is None:
        return {"title": TITLE, "skipped": "The scene has no camera."}
    render = scene.render
    before = render.resolution_percentage
    try:
        render.resolution_percentage = max(1, round(100 * WIDTH / render.resolution_x))
        # the first render loads kernels
        cycles(scene, 1, 0)
        truth, _ = cycles(scene, REFERENCE_SPP, 9)
        path = [(cycles(scene, spp, 1)) for spp in SPP]
        graph = context.evaluated_depsgraph_get()
        warnings: list[str] = []
        height, width = truth.shape[:2]
        eye = view.through_camera(scene.camera.evaluated_get(graph), render, width, height, warnings)
        surfaces, lighting = shown.read_surfaces(graph, warnings), shown.read_lighting(graph, warnings)
    finally:
        render.resolution_percentage = before
    # what is white to the eye is white in the comparison
    white = float(np.quantile(truth, 0.99)) or 1.0
    started, frames = time.perf_counter(), []
    preview = Preview(surfaces, eye, lighting.lights, lighting.sky, Settings(bounces=DEPTH))
    for number in range(1, FRAMES[-1] + 1):
        preview.frame()
        if number in FRAMES:
            spent = time.perf_counter() - started
            frames.append([round(spent, 3), _like(preview.image()[..., :3], truth, white)])
            # comparing takes no part in it
            started = time.perf_counter() - spent
    lines = {"Lightpanes' preview": frames, "Cycles": [[round(s, 3), _like(image, truth, white)] for image, s in path]}
    note = f"{width} × {height} pixels, no bake, against Cycles at {REFERENCE_SPP} samples, noise and all."
    return {"title": TITLE, "x": "s", "y": "SSIM", "log": "x", "lines": lines, "note": note}


def _like(image, truth, white) -> float:
    first, second = (np.clip(v / white, 0, 1).astype(np.float64) for v in (image, truth))
    return round(metrics.ssim(first, second), 4)


def cycles(scene: bpy.types.Scene, samples: int, seed: int) -> tuple[np.ndarray, float]:
    """(H, W, 3) linear image of the scene through its camera, path traced, row 0 at the bottom, and seconds; the scene stays
    as it was."""
    values = UNBIASED | dict.fromkeys(BOUNCES, DEPTH) | {"samples": samples, "seed": seed}
    kind = scene.render.image_settings
    own = [(scene.cycles, name, value) for name, value in values.items() if hasattr(scene.cycles, name)]
    own += [(kind, "media_type", "IMAGE")] if hasattr(kind, "media_type") else []
    own += [(scene.render, "engine", "CYCLES"), (kind, "file_format", "OPEN_EXR"), (kind, "color_depth", "32")]
    own += [(kind, "color_mode", "RGB"), (scene.render, "filepath", "")]
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in own]
    try:
        for owner, name, value in own:
            setattr(owner, name, value)
        with tempfile.TemporaryDirectory() as folder:
            scene.render.filepath = os.path.join(folder, "view.exr")
            started = time.perf_counter()
            bpy.ops.render.render(write_still=True)
            seconds = time.perf_counter() - started
            image = bpy.data.images.load(scene.render.filepath)
            try:
                return read_pixels(image)[..., :3], seconds
            finally:
                bpy.data.images.remove(image)
    finally:
        # a format first, then its depth
        for owner, name, value in before:
            setattr(owner, name, value)
