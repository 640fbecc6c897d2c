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

    reflected: (n, s) float32 albedo × direct irradiance of some training lamps, from which the later
    bounces' leading fields are learnt.
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
    # the second bounce's fields span, all but exactly, those of the bounces that follow it
    fields = np.concatenate([again @ (first @ reflected) for again in operators], 1)
    spread = _leading(fields, min(RANK, *fields.shape))
    eye = np.eye(size, dtype=np.float32)
    later = np.stack([np.linalg.solve((eye - again).T, spread).T @ again for again in operators])
    return PaneWeights(first, spread, np.ascontiguousarray(later, np.float32))


def _leading(fields: np.ndarray, rank: int, seed: int = 0) -> np.ndarray:
    """(m, rank) float32 orthonormal basis of the leading directions of the columns of `fields` (m, s).

    Randomised range finder (Halko et al. 2011): exact enough, and far cheaper than an eigenproblem.
    """
    fields = fields / np.maximum(np.linalg.norm(fields, axis=0), 1e-30)
    mix = np.random.default_rng(seed).standard_normal((fields.shape[1], rank)).astype(np.float32)
    basis = np.linalg.qr(fields @ mix)[0]
    return np.linalg.qr(fields @ (fields.T @ basis))[0]
