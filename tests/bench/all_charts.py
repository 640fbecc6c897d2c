"""python -m tests.bench.all_charts [NAME…]: `lightpanes chart --methods all` of every sample, and docs/charts.html of them all.

Each sample's figures and pictures stay in out/charts; samples that are not named are shown as they were charted last.
"""

from __future__ import annotations

import json
import os
import sys

import lightpanes
from lightpanes.addon import chart_page, commands

from . import harness

FOLDER = harness.ROOT / "out" / "charts"
SAMPLES = harness.ROOT / "sample_blends"
PAGE = harness.ROOT / "docs" / "charts.html"
RESOLUTION = 128


def main(names: list[str]) -> int:
    """Chart the samples of these names, or all; the exit code of the first that fails."""
    known = sorted(path.stem for path in SAMPLES.glob("*.blend"))
    unknown = [name for name in names if name not in known]
    if unknown:
        print(f"Unknown sample: {', '.join(unknown)}. There are: {', '.join(known)}.")
        return 2
    lightpanes.register()
    for name in names or known:
        words = ["chart", str(SAMPLES / f"{name}.blend"), "--output", str(FOLDER), "--resolution", str(RESOLUTION)]
        if code := commands.main([*words, "--methods", "all"]):
            return code
    reports = [json.loads(path.read_text("utf-8")) for path in sorted(FOLDER.glob("*_chart.json"))]
    PAGE.write_text(chart_page.page(reports, [_pictures(report) for report in reports]), "utf-8")
    print(f"Wrote {PAGE.relative_to(harness.ROOT)}: {', '.join(report['scene'] for report in reports)}")
    return 0


def _pictures(report) -> list[bytes]:
    """The chart's first, then one of each study that has lines."""
    stem = f"{report['scene']}_chart"
    names = [stem] if any(report["methods"].values()) else []
    names += [f"{stem}_{name}" for name, study in report["studies"].items() if "skipped" not in study]
    return [(FOLDER / f"{name}.png").read_bytes() for name in names]


if __name__ == "__main__":
    code = main(sys.argv[1:])
    sys.stdout.flush()
    # Blender 4.5 as a module can hang in its exit handlers
    os._exit(code)
