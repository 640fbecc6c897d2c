"""Images through a scene's camera: Cycles' passes as arrays, kept on disk, and ours beside them."""

from __future__ import annotations

import hashlib
import json
import struct
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from lightpanes.addon.reference import BOUNCES, UNBIASED
from lightpanes.core.metrics import _gaussian

CACHE = Path(__file__).resolve().parents[2] / "out" / "bench" / "cache"
FLAGS = ("use_pass_diffuse_direct", "use_pass_diffuse_indirect", "use_pass_diffuse_color", "use_pass_ambient_occlusion")
SHORT = {
    "DiffDir": "Diffuse Direct",
    "DiffInd": "Diffuse Indirect",
    "DiffCol": "Diffuse Color",
    "AO": "Ambient Occlusion",
}


@dataclass(frozen=True)
class View:
    """passes: (H, W, C) float32 by name, linear, row 0 at the bottom. seconds: that Cycles took."""

    passes: dict[str, np.ndarray]
    seconds: float


def cycles_view(
    scene, samples: int, *, seed: int = 0, bounces: int = 8, denoise: bool = False, keep: bool = True
) -> View:
    """The scene through its camera by Cycles, unbiased but for what `denoise` does; the scene stays as it was."""
    render, layer = scene.render, bpy.context.view_layer
    values = UNBIASED | dict.fromkeys(BOUNCES, bounces) | {"samples": samples, "seed": seed, "use_denoising": denoise}
    wanted = [scene.name, scene.frame_current, render.resolution_x, render.resolution_y, render.resolution_percentage]
    key = json.dumps([*wanted, values, bpy.app.version_string, render.filter_size], sort_keys=True).encode()
    source = Path(bpy.data.filepath)
    path = CACHE / f"view_{hashlib.sha256(key + source.read_bytes()).hexdigest()[:24]}.npz"
    if keep and path.exists():
        with np.load(path) as stored:
            passes = {name: stored[name] for name in stored.files if name != "seconds"}
            return View(passes, float(stored["seconds"]))
    before = [(scene.cycles, name, getattr(scene.cycles, name)) for name in values if hasattr(scene.cycles, name)]
    before += [(layer, name, getattr(layer, name)) for name in FLAGS]
    image = render.image_settings
    before += [(render, "engine", render.engine), (render, "filepath", render.filepath)]
    with tempfile.TemporaryDirectory() as folder:
        try:
            render.engine = "CYCLES"
            for name, value in values.items():
                if hasattr(scene.cycles, name):
                    setattr(scene.cycles, name, value)
            for name in FLAGS:
                setattr(layer, name, True)
            if hasattr(image, "media_type"):
                image.media_type = "MULTI_LAYER_IMAGE"
            image.file_format = "OPEN_EXR_MULTILAYER"
            image.color_depth, image.exr_codec = "32", "NONE"
            render.filepath = str(Path(folder) / "view.exr")
            started = time.perf_counter()
            bpy.ops.render.render(write_still=True)
            seconds = time.perf_counter() - started
        finally:
            for owner, name, value in reversed(before):
                setattr(owner, name, value)
        passes = read_layers((Path(folder) / "view.exr").read_bytes())
    if keep:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, seconds=seconds, **passes)
    return View(passes, seconds)


def similarity(image: np.ndarray, halves: tuple[np.ndarray, np.ndarray], weights: tuple[float, float]) -> float:
    """SSIM (`metrics.ssim`, peak 1) of an (H, W, 3) image with what two noisy images of independent noise are of.

    Noise adds to a reference's variance and to no covariance: the truth's variance in a window is the halves'
    covariance. So a perfect image gets 1, as it would beside a reference without noise. weights: of the halves, by samples.
    """
    first, second = halves
    share = weights[0] / sum(weights)
    mean = first * share + second * (1 - share)
    at, middle = _gaussian(image), _gaussian(mean)
    spread = _gaussian(image * image) - at**2
    truth = _gaussian(first * second) - _gaussian(first) * _gaussian(second)
    together = _gaussian(image * mean) - at * middle
    c1, c2 = 0.01**2, 0.03**2
    value = (
        (2 * at * middle + c1) * (2 * together + c2) / ((at**2 + middle**2 + c1) * (spread + np.maximum(truth, 0) + c2))
    )
    return float(value.mean())


def read_layers(data: bytes) -> dict[str, np.ndarray]:
    """Passes of an uncompressed multi-layer OpenEXR file of 32-bit floats."""
    at, header = 8, {}
    while data[at]:
        name, at = _text(data, at)
        _, at = _text(data, at)
        size = struct.unpack_from("<i", data, at)[0]
        header[name] = data[at + 4 : at + 4 + size]
        at += 4 + size
    left, top, right, bottom = struct.unpack("<4i", header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    channels, place = [], 0
    while header["channels"][place]:
        name, place = _text(header["channels"], place)
        channels.append(name)
        place += 16
    at += 1 + 8 * height
    lines = np.frombuffer(data, np.uint8, height * (8 + 4 * width * len(channels)), at).reshape(height, -1)
    values = np.ascontiguousarray(lines[:, 8:]).view(np.float32).reshape(height, len(channels), width)[::-1]
    passes: dict[str, dict[str, np.ndarray]] = {}
    for k, name in enumerate(channels):
        _, shown, letter = name.rsplit(".", 2)
        passes.setdefault(SHORT.get(shown, shown), {})[letter] = values[:, k]
    order = "RGBAXYZV"
    return {
        name: np.stack([letters[c] for c in sorted(letters, key=order.index)], axis=-1)
        for name, letters in passes.items()
    }


def _text(data, at):
    end = data.index(0, at)
    return data[at:end].decode(), end + 1
