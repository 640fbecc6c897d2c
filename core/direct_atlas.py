"""The lamps' direct light over the atlas: in full, or quickly from a quarter of the texels while a lamp is dragged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .panes.exits import STEPS, joined
from .penumbra import DirectLight, Receivers
from .rays import Tracer
from .scene import Light, Scene
from .surface import Texels, make_texels

COARSE_SAMPLES = 16
"""Samples of a lamp in a coarse image, at most: what its four sets make of them is smooth enough for a moment."""


class DirectAtlas:
    """Direct irradiance of lamps at the texels of a scene. Only lamps that changed are cast again.

    own: (resolution²,) bool, texels that may show light of their own, not those inside things, or None for all.
    tracer: of the scene. samples: of a lamp for which none are named. Raises SceneError where nothing has a place in the
    atlas.
    """

    def __init__(
        self,
        scene: Scene,
        resolution: int,
        tracer: Tracer,
        own: np.ndarray | None = None,
        samples: int = 64,
        seed: int = 0,
    ):
        texels = make_texels(scene, resolution)
        if own is not None and own[texels.index].any():
            texels = texels.keep(np.flatnonzero(own[texels.index]))
        self.resolution = resolution
        self._fill = texels.fill()
        self._full = DirectLight(_receivers(texels, tracer, 1), tracer, samples, seed)
        leader = _leaders(texels)
        some, self._leader = np.unique(leader, return_inverse=True)
        # on the grid of every other texel neighbours take their sets in turns again
        quarter = _receivers(texels.keep(some), tracer, 2)
        # one thread leaves the others to whatever else follows the lamp
        self._few = DirectLight(quarter, tracer.alone(), samples, seed, threads=1)

    @property
    def texels(self) -> int:
        """How many are lit."""
        return len(self._full.receivers)

    def image(self, lights: Sequence[Light], samples: Mapping[str, int] | None = None) -> np.ndarray:
        """(resolution, resolution, 3) float32 direct irradiance, W/m², black where there is no surface.

        samples: of some lamps, by name.
        """
        return self._image(self._full.irradiance(lights, samples))

    def coarse(self, lights: Sequence[Light], samples: Mapping[str, int] | None = None) -> np.ndarray:
        """The same, where lamps that changed since the last `image` count by a quarter of the texels and few samples."""
        held = [self._full.known(light, samples) for light in lights]
        moved = [light for light, known in zip(lights, held, strict=True) if known is None]
        few = {light.name: min(COARSE_SAMPLES, (samples or {}).get(light.name, self._few.samples)) for light in moved}
        total = self._few.irradiance(moved, few)[self._leader]
        for known in held:
            if known is not None:
                total += known
        return self._image(total)

    def _image(self, light):
        shown = np.concatenate([light, np.zeros((1, 3), np.float32)])[self._fill]
        return shown.reshape(self.resolution, self.resolution, 3)


def _receivers(texels: Texels, tracer: Tracer, step: int) -> Receivers:
    """The texels as receivers; each 2 × 2 of those that are `step` apart look at four sets of samples."""
    samples = texels.samples
    row, column = texels.index // (texels.resolution * step), texels.index % texels.resolution // step
    group = (2 * (row & 1) + (column & 1)).astype(np.uint8)
    return Receivers(samples.position + samples.flat * np.float32(tracer.offset), samples.normal, group)


def _leaders(texels: Texels) -> np.ndarray:
    """(t,) int row of the texel that stands for each in a coarse image: of each 2 × 2 the first, where it lies on the
    same smooth surface, else the texel itself."""
    size, index = texels.resolution, texels.index
    row = np.full(size * size, -1, np.int64)
    row[index] = np.arange(len(texels))
    odd_row, odd_column = index // size & 1, index % size & 1
    first = row[index - odd_row * size - odd_column]
    place = {step: k for k, step in enumerate(STEPS)}
    beside = joined(texels)
    same = np.zeros(len(texels), bool)
    for dy, dx in ((0, 1), (1, 0), (1, 1)):
        same |= (odd_row == dy) & (odd_column == dx) & beside[:, place[-dy, -dx]]
    return np.where(same & (first >= 0), first, np.arange(len(texels)))
