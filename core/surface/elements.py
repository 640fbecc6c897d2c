"""Cut patches into elements: smaller pieces of the same surface, each within one patch.

After the substructuring of Cohen et al. 1986 (An Efficient Radiosity Approach for Realistic Image Synthesis): what
passes light on may be finer than what light is balanced between.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..sampling import hash_uniform
from ..scene import Scene
from .patches import Patches, fit_size, summarise


def cut_patches(scene: Scene, patches: Patches, count: int, seed: int = 0) -> tuple[Patches, Patches, np.ndarray]:
    """About `count` elements, as patches of their own on smaller pieces; `patches` on these same pieces; and (n,) int32
    the patch that each element is part of, in order.

    There are no fewer elements than patches, and no more than pieces: small triangles are grouped, never merged over
    patches' borders.
    """

    def group(pieces, size):
        corners, parent, _ = pieces
        centre = corners.mean(axis=1)
        shift = hash_uniform(np.arange(3), 10, seed).astype(np.float32)
        cell = np.floor((centre - centre.min(axis=0)) / np.float32(size) + shift).astype(np.int64)
        span = cell.max(axis=0) + 1
        _, cell = np.unique((cell[:, 0] * span[1] + cell[:, 1]) * span[2] + cell[:, 2], return_inverse=True)
        key = patches.patch[parent].astype(np.int64) * (int(cell.max()) + 1) + cell.reshape(-1)
        names, element = np.unique(key, return_inverse=True)
        return pieces, element.reshape(-1).astype(np.int32), len(names)

    size = float(np.sqrt(patches.area.sum() / max(count, 1)))
    _, (corners, piece, weights), element, found = fit_size(patches.corners, size, count, group)
    weights = np.einsum("pkc,pcd->pkd", weights, patches.weights[piece])
    elements = summarise(scene, patches.parent, (corners, piece, weights), element, found)
    owner = np.empty(found, np.int32)
    owner[element] = patches.patch[piece]
    same = replace(
        patches,
        corners=corners,
        parent=elements.parent,
        weights=weights,
        piece_area=elements.piece_area,
        patch=patches.patch[piece],
    )
    return elements, same, owner
