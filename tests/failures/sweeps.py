"""Lamps that pass where panes are bad, a small version of `make bench ONLY=sweeps`. The truth is the uncompressed solve of
more entries."""

from __future__ import annotations

from functools import cache

import numpy as np

from ..bench import sweeps
from ..core.shapes import quick
from .entry import Curves, Found, entry

FRAMES = 16


@cache
def rooms(seed: int = 0) -> sweeps.Sweeps:
    settings = quick(entries=900, lamps=400, regions=64, exits="texels", error_target=0.1, seed=seed)
    truth = quick(entries=2400, lamps=50, exits="texels", seed=seed)
    return sweeps.Sweeps(sweeps.rooms(), settings, truth, 192)


@cache
def swept(name: str) -> sweeps.Swept:
    return rooms().sweep(name, FRAMES)


def medians(name: str) -> Found:
    """Median error over the frames in which there is light, with flicker."""
    found = swept(name)
    way = np.linalg.norm(np.subtract(*sweeps.PATHS[name])) * np.linspace(0, 1, FRAMES)
    expected = np.array([np.nan if one.nowhere else one.error for one in found.trusts])
    lines = {
        "eigenpanes": found.errors["eigenpanes"],
        "256 clusters": found.errors["256 clusters"],
        "panel expects": expected,
    }
    lit = ~np.isnan(found.errors["eigenpanes"])
    curves = {label: (way[lit], values[lit]) for label, values in lines.items()}
    flicker = ", ".join(f"{key} {value:+.4f}" for key, value in found.flicker.items())
    dark = (
        ""
        if lit.all()
        else f" Frames in the dark: {(~lit).sum()}, told in the panel: {sum(bool(one.nowhere) for one in found.trusts)}."
    )
    detail = f"Change from frame to frame beyond the truth's, over the mean: {flicker}.{dark}"
    return Found(float(np.nanmedian(lines["eigenpanes"])), Curves(curves, "way of the lamp, m", "error"), detail)


MEDIAN = "median error of 16 frames, against 2,400 entries without panes"
TESTS = "core/test_sweeps.py::test_flicker_is_bounded"


@entry(
    "Lamp sweeps",
    "along a surface at 1 cm",
    """A lamp that rolls over the floor. Its pool of light is smaller than an entry. It comes back from the right place, for
    entries share light with those beside them, but smeared over them. The panel says that the lamp is too close.""",
    MEDIAN,
    0.3,
    TESTS,
)
def sweep_surface() -> Found:
    return medians("surface at 1 cm")


@entry(
    "Lamp sweeps",
    "past an occluder's edge",
    "A lamp passes the edge of a free-standing screen, whose shadow opens from entry to entry.",
    MEDIAN,
    0.08,
    TESTS,
)
def sweep_edge() -> Found:
    return medians("an occluder's edge")


@entry(
    "Lamp sweeps",
    "through a door",
    "A lamp passes from one room to another, through the opening in a wall 10 cm thick.",
    MEDIAN,
    0.08,
    TESTS,
)
def sweep_door() -> Found:
    return medians("a door")


@entry(
    "Lamp sweeps",
    "through a wall",
    """A lamp passes through a wall. Within it there is no light, as there should be, and the panel says so; just before and
    after that the lamp is close to the wall.""",
    MEDIAN,
    0.1,
    TESTS,
)
def sweep_wall() -> Found:
    return medians("a wall")
