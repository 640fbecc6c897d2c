"""Orthonormal bases of what many columns have in common: randomised range finders (Halko et al. 2011, Finding Structure
with Randomness), exact enough and far cheaper than eigenproblems of the same size."""

from __future__ import annotations

import numpy as np


def leading(fields: np.ndarray, rank: int, seed: int = 0) -> np.ndarray:
    """(m, ≤ rank) float32 orthonormal basis of the leading directions of the columns of `fields` (m, s), all of which
    count alike, however bright."""
    fields = fields / np.maximum(np.linalg.norm(fields, axis=0), 1e-30)
    rank = min(rank, *fields.shape)
    mix = np.random.default_rng(seed).standard_normal((fields.shape[1], rank)).astype(np.float32)
    basis = orthonormal(fields @ mix)
    return orthonormal(fields @ orthonormal(fields.T @ basis))


def shared_leading(blocks: list[np.ndarray], rank: int, seed: int = 0) -> np.ndarray:
    """(m, ≤ rank) float32 orthonormal basis of the leading directions of all columns of `blocks`, (m, s) float32 each or
    what multiplies like it, by their brightness."""
    random = np.random.default_rng(seed)
    rank = min(rank, blocks[0].shape[0])
    basis = sum(block @ random.standard_normal((block.shape[1], rank), np.float32) for block in blocks)
    basis = orthonormal(basis)
    return orthonormal(sum(block @ (basis.T @ block).T for block in blocks))


def orthonormal(columns: np.ndarray) -> np.ndarray:
    """(m, r) float32 orthonormal columns with the span of `columns` (m, s), s ≤ m, but for what rounding makes of it.

    By their products with each other: np.linalg.qr holds the GIL.
    """
    columns = columns.astype(np.float64)
    # twice: the first time leaves what the products' condition, the span's squared, has lost
    for _ in range(2):
        square, turn = np.linalg.eigh(columns.T @ columns)
        kept = square > max(1e-12 * square.max(initial=0), 1e-60)
        columns = columns @ (turn[:, kept] / np.sqrt(square[kept]))
    return columns.astype(np.float32)
