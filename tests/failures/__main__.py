"""python -m tests.failures: measures every entry, draws its picture, and writes docs/failures.md."""

import os
import sys

from . import drawing, page
from .registry import core_entries, input_entries


def main() -> int:
    """Write the page; 1 where a bound does not hold, though the page is written then, too."""
    page.PICTURES.mkdir(exist_ok=True)
    found, broken = {}, []
    for entry in core_entries() + input_entries():
        what = found[entry] = entry.measure()
        drawing.draw(what.picture, page.picture_of(entry))
        holds = entry.holds(what.value)
        broken += [entry] * (not holds)
        print(
            f"[{' ok ' if holds else 'MISS'}] {page.title(entry):<64} {what.value:10.3g}  {page.bound_of(entry)}",
            flush=True,
        )
    names = {page.picture_of(entry).name for entry in found}
    for old in page.PICTURES.glob("*.png"):
        if old.name not in names:
            old.unlink()
    page.write(found)
    return 1 if broken else 0


code = main()
sys.stdout.flush()
# Blender 4.5 as a module can hang in its exit handlers
os._exit(code)
