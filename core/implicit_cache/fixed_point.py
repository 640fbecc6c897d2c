"""World coordinates as fixed-point words, and the hash of three of them (Delaere 2021, section 3.1).

A word is sign | integer | fraction, in units of the coarsest voxel; the fraction has a bit for each level. 32 bits are
the thesis's; 64 reach as far as anyone goes.
"""

from __future__ import annotations

import numpy as np


def voxel_words(voxel: np.ndarray, level: np.ndarray | int, levels: int, bits: int = 32) -> np.ndarray:
    """Words of the middle of voxels: (…) uint32, or uint64 with 64 bits, of one coordinate of them.

    voxel: (…) int64, counted in voxels of its level from the origin. level: 0 is the coarsest; below `levels`.
    Raises ValueError where a word has too few bits, so that far places would repeat near ones.
    """
    # a voxel's middle is an odd multiple of half of it, so no two levels share a word
    value = (2 * voxel + 1) << np.asarray(levels - 1 - np.asarray(level), np.int64)
    size = np.abs(value)
    if bits == 32 and size.size and int(size.max()) >= 1 << 31:
        raise ValueError(
            f"A place lies beyond the {1 << (31 - levels)} coarsest voxels that 32-bit words with {levels} levels reach; "
            "use 64-bit words, fewer levels or a larger coarsest voxel."
        )
    word = np.uint32 if bits == 32 else np.uint64
    return size.astype(word) | (value < 0).astype(word) << word(bits - 1)


def pcg(state: np.ndarray) -> np.ndarray:
    """uint32 of uint32: a permuted congruential generator as a hash (O'Neill 2014; Jarzynski and Olano 2020)."""
    state = state * np.uint32(747796405)
    state += np.uint32(2891336453)
    word = state >> ((state >> np.uint32(28)) + np.uint32(4))
    word ^= state
    word *= np.uint32(277803737)
    word ^= word >> np.uint32(22)
    return word


def nest(words: np.ndarray, inner: np.ndarray | int = 0) -> np.ndarray:
    """uint32: one more coordinate around the hash of those before. The nested hash is nest(x, nest(y, nest(z)))."""
    inner = np.asarray(inner, np.uint32)
    if words.dtype == np.uint64:
        inner = pcg((words >> np.uint64(32)).astype(np.uint32) + inner)
    return pcg(words.astype(np.uint32) + inner)
