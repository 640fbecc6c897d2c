"""The lamps' direct light over the atlas: in full, or quickly from a part of the texels while a lamp is dragged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from .panes.exits import STEPS, joined
from .penumbra import DirectLight, Receivers
from .rays import Tracer
from .scene import Light, Scene
from .surface import SurfaceSamples, Texels, make_texels, texel_places

COARSE_SAMPLES = 16
"""Samples of a lamp in a coarse image, at most: what its four sets make of them is smooth enough for a moment."""

COARSE_TEXELS = 16_384
"""Texels of a coarse image, about: as many as can be cast some ten times a second."""

PLACES = 2
"""Places along each side of a texel whose mean it shows: shadows of bars and bumps narrower than a texel come out as even
grey, and not as a pattern of their own, as they do from the texels' middles."""

MOST_PLACES = 1 << 22
"""Receivers in memory, some hundred bytes each; texels of finer atlases are lit at their middles."""

MOST_HALVINGS = 4
"""A texel of a coarse image stands for a square of at most 16 × 16."""


class DirectAtlas:
    """Direct irradiance of lamps at the texels of a scene. Only lamps that changed are cast again.

    A texel shows the mean over some places within it. own: (resolution²,) bool, texels that may show light of their own, not those inside things, or None for all.
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
        fill = texels.fill()
        self._fill = np.where(fill < 0, len(texels), fill)
        self.texels = len(texels)
        """How many are lit."""
        side = PLACES if PLACES**2 * len(texels) <= MOST_PLACES else 1
        places, owner, place = texel_places(scene, texels, side)
        group = place if side > 1 else _groups(texels, 1)
        self._full = DirectLight(_receivers(places, group, tracer), tracer, samples, seed, shared=side * side)
        self._count = np.bincount(owner, minlength=len(texels)).astype(np.float32)
        self._first = np.searchsorted(owner, np.arange(len(texels)))
        leader, step = _coarse_leaders(texels)
        some, leader = np.unique(leader, return_inverse=True)
        # past the last row is black
        self._leader = np.append(leader, len(some))[self._fill]
        # on the grid that is left neighbours take their sets in turns again
        part = texels.keep(some)
        part = _receivers(part.samples, _groups(part, step), tracer)
        # one thread leaves the others to whatever else follows the lamp
        self._few = DirectLight(part, tracer.alone(), samples, seed, threads=1)

    def image(self, lights: Sequence[Light], samples: Mapping[str, int] | None = None) -> np.ndarray:
        """(resolution, resolution, 4) float32 direct irradiance, W/m², alpha 1; black where there is no surface.

        samples: of some lamps, by name.
        """
        return self._image(self._means(self._full.irradiance(lights, samples)), self._fill)

    def coarse(self, lights: Sequence[Light], samples: Mapping[str, int] | None = None) -> np.ndarray:
        """The same, where lamps that changed since the last `image` count by a part of the texels and few samples."""
        held = [self._full.known(light, samples) for light in lights]
        moved = [light for light, known in zip(lights, held, strict=True) if known is None]
        few = {light.name: min(COARSE_SAMPLES, (samples or {}).get(light.name, self._few.samples)) for light in moved}
        image = self._image(self._few.irradiance(moved, few), self._leader)
        still = [known for known in held if known is not None]
        if still:
            image[..., :3] += self._image(self._means(sum(still)), self._fill)[..., :3]
        return image

    def _means(self, light):
        """(t, 3) float32 of texels, of (n, 3) of their places."""
        if len(light) == self.texels:
            return light
        return np.add.reduceat(light, self._first, axis=0) / self._count[:, None]

    def _image(self, light, rows):
        """light: (n, 3). rows: (resolution²,) of it that each texel shows; the one past its end is black."""
        values = np.ones((len(light) + 1, 4), np.float32)
        values[:-1, :3], values[-1, :3] = light, 0
        # four floats move as one number, which numpy does twice as fast as a row of four
        shown = values.view(np.complex128).reshape(-1).take(rows)
        return shown.view(np.float32).reshape(self.resolution, self.resolution, 4)


def _receivers(samples: SurfaceSamples, group: np.ndarray, tracer: Tracer) -> Receivers:
    return Receivers(samples.position + samples.flat * np.float32(tracer.offset), samples.normal, group)


def _groups(texels: Texels, step: int) -> np.ndarray:
    """(t,) uint8: each 2 × 2 of the texels that are `step` apart look at four sets of samples."""
    row, column = texels.index // (texels.resolution * step), texels.index % texels.resolution // step
    return (2 * (row & 1) + (column & 1)).astype(np.uint8)


def _coarse_leaders(texels: Texels) -> tuple[np.ndarray, int]:
    """(t,) int row of the texel that stands for each in a coarse image, and how far apart such texels are."""
    leader, rows, level, step = np.arange(len(texels)), np.arange(len(texels)), texels, 1
    for _ in range(MOST_HALVINGS):
        own = _leaders(level)
        stands = np.arange(len(texels))
        stands[rows] = rows[own]
        leader, step = stands[leader], 2 * step
        if np.count_nonzero(leader == np.arange(len(texels))) <= COARSE_TEXELS:
            break
        # those on the grid of half the resolution; others stand for themselves from here on
        row, column = level.index // level.resolution, level.index % level.resolution
        even = np.flatnonzero((row % 2 == 0) & (column % 2 == 0))
        size = (level.resolution + 1) // 2
        rows = rows[even]
        level = replace(level.keep(even), index=(row // 2 * size + column // 2)[even], resolution=size)
    return leader, step


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
