"""The chart's picture. The only file that imports matplotlib."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FixedLocator, LogLocator, NullFormatter, NullLocator

STYLE = {
    "Cycles": ("#57606a", "o", 1.6),
    "Cycles, OpenImageDenoise": ("#9a6fb0", "o", 1.6),
    "The paper's method": ("#bc5b00", "s", 1.6),
    "The paper's panes, our gather": ("#0b63b5", "D", 1.6),
    "Lightpanes": ("#00795a", "o", 2.8),
}
"""Colour, marker and width of each method's line."""

INK, SOFT, GRID = "#1f2328", "#57606a", "#e4e7eb"
TARGET = 0.05
LOST = 0.25
"""Part of a reference's noise below which an error cannot be told from it: that much of the noise is left when its square
is subtracted, which some 600 blocks know to a twentieth."""

PERCENT = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500)
SECONDS = {
    1e-4: "0.1 ms", 3e-4: "0.3 ms", 1e-3: "1 ms", 3e-3: "3 ms", 0.01: "10 ms", 0.03: "30 ms", 0.1: "0.1 s", 0.3: "0.3 s", 1: "1 s",
    3: "3 s", 10: "10 s", 30: "30 s", 100: "100 s", 300: "5 min", 900: "15 min", 3600: "1 h",
}  # fmt: skip


def draw(result: dict, path: Path) -> None:
    """Write the PNG of what `chart.measure` found."""
    figure = Figure(figsize=(12, 6), dpi=150, facecolor="white")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharey=True)
    figure.subplots_adjust(left=0.065, right=0.985, top=0.82, bottom=0.17, wspace=0.06)
    given = result["reference_noise"]
    noise = LOST * float(np.mean(given))
    _panel(left, result["methods"], "bake_s", noise, "The first picture", "time of the whole bake")
    again = "time of a relight (Cycles: another bake)"
    _panel(right, result["methods"], "relight_s", noise, "Every other lamp position", again)
    left.set_ylabel("relative error of indirect light", color=INK, fontsize=11)
    if own := result.get("default"):
        for axes, key in ((left, "bake_s"), (right, "relight_s")):
            ring = {"markersize": 14, "markerfacecolor": "none", "markeredgewidth": 1.6, "zorder": 4}
            axes.plot([own[key]], [max(own["error"], 1e-6)], "o", markeredgecolor=STYLE["Lightpanes"][0], **ring)
    figure.canvas.draw()
    for axes, key in ((left, "bake_s"), (right, "relight_s")):
        _label(axes, result["methods"], key)
    kinds = [lamp for lamp in result["lamps"] if lamp["kind"] == "near"]
    near = f", one of them {_length(kinds[0]['room_m'])} from a surface" if kinds else ""
    figure.text(0.065, 0.94, f"{result['scene']}: error against time", fontsize=18, fontweight="bold", color=INK)
    noises = "–".join(dict.fromkeys(f"{100 * n:.2g} %" for n in (min(given), max(given))))
    samples = result["reference_spp"]
    spp = "–".join(dict.fromkeys(f"{n:,}" for n in (min(samples), max(samples))))
    figure.text(
        0.065,
        0.895,
        f"Mean over {len(result['lamps'])} lamp positions that nothing was trained on{near}; thin lines: best to worst lamp; dashed: the default target.",
        fontsize=10.5,
        color=SOFT,
    )
    figure.text(
        0.065,
        0.02,
        f"{result['resolution']}² atlas, {result['triangles']:,} triangles. Further left and further down is better; ringed: default settings. "
        f"RMSE over mean on 4×4-texel blocks against Cycles at\n{spp} samples a texel, whose own noise, {noises}, is subtracted "
        "(grey: lost in it).",
        fontsize=8.5,
        color=SOFT,
    )
    figure.savefig(path, format="png")


def draw_study(study: dict, path: Path) -> Figure:
    """Write the PNG of a study that has lines (addon/studies.py); returns what was drawn."""
    figure = Figure(figsize=(6.4, 4.2), dpi=110, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    colours = ("#00795a", "#0b63b5", "#bc5b00", "#57606a")
    for (name, line), colour in zip(study["lines"].items(), colours, strict=False):
        axes.plot(*zip(*line, strict=True), marker="o", markersize=4.5, linewidth=1.8, color=colour, label=name)
    values = [y for line in study["lines"].values() for _, y in line]
    axes.set_xscale("log" if "x" in study["log"] else "linear")
    # nothing has no logarithm
    axes.set_yscale("log" if "y" in study["log"] and min(values) > 0 else "linear")
    axes.set_title(study["title"], loc="left", fontsize=12, color=INK)
    axes.set_xlabel({"s": "seconds"}.get(study["x"], study["x"]), color=INK)
    axes.set_ylabel(study["y"], color=INK)
    relative = any(word in study["y"] for word in ("error", "RMSE"))
    for axis, show in ((axes.xaxis, _plain), (axes.yaxis, _percent if relative else _plain)):
        if axis.get_scale() == "log":
            _widen(axis)
            low, high = axis.get_view_interval()
            axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high > 12 * low else (1, 1.5, 2, 3, 5, 7), numticks=30))
            axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(show)
        axis.set_minor_formatter(NullFormatter())
    if "times as" in study["y"]:
        axes.axhline(1, color=INK, linewidth=1.1, linestyle=(0, (5, 3)), zorder=1.5)
    axes.tick_params(length=0, labelsize=9.5, colors=INK)
    axes.grid(True, color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    for side in axes.spines.values():
        side.set_visible(False)
    axes.legend(frameon=False, fontsize=9)
    figure.savefig(path, format="png")
    return figure


def _widen(axis):
    """At least a factor of three, and some air, or there may be no tick at all."""
    low, high = axis.get_data_interval()
    if low > 0:
        more = max((3 / (high / low)) ** 0.5, 1.15)
        axis.set_view_interval(low / more, high * more, ignore=True)


def _plain(value, _):
    return f"{value:g}"


def _percent(value, _):
    return f"{100 * value:g} %"


def _panel(axes, found, key, noise, title, below):
    points = [p for line in found.values() for p in line]
    axes.set_xscale("log")
    axes.set_yscale("log")
    times = [p[key] for p in points]
    axes.set_xlim(min(times) / 1.9, max(times) * 1.9)
    errors = [e for p in points for e in (p["error"], *p["errors"]) if e > 0]
    low = min(*errors, TARGET) / 1.5
    # what is worst for some lamp may leave the picture
    axes.set_ylim(max(low, 5e-4), 1.5 * max(*(p["error"] for p in points), TARGET))
    axes.set_axisbelow(True)
    axes.grid(True, color=GRID, linewidth=0.9)
    for side in axes.spines.values():
        side.set_visible(False)
    axes.tick_params(length=0, labelsize=10, colors=INK)
    _ticks(axes)
    axes.axhspan(axes.get_ylim()[0], noise, color=GRID, linewidth=0, zorder=0.5)
    axes.axhline(TARGET, color=INK, linewidth=1.1, linestyle=(0, (5, 3)), zorder=1.5)
    axes.set_title(title, loc="left", fontsize=13, color=INK, pad=8)
    axes.set_xlabel(below, color=INK, fontsize=11)
    for name, line in found.items():
        colour, marker, width = STYLE.get(name, (INK, "o", 1.5))
        x, y = [p[key] for p in line], [max(p["error"], 1e-6) for p in line]
        for point in line:
            low, high = max(min(point["errors"]), 1e-6), max(point["errors"])
            axes.plot([point[key]] * 2, [low, high], color=colour, linewidth=1.1, alpha=0.35, solid_capstyle="round")
        axes.plot(x, y, color=colour, linewidth=width, marker=marker, markersize=5 + width / 2, markeredgecolor="white",
                  markeredgewidth=0.9, zorder=3)  # fmt: skip


def _ticks(axes):
    low, high = axes.get_ylim()
    percent = [p for p in PERCENT if low <= p / 100 <= high]
    axes.yaxis.set_major_locator(FixedLocator([p / 100 for p in percent]))
    axes.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.3g} %")
    low, high = axes.get_xlim()
    axes.xaxis.set_major_locator(FixedLocator([s for s in SECONDS if low <= s <= high]))
    axes.xaxis.set_major_formatter(
        lambda value, _: min(SECONDS.items(), key=lambda item: abs(math.log(item[0] / value)))[1]
    )
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_locator(NullLocator())
        axis.set_minor_formatter(NullFormatter())


def _label(axes, found, key):
    """Names beside the lines, then the ends' budgets, each where it covers least."""
    shown = {
        name: axes.transData.transform([(p[key], max(p["error"], 1e-6)) for p in line])
        for name, line in found.items()
        if line
    }
    spans = []
    for name, line in found.items():
        for point in line:
            ends = axes.transData.transform(
                [(point[key], max(e, 1e-6)) for e in (min(point["errors"]), max(point["errors"]))]
            )
            spans.append(np.linspace(*ends, 12))
        spans += [np.linspace(a, b, 40) for a, b in pairwise(shown.get(name, ()))]
    target = axes.transData.transform((axes.get_xlim()[0], TARGET))[1]
    box = axes.get_window_extent()
    spans.append(np.stack([np.linspace(box.x0, box.x1, 200), np.full(200, target)], 1))
    taken = np.concatenate([*spans, *shown.values()])
    boxes = []
    texts = [(name, name, range(len(shown[name])), 11, "bold") for name in shown]
    for name, line in found.items():
        if line:
            texts += [(_budget(line[k]), name, [k], 8, "normal") for k in (0, len(line) - 1)]
    for text, name, rows, size, weight in texts:
        best = _place(axes, text, shown[name][rows], size, weight, taken, boxes, box)
        if best is None:
            continue
        corner, extent = best
        boxes.append((*corner, *extent))
        place = axes.transData.inverted().transform(corner)
        axes.text(
            *place,
            text,
            fontsize=size,
            fontweight=weight,
            color=STYLE.get(name, (INK,))[0],
            va="bottom",
            ha="left",
            zorder=5,
            path_effects=[withStroke(linewidth=3, foreground="white")],
        )


def _place(axes, text, points, size, weight, taken, boxes, box):
    """Lower left corner and size, px, of a text beside one of the points, where it hides least; None if it must hide
    something and is not a name."""
    renderer = axes.figure.canvas.get_renderer()
    sample = axes.text(0, 0, text, fontsize=size, fontweight=weight)
    extent = sample.get_window_extent(renderer)
    sample.remove()
    width, height = extent.width, extent.height
    best, least = None, np.inf
    for x, y in points:
        for gap in (9, 16, 26, 40):
            for dx, dy, dislike in (
                (gap, -height / 2, 0), (gap, gap, 1), (gap, -height - gap, 1), (-width / 2, gap, 1), (-width / 2, -height - gap, 1),
                (-width - gap, -height / 2, 0), (-width - gap, gap, 1), (-width - gap, -height - gap, 1),
            ):  # fmt: skip
                left, low = x + dx, y + dy
                inside = (
                    box.x0 + 4 <= left
                    and left + width <= box.x1 - 4
                    and box.y0 + 4 <= low
                    and low + height <= box.y1 - 4
                )
                if not inside:
                    continue
                margin = 4
                covered = (
                    (taken[:, 0] > left - margin)
                    & (taken[:, 0] < left + width + margin)
                    & (taken[:, 1] > low - margin)
                    & (taken[:, 1] < low + height + margin)
                ).sum()
                crowded = sum(
                    left < bx + bw + 6 and bx < left + width + 6 and low < by + bh + 4 and by < low + height + 4
                    for bx, by, bw, bh in boxes
                )
                cost = 10 * covered + 1000 * crowded + dislike + gap / 9
                if cost < least:
                    best, least = ((left, low), (width, height)), cost
    return best if weight == "bold" or least < 10 else None


def _budget(point):
    return f"{point['spp']:,} spp" if "spp" in point else f"{point['entries']:,} entries"


def _length(metres):
    for unit, size in (("m", 1.0), ("cm", 0.01), ("mm", 0.001)):
        if metres >= size:
            return f"{metres / size:.3g} {unit}" if metres / size < 10 else f"{metres / size:.0f} {unit}"
    return f"{metres:.2g} m"
