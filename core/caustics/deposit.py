"""From patches of photons to power at texels."""

from __future__ import annotations

import numpy as np

from .borders import QUADS, pieces
from .quadtree import LEVELS, Forest, kinds_of
from .receivers import Receivers
from .softness import Softness
from .splat import splat

# the nine vertices of a bilinear quad, from its four
_BILINEAR = np.array(
    [[(2 - i) * (2 - j), (2 - i) * j, i * (2 - j), i * j] for i in range(3) for j in range(3)], np.float32
) / np.float32(4)


def deposit(
    forest: Forest,
    rows: np.ndarray,
    receivers: Receivers,
    samples: float,
    soft: Softness | None = None,
) -> np.ndarray:
    """(resolution², c) float64 W that the patches at `rows` bring to each texel.

    Patches of one way are whole beams. Of the others, quads whose four photons agree are; the rest is cut along the
    borders between ways (see borders). samples: for each texel, about (see splat). soft: what each point of the lamp stands
    for, None where each patch is for a point alone.
    """
    photons = forest.photons
    corner, measure = forest.corner[rows], forest.measure[rows].astype(np.float32)
    parts = [photons.place, photons.power] if soft is None else [photons.place, soft.slope, photons.power]
    values, lead = np.concatenate(parts, axis=1), 2 if soft is None else 6
    beams, divided = kinds_of(photons.signature[corner])
    patches = values[corner[beams].T]
    patches[:, :, lead:] *= measure[beams][None, :, None]
    start = corner[beams, 4]
    mixed, whole_ones = corner[divided], patches.shape[1]
    if len(mixed):
        quads = mixed[:, QUADS]
        alike, partly = (k.reshape(-1, 4) for k in kinds_of(photons.signature[quads].reshape(-1, 4)))
        share = measure[divided] / 4
        patch, quad = np.nonzero(alike)
        whole = values[quads[patch, quad].T]
        whole[:, :, lead:] *= share[patch][None, :, None]
        patch, quad = np.nonzero(partly)
        sharp = forest.level[rows][divided][patch] < LEVELS
        cut, first = pieces(forest, values, quads[patch, quad], share[patch], sharp, lead)
        parts = np.tensordot(_BILINEAR, np.concatenate([whole, cut], axis=1), axes=1)
        patches = np.concatenate([patches, parts], axis=1)
        start = np.concatenate([start, quads[alike][:, 0], first])
    rough = np.arange(patches.shape[1]) >= whole_ones
    cells = None if soft is None else (soft.cell[forest.places()[0][start]], soft.offset)
    return splat(patches, photons.chart[start], rough, receivers, samples, cells)
