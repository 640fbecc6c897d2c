"""Levels: cells of 2^level metres, chosen so that a cell spans so many pixels wherever a surface is."""

from __future__ import annotations

import numpy as np

COARSEST, FINEST = 60, -60
"""Bounds of levels, so that footprints of nothing or of infinity still have one."""


def levels_of(size: np.ndarray) -> np.ndarray:
    """(n,) int32 levels whose cells are nearest to the wanted size, m, by ratio."""
    with np.errstate(divide="ignore", invalid="ignore"):
        exact = np.rint(np.log2(size, dtype=np.float32))
    return np.clip(np.nan_to_num(exact, nan=0.0), FINEST, COARSEST).astype(np.int32)


def cell_size(level: np.ndarray) -> np.ndarray:
    """float32 edge of a level's cells, m."""
    return np.ldexp(np.float32(1), level).astype(np.float32)
