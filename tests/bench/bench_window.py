"""What a person at Blender's window feels: stalls of the main thread while a bake runs, and how soon Esc frees it."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ..gui import window
from . import harness

SAMPLE = "atrium"


def rows() -> Iterator[dict]:
    if reason := window.missing():
        yield harness.row("window: not measured", 0, ok=False, detail=reason)
        return
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        archive = window.build(folder, window.python_of_blender(folder))
        found = window.session(folder, archive, SAMPLE)
        for name in ("start", "progress", "panel", "before", "after"):
            shutil.copy(folder / f"{name}.png", harness.OUT / f"window_{name}.png")
    redraw = found["stalls"]["no bake"][""]
    yield harness.row(f"window, {SAMPLE}: gap of the main thread without a bake, redraws alone", 1000 * redraw, unit="ms")  # fmt: skip
    gaps = [(gap, stage) for name, part in found["stalls"].items() if name != "no bake" for stage, gap in part.items()]
    for kind, bar in (("worker", 0.1), ("main", 1.0)):
        gap, stage = max(item for item in gaps if item[1].startswith(f"{kind}:"))
        label = {"worker": "longest stall while the worker runs", "main": "longest step on the main thread"}[kind]
        yield harness.row(f"window, {SAMPLE}: {label}", 1000 * gap, 1000 * bar, "ms", detail=f"{stage}; redraws included")  # fmt: skip
    yield harness.row(f"window, {SAMPLE}: from Esc to a free interface", max(found["ends"]), 0.5, "s", detail=f"{len(found['ends'])} bakes")  # fmt: skip
