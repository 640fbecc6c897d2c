"""Where in space the light landed: what the panes' entries need."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .quadtree import CELLS, SIMPSON, Forest
from .splat import biquadratic

WANTED = 60_000
"""Landings of a lamp, about: dozens for each entry that matters."""

SIDES = np.array([2, 3, 4, 6, 8, 12, 16])
"""Landings of a patch a side."""

FLAT = 1e-4
"""A patch is flat where its photons are no farther off its middle one's plane, in parts of its length."""


@dataclass(frozen=True)
class Landings:
    """Where light that casters sent on first met a surface that scatters it, with or without a place in the atlas.

    position: (n, 3) float32, m. normal: (n, 3) float32 unit geometric normal on the side that it met. power: (n, 3)
    float32 W that each stands for, at the lamp's unit power.
    """

    position: np.ndarray
    normal: np.ndarray
    power: np.ndarray


def none() -> Landings:
    """Of a lamp that casters send nowhere."""
    empty = np.zeros((0, 3), np.float32)
    return Landings(empty, empty, empty)


def landings_of(forest: Forest) -> Landings:
    """Landings of all patches: spread evenly over those on flat ground, the photons' own places elsewhere.

    photons.rest holds the place in space and the normal in its first six columns.
    """
    photons, corner, measure = forest.photons, forest.corner, forest.measure
    signature = photons.signature[corner]
    alike = (signature == signature[:, :1]).all(axis=1)
    even = np.flatnonzero(alike & (signature[:, 0] > 0))
    even = even[_flat(photons.rest[corner[even], :6])]
    power = photons.power.mean(axis=1)[corner[even, 4]] * measure[even]
    per_side = np.sqrt(WANTED * power / max(power.sum(), 1e-300))
    side = SIDES[np.minimum(np.searchsorted(SIDES, per_side), len(SIDES) - 1)]
    parts = []
    for n in np.unique(side):
        rows = even[side == n]
        vertex = corner[rows].T
        weights = biquadratic(int(n), int(n))
        position = np.tensordot(weights, photons.rest[vertex, :3], axes=1)
        lit = np.maximum(np.tensordot(weights, photons.power[vertex], axes=1), 0)
        lit *= (measure[rows] / n**2)[None, :, None].astype(np.float32)
        normal = np.broadcast_to(photons.rest[vertex[4], 3:6], position.shape)
        parts.append((position.reshape(-1, 3), normal.reshape(-1, 3), lit.reshape(-1, lit.shape[2])))
    rest = np.ones(len(corner), bool)
    rest[even] = False
    share = np.where(alike[rest, None], SIMPSON, CELLS) * measure[rest, None]
    share = np.bincount(corner[rest].ravel(), share.ravel(), len(photons))
    lit = photons.power * share[:, None].astype(np.float32)
    rows = np.flatnonzero(lit.max(axis=1) > 0)
    parts.append((photons.rest[rows, :3], photons.rest[rows, 3:6], lit[rows]))
    position, normal, power = (np.concatenate([p[k] for p in parts]).astype(np.float32) for k in range(3))
    return Landings(position, normal, np.broadcast_to(power, (len(power), 3)).copy())


def _flat(place):
    """(p,) bool: patches whose photons, (p, 9, 6) places and normals, lie in one plane."""
    position, normal = place[:, :, :3], place[:, :, 3:]
    away = position - position[:, 4:5]
    off = np.abs((away * normal[:, 4:5]).sum(axis=2)).max(axis=1)
    length = np.sqrt((away * away).sum(axis=2)).max(axis=1)
    alike = (normal * normal[:, 4:5]).sum(axis=2).min(axis=1) > 0.999
    return alike & (off <= FLAT * length)
