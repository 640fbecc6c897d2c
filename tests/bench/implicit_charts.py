"""Charts and pictures of the world-space cache, in out/bench."""

from __future__ import annotations

import json

import matplotlib
import numpy as np

from . import harness

matplotlib.use("Agg")
from matplotlib import pyplot

COLOURS = {"ours": "#c8442d", "per pixel": "0.6"}


def draw(table: dict, growth: dict, occupancy: dict, spectra: dict) -> None:
    """Table 1, SSIM and FLIP, SSIM over frames by level, entries by level and the errors' spectra."""
    figure, grid = pyplot.subplots(2, 3, figsize=(15, 8), layout="constrained")
    _bars(grid[0, 0], table, "ssim", "SSIM, 64 frames of one ray")
    _bars(grid[1, 0], table, "flip", "FLIP, 64 frames of one ray", legend=False)
    for axes, (name, lines) in zip(grid[0, 1:], growth.items(), strict=True):
        for key, points in lines.items():
            style = {"color": COLOURS["ours"], "linewidth": 2.2} if key == "ours" else {"linewidth": 1.2}
            axes.plot(*zip(*points, strict=True), marker="o", markersize=3.5, label=key, **style)
        axes.set(xscale="log", xlabel="frames of one ray", ylabel="SSIM", title=f"{name}, SSIM over frames by level")
        axes.set_xticks([1, 4, 16, 64], ["1", "4", "16", "64"])
        axes.grid(color="0.93")
        axes.legend(fontsize=8, frameon=False, loc="lower right")
    axes = grid[1, 1]
    for name in ("interior",):
        for key, (frequency, error) in spectra[name].items():
            axes.plot(frequency, error, label=key, color=COLOURS.get(key), linewidth=2 if key == "ours" else 1.2)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="cycles a pixel",
        ylabel="RMS error in an octave",
        title="interior, spectrum of the error",
    )
    axes.grid(which="both", color="0.93")
    axes.legend(fontsize=8, frameon=False)
    axes = grid[1, 2]
    keys = list(next(iter(occupancy.values())))
    for k, key in enumerate(keys):
        values = [entries[key] * 12e-6 for entries in occupancy.values()]
        axes.bar(
            np.arange(len(values)) + (k - (len(keys) - 1) / 2) * 0.2,
            values,
            0.19,
            label=key,
            color=COLOURS.get(key, f"C{k}"),
        )
    axes.set_xticks(range(len(occupancy)), list(occupancy))
    axes.set(ylabel="MB at 12 bytes an entry", title="entries by level")
    axes.legend(fontsize=8, frameon=False)
    harness.OUT.mkdir(parents=True, exist_ok=True)
    figure.savefig(harness.OUT / "implicit.png", dpi=100)
    pyplot.close(figure)
    kept = {"table": table, "growth": growth, "occupancy": occupancy, "spectra": spectra}
    (harness.OUT / "implicit.json").write_text(json.dumps(kept, indent=1) + "\n", "utf-8")


def _bars(axes, table, quantity, title, legend=True):
    shown = [
        "per pixel",
        "fixed + jitter, filtered",
        "fixed + barycentric, filtered",
        "implicit + barycentric, filtered",
        "ours",
    ]
    colours = ["0.75", "#b5cde3", "#7fa6cc", "#3f6ea8", COLOURS["ours"]]
    for k, (key, colour) in enumerate(zip(shown, colours, strict=True)):
        values = [scores[key][quantity] for scores in table.values()]
        axes.bar(np.arange(len(values)) + (k - 2) * 0.16, values, 0.15, label=key, color=colour)
    axes.set_xticks(range(len(table)), list(table))
    axes.set_title(title)
    if quantity == "ssim":
        axes.set_ylim(0.65, 1.07)
        axes.set_yticks([0.7, 0.8, 0.9, 1.0])
    if legend:
        axes.legend(fontsize=7, frameon=False, loc="upper left", ncols=2)


def pictures(stages: dict[str, dict[str, np.ndarray]]) -> None:
    """Pictures of each stage, and what is wrong with them four times as strong."""
    for name, shown in stages.items():
        strip(name + "-64", shown)


def strip(name: str, shown: dict[str, np.ndarray]) -> None:
    """Pictures over their differences from the first, into implicit-NAME.png."""
    truth = next(iter(shown.values()))
    figure, grid = pyplot.subplots(2, len(shown), figsize=(4.8 * len(shown), 5.6), layout="constrained")
    for column, (key, image) in enumerate(shown.items()):
        grid[0, column].imshow(image, cmap="gray", vmin=0, vmax=1)
        grid[0, column].set_title(key, fontsize=10)
        grid[1, column].imshow(image - truth, cmap="RdBu", vmin=-0.25, vmax=0.25)
    for axes in grid.flat:
        axes.axis("off")
    figure.savefig(harness.OUT / f"implicit-{name}.png", dpi=100)
    pyplot.close(figure)
