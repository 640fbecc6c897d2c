"""The chart of penumbra casting, in out/bench."""

from __future__ import annotations

import json

import matplotlib

from . import harness

matplotlib.use("Agg")
from matplotlib import pyplot

PAPER = {"Grids, 32K": (13.5, 16.7), "Flowers, 903K": (3.5, 7.8), "Sponza, 1.27M": (8.2, 11.4)}
"""Laine and Aila 2005 over Mental Ray 3.2, 256 samples, at 1.2 M and 4.9 M receivers."""


def draw(series: dict[str, dict[str, list[tuple[float, float]]]]) -> None:
    """Speed-up over rays against each quantity, and the paper's table beside."""
    figure, grid = pyplot.subplots(1, len(series) + 1, figsize=(4 * len(series) + 3.4, 3.9), layout="constrained")
    for axes, (quantity, lines) in zip(grid, series.items(), strict=False):
        for name, points in lines.items():
            axes.plot(*zip(*points, strict=True), marker="o", markersize=4, label=name)
        axes.axhline(1, color="0.3", linewidth=1)
        axes.text(0.02, 1.04, "as fast as rays", transform=axes.get_yaxis_transform(), fontsize=7, color="0.3")
        axes.set(xscale="log", yscale="log", xlabel=quantity, ylabel="speed over Embree's rays", ylim=(0.4, 100))
        axes.yaxis.set_major_formatter(matplotlib.ticker.FuncFormatter(lambda v, _: f"{v:g}"))
        axes.grid(which="both", color="0.93")
        axes.legend(fontsize=7, frameon=False)
    grid[0].set_title("256 samples", fontsize=9)
    grid[1].set_title("65K receivers", fontsize=9)
    grid[2].set_title("65K × 256", fontsize=9)
    grid[3].set_title("65K × 256", fontsize=9)
    axes = grid[-1]
    for k, values in enumerate(PAPER.values()):
        axes.bar([k - 0.18, k + 0.18], values, 0.34, color=["#9db7d5", "#3f6ea8"])
    axes.set_xticks(range(len(PAPER)), PAPER, fontsize=7)
    axes.set(ylabel="speed over Mental Ray 3.2")
    axes.set_title("The paper: 1.2 M (light) and 4.9 M receivers", fontsize=9)
    harness.OUT.mkdir(parents=True, exist_ok=True)
    figure.savefig(harness.OUT / "penumbra.png", dpi=110)
    pyplot.close(figure)
    (harness.OUT / "penumbra.json").write_text(json.dumps(series, indent=1) + "\n", "utf-8")
