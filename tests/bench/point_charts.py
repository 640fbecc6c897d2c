"""Charts of the point cache's benchmarks, in out/bench."""

from __future__ import annotations

import json

import matplotlib
import numpy as np

from . import harness, point_errors

matplotlib.use("Agg")
from matplotlib import pyplot


def draw_blue_noise(distance: np.ndarray, correlation: np.ndarray, points) -> None:
    """The pair correlation on the atrium's largest floor."""
    figure, axes = pyplot.subplots(figsize=(6, 3.6), layout="constrained")
    axes.plot(distance, correlation, color="#1f5fa8")
    axes.axhline(1, color="0.6", linewidth=0.8)
    axes.axvline(1, color="0.6", linewidth=0.8, linestyle=":")
    axes.set(xlabel="distance / radius", ylabel="pair correlation", xlim=(0, 4), ylim=(0, None))
    axes.set_title(f"Even points on the atrium's largest floor ({len(points):,} in all)", fontsize=10)
    _save(figure, "points_blue_noise.png")


def draw_errors(charts: dict) -> None:
    """Error against count: guides with the default interpolation above, interpolations with uniform points below."""
    figure, grid = pyplot.subplots(
        2, len(charts), figsize=(4.2 * len(charts), 7.6), layout="constrained", squeeze=False
    )
    for column, (name, found) in enumerate(charts.items()):
        top, bottom = grid[0, column], grid[1, column]
        for guide in point_errors.GUIDES:
            _line(top, found[guide, "ward + gradients"], guide)
        _line(bottom, found["uniform", point_errors.PLAIN], "plain Shepard, no gaps served", linestyle="--", color="k")
        for interpolation in point_errors.INTERPOLATIONS:
            _line(bottom, found["uniform", interpolation], interpolation)
        top.set_title(f"{name}: guides, Ward with gradients", fontsize=10)
        bottom.set_title(f"{name}: interpolations, uniform points", fontsize=10)
        for axes in (top, bottom):
            axes.set(xscale="log", yscale="log", xlabel="points", ylabel="relative RMSE")
            axes.yaxis.set_major_formatter(matplotlib.ticker.FuncFormatter(lambda v, _: f"{v:g}"))
            axes.yaxis.set_minor_formatter(matplotlib.ticker.FuncFormatter(lambda v, _: f"{v:g}"))
            axes.grid(which="both", color="0.92")
            axes.legend(fontsize=7, frameon=False)
    _save(figure, "points_error.png")
    table = {name: {" / ".join(key): values for key, values in found.items()} for name, found in charts.items()}
    (harness.OUT / "points_error.json").write_text(json.dumps(table, indent=1) + "\n", "utf-8")


def draw_shadows(found: dict[str, list]) -> None:
    """Ambient occlusion and soft shadows held in points: error against count."""
    figure, axes = pyplot.subplots(figsize=(5, 3.4), layout="constrained")
    for name, values in found.items():
        _line(axes, values, name)
    axes.set(xscale="log", yscale="log", xlabel="points", ylabel="RMSE over root mean square")
    axes.set_title("What else points hold, atrium", fontsize=10)
    axes.grid(which="both", color="0.92")
    axes.legend(fontsize=8, frameon=False)
    _save(figure, "points_shadows.png")


def _line(axes, found, label, **style):
    axes.plot(
        [f[0] for f in found], [f[1] for f in found], marker="o", markersize=3, linewidth=1.2, label=label, **style
    )


def _save(figure, name):
    harness.OUT.mkdir(parents=True, exist_ok=True)
    figure.savefig(harness.OUT / name, dpi=110)
    pyplot.close(figure)
