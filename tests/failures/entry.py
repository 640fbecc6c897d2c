"""What an entry of the failure atlas is: an input, a measured figure, the bound that a test holds, and a picture.

Pictures are plain arrays, which `drawing` brings to paper, so that measuring needs no matplotlib.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

PARTS = ("Panes", "Point cache", "Penumbra casting", "Implicit cache", "Caustics", "Lamp sweeps", "Input")


@dataclass(frozen=True)
class Images:
    """Images side by side, {title: (H, W) array, row 0 at the bottom}, all in one scale from 0 to `high`, or the most of
    the first. unit: of the values."""

    images: dict[str, np.ndarray]
    unit: str = ""
    high: float | None = None


@dataclass(frozen=True)
class Curves:
    """Curves, {label: (x, y)}, with what the axes show. bound: of y, drawn as a line."""

    curves: dict[str, tuple[np.ndarray, np.ndarray]]
    x: str
    y: str
    log: str = ""
    bound: float | None = None


@dataclass(frozen=True)
class Places:
    """Places seen from above, {title: (position (n, 2) m, value (n,))}, in one scale."""

    places: dict[str, tuple[np.ndarray, np.ndarray]]
    unit: str = ""
    high: float | None = None


@dataclass(frozen=True)
class Wires:
    """Meshes as edges, {title: (segments (n, 2, 3) m, sentence below)}; a title's marks are drawn as dots (m, 3)."""

    wires: dict[str, tuple[np.ndarray, str]]
    marks: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class Found:
    """value: the measured figure. detail: more of what was measured, a sentence."""

    value: float
    picture: Images | Curves | Places | Wires
    detail: str = ""


@dataclass(frozen=True)
class Entry:
    """name: as in the design's list. what: happens and why, for the user. figure: what `value` is. bound: of the figure,
    which it does not pass, or with `at_least` does. tests: ids of further tests of the same place."""

    part: str
    name: str
    what: str
    figure: str
    bound: float
    at_least: bool
    tests: tuple[str, ...]
    measure: Callable[[], Found]

    @property
    def slug(self) -> str:
        """Name of the picture's file."""
        return self.measure.__name__

    def holds(self, value: float) -> bool:
        """Whether the bound is kept; what is not a number keeps none."""
        return bool(value >= self.bound if self.at_least else value <= self.bound)


ENTRIES: list[Entry] = []


def entry(part: str, name: str, what: str, figure: str, bound: float, tests: str, at_least: bool = False):
    """Register a function that measures an entry. tests: ids below tests/, `core/test_x.py::test_y`, by blanks."""
    assert part in PARTS

    def register(measure):
        ENTRIES.append(
            Entry(part, name, " ".join(what.split()), figure, bound, at_least, tuple(tests.split()), measure)
        )
        return measure

    return register
