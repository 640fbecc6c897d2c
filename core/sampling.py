"""Points, hashes and warps: everything random in Lightpanes comes from here, and all of it from seeds.

Points lie in [0, 1)². A warp maps them to directions or places; its density stands beside it, as a
function of what the warp returns. The tests check one against the other.
"""

from __future__ import annotations

import numpy as np

GOLDEN = 0.6180339887498949
"""1/φ: its multiples modulo 1 are the most even sequence on a line."""

PLASTIC = (0.7548776662466927, 0.5698402909980532)
"""1/ρ and 1/ρ², ρ the plastic number: the plane's counterpart (Roberts, 2018, sequence R2)."""

BELOW_ONE = np.float32(1 - 2**-24)


def hash_uint32(index: np.ndarray, dimension: int = 0, seed: int = 0) -> np.ndarray:
    """Integer hash of a counter: no state, so any index can be drawn on its own.

    index: integers of any shape, 64 bits are used. dimension, seed: independent streams.
    Returns uint32 of the index's shape. Mixer: Wellons' lowbias32, twice.
    """
    index = np.asarray(index)
    state = index.astype(np.uint32)
    if index.dtype.itemsize > 4 and index.size and int(index.max()) >> 32:
        state ^= _mix((index.astype(np.uint64) >> np.uint64(32)).astype(np.uint32))
    # a stream's key is added between two mixes, so that streams are not shifts of one another
    key = _mix(np.array([(int(seed) ^ int(seed) >> 32) & 0xFFFFFFFF], np.uint32))
    key = _mix(key + np.uint32((int(dimension) * 0x9E3779B9) & 0xFFFFFFFF))
    state = _mix(state)
    state += key[0]
    return _mix(state)


def _mix(state: np.ndarray) -> np.ndarray:
    """lowbias32, in place."""
    state ^= state >> np.uint32(16)
    state *= np.uint32(0x7FEB352D)
    state ^= state >> np.uint32(15)
    state *= np.uint32(0x846CA68B)
    state ^= state >> np.uint32(16)
    return state


def hash_uniform(index: np.ndarray, dimension: int = 0, seed: int = 0) -> np.ndarray:
    """float32 in [0, 1), uniform, of the index's shape; see `hash_uint32`."""
    return (hash_uint32(index, dimension, seed) >> np.uint32(8)).astype(np.float32) * np.float32(2**-24)


def r2_points(count: int, seed: int = 0, start: int = 0) -> np.ndarray:
    """(count, 2) float32 in [0, 1): the R2 sequence from index `start`, shifted by the seed.

    Progressive: a longer sequence begins with the shorter one.
    """
    index = np.arange(start, start + count, dtype=np.float64)[:, None]
    return _fraction(index * np.array(PLASTIC) + _shift(seed))


def hammersley_points(count: int, seed: int = 0) -> np.ndarray:
    """(count, 2) float32 in [0, 1): a golden-ratio lattice, shifted by the seed.

    More even than `r2_points`, but its size is fixed. Rows are stratified in the first coordinate,
    and stay so under any shift modulo 1 (Cranley-Patterson rotation).
    """
    index = np.arange(count, dtype=np.float64)
    lattice = np.stack([index / max(count, 1), index * GOLDEN], axis=1)
    return _fraction(lattice + _shift(seed))


def _shift(seed: int) -> np.ndarray:
    return np.array([hash_uniform(np.zeros(1, np.uint32), d, seed)[0] for d in (0, 1)], np.float64)


def _fraction(values: np.ndarray) -> np.ndarray:
    # rounding to float32 may reach 1
    return np.minimum((values - np.floor(values)).astype(np.float32), BELOW_ONE)


def frame(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tangent and bitangent, two (n, 3) float32, that make right-handed frames with unit normals (n, 3)."""
    tangent, bitangent = frame_parts(*np.asarray(normals, np.float32).T)
    return np.stack(tangent, axis=1), np.stack(bitangent, axis=1)


def frame_parts(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The same by components: three of the tangent and three of the bitangent, from those of the unit normals.

    Branchless and exact near −Z (Duff et al., Building an Orthonormal Basis, Revisited, 2017).
    """
    sign = np.copysign(np.float32(1), z)
    a = -1 / (sign + z)
    b = x * y * a
    return [1 + sign * x * x * a, sign * b, -sign * x], [b, sign + y * y * a, -y]


def concentric_disk(u: np.ndarray) -> np.ndarray:
    """(n, 2) points of the unit disk from (n, 2) of the square; keeps strata compact (Shirley, Chiu 1997)."""
    a, b = (2 * np.asarray(u, np.float32) - 1).T
    flip = np.abs(a) < np.abs(b)
    radius = np.where(flip, b, a)
    ratio = np.where(flip, a, b) / np.where(radius == 0, np.float32(1), radius)
    angle = np.float32(np.pi / 4) * ratio
    angle = np.where(flip, np.float32(np.pi / 2) - angle, angle)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def concentric_disk_pdf(points: np.ndarray) -> np.ndarray:
    """(n,) density by area of `concentric_disk` at (n, 2) points."""
    return np.where((points**2).sum(axis=1) <= 1, np.float32(1 / np.pi), np.float32(0))


def cosine_hemisphere(u: np.ndarray) -> np.ndarray:
    """(n, 3) unit directions around +Z in proportion to their cosine, from (n, 2) points (Malley)."""
    disk = concentric_disk(u)
    z = np.sqrt(np.maximum(1 - (disk**2).sum(axis=1), 0))
    return np.column_stack([disk, z])


def cosine_hemisphere_pdf(directions: np.ndarray) -> np.ndarray:
    """(n,) density by solid angle of `cosine_hemisphere`, 1/sr."""
    return np.maximum(directions[:, 2], 0) / np.float32(np.pi)


def uniform_sphere(u: np.ndarray) -> np.ndarray:
    """(n, 3) unit directions, all alike, from (n, 2) points."""
    return uniform_cone(u, -1.0)


def uniform_sphere_pdf(directions: np.ndarray) -> np.ndarray:
    """(n,) density by solid angle of `uniform_sphere`, 1/sr."""
    return np.full(len(directions), 1 / (4 * np.pi), np.float32)


def uniform_cone(u: np.ndarray, cosine: float) -> np.ndarray:
    """(n, 3) unit directions, all alike, within a cone around +Z; cosine: of its half angle."""
    u = np.asarray(u, np.float32)
    # in 1 − z, which keeps its digits in narrow cones
    depth = u[:, 0] * np.float32(1 - cosine)
    radius = np.sqrt(depth * (2 - depth))
    angle = np.float32(2 * np.pi) * u[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), 1 - depth], axis=1)


def uniform_cone_pdf(directions: np.ndarray, cosine: float) -> np.ndarray:
    """(n,) density by solid angle of `uniform_cone`, 1/sr."""
    return np.where(directions[:, 2] >= cosine, np.float32(1 / (2 * np.pi * (1 - cosine))), np.float32(0))


def uniform_triangle(u: np.ndarray) -> np.ndarray:
    """(n, 2) barycentric weights of the second and third corner, uniform by area (Heitz 2019, continuous)."""
    a, b = np.asarray(u, np.float32).T
    low = a < b
    first = np.where(low, a * np.float32(0.5), a - b * np.float32(0.5))
    second = np.where(low, b - a * np.float32(0.5), b * np.float32(0.5))
    return np.stack([first, second], axis=1)


def uniform_triangle_pdf(weights: np.ndarray) -> np.ndarray:
    """(n,) density of `uniform_triangle` over the barycentric plane; divide by twice the area for 1/m²."""
    inside = (weights >= 0).all(axis=1) & (weights.sum(axis=1) <= 1)
    return np.where(inside, np.float32(2), np.float32(0))


def spiral(count: int) -> np.ndarray:
    """(count, 3) float32 unit directions spread evenly over the sphere (a golden spiral)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.arange(count) * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], 1).astype(np.float32)
