"""Receivers: the places that a lamp lights, and the clusters of neighbours that are decided together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..rays import product3
from .lamp import LampSamples

CLUSTER = 64
"""Receivers of a cluster. Twice as many see a quarter more occluders each; half as many cost more overhead than that saves."""


@dataclass(frozen=True)
class Receivers:
    """position: (R, 3) float32, m, lifted off their surface already (Tracer.offset). normal: (R, 3) float32 unit, or
    None where light from all sides counts. group: (R,) uint8, which set of the lamp's samples each looks at, or None
    for the first.
    """

    position: np.ndarray
    normal: np.ndarray | None = None
    group: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.position)

    def take(self, rows: np.ndarray) -> Receivers:
        """Those at `rows`."""
        return Receivers(
            self.position[rows],
            None if self.normal is None else self.normal[rows],
            None if self.group is None else self.group[rows],
        )

    def sets(self, rows: np.ndarray) -> np.ndarray:
        """(n,) int set of samples of the receivers at `rows`."""
        return np.zeros(len(rows), np.intp) if self.group is None else self.group[rows].astype(np.intp)


def facing(receivers: Receivers, lamp: LampSamples) -> np.ndarray:
    """(R,) bool: whether any of the lamp is above a receiver's horizon, and the receiver before the lamp."""
    position = receivers.position
    found = np.ones(len(position), bool)
    if lamp.one_sided and not lamp.distant:
        # what lies in the lamp's own plane gets nothing
        found = (position - lamp.centre.astype(np.float32)) @ lamp.axes[2].astype(np.float32) > 0
    if receivers.normal is not None:
        # columns, along which numpy is quick
        above = product3(lamp.corners().astype(np.float32), np.ascontiguousarray(receivers.normal.T)).max(axis=0)
        height = 0 if lamp.distant else np.einsum("nd,nd->n", position, receivers.normal)
        found &= above > height
    return found


def morton(position: np.ndarray) -> np.ndarray:
    """(n,) uint64 keys that sort places (n, 3) so that neighbours are neighbours, 20 bits an axis."""
    across = np.ascontiguousarray(position.T)
    low = across.min(axis=1, initial=np.inf)
    span = max(float((across.max(axis=1, initial=-np.inf) - low).max()), 1e-30) if len(position) else 1.0
    key = np.zeros(len(position), np.uint64)
    for axis in range(3):
        cell = ((across[axis] - low[axis]) * ((2**20 - 1) / span)).astype(np.uint64)
        # two zero bits between each two (Morton)
        for shift, mask in (
            (32, 0x1F00000000FFFF),
            (16, 0x1F0000FF0000FF),
            (8, 0x100F00F00F00F00F),
            (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):
            cell = (cell | cell << np.uint64(shift)) & np.uint64(mask)
        key |= cell << np.uint64(axis)
    return key


def clusters(receivers: Receivers, lamp: LampSamples) -> np.ndarray:
    """(c, CLUSTER) int32 rows of the receivers that face the lamp, neighbours together; the last row repeats one.

    Neighbours are alike in their normal's main direction too, so that a cluster at an edge is flat.
    """
    rows = np.flatnonzero(facing(receivers, lamp)).astype(np.int32)
    if not len(rows):
        return np.zeros((0, CLUSTER), np.int32)
    key = morton(receivers.position[rows])
    if receivers.normal is not None:
        # surfaces of six directions apart, within places of a 256th of the scene
        normal = receivers.normal[rows]
        axis = np.abs(normal).argmax(axis=1)
        side = (2 * axis + (normal[np.arange(len(rows)), axis] < 0)).astype(np.uint64)
        coarse = np.uint64(36)
        key = (key >> coarse) << np.uint64(3 + 36) | side << coarse | key & np.uint64(2**36 - 1)
    rows = rows[np.argsort(key, kind="stable")]
    short = -len(rows) % CLUSTER
    return np.append(rows, np.repeat(rows[-1:], short)).reshape(-1, CLUSTER)
