"""python -m tests.bench.all_charts [NAME…] [--draw]: the charts of every sample, and docs/charts.html of them all.

Each sample's figures and pictures stay in out/charts; samples that are not named are shown as they were charted last.
`--draw` measures nothing and draws what is there anew. Cycles' references are kept in out/bench/cache.
"""

from __future__ import annotations

import io
import json
import os
import sys

import bpy
import lightpanes
from lightpanes.addon import chart, chart_page, plot
from lightpanes.addon.terminal import Bar, quiet
from PIL import Image

from . import cycles, harness

FOLDER = harness.ROOT / "out" / "charts"
SAMPLES = harness.ROOT / "sample_blends"
PAGE = harness.ROOT / "docs" / "charts.html"
RESOLUTION = 128

COLOURS = 64
"""Of a picture in the page: lines on white need no more, and take a third of the room."""


def main(words: list[str]) -> int:
    """Chart the samples of these names, or all; 2 where a name is none."""
    names = [word for word in words if word != "--draw"]
    known = sorted(path.stem for path in SAMPLES.glob("*.blend"))
    unknown = [name for name in names if name not in known]
    if unknown:
        print(f"Unknown sample: {', '.join(unknown)}. There are: {', '.join(known)}.")
        return 2
    if "--draw" not in words:
        lightpanes.register()
        FOLDER.mkdir(parents=True, exist_ok=True)
        for name in names or known:
            measure(name)
    reports = read()
    page = chart_page.page(reports, [[_smaller(png) for png in draw(report)] for report in reports])
    PAGE.write_text(page, "utf-8")
    print(f"Wrote {PAGE.relative_to(harness.ROOT)}: {', '.join(report['scene'] for report in reports)}")
    return 0


def measure(name: str) -> None:
    """All that can be charted of a sample, into its JSON."""
    bpy.ops.wm.open_mainfile(filepath=str(SAMPLES / f"{name}.blend"))
    with Bar() as bar, quiet():
        found = chart.measure(bpy.context, RESOLUTION, 0, bar, chart.NAMES, _indirect)
    report = chart_page.machine() | {"load": round(os.getloadavg()[2], 1)} | found
    (FOLDER / f"{name}_chart.json").write_text(json.dumps(report, indent=1) + "\n", "utf-8")


def read() -> list[dict]:
    """The samples' figures as they were charted last, here or for the page."""
    found = {report["scene"]: report for report in chart_page.figures(PAGE.read_text("utf-8") if PAGE.exists() else "")}
    for path in FOLDER.glob("*_chart.json"):
        found[path.stem.removesuffix("_chart")] = json.loads(path.read_text("utf-8"))
    return [found[name] for name in sorted(found)]


def draw(report: dict) -> list[bytes]:
    """PNGs: the chart's first, then one of each study that has lines."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    stem, found = FOLDER / f"{report['scene']}_chart", []
    if any(report["methods"].values()):
        found.append(stem.with_suffix(".png"))
        plot.draw(report, found[-1])
    for name, study in report["studies"].items():
        if "skipped" not in study:
            found.append(stem.with_name(f"{stem.name}_{name}.png"))
            plot.draw_study(study, found[-1])
    return [path.read_bytes() for path in found]


def _indirect(context, resolution, spp, seed, progress):
    """A reference, kept on disk. What the chart changes in a file that was opened is the same each time."""
    progress()
    return cycles.reference_indirect(context, resolution, spp, seed, script="the chart's own lamp alone")


def _smaller(png: bytes) -> bytes:
    """The picture in few colours."""
    made, small = Image.open(io.BytesIO(png)).convert("RGB"), io.BytesIO()
    made.quantize(COLOURS, dither=Image.Dither.NONE).save(small, "PNG", optimize=True)
    return small.getvalue()


if __name__ == "__main__":
    code = main(sys.argv[1:])
    sys.stdout.flush()
    # Blender 4.5 as a module can hang in its exit handlers
    os._exit(code)
