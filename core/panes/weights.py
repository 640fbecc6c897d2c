"""From the entries' direct irradiance to the panes' weights: Galerkin in mode space.

The indirect field at the entries is y = F x with x = ρ (b + y). In the modes U (orthonormal under √area)
y = U w, so w = A (ρ b) + C w with A = Uᵀ F and C = Uᵀ F ρ U. A is shared by red, green and blue. The
bounces after the first, (1 − C)⁻¹ C, make smooth fields of low rank: they are kept as Q G.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..transfer import Entries, Transport
from .modes import Modes

RANK = 256
"""Leading fields kept of all bounces after the first."""


@dataclass(frozen=True)
class PaneWeights:
    """first: (m, n) float32, A. spread: (m, r) float32, Q. later: (3, r, m) float32, G. m = regions × panes."""

    first: np.ndarray
    spread: np.ndarray
    later: np.ndarray

    def of(self, reflected: np.ndarray) -> np.ndarray:
        """(m, 3) float32 weights for `reflected` (n, 3) float32: albedo × direct irradiance, W/m²."""
        once = self.first @ reflected
        again = np.stack([self.later[c] @ once[:, c] for c in range(3)], 1)
        return once + self.spread @ again


def make_weights(entries: Entries, transport: Transport, modes: Modes, reflected: np.ndarray) -> PaneWeights:
    """Weights operator for `modes`.

    reflected: (n, s) float32 albedo × direct irradiance of training lamps, from which the later bounces'
    leading fields are learnt.
    """
    count, k, regions = len(entries), modes.panes, modes.regions
    size = regions * k
    root = np.sqrt(entries.area / entries.area.mean()).astype(np.float32)
    order = np.argsort(modes.region, kind="stable")
    ends = np.concatenate([[0], np.cumsum(np.bincount(modes.region, minlength=regions))])
    first = np.empty((size, count), np.float32)
    for r in range(regions):
        rows = order[ends[r] : ends[r + 1]]
        first[r * k : r * k + k] = (modes.basis[rows] * root[rows, None]).T @ transport.between[rows]
    operators = []
    for c in range(3):
        again = np.empty((size, size), np.float32)
        for r in range(regions):
            rows = order[ends[r] : ends[r + 1]]
            back = modes.basis[rows] * (entries.albedo[rows, c] / root[rows])[:, None]
            again[:, r * k : r * k + k] = first[:, rows] @ back
        operators.append(again)
    once = first @ reflected
    fields = []
    solved = []
    for again in operators:
        inverse = np.linalg.inv(np.eye(size, dtype=np.float32) - again)
        solved.append(inverse)
        fields.append(inverse @ (again @ once) - 0)
    fields = np.concatenate(fields, 1)
    fields = fields / np.maximum(np.linalg.norm(fields, axis=0), 1e-30)
    rank = min(RANK, size, fields.shape[1])
    spread = _leading(fields, rank)
    later = np.stack([(spread.T @ inverse) @ again for inverse, again in zip(solved, operators, strict=True)])
    return PaneWeights(first, spread, later)


def _leading(fields, rank):
    """(m, rank) orthonormal basis of the leading directions of the columns of `fields` (m, s)."""
    if fields.shape[0] <= fields.shape[1]:
        _, vectors = np.linalg.eigh((fields @ fields.T).astype(np.float64))
        return np.ascontiguousarray(vectors[:, ::-1][:, :rank], np.float32)
    values, mixes = np.linalg.eigh((fields.T @ fields).astype(np.float64))
    values, mixes = values[::-1][:rank], mixes[:, ::-1][:, :rank]
    good = values > 1e-10 * max(values[0], 1e-30)
    return np.ascontiguousarray(fields @ (mixes[:, good] / np.sqrt(values[good])), np.float32)
