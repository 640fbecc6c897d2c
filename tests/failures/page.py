"""The page of all failures, `docs/failures.md`, written from what was measured."""

from __future__ import annotations

import datetime
from pathlib import Path

from ..bench.harness import machine
from .entry import PARTS, Entry, Found

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "failures.md"
PICTURES = ROOT / "docs" / "failures"

HEAD = """# Where methods fail

Every method has places where it is bad. Here is each that we know of: what happens there and why, a figure that was
measured, the bound that a test holds it to, and a picture. `make failures` measures and draws all of it anew; the bounds
are those of the tests, read from the same lines of code (`tests/failures/`). [The manual](manual.md) says what to do
about them.
"""

NOTES = {
    "Lamp sweeps": """Small ones, as the tests run them. `make bench ONLY=sweeps` lets lamps pass for 200 frames, with brute-force rays and
Cycles as the truth, and holds against it what the panel expects, there and in sweeps of three other scenes:

![Error over the frames of five sweeps, with what the panel expects, and flicker](sweeps.png)""",
}
"""What is said of parts."""


def figure(value: float) -> str:
    """A measured figure in few digits."""
    return "0" if abs(value) < 1e-12 else f"{value:.3g}"


def bound_of(entry: Entry) -> str:
    return f"{'at least' if entry.at_least else 'at most'} {entry.bound:g}"


def picture_of(entry: Entry) -> Path:
    return PICTURES / f"{entry.slug}.png"


def tests_of(entry: Entry) -> str:
    own = f"tests/{'addon' if entry.part == 'Input' else 'core'}/test_failure_atlas.py::test_the_bound_holds[{entry.slug}]"
    return ", ".join(f"`{name}`" for name in (own, *(f"tests/{name}" for name in entry.tests)))


def write(found: dict[Entry, Found]) -> None:
    """Write the page; the pictures are there already."""
    date = datetime.date.today().isoformat()
    lines = [HEAD, f"Measured {date}: {machine(load=False)}.\n"]
    lines += ["| part | place | measured | bound |", "|---|---|---|---|"]
    for entry, what in found.items():
        link = f"[{entry.name}](#{anchor(entry)})"
        lines.append(f"| {entry.part} | {link} | {figure(what.value)} | {bound_of(entry)} |")
    for part in PARTS:
        lines.append(f"\n## {part}")
        if part in NOTES:
            lines.append(f"\n{NOTES[part]}")
        for entry, what in found.items():
            if entry.part == part:
                lines += section(entry, what)
    PAGE.write_text("\n".join(lines) + "\n")


def anchor(entry: Entry) -> str:
    """As GitHub makes it from the section's title."""
    kept = "".join(c for c in title(entry).lower() if c.isalnum() or c in " -_")
    return kept.replace(" ", "-")


def title(entry: Entry) -> str:
    return f"{entry.part}: {entry.name}"


def section(entry: Entry, found: Found) -> list[str]:
    detail = f" {found.detail}{'' if found.detail.endswith(('.', '”')) else '.'}" if found.detail else ""
    name = picture_of(entry).relative_to(PAGE.parent).as_posix()
    return [
        f"\n### {title(entry)}\n",
        f"{entry.what}\n",
        f"- **Measured** {figure(found.value)}: {entry.figure}.{detail}",
        f"- **Bound** {bound_of(entry)}",
        f"- Tests: {tests_of(entry)}\n",
        f"![{entry.name}]({name})",
    ]
