"""Pictures of entries, drawn with matplotlib; small files."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from .entry import Curves, Images, Places, Wires

PANEL = (3.2, 2.7)
"""Inches of one picture of several."""

COLOURS = 96
"""Of a picture's palette."""

STYLE = {"font.size": 8, "axes.titlesize": 8, "figure.dpi": 80, "savefig.dpi": 80}


def draw(picture: Images | Curves | Places | Wires, path: Path) -> None:
    """Write a picture as PNG."""
    with plt.rc_context(STYLE):
        figure = {Images: _images, Curves: _curves, Places: _places, Wires: _wires}[type(picture)](picture)
        held = BytesIO()
        figure.savefig(held, metadata={"Software": None}, bbox_inches="tight")
        plt.close(figure)
    # a palette takes a third of the bytes
    with Image.open(held) as image:
        image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)


def _panels(count: int, **more):
    figure, axes = plt.subplots(
        1, count, figsize=(PANEL[0] * count, PANEL[1]), squeeze=False, layout="constrained", **more
    )
    return figure, axes[0]


def _images(picture):
    figure, axes = _panels(len(picture.images))
    first = next(iter(picture.images.values()))
    high = picture.high or float(first.max()) or 1.0
    for ax, (title, values) in zip(axes, picture.images.items(), strict=True):
        shown = ax.imshow(values, origin="lower", vmin=0, vmax=high, cmap="inferno")
        ax.set(title=title, xticks=[], yticks=[])
    figure.colorbar(shown, ax=axes, shrink=0.8, label=picture.unit)
    return figure


def _curves(picture):
    figure, (ax,) = _panels(1)
    figure.set_size_inches(5.2, 2.7)
    styles = ("-o", "--s", ":^", "-.v")
    for number, (label, (x, y)) in enumerate(picture.curves.items()):
        style = styles[number % len(styles)] if len(x) < 60 else ("-", "--")[number % 2]
        ax.plot(x, y, style, label=label, markersize=3, linewidth=1.2)
    if picture.bound is not None:
        ax.axhline(picture.bound, color="0.5", linewidth=0.8, linestyle=":", label="bound")
    if "x" in picture.log:
        ax.set_xscale("log")
    if "y" in picture.log:
        ax.set_yscale("log")
    else:
        values = np.concatenate([y for _, y in picture.curves.values()])
        ax.set_ylim(min(0, 1.1 * float(values.min())), 1.15 * float(values.max()) or 1)
    ax.set(xlabel=picture.x, ylabel=picture.y)
    ax.grid(alpha=0.3)
    ax.legend(frameon=False)
    return figure


def _places(picture):
    figure, axes = _panels(len(picture.places))
    high = picture.high or max(float(np.quantile(value, 0.995)) for _, value in picture.places.values()) or 1.0
    for ax, (title, (place, value)) in zip(axes, picture.places.items(), strict=True):
        span = np.ptp(place, axis=0).max()
        size = (150 * np.sqrt(np.prod(np.ptp(place, axis=0) / span) / len(place))) ** 2
        order = np.argsort(value)
        shown = ax.scatter(
            *place[order].T, c=value[order], s=np.clip(size, 1, 220), vmin=0, vmax=high, cmap="inferno", marker="s"
        )
        ax.set(title=title, aspect="equal", facecolor="0.85")
        ax.set_xlabel("m")
    figure.colorbar(shown, ax=axes, shrink=0.8, label=picture.unit)
    return figure


def _wires(picture):
    figure, axes = _panels(len(picture.wires), subplot_kw={"projection": "3d"})
    for ax, (title, (segments, _)) in zip(axes, picture.wires.items(), strict=True):
        for a, b in segments:
            ax.plot(*np.stack([a, b], 1), color="0.2", linewidth=0.8)
        marks = picture.marks.get(title, np.zeros((0, 3)))
        ax.scatter(*marks.T, color="orange", label="lamp" if len(marks) else None)
        ax.set(title=title, box_aspect=(1, 1, 1))
        ax.tick_params(labelsize=6)
    return figure
