"""How far the light can be trusted under the lamps as they are now: known before anybody looks.

What the panes leave out of a lamp's field is measured at each relight, by a sketch that the bake keeps of it. All other
error was measured by the bake for its test lamps. It grows as light gathers on few entries, whose size then shows and which
few rays meet, and so it is scaled by how much more the present lamps do that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..scene import Light
from .relighter import Relighter
from .weights import PaneWeights

MARGIN = 1.5
"""Error over that of the bake itself from which on a lamp is worth a word, where the bake missed what was asked for: it is
the mean of lamps that differ as much."""

CLOSE = 1.0
"""A lamp is close to a surface within this many times the entry's size there."""


@dataclass(frozen=True)
class Expected:
    """Of a bake, relative RMSEs. target: asked for. error: measured, of the lamps that it was tried with; rest: all of that
    which is not the panes'. gathered: `concentration` of these lamps, 0 where the bake is too old to know."""

    target: float = 1.0
    error: float = 0.0
    rest: float = 0.0
    gathered: float = 0.0


def expected_of(report: Mapping) -> Expected:
    """From a bake's report."""
    error, parts = report.get("error") or 0.0, report.get("error_parts", {})
    # parts are measured one by one, and need not sum up to the whole
    rest = min(float(np.sqrt(sum(part**2 for name, part in parts.items() if name != "panes"))), error)
    return Expected(report.get("error_target", 1.0), error, rest, report.get("concentration", 0.0))


@dataclass(frozen=True)
class Trust:
    """error: relative RMSE over the surface that is to be expected under all live lamps; None where the bake is too old to
    tell. panes: the part of it that the panes leave out. worst: of the lamps, the one that adds most to it, None without
    lamps. close: whether a surface is nearer to that one than entries are wide. nowhere: lamps whose light meets no baked
    surface, inside of a thing or outside of a room."""

    error: float | None
    panes: float | None
    worst: Light | None
    close: bool
    nowhere: tuple[Light, ...]

    def warns(self, expected: Expected) -> bool:
        """Whether the user must know: more error than was asked for, and than the bake has said it has anyway."""
        return self.error is not None and self.error > max(expected.target, MARGIN * expected.error)


def trust(relighter: Relighter, lights: Sequence[Light], expected: Expected) -> Trust:
    """Of the lamps that `relighter` has just been asked for (`Relighter.light`)."""
    lamps = [(light, known) for light in lights if light.live and (known := relighter.known(light)) is not None]
    shining = [(light, known) for light, known in lamps if light.power.any()]
    nowhere = tuple(light for light, known in shining if not known.unit.any())
    if any(known.sketch is None for _, known in shining) or not expected.gathered:
        return Trust(None, None, None, False, nowhere)
    level = relighter.mean(sum(known.weights for _, known in shining)) if shining else 0.0
    if level <= 0:
        return Trust(0.0, 0.0, None, False, nowhere)

    def parts(sketch):
        """What the panes leave out, and the rest, of the light of a sketch."""
        missed, sent = rms(sketch)
        return missed / level, expected.rest * max(sent / level / expected.gathered, least)

    least = 1.0
    panes, rest = parts(sum(known.sketch for _, known in shining))
    least = 0.0
    worst = max(shining, key=lambda one: np.hypot(*parts(one[1].sketch)))[0]
    return Trust(float(np.hypot(panes, rest)), float(panes), worst, _is_close(relighter, worst), nowhere)


def rms(sketch: np.ndarray) -> np.ndarray:
    """(…,) RMS over area and RGB of what sketches (…, SKETCH, 3) stand for, W/m²."""
    return np.sqrt((sketch**2).sum(axis=(-2, -1)) / 3)


def concentration(weights: PaneWeights, area: np.ndarray, direct: np.ndarray) -> float:
    """RMS over the surface of what entries send out, over the mean irradiance that it makes; mean over lamps that light the
    entries with `direct` (n, 3 s), three of which take red, green and blue.

    A ray meets an entry about as often as that is large, so the noise of a gather is in proportion to this.
    """
    level = weights.mean(area)
    found = []
    for s in range(0, direct.shape[1], 3):
        values, sketch = weights.of_and_sketch(np.ascontiguousarray(direct[:, s : s + 3]))
        mean = level @ values
        lit = mean > 0
        found += (np.sqrt((sketch[1] ** 2).sum(axis=0))[lit] / mean[lit]).tolist()
    return float(np.mean(found)) if found else 0.0


def _is_close(relighter, light):
    if light.kind == "SUN":
        return False
    surface = relighter.panes.surface
    # a place of each: one a row of `size`
    place = surface.position[:: len(surface.position) // max(len(surface), 1)]
    return bool((np.linalg.norm(place - light.position.astype(np.float32), axis=1) < CLOSE * surface.size).any())
