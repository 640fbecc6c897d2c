"""Caustics within a bake: lamp after lamp, so that progress shows and a cancel is heard, in no more than the time there is."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from ..caustics import CausticAtlas
from ..scene import Light

FEWEST = 5_000
"""Photons of a lamp that a time budget leaves at least."""

now = time.perf_counter


def trace_lamps(
    atlas: CausticAtlas,
    lights: Sequence[Light],
    photons: int,
    tell: Callable[[float], object],
    seconds: float = math.inf,
) -> int:
    """Trace the lamps' photons into the atlas, which then has their images and landings. Returns how many of each lamp.

    photons: of each lamp, fewer where so many take longer than `seconds`, down to FEWEST. tell: called every few thousand
    photons with the part in [0, 1] that is done, which never falls; an exception that it raises ends the work.
    """
    tell(0.0)
    least, after = min(photons, FEWEST), 0.0
    if math.isfinite(seconds):
        # as many as fit by what a few of each took, which are thrown away where more are traced
        began, after = now(), 0.2 if photons > least else 1.0
        _refine(atlas, lights, least, lambda part: tell(after * part))
        took = max(now() - began, 1e-6)
        photons = min(photons, int(least * (seconds - took) / took) // 100 * 100)
    if photons > least or not after:
        _refine(atlas, lights, photons, lambda part: tell(after + (1 - after) * part))
    tell(1.0)
    return max(photons, least)


def _refine(atlas, lights, photons, tell):
    for k in range(len(lights)):
        # with those before it, which keep what they have
        for step in atlas.refine(lights[: k + 1], photons):
            tell((k + step.done) / len(lights))
