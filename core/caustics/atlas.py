"""The lamps' caustics over the atlas, from coarse to fine while a lamp is dragged."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..scene import Light, Scene, SceneError
from .casters import casters
from .lamp import Energy, LampCaustics
from .landings import Landings
from .receivers import Receivers
from .surfaces import Surfaces

PHOTONS = 40_000
"""Of a lamp, where no number is named."""


@dataclass(frozen=True)
class Progress:
    """A picture on the way. level: steps so far. photons: used so far by the lamps that changed. done: part in [0, 1]."""

    level: int
    photons: int
    done: float
    _atlas: CausticAtlas = field(repr=False)
    _lights: tuple = field(repr=False)

    @property
    def image(self) -> np.ndarray:
        """(resolution, resolution, 4) float32 W/m² as it stands, alpha 1. Made when asked for."""
        return self._atlas._image(self._lights)


class CausticAtlas:
    """Irradiance at the texels of a scene by light that mirrors and glass focus there. Only lamps that changed cost.

    own: (resolution²,) bool, texels that may show light of their own, not those inside things, or None for all. seed:
    same seed, same picture, on one thread or many. threads: None for all. Raises SceneError where nothing has a place in
    the atlas or nothing casts caustics (`casters`).
    """

    def __init__(
        self,
        scene: Scene,
        resolution: int,
        own: np.ndarray | None = None,
        seed: int = 0,
        threads: int | None = None,
    ):
        found = casters(scene)
        if found is None:
            raise SceneError(
                "Nothing here mirrors or refracts sharply, so there are no caustics; give a material glass or metal with a low roughness."
            )
        self.resolution, self._seed, self._threads = resolution, seed, threads
        self.casters = found
        self._receivers = Receivers(scene, resolution, own)
        self._surfaces = Surfaces(scene, found)
        self._lamps: dict[tuple, LampCaustics] = {}

    def refine(self, lights: Sequence[Light], photons: int = PHOTONS) -> Iterator[Progress]:
        """Pictures from coarse to fine; stop iterating to cancel. photons: of each lamp. Lamps that did not change since
        the last call keep what they have; a call that was cancelled goes on from where it stopped.

        Yields once at least, at the end the finest picture.
        """
        lights = tuple(lights)
        held = {}
        for light in lights:
            known = self._lamps.get(light.geometry)
            if known is None or known.photons < photons:
                known = LampCaustics(light, self._surfaces, self._receivers, photons, self._seed, self._threads)
            held[light.geometry] = known
        self._lamps = held
        changed = [lamp for lamp in held.values() if not lamp.done]
        level = 0
        while True:
            for lamp in changed:
                lamp.advance()
            level += 1
            used = sum(lamp.used for lamp in changed)
            if all(lamp.done for lamp in changed):
                yield Progress(level, used, 1.0, self, lights)
                return
            yield Progress(level, used, min(used / (photons * len(changed)), 1.0), self, lights)

    def image(self, lights: Sequence[Light], photons: int = PHOTONS) -> np.ndarray:
        """(resolution, resolution, 4) float32 irradiance, W/m², alpha 1, at its finest; black where there is none."""
        for step in self.refine(lights, photons):
            last = step
        return last.image

    def energy(self, light: Light) -> Energy:
        """Where a lamp's light went, as of the last picture with it; makes one where there is none."""
        return self._lamp(light).energy()

    def landings(self, light: Light) -> Landings:
        """Where light that casters sent on first met other surfaces, as of the last picture with the lamp; makes one where
        there is none. Includes surfaces without a place in the atlas."""
        return self._lamp(light).landings()

    def _lamp(self, light):
        if light.geometry not in self._lamps:
            self.image([light])
        return self._lamps[light.geometry]

    def _image(self, lights):
        total = np.zeros((self.resolution**2, 4), np.float32)
        total[:, 3] = 1
        for light in lights:
            lamp = self._lamps.get(light.geometry)
            if lamp is not None:
                total[:, :3] += lamp.irradiance() * light.power.astype(np.float32)
        return total.reshape(self.resolution, self.resolution, 4)
