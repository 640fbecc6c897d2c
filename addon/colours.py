"""What the points' colours mean: a perceptual map over radius, ambient occlusion or irradiance, and its legend."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..core.scene import SceneError
from . import points
from .pixels import read_pixels

KINDS = ("radius", "ao", "irradiance")
TITLES = {"radius": "radius, m", "ao": "ambient occlusion, 1 is open", "irradiance": "irradiance, W/m²"}

LEGEND = 64
"""Height of a legend, px."""

# Matplotlib's viridis (by Smith, van der Walt and Firing, CC0) at even steps, sRGB.
_MAP = np.array([0x440154, 0x482878, 0x3E4989, 0x31688E, 0x26828E, 0x1F9E89, 0x35B779, 0x6DCD59, 0xB4DE2C, 0xFDE725])
_MAP = np.stack([_MAP >> 16, _MAP >> 8 & 255, _MAP & 255], 1).astype(np.float32) / 255
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


@dataclass(frozen=True)
class Scale:
    """From `low` to `high` along the map, by ratios where `log` is set."""

    low: float
    high: float
    log: bool

    def colours(self, values: np.ndarray) -> np.ndarray:
        """(n, 3) float32 sRGB of values (n,)."""
        low, high = (np.log(v) for v in (self.low, self.high)) if self.log else (self.low, self.high)
        values = np.log(np.maximum(values, self.low)) if self.log else values
        at = np.clip((values - low) / max(high - low, 1e-30), 0, 1) * (len(_MAP) - 1)
        steps = np.arange(len(_MAP))
        return np.stack([np.interp(at, steps, _MAP[:, c]) for c in range(3)], 1).astype(np.float32)

    def ticks(self) -> list[float]:
        """Round values within the scale, a handful."""
        if not self.log:
            return [float(v) for v in np.linspace(self.low, self.high, 6)]
        exponents = range(int(np.floor(np.log10(self.low))), int(np.ceil(np.log10(self.high))) + 1)
        for digits in ((1, 1.5, 2, 3, 5, 7), (1, 2, 5), (1,)):
            found = [d * 10.0**e for e in exponents for d in digits if self.low <= d * 10.0**e <= self.high]
            if len(found) <= 9:
                break
        return found if len(found) > 1 else [self.low, self.high]


def read(scene: bpy.types.Scene, kind: str) -> tuple[np.ndarray, Scale]:
    """The points' values (n,) float32 and the scale that shows them. Raises SceneError where there are no points."""
    values = points.read(scene, points.LIGHT if kind == "irradiance" else kind)
    if values is None:
        raise SceneError(f"Scene '{scene.name}' has no points; bake with Light At set to Points (--exits points).")
    if kind == "ao":
        return values, Scale(0.0, 1.0, False)
    if kind == "irradiance":
        values = values[:, :3] @ _LUMINANCE
        lit = values[values > 0]
        if not len(lit):
            return values, Scale(0.0, 1.0, False)
        high = float(np.quantile(lit, 0.995))
        return values, Scale(max(float(np.quantile(lit, 0.02)), high / 1000), high, True)
    low, high = (float(q) for q in np.quantile(values, (0.005, 0.995)))
    return values, Scale(low, max(high, 1.001 * low), True)


def legend(scale: Scale, kind: str, count: int, width: int) -> np.ndarray:
    """(LEGEND, width, 3) float32 sRGB, the first row at the bottom: the map, its values and what they are."""
    strip = np.full((LEGEND, width, 3), 0.06, np.float32)
    left, right = 24, width - 24
    share = np.linspace(0, 1, right - left, dtype=np.float32)
    strip[28:44, left:right] = Scale(0, 1, False).colours(share)
    span = (scale.low, scale.high) if not scale.log else (np.log(scale.low), np.log(scale.high))
    labels = [(left, LEGEND - 16, f"{count:,} points · {TITLES[kind]}".replace(",", " ", f"{count:,}".count(",")))]
    free = -np.inf
    for value in scale.ticks():
        place = ((np.log(value) if scale.log else value) - span[0]) / max(span[1] - span[0], 1e-30)
        x = left + int(place * (right - left - 1))
        strip[24:28, x : x + 1] = 0.8
        if x > free:
            labels.append((x - 4, 9, f"{value:.2g}"))
            free = x + 44
    return np.maximum(strip, 0.85 * _text(labels, width)[..., None])


def _text(labels, width) -> np.ndarray:
    """(LEGEND, width) float32 coverage of texts at (x, y, text); none where this Blender can't draw them here."""
    import blf

    if not hasattr(blf, "bind_imbuf"):
        return np.zeros((LEGEND, width), np.float32)
    import imbuf

    buffer = imbuf.new((width, LEGEND))
    blf.size(0, 13)
    with blf.bind_imbuf(0, buffer, display_name="sRGB"):
        for x, y, text in labels:
            blf.position(0, x, y, 0)
            blf.color(0, 1, 1, 1, 1)
            blf.draw_buffer(0, text)
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "text.png")
        imbuf.write(buffer, filepath=path)
        buffer.free()
        image = bpy.data.images.load(path)
        try:
            drawn = read_pixels(image)
        finally:
            bpy.data.images.remove(image)
    return drawn[..., -1] if drawn.shape[2] == 4 else drawn[..., 0]


def write_png(path: Path, pixels: np.ndarray) -> None:
    """pixels: (H, W, 3) float32 sRGB, the first row at the bottom."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(path.stem, width, height, alpha=False)
    try:
        # an image of bytes keeps display values as they are
        full = np.ones((height, width, 4), np.float32)
        full[..., :3] = pixels
        image.pixels.foreach_set(full.reshape(-1))
        image.file_format, image.filepath_raw = "PNG", str(path)
        image.save()
    finally:
        bpy.data.images.remove(image)
