"""Run the benchmarks, print their rows as a table, keep them in out/bench/results.json.

A benchmark is a module tests/bench/bench_NAME.py with `rows()`, which returns or yields rows made by
`row`. Every table starts with the machine and two calibrations, because seconds mean nothing without.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import json
import math
import os
import platform
import statistics
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "out" / "bench"
RESULTS = OUT / "results.json"
CALIBRATION = "calibration: "


def row(
    name: str,
    value: float,
    bar: float | None = None,
    unit: str = "",
    *,
    at_least: bool = False,
    ok: bool | None = None,
    detail: str = "",
) -> dict:
    """One line of the table. It is ok when value ≤ bar (≥ with at_least), or when there is no bar."""
    value = float(value)
    if ok is None:
        ok = math.isfinite(value) and (bar is None or (value >= bar if at_least else value <= bar))
    return {"row": name, "value": value, "bar": bar, "unit": unit, "ok": bool(ok), "detail": detail}


def interleaved(*functions: Callable[[], object], repeats: int = 5) -> list[float]:
    """Median seconds of each function; they take turns, so that a busy machine slows all alike."""
    seconds = [[] for _ in functions]
    for _ in range(repeats):
        for function, record in zip(functions, seconds, strict=True):
            started = time.perf_counter()
            function()
            record.append(time.perf_counter() - started)
    return [statistics.median(record) for record in seconds]


def calibrations() -> list[dict]:
    """What this machine can do now: rays a second, bytes a second. The same work on every machine."""
    from lightpanes.core.rays import chunks
    from lightpanes.core.threads import in_threads, thread_count

    bvh, origins, directions = _fixed_rays()
    pieces = chunks(len(origins))
    block = np.zeros(32 * 1024 * 1024, np.float32)
    target = np.empty_like(block)
    halves = chunks(len(block), -(-len(block) // thread_count()))

    def trace():
        in_threads(lambda s: bvh.closest(origins[s], directions[s]), pieces)

    def copy():
        in_threads(lambda s: np.copyto(target[s], block[s]), halves)

    rays, bandwidth = interleaved(trace, copy, repeats=7)
    detail = f"{thread_count()} threads"
    return [
        row(
            f"{CALIBRATION}Embree, closest hit",
            len(origins) / rays / 1e6,
            unit="Mray/s",
            detail=f"{bvh.size} triangles, {detail}",
        ),
        row(
            f"{CALIBRATION}memory, copy",
            2 * block.nbytes / bandwidth / 1e9,
            unit="GB/s",
            detail=f"read + write, {detail}",
        ),
    ]


def _fixed_rays(count: int = 1 << 20):
    """Uniform directions from uniform points in a room with 299 boxes: 3,600 triangles."""
    from lightpanes.core.rays import Bvh

    rng = np.random.default_rng(1)
    corner = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)], np.float32)
    quads = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    low = np.vstack([[0, 0, 0], rng.uniform(0, 9.5, (299, 3))])
    size = np.vstack([[10, 10, 10], rng.uniform(0.1, 0.5, (299, 3))])
    boxes = low[:, None] + corner[None] * size[:, None]
    origins = rng.uniform(0, 10, (count, 3)).astype(np.float32)
    directions = rng.normal(size=(count, 3)).astype(np.float32)
    return Bvh(boxes[:, triangles].reshape(-1, 3, 3).astype(np.float32)), origins, directions


def machine(load: bool = True) -> str:
    """CPU, cores, load if wanted, and the versions that matter, in one line."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        cpu = next(
            (line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")),
            cpu,
        )
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    busy = f", load {os.getloadavg()[0]:.1f}" if load and hasattr(os, "getloadavg") else ""
    versions = [f"Python {platform.python_version()}"]
    for package in ("numpy", "embreex", "bpy"):
        if importlib.util.find_spec(package):
            versions.append(f"{package} {importlib.metadata.version(package)}")
    return f"{platform.system()}, {cpu}, {cores} cores{busy}; {', '.join(versions)}"


def main(arguments: list[str]) -> int:
    """Run all benchmarks, or those whose names are given; 1 when a bar is missed or a benchmark fails."""
    known = [path.stem.removeprefix("bench_") for path in sorted(Path(__file__).parent.glob("bench_*.py"))]
    wanted = [name for argument in arguments for name in argument.replace(",", " ").split()]
    unknown = [name for name in wanted if name not in known]
    if unknown:
        print(f"Unknown benchmark: {', '.join(unknown)}. There are: {', '.join(known)}.")
        return 2
    print(machine())
    fresh = calibrations()
    for line in fresh:
        print(_line(line), flush=True)
    for name in wanted or known:
        for line in _rows(name):
            fresh.append(line)
            print(_line(line), flush=True)
            _store(fresh, merge=True)
    _store(fresh, merge=bool(wanted))
    return 0 if all(line["ok"] for line in fresh) else 1


def _rows(name: str) -> Iterator[dict]:
    try:
        yield from importlib.import_module(f"tests.bench.bench_{name}").rows()
    except Exception as error:
        traceback.print_exc()
        yield row(f"{name}: failed", math.inf, ok=False, detail=f"{type(error).__name__}: {error}")


def _store(fresh: list[dict], merge: bool) -> None:
    """Write the rows; with merge, over those of earlier runs that have the same name."""
    rows = {line["row"]: line for line in fresh}
    if merge and RESULTS.exists():
        rows = {line["row"]: line for line in json.loads(RESULTS.read_text())} | rows
    OUT.mkdir(parents=True, exist_ok=True)
    lines = sorted(rows.values(), key=lambda line: not line["row"].startswith(CALIBRATION))
    # JSON has no infinity
    lines = [
        line | {"value": line["value"] if line["value"] is not None and math.isfinite(line["value"]) else None}
        for line in lines
    ]
    part = RESULTS.with_suffix(".part")
    part.write_text(json.dumps(lines, indent=1, ensure_ascii=False) + "\n")
    part.replace(RESULTS)


def _line(line: dict) -> str:
    state = " ok " if line["ok"] else "MISS"
    bar = "" if line["bar"] is None else f"(bar {line['bar']:g})"
    detail = f"  {line['detail']}" if line["detail"] else ""
    return f"[{state}] {line['row']:<64} {line['value']:>10.4g} {line['unit']:<7} {bar:<13}{detail}"
