"""Light of a soft lamp that spreads over many texels: drawn narrower, and blurred by the rest afterwards.

Samples that are drawn at random over a wide spot make a noisy one. So half of what a beam is spread by is left to a filter
over the texels, of the width that suits it; what is left to chance is then narrower than the filter, and does not show.
"""

from __future__ import annotations

import numpy as np

WIDTHS = np.concatenate([[1.0, 1.1, 1.25, 1.45, 1.7, 2.4], 3.1 * 1.35 ** np.arange(8)])
"""Texels of the filters: boxes, each used twice."""


def _variance(width):
    """Texels², of a box along its axis."""
    whole = np.floor((width - 1) / 2)
    part = (width - 1) / 2 - whole
    return (whole * (whole + 1) * (2 * whole + 1) / 3 + 2 * part * (whole + 1) ** 2) / width


VARIANCE = 2 * _variance(WIDTHS)

REACH = np.ceil(WIDTHS).astype(int) + 1
"""Texels to which the filters may carry light."""

PART = 1 / 12
"""Of the square of a beam's shorter side: the variance of its filter at most. What is narrow beside its spread is one of
many, whose samples are many together, and show the spread's own shape."""

BOX = 1.0
"""Twelve times the variance, texels², up to which what is left is no more than a wider box."""


def softened(slope: np.ndarray, cell: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How beams are spread: (m,) int number of each one's filter; (2, m) twelve times the variance along x and y that is
    left to samples; (m,) factor of the offsets by which these are drawn, 0 where a wider box does.

    slope: (4, m) texels by a step on the unit lamp, x and y for each axis of it. cell: (2, m) variance of what the beam
    stands for along these. lengths: (2, m) texels of its sides.
    """
    x, y = slope[0] ** 2 * cell[0] + slope[2] ** 2 * cell[1], slope[1] ** 2 * cell[0] + slope[3] ** 2 * cell[1]
    both = slope[0] * slope[1] * cell[0] + slope[2] * slope[3] * cell[1]
    mean = (x + y) / 2
    least = mean - np.hypot((x - y) / 2, both)
    most = np.minimum(np.maximum(least, 0), PART * lengths.min(axis=0) ** 2)
    level = np.searchsorted(VARIANCE, most + 1e-9, side="right") - 1
    jitter = np.sqrt(np.maximum(1 - VARIANCE[level] / np.maximum(mean, 1e-12), 0)).astype(np.float32)
    rest = 12 * np.stack([x, y]) * jitter**2
    jitter[rest.max(axis=0) <= BOX] = 0
    return level, rest, jitter


def blurred(image: np.ndarray, width: float) -> np.ndarray:
    """(h, w) float64 after a box of `width` texels twice along each axis; nothing near its edge may be lit."""
    whole = int((width - 1) // 2)
    part = (width - 1) / 2 - whole
    for axis in (0, 0, 1, 1):
        size = image.shape[axis]
        pad = [(whole + 2, whole + 1) if k == axis else (0, 0) for k in (0, 1)]
        sums = np.cumsum(np.pad(image, pad), axis=axis)

        def box(half, sums=sums, axis=axis, size=size):
            low, high = whole + 1 - half, whole + 2 + half
            return (
                sums[(slice(None),) * axis + (slice(high, high + size),)]
                - sums[(slice(None),) * axis + (slice(low, low + size),)]
            )

        image = ((1 - part) * box(whole) + part * box(whole + 1)) / width
    # what the running sum rounds
    return np.maximum(image, 0)
