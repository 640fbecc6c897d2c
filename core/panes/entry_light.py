"""Direct irradiance of the entries under a lamp, shadows included."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..form_factors import triangles_from
from ..lights import irradiance
from ..rays import Tracer
from ..scene import Light
from ..surface import Patches, SurfaceSamples
from ..transfer import Entries
from .sharing import Sharing

FEW = 2
"""Places of an entry that see a lamp, those whose middle is nearest to the entry's; all once the lamp is near."""

CLOSE = 3.0
"""A lamp is near an entry within this many times the entry's size."""


@dataclass(frozen=True)
class EntrySurface:
    """The entries as lamps see them, all that a relight needs of the scene's shape.

    position, normal: (n × each, 3) float32 places on the entries, lifted off the surface, row-major.
    albedo: (n, 3) float32. size: (n,) float32, √area of the whole patch, m. pieces: (p, 3, 3) float32 corners,
    m, of the triangles that make the entries, wound towards the entry's side and sorted by entry; counts: (n,) int32 pieces of each.
    """

    position: np.ndarray
    normal: np.ndarray
    albedo: np.ndarray
    size: np.ndarray
    pieces: np.ndarray
    counts: np.ndarray

    def __len__(self) -> int:
        return len(self.albedo)

    @cached_property
    def left(self) -> np.ndarray:
        """(n,) float32 part of each entry that nothing stands on: places that are left stand in for others, in turns."""
        each = len(self.position) // max(len(self), 1)
        place = self.position.reshape(len(self), each, 3)
        again = np.pad((place[:, 1:] == place[:, :1]).all(axis=2), ((0, 0), (0, 1)), constant_values=True)
        return (again.argmax(axis=1) + 1).astype(np.float32) / np.float32(max(each, 1))

    @cached_property
    def middle(self) -> np.ndarray:
        """(n, 3) float32 m, of what is left of each entry."""
        corners = self.pieces.astype(np.float64)
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        own = np.repeat(np.arange(len(self)), self.counts)
        total = np.stack([np.bincount(own, corners.mean(axis=1)[:, k] * area, len(self)) for k in range(3)], 1)
        whole = total / np.maximum(np.bincount(own, area, len(self)), 1e-300)[:, None]
        some = self.position.reshape(len(self), -1, 3).mean(axis=1)
        return np.where((self.left < 1)[:, None], some, whole).astype(np.float32)

    @classmethod
    def of(cls, entries: Entries, patches: Patches, places: SurfaceSamples, offset: float) -> EntrySurface:
        """places: (n × each) samples on the entries, row-major; offset: lift, m."""
        order = np.argsort(patches.patch, kind="stable")
        count = np.bincount(patches.patch, minlength=len(patches))
        first = np.cumsum(count) - count
        counts = count[entries.patch]
        # every entry's own pieces, one run after another
        run = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        pieces = patches.corners[order[np.repeat(first[entries.patch], counts) + run]]
        back = np.repeat(entries.back, counts)
        pieces[back] = pieces[back][:, ::-1]
        return cls(
            position=(places.position + places.flat * np.float32(offset)).astype(np.float32),
            normal=places.normal,
            albedo=entries.albedo,
            size=np.sqrt(patches.area[entries.patch]).astype(np.float32),
            pieces=np.ascontiguousarray(pieces),
            counts=counts.astype(np.int32),
        )


class EntryLight:
    """Evaluates lamps at the entries: few places on each, more where the lamp is near, and there the exact solid
    angle of the entry in place of an average over places, whose noise would otherwise be a wrong brightness.

    few: places of each entry that see a lamp which is not near.
    """

    def __init__(self, surface: EntrySurface, tracer: Tracer, seed: int = 0, few: int = FEW):
        self.surface = surface
        self.tracer = tracer
        self.seed = seed
        count = len(surface)
        self.each = len(surface.position) // max(count, 1)
        self._position = surface.position.reshape(count, self.each, 3)
        self._normal = surface.normal.reshape(count, self.each, 3)
        self._first = np.ascontiguousarray(self._position[:, 0].T)
        self.few = min(few, self.each)
        pick = _balanced_pair(self._position) if self.few == 2 else np.tile(np.arange(self.few), (count, 1))
        # place-major: the first block is one place on every entry
        self._few = tuple(v[np.arange(count), pick.T].reshape(-1, 3) for v in (self._position, self._normal))
        self._few_apart = _apart(np.moveaxis(self._few[0].reshape(self.few, count, 3), 0, 1))
        self._first_piece = np.cumsum(surface.counts) - surface.counts

    def unit(self, light: Light) -> np.ndarray:
        """(n,) or (n, 3) float32 irradiance at unit power (see `lights.irradiance`)."""
        return self.look(light)[0]

    def look(self, light: Light) -> tuple[np.ndarray, np.ndarray]:
        """The irradiance as `unit` has it, and its moment (n, 3) float32, times m: the mean over an entry's places of the
        irradiance, times how far the place is from the middle of all."""
        count = len(self.surface)
        found = irradiance(light, *self._few, self.tracer.visibility, 1, self.seed)
        found = found.reshape(self.few, count, *found.shape[1:])
        grey = _grey(found)
        moment = np.einsum("kn,nkd->nd", grey, self._few_apart) / np.float32(self.few)
        lit = (grey > 0).mean(axis=0)
        found = found.mean(axis=0)
        near, depth = self._near(light)
        edge = self._edges(lit, near)
        if len(edge):
            found, edge = self._across(light, edge, lit, found, moment)
        if len(near):
            closely, moment[near] = self._closely(light, near)
            found = _with(found, near, closely)
        # what is known of all is shared at last, or what one gets from another would be lost
        if len(edge):
            self._sharing.share(found, moment, edge, np.ones(len(edge), np.float32))
        if len(near):
            self._sharing.share(found, moment, near, np.minimum(2 * depth, 1))
        return found, moment

    def _edges(self, lit, near):
        """(m,) entries that a shadow's edge crosses, and those beside them, if they are not near the lamp; lit: (n,) part of
        each entry's few places that see the lamp."""
        some = np.flatnonzero(lit)
        beside = self._sharing.beside[some]
        differs = (lit.take(beside, mode="clip") != lit[some, None]) & (beside >= 0)
        edge = (lit > 0) & (lit < 1)
        edge[some[differs.any(axis=1)]] = True
        edge[beside[differs]] = True
        edge[near] = False
        return np.flatnonzero(edge)

    def _across(self, light, edge, lit, found, moment):
        """Look at entries (m,) from more places, together from no more than all entries are. Returns the irradiance of all,
        and those that the edge does cross; moments are mended in place."""
        each = min(self.each, len(lit) * self.few // len(edge))
        if each > self.few:
            position, normal = self._position[edge, :each], self._normal[edge, :each]
            places = position.reshape(-1, 3), normal.reshape(-1, 3)
            closely = irradiance(light, *places, self.tracer.visibility, 1, self.seed)
            closely = closely.reshape(len(edge), each, *closely.shape[1:])
            grey = _grey(closely)
            lit[edge] = (grey > 0).mean(axis=1)
            moment[edge] = np.einsum("nk,nkd->nd", grey, _apart(position)) / np.float32(each)
            closely = closely.mean(axis=1)
            found = _with(found, edge, closely)
        elif self.few < self.each:
            edge = edge[:0]
        return found, edge[(lit[edge] > 0) & (lit[edge] < 1)]

    @cached_property
    def _sharing(self):
        return Sharing(self.surface, self.tracer)

    def _near(self, light):
        """(m,) entries that a lamp is near, and (m,) how deep within the distance where that begins, in parts of it."""
        if light.kind == "SUN":
            return np.zeros(0, np.int64), np.zeros(0, np.float32)
        reach = light.radius + 0.5 * max(light.size) * (light.kind == "AREA")
        x, y, z = self._first - light.position.astype(np.float32)[:, None]
        apart = np.sqrt(x * x + y * y + z * z)
        depth = 1 - (apart - np.float32(reach)) / (np.float32(CLOSE) * self.surface.size)
        near = np.flatnonzero(depth > 0)
        return near, depth[near]

    def _closely(self, light, near):
        position, normal = self._position[near], self._normal[near]
        places = position.reshape(-1, 3), normal.reshape(-1, 3)
        found = irradiance(light, *places, self.tracer.visibility, 1, self.seed)
        found = found.reshape(len(near), self.each, *found.shape[1:])
        apart = _apart(position)
        moment = np.einsum("nk,nkd->nd", _grey(found), apart) / np.float32(self.each)
        found = found.mean(axis=1)
        if light.kind == "AREA":
            return found, moment
        vectors = light.position.astype(np.float32) - position
        distance2 = np.einsum("nkd,nkd->nk", vectors, vectors)
        facing = np.maximum(np.einsum("nkd,nkd->nk", vectors, normal), 0)
        plain = facing / (4 * np.pi * distance2**1.5)
        free, free_moment = plain.mean(axis=1), np.einsum("nk,nkd->nd", plain, apart) / np.float32(self.each)
        angle, exact_moment = self._seen_from(near, light.position)
        area = 4 * np.pi * self.surface.size[near].astype(np.float64) ** 2
        # a soft lamp that touches the entry has no solid angle to speak of
        use = (free > 0) & (distance2.min(axis=1) > (2 * light.radius) ** 2)
        scale = np.where(use, angle / area / np.where(free > 0, free, 1), 1)
        # places tell what is in the way, and the rest is exact, where no part of the entry is hidden
        passes = np.where(use, (found if found.ndim == 1 else found.mean(axis=1)) / np.where(free > 0, free, 1), 0)
        known = (use & (self.surface.left[near] == 1))[:, None]
        more = passes[:, None] * (exact_moment / area[:, None] - scale[:, None] * free_moment)
        moment = moment * scale[:, None] + np.where(known, more, 0)
        scale = scale.astype(np.float32)
        return found * (scale if found.ndim == 1 else scale[:, None]), moment.astype(np.float32)

    def _solid_angle(self, entries, place):
        """(m,) sr that each entry's lit side fills, seen from `place`."""
        return self._seen_from(entries, place)[0]

    def _seen_from(self, entries, place):
        """The solid angle (m,), and its moment (m, 3) about each entry's middle, m."""
        counts = self.surface.counts[entries]
        run = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        pieces = self.surface.pieces[np.repeat(self._first_piece[entries], counts) + run]
        parts = triangles_from(pieces, place)
        own = np.repeat(np.arange(len(entries)), counts)
        angle, *moment = (np.bincount(own, v, len(entries)) for v in (parts[0], *parts[1].T))
        return angle, np.stack(moment, 1) + (place - self.surface.middle[entries]) * angle[:, None]


def _with(found, rows, values):
    """Irradiance (n,) or (n, 3) with values (m,) or (m, 3) at some rows; tints are known where any ray was traced."""
    if values.ndim > found.ndim:
        found = np.repeat(found[:, None], 3, axis=1)
    found[rows] = values if values.ndim == found.ndim else values[:, None]
    return found


def _apart(position):
    """(n, k, 3) of places of entries: how far each is from their middle, m."""
    return position - position.mean(axis=1, keepdims=True)


def _grey(values):
    """(a, b) of (a, b) or (a, b, 3)."""
    return values if values.ndim == 2 else values.mean(axis=2)


def _balanced_pair(position: np.ndarray) -> np.ndarray:
    """(n, 2) int of the two places of each entry (n, each, 3) whose middle is nearest to the middle of all.

    Light that varies evenly over the entry is then averaged without error.
    """
    centred = position - position.mean(axis=1, keepdims=True)
    gram = np.einsum("nid,njd->nij", centred, centred)
    square = np.einsum("nii->ni", gram)
    apart = square[:, :, None] + square[:, None, :] + 2 * gram
    each = position.shape[1]
    apart[:, *np.tril_indices(each)] = np.inf
    return np.stack(np.divmod(apart.reshape(len(position), -1).argmin(axis=1), each), 1)
