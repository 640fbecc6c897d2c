"""The caches of the papers, where a sample goes to one point: Delaere 2021 with implicit points or fixed voxels, and
Binder, Fricke and Keller 2019 with voxels and jitter. Kept for comparison; `Cache` does better."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..rays import chunks
from ..sampling import hash_uniform
from ..threads import in_threads
from .choice import areas, jittered, pick, three_nearest
from .frame_table import FixedTable, merge, sum_frame, values_at
from .implicit_points import ImplicitPoints
from .keys import surface_keys
from .reconstruction import interpolate

PIECE = 1 << 13
"""Places handled together: candidates and the nearest three stay in the second-level cache."""

CHOICES = ("nearest", "barycentric", "jitter")


class OnePointPlaces(NamedTuple):
    """Places (3, n) float64, m, their unit normals (3, n) float32, surfaces (n,) uint32 and levels (n,) int64; keys
    (3, n) uint32 and probabilities (3, n) float32 of the nearest points. At each frame one is chosen."""

    position: np.ndarray
    normal: np.ndarray
    surface: np.ndarray
    level: np.ndarray
    key: np.ndarray
    weight: np.ndarray


class OnePointCache:
    """Shading at points, a sample to one of them.

    points: where they are. choice: "nearest"; "barycentric", one of three by its λ; "jitter", the nearest of a place
    moved in the tangent plane by up to `jitter` points' spacings.
    cell: spacing of points in footprints. radius: of the reconstruction, in spacings.
    ageing: s of the merge. scale: largest value that is kept.
    by_normal: surfaces that face other ways are kept apart, which is not in the papers, and objects with them.
    projected: distances in the tangent plane, as if points lay on the surface (the thesis's outlook).
    """

    def __init__(
        self,
        channels: int = 1,
        *,
        points: ImplicitPoints | None = None,
        choice: str = "barycentric",
        cell: float = 2.0,
        radius: float = 1.5,
        jitter: float = 1.5,
        ageing: float = 0.9,
        scale: float = 1.0,
        slots: int = 1 << 20,
        by_normal: bool = False,
        projected: bool = False,
        seed: int = 0,
        threads: int | None = None,
    ):
        if choice not in CHOICES:
            raise ValueError(f"Unknown choice {choice!r}, use one of {', '.join(CHOICES)}.")
        self.points = points or ImplicitPoints()
        self.choice, self.cell, self.radius, self.jitter = choice, cell, radius, jitter
        self.ageing, self.scale, self.by_normal, self.projected = ageing, scale, by_normal, projected
        self.seed, self.threads, self.frames = seed, threads, 0
        self.table = FixedTable(channels, slots)

    @property
    def entries(self) -> int:
        """Points that hold a value."""
        return int(np.count_nonzero(self.table.key))

    @property
    def occupancy(self) -> float:
        """Share of the table's slots in use."""
        return self.entries / len(self.table.key)

    @property
    def bytes_per_entry(self) -> int:
        """Of memory."""
        return self.table.bytes_per_entry

    def frame(self, position, normal, object_id, footprint, value) -> np.ndarray:
        """As `Cache.frame`; the result is filtered."""
        places = self.look_up(position, normal, object_id, footprint)
        self.add(places, value)
        return self.read(places)

    def look_up(self, position, normal, object_id=None, footprint=1.0) -> OnePointPlaces:
        """As `Cache.look_up`."""
        place = np.ascontiguousarray(np.asarray(position, np.float64).T)
        normal = np.ascontiguousarray(np.asarray(normal, np.float32).T)
        size = np.broadcast_to(np.asarray(footprint, np.float64) * self.cell, place.shape[1])
        level = self.points.level_of(size)
        surface = np.full(place.shape[1], self.seed, np.uint32)
        if self.by_normal:
            surface = surface_keys(normal, object_id, self.seed, place.shape[1]).astype(np.uint32)

        def search(s):
            found, squared = three_nearest(self._candidates(place[:, s], normal[:, s], level[s], surface[s]))
            if self.choice == "barycentric":
                return found, areas(squared)
            weight = np.zeros(found.shape, np.float32)
            weight[0] = 1
            return found, weight

        parts = in_threads(search, chunks(place.shape[1], PIECE), self.threads)
        keys, weights = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
        return OnePointPlaces(place, normal, surface, level, keys, weights)

    def _candidates(self, place, normal, level, surface, reach=1):
        for key, offset in self.points.candidates(place, level, surface, reach):
            if self.projected:
                offset = offset - np.einsum("kn,kn->n", offset, normal) * normal
            yield key, offset

    def _chosen(self, places):
        """(n,) uint32 keys, by this frame's random numbers."""
        count = places.key.shape[1]
        index = np.arange(count, dtype=np.uint32)
        if self.choice == "jitter":
            chance = np.stack([hash_uniform(index, 2 * self.frames + d, self.seed) for d in (0, 1)], axis=1)
            reach = self.points.octant_size(places.level) * self.jitter
            moved = jittered(places.position, places.normal, reach, chance)

            def nearest(s):
                return three_nearest(
                    self._candidates(moved[:, s], places.normal[:, s], places.level[s], places.surface[s], 0)
                )[0][0]

            return np.concatenate(in_threads(nearest, chunks(count, PIECE), self.threads))
        row = pick(places.weight, hash_uniform(index, 2 * self.frames, self.seed))
        return places.key[row, np.arange(count)]

    def add(self, places: OnePointPlaces, values: np.ndarray) -> np.ndarray:
        """As `Cache.add`; returns the (n,) uint32 keys of the chosen points."""
        self.frames += 1
        keys = self._chosen(places)
        merge(
            self.table, sum_frame(keys, np.asarray(values, np.float32).reshape(len(keys), -1)), self.scale, self.ageing
        )
        return keys

    def at(self, keys: np.ndarray) -> np.ndarray:
        """(n, channels) float32 at chosen points: the picture before reconstruction."""
        return values_at(self.table, self.table.find(keys), self.scale).T

    def read(self, places: OnePointPlaces, otherwise: float = 0.0) -> np.ndarray:
        """(n, channels) float32, reconstructed from all points within the radius; `otherwise` where none is known."""
        spacing = self.points.octant_size(places.level)
        reach = int(np.ceil(self.radius))

        def value_of(keys):
            slot = self.table.find(keys)
            return values_at(self.table, slot, self.scale), slot >= 0

        def mix(s):
            around = self._candidates(
                places.position[:, s], places.normal[:, s], places.level[s], places.surface[s], reach
            )
            value, weight = interpolate(around, (spacing[s] * self.radius).astype(np.float32), value_of)
            return np.where(weight > 0, value, np.float32(otherwise)).T

        return np.concatenate(in_threads(mix, chunks(places.key.shape[1], PIECE), self.threads))
