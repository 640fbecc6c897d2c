"""How far the light can be trusted under the lamps as they are now: known before anybody looks.

What the panes leave out of a lamp's field is measured at each relight, by a sketch that the bake keeps of it. All other
error was measured by the bake for its test lamps. Part of that has to do with where light comes from: noise, and the size of
the entries. It grows as light gathers on few entries, which few rays meet and whose size then shows, and so it is scaled by
the contrast of the present lamps' light over that of the test lamps'. The rest stays as it is.
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
the mean of lamps that differ as much, and it was told."""

KEPT = 0.5
"""Part of what a sketch misses, entry by entry, that shows on blocks of texels at least, whatever else explains the error."""

LEAST = 0.25
"""Part of the mean square of what entries send out that counts as contrast even where light is quite even."""

UNEVEN = 0.7
"""Part of `unevenness`, which is of first order and of places, that is an error of texels: in the two sweeps of
tests/bench/sweeps.py in which it is most of what goes wrong. At 1 cm above a floor that is half as much again too much, beside a
wall a seventh too little."""

CLOSE = 1.0
"""A lamp is close to a surface within this many times the entry's size there."""


@dataclass(frozen=True)
class Expected:
    """Of a bake, relative RMSEs. target: asked for. error: measured, of the lamps that it was tried with. Of that, grows: what
    contrast makes larger, and still: what neither that nor the sketch knows of. seen: part of what the sketch misses that
    shows on blocks of texels. contrast: of these lamps (`concentration`), 0 where the bake is too old to know."""

    target: float = 1.0
    error: float = 0.0
    grows: float = 0.0
    still: float = 0.0
    seen: float = 1.0
    contrast: float = 0.0

    @property
    def limit(self) -> float:
        """The error from which on the user must know: more than was asked for, and than the bake has said it has anyway."""
        return self.target if self.error <= self.target else MARGIN * self.error


def expected_of(report: Mapping) -> Expected:
    """From a bake's report."""
    error, parts = report.get("error") or 0.0, report.get("error_parts", {})
    known = report.get("concentration") or {}
    if not isinstance(known, Mapping):
        known = {}
    # parts are measured one by one, and need not sum up to the whole
    grows = min(float(np.sqrt(sum(part**2 for name, part in parts.items() if name != "panes"))), error)
    left, missed = float(np.sqrt(error**2 - grows**2)), known.get("missed", 0.0)
    still = float(np.sqrt(max(left**2 - missed**2, 0.0)))
    seen = min(max(left / missed, KEPT), 1.0) if missed > 0 else 1.0
    return Expected(report.get("error_target", 1.0), error, grows, still, seen, known.get("contrast", 0.0))


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
        """Whether the user must know (`Expected.limit`)."""
        return self.error is not None and self.error > expected.limit


def trust(relighter: Relighter, lights: Sequence[Light], expected: Expected) -> Trust:
    """Of the lamps that `relighter` has just been asked for (`Relighter.light`)."""
    lamps = [(light, known) for light in lights if light.live and (known := relighter.known(light)) is not None]
    shining = [(light, known) for light, known in lamps if light.power.any()]
    nowhere = tuple(light for light, known in shining if not known.unit.any())
    if any(known.sketch is None for _, known in shining) or not expected.contrast:
        return Trust(None, None, None, False, nowhere)
    level = relighter.mean(sum(known.weights for _, known in shining)) if shining else 0.0
    if level <= 0:
        return Trust(0.0, 0.0, None, False, nowhere)

    missed, sent = rms(sum(known.sketch for _, known in shining)) / level
    missed *= expected.seen
    # what a bake is tried with is no easier than other light
    grown = expected.grows * max(contrast(sent) / expected.contrast, 1.0)
    uneven = np.sqrt(sum(_uneven(one) ** 2 for one in shining)) / level
    error = float(np.sqrt(missed**2 + grown**2 + uneven**2 + expected.still**2))

    def share(one):
        """What a lamp adds."""
        missed, sent = rms(one[1].sketch) / level
        return np.sqrt(
            (expected.seen * missed) ** 2
            + (expected.grows * sent / expected.contrast) ** 2
            + (_uneven(one) / level) ** 2
        )

    worst = max(shining, key=share)[0]
    return Trust(error, float(missed), worst, _is_close(relighter, worst), nowhere)


def _uneven(one):
    """W/m²: RMS over RGB of what is wrong because entries shine evenly, under a lamp of which that is known."""
    light, known = one
    return UNEVEN * float(np.sqrt(np.mean((known.uneven * light.power) ** 2)))


def contrast(sent: float) -> float:
    """Of light with an RMS of `sent`, over the mean irradiance that it makes, in what entries send out.

    Of a gather's rays each brings what an entry sends out, so their variance is the mean square of it but for that of the
    irradiance, which in a room is about the square of the mean.
    """
    return float(np.sqrt(max(sent**2 - 1, LEAST * sent**2)))


def rms(sketch: np.ndarray) -> np.ndarray:
    """(…,) RMS over area and RGB of what sketches (…, SKETCH, 3) stand for, W/m²."""
    return np.sqrt((sketch**2).sum(axis=(-2, -1)) / 3)


def concentration(weights: PaneWeights, area: np.ndarray, direct: np.ndarray) -> dict[str, float]:
    """Of lamps that light the entries with `direct` (n, 3 s), three of which take red, green and blue, means: "contrast" of
    what entries send out, and "missed", the RMS of what panes leave out over the mean irradiance."""
    level = weights.mean(area)
    found = []
    for s in range(0, direct.shape[1], 3):
        values, sketch = weights.of_and_sketch(np.ascontiguousarray(direct[:, s : s + 3]))
        mean = level @ values
        for c in np.flatnonzero(mean > 0):
            missed, sent = np.sqrt((sketch[:, :, c] ** 2).sum(axis=1)) / mean[c]
            found.append((contrast(sent), missed))
    # mean squares, as errors add up
    means = np.sqrt(np.mean(np.square(found), axis=0)) if found else (0.0, 0.0)
    return {"contrast": float(means[0]), "missed": float(means[1])}


def _is_close(relighter, light):
    if light.kind == "SUN":
        return False
    surface = relighter.panes.surface
    # a place of each: one a row of `size`
    away = surface.position[:: len(surface.position) // max(len(surface), 1)] - light.position.astype(np.float32)
    return bool((np.einsum("nd,nd->n", away, away) < (CLOSE * surface.size) ** 2).any())
