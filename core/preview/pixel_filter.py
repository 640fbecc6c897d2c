"""Where in a pixel the frames look, one after another: places that together are the pixel's filter."""

from __future__ import annotations

import numpy as np

from ..sampling import r2_points

_TERMS = (0.35875, -0.48829, 0.14128, -0.01168)


def blackman_harris(at: np.ndarray, width: float) -> np.ndarray:
    """Weight at distances from a pixel's middle, px; not normalised. Cycles' filter of this width reaches that far."""
    phase = np.pi * (np.asarray(at) / width + 1)
    value = sum(term * np.cos(k * phase) for k, term in enumerate(_TERMS))
    return np.where(np.abs(at) <= width, value, 0.0)


def offsets(count: int, width: float, seed: int = 0) -> np.ndarray:
    """(count, 2) places in a pixel, (0.5, 0.5) its middle, which is the first; spread as the filter weighs.

    Any number of them from the start is spread well.
    """
    grid = np.linspace(-width, width, 1025)
    upto = np.cumsum(blackman_harris((grid[1:] + grid[:-1]) / 2, width))
    upto = np.append(0, upto / upto[-1])
    # in pairs about the middle, or few of them would shift the image
    points = r2_points(count // 2 + 1, seed).astype(np.float64)
    away = np.interp((points - points[:1] + 0.5) % 1.0, upto, grid)
    pairs = np.stack([away[1:], -away[1:]], axis=1).reshape(-1, 2)
    return np.concatenate([away[:1], pairs])[:count] + 0.5
