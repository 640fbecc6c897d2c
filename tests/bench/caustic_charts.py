"""The chart and the pictures of caustics, in out/bench; the chart is docs/photons.png too."""

from __future__ import annotations

import json
import shutil

import matplotlib
import numpy as np

from . import harness

matplotlib.use("Agg")
from matplotlib import pyplot

STYLES = {"adaptive beams": ("#3f6ea8", "o"), "uniform beams": ("#9db7d5", "s"), "jittered points": ("#b55a3c", "^")}


def draw(lines: dict[str, dict[str, list[tuple[float, float, float]]]]) -> None:
    """Error against photons above, against time below, a column for each scene."""
    figure, grid = pyplot.subplots(2, len(lines), figsize=(3.4 * len(lines), 6.2), layout="constrained", sharey="col")
    for column, (name, kinds) in enumerate(lines.items()):
        for row, (quantity, which) in enumerate((("photons", 0), ("seconds", 1))):
            axes = grid[row, column]
            for kind, line in kinds.items():
                colour, marker = STYLES[kind]
                x, y = [p[which] for p in line], [p[2] for p in line]
                axes.plot(x, y, color=colour, marker=marker, markersize=4, label=kind)
            axes.set(xscale="log", yscale="log", xlabel=quantity)
            axes.xaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
            axes.grid(which="major", color="0.92")
        grid[0, column].set_title(name, fontsize=10)
    for axes in grid[:, 0]:
        axes.set_ylabel("error, 4 × 4 texels")
    grid[0, 0].legend(fontsize=7, frameon=False)
    harness.OUT.mkdir(parents=True, exist_ok=True)
    figure.savefig(harness.OUT / "photons.png", dpi=110)
    pyplot.close(figure)
    shutil.copy(harness.OUT / "photons.png", harness.ROOT / "docs" / "photons.png")
    (harness.OUT / "caustics.json").write_text(json.dumps(lines, indent=1) + "\n", "utf-8")


def draw_pictures(ours: dict[str, np.ndarray], references: dict[str, np.ndarray]) -> None:
    """The atlases, ours above the references, as bright as suits each."""
    figure, grid = pyplot.subplots(2, len(ours), figsize=(4 * len(ours), 8), layout="constrained")
    for column, name in enumerate(ours):
        white = np.percentile(references[name], 99.7)
        for row, image in enumerate((ours[name], references[name])):
            grid[row, column].imshow(np.clip(image / white, 0, 1) ** (1 / 2.2), origin="lower", cmap="gray")
            grid[row, column].axis("off")
        grid[0, column].set_title(f"{name}: 40K photons; below 100 M points", fontsize=9)
    harness.OUT.mkdir(parents=True, exist_ok=True)
    figure.savefig(harness.OUT / "caustics_scenes.png", dpi=110)
    pyplot.close(figure)
