"""python -m tests.bench.all_charts [NAME…] [--again] [--draw]: the charts of every sample, and docs/charts.html of them all.

Each sample's figures and pictures stay in out/charts; samples that are not named are shown as they were charted last.
A sample that was charted with the same code, file, settings and versions is not measured again, so that a run goes on where it
was ended; `--again` measures it all the same. `--draw` measures nothing and draws what is there anew. Cycles' references
are kept in out/bench/cache.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import sys

import bpy
import lightpanes
from lightpanes.addon import chart, chart_page, plot
from lightpanes.addon.terminal import Bar, quiet
from PIL import Image

from . import cycles, harness, judged

FOLDER = harness.ROOT / "out" / "charts"
SAMPLES = harness.ROOT / "sample_blends"
PAGE = harness.ROOT / "docs" / "charts.html"

MEASURING = ("chart", "rungs", "methods", "studies", "preview_study", "reference", "denoised")
"""Modules of addon whose code is part of what was measured, beside all of core."""

COLOURS = 64
"""Of a picture in the page: lines on white need no more, and take a third of the room."""


def main(words: list[str]) -> int:
    """Chart the samples of these names, or all; 2 where a name is none."""
    names = [word for word in words if word not in ("--again", "--draw")]
    known = sorted(path.stem for path in SAMPLES.glob("*.blend"))
    unknown = [name for name in names if name not in known]
    if unknown:
        print(f"Unknown sample: {', '.join(unknown)}. There are: {', '.join(known)}.")
        return 2
    if "--draw" not in words:
        lightpanes.register()
        FOLDER.mkdir(parents=True, exist_ok=True)
        try:
            _measure(names or known, "--again" in words)
        finally:
            # of what is there, wherever the run was ended
            shown = write()
    else:
        shown = write()
    print(f"Wrote {PAGE.relative_to(PAGE.parents[1])}: {', '.join(shown)}")
    return 0


def _measure(names: list[str], again: bool) -> None:
    """Chart the samples, but for those that were charted as they would be now."""
    for name in names:
        if not again and (made := _charted(name)):
            print(f"{name} was charted with this code on {made['date']} (load {made['load']}); --again does it anew.")
        else:
            measure(name)


def write() -> list[str]:
    """The page of all samples that were charted; their names."""
    reports = read()
    page = chart_page.page(reports, [[_smaller(png) for png in draw(report)] for report in reports])
    PAGE.write_text(page, "utf-8")
    return [report["scene"] for report in reports]


def measure(name: str) -> None:
    """All that can be charted of a sample, into its JSON."""
    # the code that runs, should files change meanwhile
    code = made_by(name)
    bpy.ops.wm.open_mainfile(filepath=str(SAMPLES / f"{name}.blend"))
    with Bar() as bar, quiet():
        found = chart.measure(bpy.context, judged.resolution(name), 0, bar, chart.NAMES, _indirect)
    report = chart_page.machine() | {"load": round(os.getloadavg()[2], 1), "made_by": code} | found
    (FOLDER / f"{name}_chart.json").write_text(json.dumps(report, indent=1) + "\n", "utf-8")


def made_by(name: str) -> str:
    """Says whether figures of a sample would be measured the same way: of code, file, settings and versions."""
    modules = [harness.ROOT / "addon" / f"{module}.py" for module in MEASURING]
    paths = [*sorted((harness.ROOT / "core").rglob("*.py")), *modules, SAMPLES / f"{name}.blend"]
    digest = hashlib.sha256(f"{judged.resolution(name)} {chart_page.machine()['versions']}".encode())
    for path in paths:
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


def _charted(name: str) -> dict | None:
    """A sample's figures if they need not be measured again."""
    return next((one for one in read() if one["scene"] == name and one.get("made_by") == made_by(name)), None)


def read() -> list[dict]:
    """The samples' figures as they were charted last, here or for the page, which may be the newer one."""
    found = {report["scene"]: report for report in chart_page.figures(PAGE.read_text("utf-8") if PAGE.exists() else "")}
    for path in FOLDER.glob("*_chart.json"):
        name, own = path.stem.removesuffix("_chart"), json.loads(path.read_text("utf-8"))
        if name not in found or found[name]["date"] <= own["date"]:
            found[name] = own
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
