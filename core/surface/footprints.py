"""Places within texels: light that varies within a texel is known by its mean, which a place in the middle misses."""

from __future__ import annotations

import numpy as np

from ..scene import Scene
from .samples import SurfaceSamples
from .texels import Texels, make_texels

ALIKE = 0.9
"""Least cosine between the normals of a texel and of its places: what lies across an edge is another surface."""


def texel_places(scene: Scene, texels: Texels, side: int) -> tuple[SurfaceSamples, np.ndarray, np.ndarray]:
    """A regular grid of side × side places within each texel: those on the texel's own object that face alike.

    A texel without any has one, its own sample. Returns the samples, texel by texel; (n,) int64 row of each one's texel;
    and (n,) uint8 which place of the grid it is, in [0, side²).
    """
    if side == 1:
        return texels.samples, np.arange(len(texels)), np.zeros(len(texels), np.uint8)
    size = texels.resolution
    fine = make_texels(scene, side * size)
    row, column = np.divmod(fine.index.astype(np.int64), side * size)
    at = np.full(size * size, -1, np.int64)
    at[texels.index] = np.arange(len(texels))
    owner = at[row // side * size + column // side]
    place = (row % side * side + column % side).astype(np.uint8)
    # the row −1 of a texel that is not asked for does no harm
    own, found = texels.samples, fine.samples
    thing = scene.triangle_object
    alike = np.einsum("nd,nd->n", own.normal[owner], found.normal) > ALIKE
    keep = np.flatnonzero((owner >= 0) & fine.centred & alike & (thing[own.triangle[owner]] == thing[found.triangle]))
    alone = np.ones(len(texels), bool)
    alone[owner[keep]] = False
    alone = np.flatnonzero(alone)
    samples = found.take(keep).join(own.take(alone))
    owner, place = np.append(owner[keep], alone), np.append(place[keep], np.zeros(len(alone), np.uint8))
    order = np.argsort(owner, kind="stable")
    return samples.take(order), owner[order], place[order]
