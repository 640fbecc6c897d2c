"""Eigenpanes: per region the few leading modes of the indirect fields that lamps can make.

After clustered principal components for precomputed transfer (Sloan et al. 2003), learnt at the
entries, which sample the whole surface, and extended to the exits by P = W Φ, where Φ are the
radiosities that make the modes (Nyström).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..transfer import Entries, Transport
from .spans import shared_leading

FLOOR = 1e-5
"""Singular values below this part of a region's largest are noise, not light."""

SPOT = 0.003
"""Weight, beside a training lamp's field of mean 1, of a lamp so near to an entry that it lights no other."""

LIT = 100
"""Entries that a training lamp lights from which on it counts in full. One that lights fewer is so bright there, for a field of
mean 1, that all panes of places which see these entries would follow it alone."""

LARGE = 128
"""Rows of a region above which its modes are sought among as many of its fields' leading directions."""


@dataclass(frozen=True)
class Modes:
    """The panes' modes as seen from the entries; modes of region r are columns r·k … r·k + k − 1.

    region: (n,) int32 of each entry. panes: k, modes a region. regions: their number.
    basis: (n, k) float32, each entry's row of its own region's orthonormal modes, √area-weighted.
    dual: (n, k) float32, like basis: what a field is multiplied with to get its weights. They are its orthogonal
    projection, corrected so that each region reflects the right flux: bounces would multiply an error of it.
    makers: (n, regions × k) float32, the radiosities Φ whose gathered field is the mode; None once the bake's tables hold
    them.
    """

    region: np.ndarray
    panes: int
    regions: int
    basis: np.ndarray
    dual: np.ndarray
    makers: np.ndarray | None


def training_fields(
    entries: Entries, transport: Transport, direct: np.ndarray, mixtures: int = 96, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Radiosities X (n, s) that lamps cause and the indirect fields Y = F X (n, s) that they make, of mean 1, or less where
    few entries are lit.

    direct: (n, l) irradiance. Lamps take turns with red, green and blue albedo, since panes are shared by all
    three. Later bounces are smooth: random mixtures of lamps, `mixtures` a bounce for two bounces, are enough.
    """
    albedo = entries.albedo[:, np.arange(direct.shape[1]) % 3]
    radiosity = [albedo * direct]
    field = [transport.arriving(radiosity[0])]
    area = (entries.area / entries.area.sum()).astype(np.float32)
    mean = area @ field[0]
    lit = mean > 1e-6 * mean.max(initial=0)
    mix = np.random.default_rng(seed).random((int(lit.sum()), mixtures), np.float32)
    # few lamps a mixture, or all mixtures would be the same grey
    mix *= mix > 1 - 8 / max(len(mix), 9)
    later = field[0][:, lit] @ (mix / np.maximum(mean[lit, None], 1e-30))
    for _ in range(2):
        radiosity.append(entries.albedo[:, np.arange(mixtures) % 3] * later)
        later = transport.arriving(radiosity[-1])
        field.append(later)
    radiosity, field = np.concatenate(radiosity, 1), np.concatenate(field, 1)
    mean = area @ field
    lit = mean > 1e-6 * mean.max(initial=0)
    flux = entries.area[:, None] * radiosity[:, lit]
    # the number of entries that would share the flux evenly
    entries_lit = flux.sum(axis=0) ** 2 / (flux**2).sum(axis=0)
    scale = (np.minimum(entries_lit / LIT, 1) / mean[lit]).astype(np.float32)
    return radiosity[:, lit] * scale, field[:, lit] * scale


def learn_modes(
    entries: Entries, transport: Transport, region: np.ndarray, radiosity: np.ndarray, field: np.ndarray, panes: int
) -> Modes:
    """The leading `panes` modes of each region's part of the fields (n, s).

    Few training lamps stand near any one place, so what only they would show is learnt from the transport itself:
    the field of every single entry counts as well, a little.
    """
    regions = int(region.max()) + 1
    root = np.sqrt(entries.area / entries.area.mean()).astype(np.float32)[:, None]
    basis = np.zeros((len(region), panes), np.float32)
    dual = np.zeros_like(basis)
    flux = root[:, 0] * entries.albedo.mean(axis=1)
    mixes = np.zeros((field.shape[1], regions * panes), np.float32)
    makers = np.empty((len(region), regions * panes), np.float32)
    share = (entries.area / entries.area.sum()).astype(np.float32)
    reach = transport.leaving(slice(None), share[:, None])[0]
    # what reaches all but nothing would need to be blinding
    glow = np.where(reach > 0.1 * reach.mean(), SPOT / np.maximum(reach, 1e-30), 0).astype(np.float32)
    order = np.argsort(region, kind="stable")
    ends = np.cumsum(np.bincount(region, minlength=regions))
    # one small eigenproblem a region: a loop over regions, not over entries
    for r in range(regions):
        rows = order[ends[r - 1] if r else 0 : ends[r]]
        block = root[rows] * field[rows]
        lone = transport.spots(rows, glow)
        spots = root[rows] * lone.seen
        turned = None
        if len(rows) > LARGE:
            turned = shared_leading([block, spots], LARGE)
            block_turned, spots_turned = turned.T @ block, turned.T @ spots
        else:
            block_turned = block
            spots_turned = spots if isinstance(spots, np.ndarray) else np.eye(len(rows), dtype=np.float32) @ spots
        # float64: the Gram matrix squares the range of the singular values
        gram = block_turned @ block_turned.T + spots_turned @ spots_turned.T
        values, vectors = np.linalg.eigh(gram.astype(np.float64))
        keep = min(panes, len(rows))
        values, vectors = values[::-1][:keep], vectors[:, ::-1][:, :keep]
        good = values > FLOOR**2 * values[0]
        values, vectors = values[good], vectors[:, good].astype(np.float32)
        if turned is not None:
            vectors = turned @ vectors
        basis[rows[:, None], np.arange(len(values))] = vectors
        dual[rows[:, None], np.arange(len(values))] = _keep_flux(vectors, flux[rows])
        inverse = np.zeros((len(rows), panes), np.float32)
        inverse[:, : len(values)] = vectors / values.astype(np.float32)
        mixes[:, r * panes : (r + 1) * panes] = block.T @ inverse
        makers[:, r * panes : (r + 1) * panes] = lone.radiosity((inverse.T @ spots).T)
    makers += radiosity @ mixes
    return Modes(region, panes, regions, basis, dual, makers)


def _keep_flux(vectors: np.ndarray, flux: np.ndarray) -> np.ndarray:
    """(m, k): orthonormal `vectors` (m, k) as a projection whose remainder r has no flux: flux · r = 0."""
    share = flux @ vectors
    total = float(share @ share)
    # black regions reflect nothing, whatever their weights
    if total <= 1e-12 * max(float(flux @ flux), 1e-30):
        return vectors
    missed = flux - vectors @ share
    return vectors + np.outer(missed, share / total)
