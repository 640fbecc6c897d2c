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

STYLE = """body{font:15px/1.5 system-ui,sans-serif;color:#1f2328;max-width:1100px;margin:2em auto;padding:0 1em}
h1,h2{line-height:1.2}img{max-width:100%;height:auto}table{border-collapse:collapse;margin:1em 0;font-size:13px}
td,th{padding:.2em .8em;border-bottom:1px solid #e4e7eb;text-align:right}td:first-child,th:first-child{text-align:left}
p.note{color:#57606a;font-size:13px}"""

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
        f'<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title><style>{STYLE}</style></head><body>',
        f"<h1>{html.escape(title)}</h1>",
        *(f"<p>{html.escape(line)}</p>" for line in dict.fromkeys(map(_made, reports))),
        f"<p>{_links(reports)}</p>" if len(reports) > 1 else "",
    ]
    for report, images in zip(reports, pictures, strict=True):
        parts += _scene(report, list(images))
    # nothing in it may end the element
    data = json.dumps(reports, ensure_ascii=False).replace("</", "<\\/")
    parts.append(f'<script type="application/json" id="figures">{data}</script>')
    return "\n".join([*parts, "</body></html>", ""])


def figures(page: str) -> list[dict]:
    """The figures that a page was made of; none where it holds none."""
    found = re.search(r'<script type="application/json" id="figures">(.*?)</script>', page, re.DOTALL)
    return json.loads(found.group(1)) if found else []


def _made(report) -> str:
    busy = f" Other work ran beside: a load of {report['load']}." if report.get("load", 0) > BUSY else ""
    return f"{report['date']}. {report['machine']}. {report['versions']}.{busy}"


def _links(reports) -> str:
    names = [html.escape(report["scene"]) for report in reports]
    return " · ".join(f'<a href="#{name}">{name}</a>' for name in names)


def _scene(report, images) -> list[str]:
    name = html.escape(report["scene"])
    parts = [f'<h2 id="{name}">{name}</h2>']
    if report["methods"]:
        parts += _picture(images, "error against time")
        parts.append(f'<p class="note">Error: {html.escape(report["error"])}.</p>')
        parts += _methods(report["methods"])
    parts += [f'<p class="note">{html.escape(note)}</p>' for note in report["notes"]]
    for study in report.get("studies", {}).values():
        parts.append(f"<h3>{html.escape(study['title'])}</h3>")
        if "skipped" in study:
            parts.append(f"<p>Not measured: {html.escape(study['skipped'])}</p>")
            continue
        parts += _picture(images, study["title"])
        parts.append(f'<p class="note">{html.escape(study["note"])}</p>')
        rows = [[name, f"{x:g}", f"{y:g}"] for name, line in study["lines"].items() for x, y in line]
        parts += _table(["", study["x"], study["y"]], rows)
    return parts


def _methods(found) -> list[str]:
    rows = []
    for name, line in found.items():
        for point in line:
            budget = f"{point['spp']} spp" if "spp" in point else f"{point['entries']} entries"
            numbers = [f"{100 * point['error']:.2f} %", f"{point['bake_s']:.3g}", f"{1000 * point['relight_s']:.3g}"]
            rows.append([name, budget, *numbers])
    return _table(["", "budget", "error", "bake, s", "relight, ms"], rows)


def _table(head, rows) -> list[str]:
    lines = ["<table><tr>" + "".join(f"<th>{html.escape(cell)}</th>" for cell in head) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows]
    return [*lines, "</table>"]


def _picture(images, text) -> list[str]:
    if not images:
        return []
    data = base64.b64encode(images.pop(0)).decode("ascii")
    return [f'<p><img alt="{html.escape(text)}" src="data:image/png;base64,{data}"></p>']
