"""What mirrors and glass send to the entries: the first diffuse hit of caustic photons is an entry's direct light."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..caustics import Landings
from ..rays import Bvh, chunks
from ..scene import Light
from ..threads import in_threads
from .entry_light import EntrySurface

LIFT = 4.0
"""Start of the rays that find a landing's entry, in offsets off its surface; they end as far behind it."""


class CausticLight:
    """Irradiance of entries by caustics.

    surface: of the panes. landings: of a lamp at unit power (`CausticAtlas.landings`). offset: m, the tracer's.
    """

    def __init__(self, surface: EntrySurface, landings: Callable[[Light], Landings], offset: float):
        self.surface = surface
        self._landings = landings
        self._lift = np.float32(LIFT * offset)
        self._entry = np.repeat(np.arange(len(surface)), surface.counts)
        # the two sides of a sheet are two pieces in one place, of which a ray finds one: each side has its own hierarchy
        alike = np.sort(surface.pieces, axis=1).reshape(len(surface.pieces), -1)
        first = np.zeros(len(alike), bool)
        first[np.unique(alike, axis=0, return_index=True)[1]] = True
        self._sides = [(rows, Bvh(surface.pieces[rows])) for rows in (np.flatnonzero(first), np.flatnonzero(~first))]
        edges = surface.pieces[:, 1:] - surface.pieces[:, :1]
        self._normal = np.cross(edges[:, 0], edges[:, 1])

    def unit(self, light: Light) -> np.ndarray:
        """(n, 3) float32 irradiance at unit power. Light on surfaces that are no entry is lost, as the panes lose it."""
        landings = self._landings(light)
        entry = self._found(landings.position, landings.normal)
        power = np.where(entry[:, None] >= 0, landings.power, 0)
        entry = np.maximum(entry, 0)
        total = np.stack([np.bincount(entry, power[:, k], len(self.surface)) for k in range(3)], 1)
        return (total / np.maximum(self.surface.size.astype(np.float64) ** 2, 1e-30)[:, None]).astype(np.float32)

    def _found(self, position, normal):
        """(n,) int entry under places, on the side to which the normals point; −1 where there is none."""

        def part(piece):
            start = position[piece] + normal[piece] * self._lift
            down = normal[piece] * (-2 * self._lift)
            found = np.full(len(start), -1, np.int64)
            nearest = np.full(len(start), np.inf, np.float32)
            for rows, bvh in self._sides:
                hits = bvh.hits(start, down, np.ones(len(start), np.float32))
                number = rows[hits.triangle] if len(rows) else hits.triangle
                faces = np.einsum("nd,nd->n", self._normal[number], normal[piece]) > 0
                use = (hits.triangle >= 0) & faces & (hits.distance < nearest)
                found[use], nearest[use] = self._entry[number[use]], hits.distance[use]
            return found

        parts = in_threads(part, chunks(len(position)))
        return np.concatenate(parts) if parts else np.zeros(0, np.int64)
