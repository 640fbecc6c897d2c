"""Interpolation weights as single floats: a point's number and its weight in one, as an image can hold them.

float32 holds integers exactly up to 2^24: the upper bits are the number plus one, the lower ones the weight.
"""

from __future__ import annotations

import numpy as np

from ..memory import slices
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
    result = np.empty(weights.point.shape, np.float32)
    for s in slices(len(result), 32 * result.shape[1]):
        lower = np.clip(np.rint(weights.weight[s] * (steps // 2)) + zero, 0, steps - 1)
        codes = (weights.point[s].astype(np.int64) + 1) * steps + lower.astype(np.int64)
        result[s] = np.where(lower == zero, 0, codes)
    return result


def decode(codes: np.ndarray, bits: int) -> Weights:
    """Weights from (q, k) codes, their sums made 1 again; a code's sign means nothing here."""
    steps, zero = 1 << bits, 1 << bits - 2
    point, weight = np.empty(codes.shape, np.int32), np.empty(codes.shape, np.float32)
    for s in slices(len(codes), 48 * codes.shape[1]):
        whole = np.abs(codes[s]).astype(np.int64)
        found = np.where(whole > 0, (whole % steps - zero) * np.float32(2 / steps), 0).astype(np.float32)
        total = found.sum(axis=1, keepdims=True)
        weight[s] = found / np.where(np.abs(total) > 1e-6, total, 1)
        point[s] = np.maximum(whole // steps - 1, 0)
    return Weights(point, weight)
