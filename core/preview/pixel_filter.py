"""Where in a pixel the frames look, one after another: places that together are the pixel's filter."""

from __future__ import annotations

import numpy as np

from ..sampling import r2_points

_TERMS = (0.35875, -0.48829, 0.14128, -0.01168)


def blackman_harris(at: np.ndarray, width: float) -> np.ndarray:
    """Weight of a filter of `width` pixels at distances from its middle, as Cycles has it; not normalised."""
    phase = 2 * np.pi * (np.asarray(at) / width + 0.5)
    value = sum(term * np.cos(k * phase) for k, term in enumerate(_TERMS))
    return np.where(np.abs(at) <= width / 2, value, 0.0)


def offsets(count: int, width: float, seed: int = 0) -> np.ndarray:
    """(count, 2) places in a pixel, (0.5, 0.5) its middle, which is the first; spread as the filter weighs.

    Any number of them from the start is spread well.
    """
    grid = np.linspace(-width / 2, width / 2, 1025)
    upto = np.cumsum(blackman_harris((grid[1:] + grid[:-1]) / 2, width))
    upto = np.append(0, upto / upto[-1])
    points = r2_points(count, seed).astype(np.float64)
    # begin in the middle
    points = (points - points[:1] + 0.5) % 1.0
    return np.interp(points, upto, grid) + 0.5
