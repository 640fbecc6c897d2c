"""Whether the default settings are good ones: rows read from the charts of all samples, which `make charts` measures."""

from __future__ import annotations

from collections.abc import Iterator

from lightpanes.addon import chart
from lightpanes.addon.chart_page import factors, relit

from . import all_charts, harness

BAR = 1.5


def rows() -> Iterator[dict]:
    """How far the default settings are from the best point of the chart, a row for each sample.

    What a bake gives is an error for a time, so there are two best points: that of the least time among those whose error
    is no larger than the default's, and that of the least error among those that take no longer. The figure is the larger
    one of two factors, of the time and of the error, by which these are better. All bakes that can be relit count, the paper's and
    clusters too, with every budget, and the default's own budgets set by hand, which try nothing. Cycles, whose bakes cannot, is held against the default's relight: to be as exact there it takes so many times as long.
    """
    reports = all_charts.read()
    missing = sorted({path.stem for path in all_charts.SAMPLES.glob("*.blend")} - {one["scene"] for one in reports})
    for name in missing:
        yield harness.row(f"charts, {name}: default over the best point", float("inf"), BAR, detail="no chart of it")
    for report in reports:
        yield _row(report)


def _row(report):
    methods = report["methods"]
    ours, by_hand = report["default"], report.get("by_hand")
    cycles = [methods[chart.WAYS[name]] for name in ("cycles", "denoised") if chart.WAYS[name] in methods]
    time, error = factors(ours, relit(report))
    detail = f"error {ours['error']:.4f} after {ours['bake_s']:.1f} s; time × {time:.2f}, error × {error:.2f}"
    if by_hand:
        detail += f"; by hand {by_hand['error']:.4f} after {by_hand['bake_s']:.1f} s"
    alike = [point["bake_s"] for line in cycles for point in line if point["error"] <= ours["error"]]
    if alike:
        detail += f"; Cycles as exact: {min(alike) / ours['relight_s']:.0f} times a relight, {min(alike) / ours['bake_s']:.2g} of the bake"
    else:
        detail += "; no bake of Cycles' is as exact"
    return harness.row(f"charts, {report['scene']}: default over the best point", max(time, error), BAR, detail=detail)
