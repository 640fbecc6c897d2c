"""The chart of lamp sweeps, in out/bench and as docs/sweeps.png. `python -m tests.bench.sweep_charts` draws it anew."""

from __future__ import annotations

import datetime
import io
import json

import matplotlib
import numpy as np
from PIL import Image

from . import harness
from .sweep_detector import HIGH, LOW

matplotlib.use("Agg")
from matplotlib import pyplot

COLOURS = {"eigenpanes": "#00795a", "256 clusters": "#bc5b00", "Cycles": "#0b63b5", "uncompressed": "0.55"}
LABELS = {"Cycles": "Cycles, 96 spp", "uncompressed": "no panes, 6000 entries"}
EXPECTED = "#c0246b"
PERCENT = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2)

PALETTE = 96


def draw(figures: dict) -> None:
    """Error over the frames of each sweep, with what the detector expects, the flicker of each way, and expected against
    true error, of sweeps held out as well."""
    swept = figures["sweeps"]
    figure, grid = pyplot.subplots(2, 4, figsize=(16, 7.2), layout="constrained")
    panels = list(grid.flat)
    for axes, (name, one) in zip(panels, swept.items(), strict=False):
        _sweep(axes, name, one, figures)
    for axes in panels[len(swept) : -3]:
        axes.axis("off")
    _flicker(panels[-3], swept)
    _detector(panels[-2], figures)
    handles, labels = panels[0].get_legend_handles_labels()
    panels[-1].axis("off")
    panels[-1].legend(
        handles, labels, loc="upper left", bbox_to_anchor=(-0.25, 1), frameon=False, fontsize=9
    ).set_in_layout(False)
    told = f"{figures['made']}\n\nLamps pass for {figures['frames']} frames through two rooms\nof 3 × 3 × 2.5 m, baked for an error of {figures['target']:.0%}. Error on\nblocks of 4 × 4 texels against brute-force rays, on\nevery twentieth frame."
    panels[-1].text(-0.2, 0.02, told, fontsize=8.5, color="0.3", va="bottom", in_layout=False)
    made = io.BytesIO()
    figure.savefig(made, dpi=90)
    pyplot.close(figure)
    image = Image.open(made).convert("RGB").quantize(PALETTE, dither=Image.Dither.NONE)
    for path in (harness.OUT / "sweeps.png", harness.ROOT / "docs" / "sweeps.png"):
        image.save(path, "PNG", optimize=True)


def made() -> str:
    """Date, machine and versions."""
    return f"{datetime.date.today().isoformat()}. " + harness.machine(load=False).replace("; ", ".\n", 1).replace(
        ", embreex", ",\nembreex"
    )


def _sweep(axes, name, one, figures):
    for way, values in one["errors"].items():
        shown = [np.nan if v is None else v for v in values]
        axes.plot(
            one["frames"], shown, "o-", markersize=3, color=COLOURS[way], label=LABELS.get(way, way), linewidth=1.2
        )
    pairs = zip(one["expected"], one["dark"], strict=True)
    expected = np.array([np.nan if v is None or dark else v for v, dark in pairs])
    axes.plot(expected, "--", color=EXPECTED, linewidth=1.3, label="expected in the panel, of eigenpanes")
    axes.axhline(figures["target"], color="0.2", linewidth=0.9, linestyle=":", label="error asked for")
    axes.set(title=name, yscale="log", ylim=(0.008, 2.5), xlabel="frame", ylabel="error")
    _percent(axes.yaxis)
    axes.grid(color="0.92")


def _percent(axis):
    axis.set_major_locator(matplotlib.ticker.FixedLocator(PERCENT))
    axis.set_major_formatter(lambda value, _: f"{100 * value:g} %")
    axis.set_minor_locator(matplotlib.ticker.NullLocator())


def _flicker(axes, swept):
    ways = ("eigenpanes", "256 clusters", "Cycles")
    for k, way in enumerate(ways):
        place = np.arange(len(swept)) + 0.27 * (k - 1)
        axes.bar(place, [s["flicker"][way] for s in swept.values()], 0.25, color=COLOURS[way])
    axes.axhline(0, color="0.3", linewidth=0.8)
    axes.set_yscale("symlog", linthresh=1e-3)
    axes.set_xticks(range(len(swept)), list(swept), fontsize=8, rotation=20, ha="right")
    axes.set(title="flicker beyond the truth's", ylabel="change a frame over the mean")
    axes.grid(axis="y", color="0.92")
    axes.set_axisbelow(True)


def _detector(axes, figures):
    ends = np.array([0.03, 1.5])
    axes.fill_between(ends, LOW * ends, HIGH * ends, color="0.92", label=f"true error {LOW} to {HIGH} times as large")
    axes.plot(ends, ends, color="0.6", linewidth=0.8)
    for key, label, colour, marker in (
        ("detector", "these sweeps", COLOURS["eigenpanes"], "o"),
        ("held out", "sweeps of three other scenes", EXPECTED, "^"),
    ):
        lit = [one for one in figures.get(key, ()) if one["true"] is not None]
        axes.plot([o["expected"] for o in lit], [o["true"] for o in lit], marker, color=colour, markersize=4, label=label, alpha=0.8, linewidth=0)  # fmt: skip
    for line in (axes.axvline, axes.axhline):
        line(figures["target"], color="0.2", linewidth=0.9, linestyle=":")
    axes.set(title="expected against true error", xscale="log", yscale="log", xlim=ends, ylim=ends, xlabel="expected in the panel", ylabel="true")  # fmt: skip
    for axis in (axes.xaxis, axes.yaxis):
        _percent(axis)
    axes.legend(fontsize=8, frameon=False, loc="lower right")


if __name__ == "__main__":
    draw(json.loads((harness.OUT / "sweeps.json").read_text("utf-8")))
