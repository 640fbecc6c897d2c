"""All charts of a scene as one HTML page that needs nothing else: no network, no files beside it."""

from __future__ import annotations

import base64
import datetime
import html
import json
import os
import platform
import re
import sys

import bpy
import numpy as np

STYLE = """body{font:16px/1.5 system-ui,sans-serif;color:#1f2328;background:#fff;max-width:1100px;margin:2em auto;padding:0 1em}
h1,h2,h3{line-height:1.2}h2{margin-top:2.5em;border-top:1px solid #e4e7eb;padding-top:1em}
.wide{overflow-x:auto}img{display:block;max-width:100%;height:auto}table{border-collapse:collapse;margin:1em 0;font-size:14px}
td,th{padding:.25em .8em;border-bottom:1px solid #e4e7eb;text-align:right}td:first-child,th:first-child{text-align:left}
summary{cursor:pointer}.note{color:#57606a;font-size:14px}
@media(max-width:700px){.wide img{max-width:none;width:560px}.wide .both{width:860px}}"""
"""On a telephone the wide pictures, and tables, are pushed aside with a finger: smaller, nobody could read them."""

BUSY = 3.0
"""Load from which times are those of a busy machine: a chart keeps two cores busy by itself."""


def machine() -> dict[str, str]:
    """What the figures were made on, and when; goes into the JSON, too."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "date": datetime.date.today().isoformat(),
        "machine": f"{platform.system()} {platform.machine()}, {_processor()}, {cores} cores",
        "versions": f"Blender {bpy.app.version_string}, Python {platform.python_version()}, numpy {np.__version__}",
    }


def _processor() -> str:
    if sys.platform.startswith("linux"):
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            for line in file:
                if line.startswith("model name"):
                    return line.split(":", 1)[1].strip()
    return platform.processor() or "unknown processor"


def page(reports: list[dict], pictures: list[list[bytes]]) -> str:
    """The page of scenes' figures (`chart.measure`, with "studies") and of their PNGs, the chart's first, then one for each
    study that has lines. Without pictures the tables alone. `figures` reads the figures back."""
    title = f"Lightpanes: charts of {', '.join(report['scene'] for report in reports)}"
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width,initial-scale=1">',
        f"<title>{html.escape(title)}</title><style>{STYLE}</style></head><body>",
        f"<h1>{html.escape(title)}</h1>",
        *_lead(reports),
        *(f'<p class="note">{html.escape(line)}</p>' for line in dict.fromkeys(map(_made, reports))),
        f"<p>{_links(reports)}</p>" if len(reports) > 1 else "",
    ]
    for report, images in zip(reports, pictures, strict=True):
        parts += _scene(report, list(images))
    # nothing in it may end the element
    data = json.dumps(reports, ensure_ascii=False).replace("</", "<\\/")
    parts.append(f'<script type="application/json" id="figures">{data}</script>')
    return "\n".join([*parts, "</body></html>", ""])


def factors(ours: dict, points: list[dict]) -> tuple[float, float]:
    """Time of a point over the least of those as exact, and its error over the least of those as fast; at least 1."""
    time = min([point["bake_s"] for point in points if point["error"] <= ours["error"]], default=ours["bake_s"])
    error = min([point["error"] for point in points if point["bake_s"] <= ours["bake_s"]], default=ours["error"])
    return ours["bake_s"] / min(time, ours["bake_s"]), ours["error"] / max(min(error, ours["error"]), 1e-6)


def relit(report: dict) -> list[dict]:
    """All points of a report whose bakes can be relit, the default's budgets by hand among them."""
    found = [point for line in report["methods"].values() for point in line if "spp" not in point]
    return found + ([report["by_hand"]] if "by_hand" in report else [])


def figures(page: str) -> list[dict]:
    """The figures that a page was made of; none where it holds none."""
    found = re.search(r'<script type="application/json" id="figures">(.*?)</script>', page, re.DOTALL)
    return json.loads(found.group(1)) if found else []


def _lead(reports) -> list[str]:
    """What there is to learn: the default bakes of all scenes beside what else can be done."""
    known = [report for report in reports if "default" in report]
    if not known:
        return []
    ours = [report["default"] for report in known]
    errors, bakes, again = (
        _span([point[key] for point in ours], show)
        for key, show in (("error", _percent), ("bake_s", _time), ("relight_s", _time))
    )
    rows = []
    for report in known:
        own, best = report["default"], max(factors(report["default"], relit(report)))
        cycles = [point for line in report["methods"].values() for point in line if "spp" in point]
        alike = min((point["bake_s"] for point in cycles if point["error"] <= own["error"]), default=None)
        longest = max((point["bake_s"] for point in cycles), default=None)
        beside = "–" if longest is None else f"more than {_time(longest)}" if alike is None else _time(alike)
        numbers = [_percent(own["error"]), _time(own["bake_s"]), _time(own["relight_s"]), beside, f"{best:.2f} ×"]
        rows.append([report["scene"], f"{report['resolution']}²", *numbers])
    head = ["", "texels", "error", "bake", "each relight", "Cycles as exact", "behind the best"]
    load = max(report.get("load", 0) for report in known)
    busy = f" Other work ran beside, a load of up to {load}: a quiet machine takes less time." if load > BUSY else ""
    return [
        f"<p>With default settings (an error of 5 % is asked for) a bake errs by {errors} and takes {bakes}. From then on another "
        f"lamp position takes {again}, where Cycles starts again. The lamps stand where no bake was trained on.{busy}</p>",
        *_table(head, rows),
        '<p class="note">Cycles as exact: the time of its least bake, plain or denoised, that errs no more than ours does. Behind the best: how much '
        "faster as exact, or more exact as fast, the best of all other bakes here is that can be relit: other budgets, "
        "those of the default bake set by hand, the paper's method and its panes. 1 × means that none is better.</p>",
    ]


def _span(values, show) -> str:
    low, high = show(min(values)), show(max(values))
    return low if low == high else f"{low} to {high}"


def _percent(part: float) -> str:
    return f"{100 * part:.1f} %"


def _time(seconds: float) -> str:
    return (
        f"{1000 * seconds:.2g} ms" if seconds < 0.0995 else f"{seconds:.2g} s" if seconds < 9.95 else f"{seconds:.0f} s"
    )


def _made(report) -> str:
    return f"{report['date']}. {report['machine']}. {report['versions']}."


def _links(reports) -> str:
    names = [html.escape(report["scene"]) for report in reports]
    return " · ".join(f'<a href="#{name}">{name}</a>' for name in names)


def _scene(report, images) -> list[str]:
    name = html.escape(report["scene"])
    parts = [f'<h2 id="{name}">{name}</h2>']
    if report.get("load", 0) > BUSY:
        parts.append(
            f'<p class="note">Other work ran beside, a load of {report["load"]}: a quiet machine takes less time.</p>'
        )
    if report["methods"]:
        parts += _picture(images, "error against time", True)
        parts.append(f'<p class="note">Error: {html.escape(report["error"])}.</p>')
    parts += [f'<p class="note">{html.escape(note)}</p>' for note in report["notes"]]
    if report["methods"]:
        parts += _folded("All figures", _methods(report))
    for study in report.get("studies", {}).values():
        parts.append(f"<h3>{html.escape(study['title'])}</h3>")
        if "skipped" in study:
            parts.append(f"<p>Not measured: {html.escape(study['skipped'])}</p>")
            continue
        parts += _picture(images, study["title"])
        parts.append(f'<p class="note">{html.escape(study["note"])}</p>')
        rows = [[name, f"{x:g}", f"{y:g}"] for name, line in study["lines"].items() for x, y in line]
        parts += _folded("Figures", _table(["", study["x"], study["y"]], rows))
    return parts


def _folded(title, lines) -> list[str]:
    return [f"<details><summary>{title}</summary>", *lines, "</details>"]


def _methods(report) -> list[str]:
    rows, found = [], dict(report["methods"])
    if "by_hand" in report:
        found["The default's budgets by hand"] = [report["by_hand"]]
    for name, line in found.items():
        for point in line:
            budget = f"{point['spp']} spp" if "spp" in point else f"{point['entries']} entries"
            numbers = [_percent(point["error"]), _time(point["bake_s"]), _time(point["relight_s"])]
            rows.append([name, budget, *numbers])
    return _table(["", "budget", "error", "bake", "relight"], rows)


def _table(head, rows) -> list[str]:
    lines = ['<div class="wide"><table><tr>' + "".join(f"<th>{html.escape(cell)}</th>" for cell in head) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows]
    return [*lines, "</table></div>"]


def _picture(images, text, both=False) -> list[str]:
    """both: of two charts side by side."""
    if not images:
        return []
    data, kind = base64.b64encode(images.pop(0)).decode("ascii"), ' class="both"' if both else ""
    return [f'<div class="wide"><img{kind} alt="{html.escape(text)}" src="data:image/png;base64,{data}"></div>']
