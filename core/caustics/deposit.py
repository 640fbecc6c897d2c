"""From patches of photons to power at texels."""

from __future__ import annotations

import numpy as np

from .quadtree import Forest, kinds_of
from .receivers import Receivers
from .splat import box_samples, splat

_QUADS = np.array([[0, 1, 3, 4], [1, 2, 4, 5], [3, 4, 6, 7], [4, 5, 7, 8]])
# the nine vertices of a bilinear quad, from its four
_BILINEAR = np.array(
    [[(2 - i) * (2 - j), (2 - i) * j, i * (2 - j), i * j] for i in range(3) for j in range(3)], np.float32
) / np.float32(4)


def deposit(forest: Forest, rows: np.ndarray, receivers: Receivers, threads: int | None = None) -> np.ndarray:
    """(resolution², c) float64 W that the patches at `rows` bring to each texel.

    Patches of one way are whole beams. Of the others, quads whose four photons agree are, and the remaining photons
    count as points: they are many and small.
    """
    photons = forest.photons
    corner, measure = forest.corner[rows], forest.measure[rows].astype(np.float32)
    values = np.concatenate([photons.place, photons.power], axis=1)
    beams, divided = kinds_of(photons.signature[corner])
    patches = values[corner[beams].T]
    patches[:, :, 2:] *= measure[beams][None, :, None]
    chart = photons.chart[corner[beams, 4]]
    quads = corner[divided][:, _QUADS].reshape(-1, 4)
    share = np.repeat(measure[divided] / 4, 4)
    alike, partly = kinds_of(photons.signature[quads])
    if alike.any():
        parts = np.tensordot(_BILINEAR, values[quads[alike].T], axes=1)
        parts[:, :, 2:] *= share[alike][None, :, None]
        patches = np.concatenate([patches, parts], axis=1)
        chart = np.concatenate([chart, photons.chart[quads[alike, 0]]])
    total = splat(patches, chart, receivers, threads)
    if partly.any():
        points = quads[partly].ravel()
        lands = photons.signature[points] & 1 == 1
        lands &= photons.signature[points] > 0
        power = np.repeat(share[partly] / 4, 4)[lands]
        points = points[lands]
        x, y = photons.place[points].T
        box = np.ones(len(points), np.float32)
        box_samples(total, x, y, box, box, (photons.power[points] * power[:, None]).T, receivers.resolution)
    return total
