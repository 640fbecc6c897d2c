"""Where light can get: a flood of particles from lamps, sky and glowing faces, or from all fronts where none is yet.

Light stays out of solid things whether or not their meshes are closed, so what the flood finds tells the
back of a sheet, which light reaches, from the inside of a box, which it does not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..rays import Bvh, Hits, Transmission, chunks
from ..sampling import concentric_disk, cosine_hemisphere, frame, hash_uniform, spiral
from ..scene import Scene, used_rows
from ..surface import Patches
from ..threads import in_threads

PARTICLES = 32_768
BOUNCES = 12


@dataclass(frozen=True)
class Vertices:
    """Where particles of one bounce met surfaces. piece: (n,) int of the patches; behind: (n,) bool, on its reverse.
    place, normal: (n, 3) float32, the normal on the particle's side."""

    piece: np.ndarray
    behind: np.ndarray
    place: np.ndarray
    normal: np.ndarray


def flood(scene: Scene, patches: Patches, bvh: Bvh, offset: float, seed: int = 0) -> np.ndarray:
    """(2 × patches,) int64 particles that met each side of each patch: row 2p its front, 2p + 1 its back."""
    found = np.zeros(2 * len(patches), np.int64)
    for met in walk(scene, patches, bvh, offset, seed):
        found += np.bincount(2 * patches.patch[met.piece] + met.behind, minlength=len(found))
    return found


def walk(
    scene: Scene, patches: Patches, bvh: Bvh, offset: float, seed: int = 0, places: np.ndarray | None = None
) -> Iterator[Vertices]:
    """The particles' paths, bounce by bounce.

    places: (m, 3) m, where lamps may stand beside those of the scene.
    """
    origins, directions, guess = _sources(scene, patches, offset, seed, places)
    clear = Transmission(scene).see_through[patches.parent]
    cross = np.cross(patches.corners[:, 1] - patches.corners[:, 0], patches.corners[:, 2] - patches.corners[:, 0])
    # float64: millimetre scenes
    flat = (cross / np.maximum(np.linalg.norm(cross.astype(np.float64), axis=1, keepdims=True), 1e-300)).astype(
        np.float32
    )
    for bounce in range(BOUNCES):
        hits = _hits(bvh, np.ascontiguousarray(origins, np.float32), np.ascontiguousarray(directions, np.float32))
        met = np.flatnonzero(hits.triangle >= 0)
        if not len(met):
            break
        piece, ahead = hits.triangle[met], directions[met]
        behind = np.einsum("nd,nd->n", flat[piece], ahead) > 0
        if guess and bounce == 0:
            # a floor under a box sees nothing but the box's inside
            met, piece, ahead, behind = (v[~behind] for v in (met, piece, ahead, behind))
        place = origins[met] + ahead * hits.distance[met, None]
        normal = np.where(behind[:, None], -flat[piece], flat[piece])
        yield Vertices(piece, behind, place, normal)
        index = np.arange(len(met))
        spin = np.stack([hash_uniform(index, 3 * bounce + k, seed + 61) for k in (0, 1)], 1)
        local = cosine_hemisphere(spin)
        tangent, bitangent = frame(normal)
        scattered = local[:, :1] * tangent + local[:, 1:2] * bitangent + local[:, 2:] * normal
        passes = clear[piece] & (hash_uniform(index, 3 * bounce + 2, seed + 61) < 0.5)
        directions = np.where(passes[:, None], ahead, scattered).astype(np.float32)
        # back along its path as well: beside an edge, rounding may have put it behind the other face
        origins = place + np.where(passes[:, None], -normal, normal - 2 * ahead) * np.float32(offset)


def _hits(bvh, origins, directions):
    """Closest hits, on threads."""
    parts = in_threads(lambda s: bvh.hits(origins[s], directions[s]), chunks(len(origins)))
    return Hits(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _sources(scene, patches, offset, seed, places=None):
    """Origins and directions (n, 3) float32 of the flood's particles, and whether they are but a guess."""
    parts = []
    lamps = [light for light in scene.lights if light.kind != "SUN"]
    for light in lamps:
        around = spiral(PARTICLES // len(lamps))
        if light.kind == "AREA":
            around = around * np.where(around @ light.direction < 0, -1, 1)[:, None]
        parts.append((np.tile(light.position, (len(around), 1)), around))
    if places is not None and len(places):
        around = spiral(max(PARTICLES // len(places), 64))
        parts.append((np.repeat(places, len(around), axis=0), np.tile(around, (len(places), 1))))
    if (scene.sky is not None and not scene.sky.is_black) or any(light.kind == "SUN" for light in scene.lights):
        inward = spiral(PARTICLES)
        tangent, bitangent = frame(inward)
        index = np.arange(PARTICLES)
        disk = concentric_disk(np.stack([hash_uniform(index, k, seed + 62) for k in (0, 1)], 1))
        used = scene.positions[used_rows(scene.triangles, len(scene.positions))]
        middle, radius = 0.5 * (used.min(axis=0) + used.max(axis=0)), np.float32(0.5 * scene.extent)
        across = radius * (disk[:, :1] * tangent + disk[:, 1:] * bitangent)
        parts.append((middle + across - 2 * radius * inward, inward))
    glowing = np.flatnonzero(patches.emission.any(axis=1))
    if len(glowing):
        chosen = np.resize(glowing, max(PARTICLES // 4, 1)).astype(np.int32)
        samples = patches.sample(scene, chosen, seed + 63)
        around = spiral(len(chosen))
        around = np.random.default_rng(seed).permutation(around)
        # both faces of a glowing surface shine
        side = np.where(np.einsum("nd,nd->n", around, samples.flat) < 0, -1, 1)[:, None]
        lift = samples.flat * side * np.float32(1e-5 * scene.extent)
        parts.append((samples.position + lift, around))
    if guess := not parts:
        # no light yet: lamps will be put where the faces look
        samples = patches.sample(scene, np.resize(np.arange(len(patches), dtype=np.int32), PARTICLES), seed + 64)
        index = np.arange(PARTICLES)
        local = cosine_hemisphere(np.stack([hash_uniform(index, k, seed + 64) for k in (7, 8)], 1))
        tangent, bitangent = frame(samples.flat)
        ahead = local[:, :1] * tangent + local[:, 1:2] * bitangent + local[:, 2:] * samples.flat
        parts.append((samples.position + samples.flat * np.float32(offset), ahead))
    origins, directions = (np.concatenate(p).astype(np.float32) for p in zip(*parts, strict=True))
    return origins, directions, guess
