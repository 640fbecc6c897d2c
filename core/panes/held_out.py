"""Lamps that a bake is judged by, none of which it was trained on.

What users do with a bake is move their lamps: half of the judges are the scene's own live lamps, moved about; the others
are point lamps anywhere in the air. None of them is closer to a surface than CLEAR. A few lamps in nooks err many times as
much as all others, so judges are not drawn by chance: of many lamps, sorted by how unevenly they light the scene, they are
every so many-th one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..sampling import frame, hash_uniform
from ..scene import Light, Scene
from ..surface import SurfaceSamples
from ..transfer import Gatherer
from .training import free_air, point_lamps, room_around

CLEAR = 0.03
"""Least distance of judging lamps from surfaces, in parts of the scene's extent."""

REACH = 0.15
"""How far the scene's own lamps are moved at most, in parts of the extent."""

TRIES = 24
"""Places that each lamp is tried at; one that fits nowhere stays."""

TURN = np.radians(25)
"""How far suns are turned at most. A sun that gets in by a slit alone is another matter than the one that the user has."""

SUN_PLACES = 512
"""Places that tell how much of a sun gets to the scene."""


def held_out_lamps(
    scene: Scene, points: SurfaceSamples, gatherer: Gatherer, count: int, seed: int
) -> tuple[list[Light], np.ndarray]:
    """`count` lamps: the scene's own live ones moved about, and point lamps anywhere in the air, in turns; and (l,) bool,
    which are the scene's own.

    points: places on the entries, from which the air is found. Suns turn to where they still reach them. Fewer where
    the scene has no room.
    """
    live = [light for light in scene.lights if light.live]
    half = count // 2 if live else 0
    own = [_moved(live[k % len(live)], scene, points, gatherer, k, seed) for k in range(half)]
    chosen = np.sort(np.random.default_rng(seed + 29).integers(0, len(points), 8 * count + 64))
    air = free_air(points.take(chosen), gatherer.bvh, scene.extent, seed + 31)
    room = room_around(air, gatherer)
    rank = hash_uniform(np.arange(len(air)), 7, seed)
    # where it is narrow, the roomiest places come first
    order = np.lexsort((rank, -np.minimum(room, CLEAR * scene.extent)))
    anywhere = point_lamps(air[order[: count - half]][room[order[: count - half]] > 0])
    lamps = _in_turns(own, anywhere)
    return lamps, np.array(_in_turns([True] * len(own), [False] * len(anywhere)), bool)


def representative(lamps: list[Light], own: np.ndarray, uneven: np.ndarray, count: int) -> list[Light]:
    """`count` of many lamps, as from `held_out_lamps`: of the scene's own, (l,) bool, and of the others the middle ones of
    as many parts, sorted by `uneven` (l,). They stay in turns."""
    mine, others = np.flatnonzero(own), np.flatnonzero(~own)
    many = min(count // 2, len(mine)) if len(others) else min(count, len(mine))
    chosen = []
    for group, part in ((mine, many), (others, min(count - many, len(others)))):
        middle = ((np.arange(part) + 0.5) * len(group) / max(part, 1)).astype(np.int64)
        chosen.append([lamps[group[k]] for k in np.argsort(uneven[group], kind="stable")[middle]])
    return _in_turns(*chosen)


def _in_turns(some, others):
    """One of each list after the other, then what is left of the longer one."""
    pairs = [one for pair in zip(some, others, strict=False) for one in pair]
    least = min(len(some), len(others))
    return pairs + some[least:] + others[least:]


def _moved(light: Light, scene: Scene, points: SurfaceSamples, gatherer: Gatherer, number: int, seed: int) -> Light:
    """A lamp somewhere around where it is, but in the same room."""
    if light.kind == "SUN":
        return _turned(light, scene, points, gatherer, number, seed)
    direction, part = _directions(number, seed)
    origin = np.tile(light.position.astype(np.float32), (TRIES, 1))
    free = np.minimum(gatherer.bvh.hits(origin, direction).distance, REACH * scene.extent)
    places = origin + direction * (free * np.cbrt(part))[:, None].astype(np.float32)
    fits = np.flatnonzero(room_around(places, gatherer) > CLEAR * scene.extent)
    if not len(fits):
        return light
    matrix = light.matrix.copy()
    matrix[:3, 3] = places[fits[0]]
    return replace(light, matrix=matrix)


def _turned(light, scene, points, gatherer, number, seed):
    """A sun turned a little, but so that no less than half as much of it gets to the scene."""
    around, _ = _directions(number, seed)
    own = -light.direction
    toward = own + np.tan(TURN) * np.concatenate([np.zeros((1, 3)), around])
    toward = (toward / np.linalg.norm(toward, axis=1, keepdims=True)).astype(np.float32)
    some = points.take(np.linspace(0, len(points) - 1, SUN_PLACES).astype(np.int64))
    origin = some.position + some.flat * np.float32(1e-4 * scene.extent)
    share = np.empty(len(toward))
    for k, axis in enumerate(toward):
        facing = np.maximum(some.normal @ axis, 0)
        free = gatherer.bvh.hits(origin, np.tile(axis, (len(origin), 1))).triangle < 0
        share[k] = (facing * free).mean()
    fits = np.flatnonzero((share[1:] >= 0.5 * share[0]) & (share[1:] > 0))
    if not len(fits):
        return light
    axis = toward[1 + fits[0]]
    side, up = (v[0] for v in frame(axis[None]))
    matrix = light.matrix.copy()
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = side, up, axis
    return replace(light, matrix=matrix)


def _directions(number, seed):
    """(TRIES, 3) float32 unit directions of a lamp, and (TRIES,) in [0, 1) how far along them."""
    index = np.arange(TRIES) + TRIES * number
    z, angle = 2 * hash_uniform(index, 1, seed) - 1, 2 * np.pi * hash_uniform(index, 2, seed)
    ring = np.sqrt(1 - z * z)
    around = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], 1).astype(np.float32)
    return around, hash_uniform(index, 3, seed)
