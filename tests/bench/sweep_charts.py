"""The chart of lamp sweeps, in out/bench and as docs/sweeps.png."""

from __future__ import annotations

import shutil

import matplotlib
import numpy as np

from . import harness

matplotlib.use("Agg")
from matplotlib import pyplot

COLOURS = {"eigenpanes": "C0", "256 clusters": "C1", "Cycles": "C2", "uncompressed": "0.5"}


def draw(figures: dict) -> None:
    """Error over the frames of each sweep, with what the detector expects, and the flicker of each way."""
    swept = figures["sweeps"]
    figure, grid = pyplot.subplots(2, 3, figsize=(12, 6.4), layout="constrained")
    for axes, (name, one) in zip(grid.flat, swept.items(), strict=False):
        for way, values in one["errors"].items():
            shown = [np.nan if v is None else v for v in values]
            label = {"Cycles": "Cycles, 96 spp", "uncompressed": "no panes, 6000 entries"}.get(way, way)
            axes.plot(one["frames"], shown, "o-", markersize=3, color=COLOURS[way], label=label, linewidth=1)
        expected = np.array(
            [np.nan if v is None or dark else v for v, dark in zip(one["expected"], one["dark"], strict=True)]
        )
        axes.plot(expected, "--", color="C3", linewidth=1, label="detector expects")
        axes.axhline(figures["target"], color="0.3", linewidth=0.8, linestyle=":")
        axes.set(title=name, yscale="log", ylim=(0.005, 2), xlabel="frame", ylabel="error against brute force")
        axes.grid(which="both", color="0.93")
    grid.flat[0].legend(fontsize=7, frameon=False)
    axes = grid.flat[len(swept)]
    ways = ("eigenpanes", "256 clusters", "Cycles")
    for k, way in enumerate(ways):
        axes.bar(
            np.arange(len(swept)) + 0.27 * (k - 1),
            [s["flicker"][way] for s in swept.values()],
            0.25,
            color=COLOURS[way],
            label=way,
        )
    axes.axhline(0, color="0.3", linewidth=0.8)
    axes.set_yscale("symlog", linthresh=1e-3)
    axes.set_xticks(range(len(swept)), [name.replace(" ", "\n", 1) for name in swept], fontsize=7)
    axes.set_title("flicker: change beyond the truth's", fontsize=10)
    axes.legend(fontsize=7, frameon=False)
    harness.OUT.mkdir(parents=True, exist_ok=True)
    figure.savefig(harness.OUT / "sweeps.png", dpi=90)
    pyplot.close(figure)
    shutil.copy(harness.OUT / "sweeps.png", harness.ROOT / "docs" / "sweeps.png")
