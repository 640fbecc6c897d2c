"""Interpolation weights as single floats: a point's number and its weight in one, as an image can hold them.

float32 holds integers exactly up to 2^24: the upper bits are the number plus one, the lower ones the weight.
"""

from __future__ import annotations

import numpy as np

from .interpolation import Weights

DIGITS = 24


def weight_bits(points: int) -> int:
    """Bits that are left for a weight beside the numbers of so many points, at most 8.

    Raises ValueError for more points than leave 4 bits.
    """
    bits = min(8, DIGITS - int(points + 1).bit_length())
    if bits < 4:
        raise ValueError(f"{points} points are too many to store; raise the error target.")
    return bits


def encode(weights: Weights, bits: int) -> np.ndarray:
    """(q, k) float32 codes; weights are kept from −½ to just below 1½, in steps of 2 / 2^bits. 0 is no point."""
    steps, zero = 1 << bits, 1 << bits - 2
    lower = np.clip(np.rint(weights.weight * (steps // 2)) + zero, 0, steps - 1)
    codes = (weights.point.astype(np.int64) + 1) * steps + lower.astype(np.int64)
    return np.where(lower == zero, 0, codes).astype(np.float32)


def decode(codes: np.ndarray, bits: int) -> Weights:
    """Weights from (q, k) codes, their sums made 1 again; a code's sign means nothing here."""
    steps, zero = 1 << bits, 1 << bits - 2
    whole = np.abs(codes).astype(np.int64)
    weight = np.where(whole > 0, (whole % steps - zero) * np.float32(2 / steps), 0).astype(np.float32)
    total = weight.sum(axis=1, keepdims=True)
    weight /= np.where(np.abs(total) > 1e-6, total, 1)
    return Weights(np.maximum(whole // steps - 1, 0).astype(np.int32), weight)
