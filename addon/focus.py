"""What caustics bring to the entries of a bake, from where it bounces on."""

from __future__ import annotations

import numpy as np

from ..core.caustics import Landings
from ..core.panes.caustic_light import CausticLight
from ..core.panes.entry_light import EntrySurface
from ..core.scene import Light
from .caustics import Landed


class Focus:
    """What caustics bring to the entries of a bake.

    surface: of its panes. offset: m, the tracer's.
    """

    def __init__(self, surface: EntrySurface, offset: float):
        self._landings: dict[tuple, Landings] = {}
        self._light = CausticLight(surface, lambda light: self._landings[light.geometry], offset)
        self._held: dict[tuple, np.ndarray] = {}
        self._former: dict[str, np.ndarray] = {}

    def take(self, landed: Landed) -> None:
        """Know where the light of lamps falls now; those of which that is known already cost nothing."""
        former, self._landings, held = self._landings, {}, {}
        for light, landings in landed.landings:
            place = light.geometry
            self._landings[place] = landings
            if place in self._held and _alike(former[place], landings):
                held[place] = self._held[place]
            else:
                held[place] = self._light.unit(light)
        self._held = held
        self._former = {light.name: held[light.geometry] for light, _ in landed.landings}

    def of(self, light: Light) -> np.ndarray | None:
        """(n, 3) float32 irradiance at unit power. While a lamp is dragged that of where it was, until more is known."""
        return self._held.get(light.geometry, self._former.get(light.name))


def _alike(first: Landings, second: Landings) -> bool:
    return all(np.array_equal(getattr(first, k), getattr(second, k)) for k in ("power", "position", "normal"))
