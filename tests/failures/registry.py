"""All entries of the failure atlas: those that need no Blender, and those that do."""

from __future__ import annotations

from . import caustics, implicit_cache, panes, penumbra, point_cache, sweeps  # noqa: F401
from .entry import ENTRIES, PARTS, Entry


def core_entries() -> list[Entry]:
    """Those of the methods, in the design's order."""
    return _sorted(entry for entry in ENTRIES if entry.part != "Input")


def input_entries() -> list[Entry]:
    """Those of odd input; needs bpy."""
    from . import input  # noqa: F401

    return _sorted(entry for entry in ENTRIES if entry.part == "Input")


def _sorted(entries):
    return sorted(entries, key=lambda entry: PARTS.index(entry.part))
