"""Light that comes to points by bounces: a path from each, which ends where a bake or a coarse cache knows the rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..lights import sky_radiance
from ..sampling import hash_uint32, hash_uniform
from ..scene import Sky
from ..threads import in_threads
from ..vectors import scaled
from .baked import BakedLight
from .gbuffer import pieces
from .light import Baked, Lamps
from .surfaces import Surfaces

FEED = (0.25, 0.0625)
"""Part of the secondary hits from which paths go on to feed the coarse cache, in the first FEEDING frames and at last;
all of them read it."""

FEEDING = 8
"""Frames; from then on the part falls as one over their number."""

AT_BOUNCES = 2
"""Lamps asked at a bounce; with more, so many are picked. With one alone half the light of two would often be picked
where it is blocked."""

BRIGHTEST = 0.98
"""Albedo at a bounce, at most: between white walls light would never die out."""

_PI = np.float32(np.pi)
_DIMENSIONS = 8
"""Random numbers of a bounce; each is a stream of hashes of its own."""


@dataclass(frozen=True)
class Light:
    """Irradiance at n points, one sample each, (n, 3) float32 W/m². first: from sky and emissive faces that they see;
    indirect: after at least one bounce. way: (n,) m to what the sample's ray met, infinite for the sky."""

    first: np.ndarray
    indirect: np.ndarray
    way: np.ndarray

    @property
    def total(self) -> np.ndarray:
        return self.first + self.indirect


@dataclass(frozen=True)
class _Vertices:
    """Where m of n paths land. rows: (m,) of the n. position (m, 3) m, lifted; normal, flat (m, 3) unit. factor (m, 3):
    irradiance here to irradiance where the path comes from. light: (m, 3) W/m², that of lamps and of what a bake knows.
    open: (m,) bool, where the rest is not known. object_id: (m,)."""

    rows: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    flat: np.ndarray
    factor: np.ndarray
    light: np.ndarray
    open: np.ndarray
    object_id: np.ndarray


class PathTracer:
    """Follows light through a scene. baked: images that know the light at surfaces of the atlas.

    coarse: a world-space cache of irradiance (implicit_cache.Cache), which ends paths; None to follow them on.
    """

    def __init__(
        self,
        surfaces: Surfaces,
        lamps: Lamps,
        sky: Sky | None,
        baked: Baked | None = None,
        coarse=None,
        seed: int = 0,
    ):
        self.surfaces, self.lamps, self.sky = surfaces, lamps, sky
        self.coarse, self.seed, self.frames, self.feed = coarse, seed, 0, FEED[0]
        self.bake = BakedLight(surfaces, baked) if baked is not None else None

    def gather(self, position, normal, flat, pixel, span: float, u, spot, frame: int, bounces: int) -> Light:
        """One path from each of n points.

        position: lifted off the surface. pixel: (n,) uint32 names the points in hashes. span: m, a pixel's width at
        most surfaces, the unit of the coarse cache. u, spot: (2, n) in [0, 1), the first direction, and places on lamps
        where it leads. bounces: after which paths end, at most.
        """
        seed = int(hash_uint32(np.array([frame]), 77, self.seed)[0])
        self.feed = max(FEED[1], FEED[0] * min(1.0, FEEDING / (self.frames + 1)))
        self.frames += 1
        return self._gather(position, normal, flat, pixel, span, u, spot, seed, bounces, 0)

    def _gather(self, position, normal, flat, pixel, span, u, spot, seed, bounces, turn) -> Light:
        light = Light(
            *(np.zeros((len(position), 3), np.float32) for _ in range(2)), np.full(len(position), np.inf, np.float32)
        )
        vertices = in_threads(
            lambda s: self._step(
                light, s, *_same(normal, flat, s), position[s], pixel[s], u[:, s], spot[:, s], seed, turn, bounces
            ),
            pieces(len(position)),
        )
        vertices = [at for at in vertices if at is not None]
        if not vertices:
            return light
        at = _joined(vertices)
        rest = np.flatnonzero(at.open)
        if len(rest):
            if self.coarse is not None and turn == 0:
                self._end_in_cache(at.light, at, rest, pixel, span, seed, bounces, turn)
            else:
                self._go_on(at.light, at, rest, rest, pixel, span, seed, bounces, turn)
        light.indirect[at.rows] = at.factor * at.light
        return light

    def _go_on(self, light, at, rest, into, pixel, span, seed, bounces, turn):
        """Follow paths on from `rest`, each with the chance that it matters (Russian roulette), and add what they find
        to the rows `into` of `light`."""
        survive = np.clip(at.factor[rest].max(axis=1), 0.1, 1)
        lives = np.flatnonzero(hash_uniform(pixel[at.rows[rest]], _DIMENSIONS * (turn + 1) + 6, seed) < survive)
        if len(lives):
            deeper = self._deeper(at, rest[lives], pixel, span, seed, bounces - 1, turn)
            light[into[lives]] += deeper.total / survive[lives, None]

    def _end_in_cache(self, light, at, rest, pixel, span, seed, bounces, turn):
        """Read the coarse cache where paths land, and feed it from a part of these places, by paths to the end.

        What it is fed with never comes from it, or the first frames' ignorance would linger.
        """
        feeds = hash_uniform(pixel[at.rows[rest]], _DIMENSIONS * (turn + 1) + 7, seed) < self.feed
        for create, rows in ((True, rest[feeds]), (False, rest[~feeds])):
            if not len(rows):
                continue
            places = self.coarse.look_up(at.position[rows], at.normal[rows], at.object_id[rows], span, create=create)
            if create:
                fed = np.zeros((len(rows), 3), np.float32)
                self._go_on(fed, at, rows, np.arange(len(rows)), pixel, span, seed, bounces, turn)
                self.coarse.add(places, fed)
            light[rows] += self.coarse.read(places)

    def _deeper(self, at, rows, pixel, span, seed, bounces, turn) -> Light:
        base, origin = _DIMENSIONS * (turn + 1), at.rows[rows]
        u, spot = (np.stack([hash_uniform(pixel[origin], base + k, seed) for k in pair]) for pair in ((4, 5), (0, 1)))
        return self._gather(
            at.position[rows], at.normal[rows], at.flat[rows], pixel[origin], span, u, spot, seed, bounces, turn + 1
        )  # fmt: skip

    def _step(
        self, into: Light, piece, normal, flat, position, pixel, u, spot, seed, turn, bounces
    ) -> _Vertices | None:
        """One ray from each point of a piece: light of sky and emission that it meets, and its way, go into `into`, and so
        does what the last bounce brings; returns where it lands if it may go on from there."""
        surfaces, base = self.surfaces, _DIMENSIONS * turn
        directions = surfaces.scatter(normal, flat, u)
        chance = hash_uniform(pixel, base + 3, seed) if surfaces.any_see_through else None
        found = surfaces.land(surfaces.reflecting, position, directions, chance)
        first = into.first[piece]
        if self.sky is not None and len(found.missed):
            light = sky_radiance(self.sky, directions[found.missed]) * _PI
            first[found.missed] = light if found.missed_weight is None else light * found.missed_weight
        rows, triangle, u, v = found.rows, found.triangle, found.u, found.v
        into.way[piece][rows] = found.distance
        if bounces < 1 and not surfaces.looks.emits:
            return None
        heading = directions.take(rows, axis=0, mode="clip")
        hit = scaled(heading, found.distance)
        hit += position.take(rows, axis=0, mode="clip")
        normal, flat = surfaces.normals(triangle, u, v, heading)
        if surfaces.looks.emits:
            light = surfaces.looks.emission(triangle, u, v) * _PI
            first[rows] += light if found.weight is None else light * found.weight
        if bounces < 1:
            return None
        factor = surfaces.looks.albedo(triangle, u, v)
        np.minimum(factor, BRIGHTEST, out=factor)
        if found.weight is not None:
            factor *= found.weight
        hit += surfaces.offset * flat
        who = pixel[rows]
        if len(self.lamps):
            spot = spot if len(rows) == len(position) else spot.take(rows, axis=1, mode="clip")
            pick = hash_uniform(who, base + 2, seed) if len(self.lamps) > AT_BOUNCES else None
            light = self.lamps.irradiance(hit, normal, spot, pick, most=AT_BOUNCES)
        else:
            light = np.zeros_like(hit)
        unknown = np.ones(len(rows), bool)
        if self.bake is not None:
            known = np.flatnonzero(self.bake.holds(triangle, flat))
            unknown[known] = False
            read = self.bake.read(triangle[known], u[known], v[known])
            light[known] += sum(read).T
        if bounces == 1:
            light *= factor
            into.indirect[piece][rows] = light
            return None
        owner = surfaces.scene.triangle_object[triangle]
        return _Vertices(rows + piece.start, hit, normal, flat, factor, light, unknown, owner)


def _joined(vertices: list[_Vertices]) -> _Vertices:
    columns = {name: [getattr(at, name) for at in vertices] for name in _Vertices.__dataclass_fields__}
    joined = {name: np.concatenate(column) for name, column in columns.items() if name != "flat"}
    same = all(at.flat is at.normal for at in vertices)
    joined["flat"] = joined["normal"] if same else np.concatenate(columns["flat"])
    return _Vertices(**joined)


def _same(normal, flat, piece):
    """Parts of the normals; one array where both are one, which spares work."""
    part = normal[piece]
    return part, part if flat is normal else flat[piece]
