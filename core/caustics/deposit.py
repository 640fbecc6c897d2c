"""From patches of photons to power at texels."""

from __future__ import annotations

import numpy as np

from .quadtree import Forest, kinds_of
from .receivers import Receivers
from .splat import splat

_QUADS = np.array([[0, 1, 3, 4], [1, 2, 4, 5], [3, 4, 6, 7], [4, 5, 7, 8]])
# the nine vertices of a bilinear quad, from its four
_BILINEAR = np.array(
    [[(2 - i) * (2 - j), (2 - i) * j, i * (2 - j), i * j] for i in range(3) for j in range(3)], np.float32
) / np.float32(4)


LONE = 3.0
"""Texels that a photon is spread over, in each direction, at most, when nothing says how wide its beam is."""

_AHEAD = np.array([[3, 3, -3, -3], [1, -1, 1, -1]])
"""From each corner of a quad to the one ahead of it along both sides, in the patch's numbering."""


def deposit(
    forest: Forest, rows: np.ndarray, receivers: Receivers, samples: float, threads: int | None = None
) -> np.ndarray:
    """(resolution², c) float64 W that the patches at `rows` bring to each texel.

    Patches of one way are whole beams. Of the others, quads whose four photons agree are; in the rest each photon stands
    for the quarter of the quad next to it, as wide as neighbours that went the same way say. samples: for each texel, about (see splat).
    """
    photons = forest.photons
    corner, measure = forest.corner[rows], forest.measure[rows].astype(np.float32)
    values = np.concatenate([photons.place, photons.power], axis=1)
    beams, divided = kinds_of(photons.signature[corner])
    patches = values[corner[beams].T]
    patches[:, :, 2:] *= measure[beams][None, :, None]
    chart = photons.chart[corner[beams, 4]]
    mixed, whole_ones = corner[divided], patches.shape[1]
    if len(mixed):
        quads = mixed[:, _QUADS]
        alike, partly = (k.reshape(-1, 4) for k in kinds_of(photons.signature[quads].reshape(-1, 4)))
        share = measure[divided] / 4
        patch, quad = np.nonzero(alike)
        whole = values[quads[patch, quad].T]
        whole[:, :, 2:] *= share[patch][None, :, None]
        patch, quad = np.nonzero(partly)
        cells, middle = _quarters(photons, values, mixed[patch], quad, share[patch] / 4)
        parts = np.tensordot(_BILINEAR, np.concatenate([whole, cells], axis=1), axes=1)
        patches = np.concatenate([patches, parts], axis=1)
        chart = np.concatenate([chart, photons.chart[quads[alike][:, 0]], photons.chart[middle]])
    rough = np.arange(patches.shape[1]) >= whole_ones
    return splat(patches, chart, rough, receivers, samples, threads)


def _quarters(photons, values, corner, quad, share):
    """(4, m, 2 + c) corners of the quarters that photons of quads stand for, and (m,) rows of those photons.

    corner: (n, 9) of patches, quad: (n,) which of its four. share: (n,) float32 part of the square of a quarter.
    """
    found, middles = [], []
    for k in range(4):
        at = _QUADS[quad, k]
        here = corner[np.arange(len(corner)), at]
        signature = photons.signature[here]
        lands = (signature > 0) & (signature & 1 == 1)
        if not lands.any():
            continue
        at, here, own, mine = at[lands], here[lands], corner[lands], signature[lands]
        rows = np.arange(len(at))
        half = []
        for ahead in _AHEAD[:, k]:
            other = own[rows, at + ahead]
            inside = photons.signature[other] == mine
            step = np.where(inside[:, None], photons.place[other] - photons.place[here], 0)
            # none there: as far as from the neighbour behind, where there is one
            behind = at - ahead
            exists = (behind >= 0) & (behind < 9)
            if abs(ahead) == 1:
                exists &= np.clip(behind, 0, 8) // 3 == at // 3
            other = own[rows, np.clip(behind, 0, 8)]
            use = ~inside & exists & (photons.signature[other] == mine)
            step = np.where(use[:, None], photons.place[here] - photons.place[other], step)
            half.append(step * np.float32(0.5))
        # a photon all of whose neighbours went elsewhere: as wide as others, so that it is no speck
        alone = ~(half[0].any(axis=1) | half[1].any(axis=1))
        if alone.any() and not alone.all():
            wide = np.median(np.abs(np.concatenate(half)[np.tile(~alone, 2)]).max(axis=1))
            for axis in (0, 1):
                half[axis][alone, axis] = np.sign(_AHEAD[axis, k]) * min(wide, LONE)
        cell = np.repeat(values[here][None], 4, axis=0)
        cell[:, :, 2:] *= share[lands][None, :, None]
        cell[1, :, :2] += half[1]
        cell[2, :, :2] += half[0]
        cell[3, :, :2] += half[0] + half[1]
        found.append(cell)
        middles.append(here)
    if not found:
        return np.zeros((4, 0, values.shape[1]), np.float32), np.zeros(0, np.int64)
    return np.concatenate(found, axis=1), np.concatenate(middles)
