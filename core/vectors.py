"""Vectors by component: numpy works on rows of three some five times as slowly as on three long rows.

A vector here is three (n,) float32 arrays; rays and points elsewhere are (n, 3).
"""

from __future__ import annotations

import numpy as np

from .sampling import frame_parts

_F = np.float32


def split(rows: np.ndarray) -> np.ndarray:
    """(3, n) contiguous components of (n, 3)."""
    return np.ascontiguousarray(rows.T)


def join(x, y, z) -> np.ndarray:
    """(n, 3) from components."""
    rows = np.empty((len(x), 3), np.float32)
    rows[:, 0], rows[:, 1], rows[:, 2] = x, y, z
    return rows


def scaled(rows: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """(n, 3) times (n,), as a new array."""
    result = np.empty((len(rows), 3), np.float32)
    for k in range(3):
        np.multiply(rows[:, k], factor, out=result[:, k])
    return result


def put(rows: np.ndarray, at, values: np.ndarray) -> None:
    """rows[at] = values, all (…, 3) float32 and contiguous, each row as one number: in half the time."""
    whole = np.dtype((np.void, 12))
    rows.view(whole)[:, 0][at] = np.ascontiguousarray(values, np.float32).view(whole)[:, 0]


def outer(values: np.ndarray, colour: np.ndarray) -> np.ndarray:
    """(n, 3): (n,) times (3,)."""
    result = np.empty((len(values), 3), np.float32)
    for k in range(3):
        np.multiply(values, colour[k], out=result[:, k])
    return result


def dot(a, b) -> np.ndarray:
    """(n,) scalar products."""
    result = a[0] * b[0]
    result += a[1] * b[1]
    result += a[2] * b[2]
    return result


def normalised(v: np.ndarray) -> np.ndarray:
    """(3, n) vectors of length 1."""
    return v / np.sqrt(np.maximum(dot(v, v), _F(1e-30)))


def around(axis, a, b, c) -> list[np.ndarray]:
    """a, b, c along a tangent, a bitangent and the unit axis itself, in the world (the frame of `sampling.frame`)."""
    return [t * a + u * b + n * c for t, u, n in zip(*frame_parts(*axis), axis, strict=True)]
