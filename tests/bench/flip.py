"""How different two pictures look when they are shown in turn on a screen (ꟻLIP: Andersson et al., FLIP: A Difference
Evaluator for Alternating Images, 2020): colours as the eye blurs them, and edges and points as it finds them."""

from __future__ import annotations

import numpy as np

PIXELS_A_DEGREE = 0.7 * 3840 / 0.7 * np.pi / 180
"""Of vision: a screen 0.7 m wide of 3840 pixels, seen from 0.7 m, as in the paper."""

_TO_XYZ = np.array([[10135552, 8788810, 4435075], [2613072, 8788810, 887015], [1425312, 8788810, 70074185]]) / [
    [24577794, 24577794, 24577794], [12288897, 12288897, 12288897], [73733382, 73733382, 73733382]
]  # fmt: skip
# what the eye's contrast sensitivity is made of: two Gaussians for brightness, red-green and blue-yellow
_SENSITIVITY = ((1, 0.0047, 0, 1e-5), (1, 0.0053, 0, 1e-5), (34.1, 0.04, 13.5, 0.025))
_EXPONENT, _FEATURE_EXPONENT = 0.7, 0.5
_LOW, _LOW_SHARE = 0.4, 0.95
_FEATURE_WIDTH = 0.082


def flip(image: np.ndarray, reference: np.ndarray, pixels_a_degree: float = PIXELS_A_DEGREE) -> float:
    """Mean difference in [0, 1] of (H, W) or (H, W, 3) pictures, linear, of which [0, 1] is shown."""
    image, reference = (_opponent(_linear(picture)) for picture in (image, reference))
    colour = _colour_difference(image, reference, pixels_a_degree)
    feature = _feature_difference(image, reference, pixels_a_degree)
    return float((colour ** (1 - feature)).mean())


def _linear(picture):
    picture = np.clip(np.asarray(picture, np.float64), 0, 1)
    return np.repeat(picture[..., None], 3, axis=2) if picture.ndim == 2 else picture


def _xyz(linear):
    """Over the white's, which is that of the primaries."""
    return linear @ (_TO_XYZ / _TO_XYZ.sum(axis=1, keepdims=True)).T


def _opponent(linear):
    """Brightness, red-green and blue-yellow (YCxCz)."""
    x, y, z = np.moveaxis(_xyz(linear), 2, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=2)


def _from_opponent(opponent):
    y = (opponent[..., 0] + 16) / 116
    relative = np.stack([opponent[..., 1] / 500 + y, y, y - opponent[..., 2] / 200], axis=2)
    return relative @ np.linalg.inv(_TO_XYZ / _TO_XYZ.sum(axis=1, keepdims=True)).T


def _lab(linear):
    """CIE L*a*b*, with less colour where it is dark (Hunt's effect)."""
    relative = _xyz(linear)
    edge = 6 / 29
    f = np.where(relative > edge**3, np.cbrt(relative), relative / (3 * edge**2) + 4 / 29)
    bright = 116 * f[..., 1] - 16
    red, blue = 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])
    return np.stack([bright, 0.01 * bright * red, 0.01 * bright * blue], axis=-1)


def _distance(a, b):
    """HyAB, which suits large differences, too."""
    return np.abs(a[..., 0] - b[..., 0]) + np.hypot(a[..., 1] - b[..., 1], a[..., 2] - b[..., 2])


def _colour_difference(image, reference, pixels_a_degree):
    reach = int(np.ceil(3 * np.sqrt(0.04 / (2 * np.pi**2)) * pixels_a_degree))
    away = np.arange(-reach, reach + 1) / pixels_a_degree
    shown = []
    for picture in (image, reference):
        planes = []
        for k, (a1, b1, a2, b2) in enumerate(_SENSITIVITY):
            # each Gaussian is one across times one down; their sum weighs 1
            parts = [(a * np.sqrt(np.pi / b), np.exp(-(np.pi**2) * away**2 / b)) for a, b in ((a1, b1), (a2, b2)) if a]
            whole = sum(weight * taps.sum() ** 2 for weight, taps in parts)
            planes.append(sum(weight / whole * _filtered(picture[..., k], taps, taps) for weight, taps in parts))
        shown.append(_lab(np.clip(_from_opponent(np.stack(planes, axis=2)), 0, 1)))
    difference = _distance(*shown) ** _EXPONENT
    most = _distance(_lab(np.array([0.0, 1, 0])), _lab(np.array([0.0, 0, 1]))) ** _EXPONENT
    low = _LOW * most
    high = _LOW_SHARE + (difference - low) / (most - low) * (1 - _LOW_SHARE)
    return np.where(difference < low, difference * _LOW_SHARE / low, high)


def _feature_difference(image, reference, pixels_a_degree):
    spread = 0.5 * _FEATURE_WIDTH * pixels_a_degree
    away = np.arange(-int(np.ceil(3 * spread)), int(np.ceil(3 * spread)) + 1)
    bell = np.exp(-(away**2) / (2 * spread**2))
    found = []
    for picture in (image, reference):
        bright = (picture[..., 0] + 16) / 116
        sizes = []
        for taps in (-away * bell, (away**2 / spread**2 - 1) * bell):
            # the negative part weighs −1, the positive one 1
            whole = np.where(taps < 0, taps / -taps[taps < 0].sum(), taps / taps[taps > 0].sum())
            smooth = bell / bell.sum()
            sizes.append(np.hypot(_filtered(bright, smooth, whole), _filtered(bright, whole, smooth)))
        found.append(sizes)
    difference = np.max([np.abs(a - b) for a, b in zip(*found, strict=True)], axis=0)
    return (difference / np.sqrt(2)) ** _FEATURE_EXPONENT


def _filtered(plane, down, across):
    """Of taps down and across; beyond its border a picture goes on as it is there."""
    for axis, taps in enumerate((down, across)):
        reach = len(taps) // 2
        padded = np.pad(plane, [(reach, reach) if k == axis else (0, 0) for k in (0, 1)], mode="edge")
        size = plane.shape[axis]
        plane = sum(tap * np.take(padded, range(k, k + size), axis) for k, tap in enumerate(taps))
    return plane
