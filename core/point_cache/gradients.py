"""Gather at points what their neighbours need as well: how light changes with the normal and with the place.

Rotation and translation gradients from one stratified hemisphere (Ward & Heckbert 1992, Irradiance Gradients). All
are linear in what the rays land on, so they hold for panes as they do for light.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..rays import chunks, product3
from ..sampling import hash_uniform
from ..surface import SurfaceSamples
from ..threads import in_threads
from ..transfer import Begun, Gatherer
from ..transfer.gather import turns

POINTS = 256
"""Points gathered together."""

TOGETHER = 16
"""Directions that are traced together."""

LANDED = 1 << 25
"""Bytes of what rays land on that are added up together, at most."""

CLAMP = 2.0
"""Ray lengths count as this many times the point's radius at least: nearer things would shout."""

ROWS = 7
"""What a point holds of each column: the value, its gradient by the normal (3) and by the place (3)."""


def rings(rays: int) -> tuple[int, int]:
    """Rings and sectors of a hemisphere of about `rays` rays, whose cells are about as long as wide."""
    count = max(2, round(np.sqrt(rays / np.pi)))
    return count, max(4, round(rays / count))


def gather_gradients(
    gatherer: Gatherer,
    points: SurfaceSamples,
    radius: np.ndarray,
    tables: np.ndarray,
    rays: int,
    seed: int,
    tick: Callable[[int], None] | None = None,
    point: np.ndarray | None = None,
    table: np.ndarray | None = None,
    begun: Begun | None = None,
) -> np.ndarray:
    """(m, ROWS, c) float32: mean of table rows over what points' rays land on, and its gradients.

    radius: (n,) m. tables: (t, ids, c) float32, a row per id of the gatherer. point, table: (m,) which point with which
    table, sorted by point; each point with the first table if not given. begun: of the same gather, ended before its
    time, from which it goes on. The gradient by the normal, g, gives
    value + (n' − n) · g at normal n'; that by the place, 1/m, gives value + (x' − x) · g at place x'.
    """
    inner, around = rings(rays)
    if point is None or table is None:
        point, table = np.arange(len(points)), np.zeros(len(points), np.int64)
    ids_of_table, columns = tables.shape[1:]
    flat_tables = tables.reshape(-1, columns)
    begun = Begun() if begun is None else begun
    result = begun.rows_of((len(point), ROWS, columns))
    smooth = bool((np.einsum("nd,nd->n", points.normal, points.flat) < 0.9999).any())

    def part(piece):
        count = piece.stop - piece.start
        pattern = _pattern(inner, around, piece.start, seed)
        frames = turns(points.normal[piece], piece, seed)
        origins = points.position[piece] + points.flat[piece] * np.float32(gatherer.offset)
        flat = np.ascontiguousarray(points.flat[piece].T) if smooth else None
        ids = np.empty((inner * around, count), np.int32)
        far = np.empty((inner * around, count), np.float32)
        for s in chunks(len(pattern), TOGETHER):
            ids[s], far[s] = _land(gatherer, origins, flat, pattern[s], frames)
        far = np.maximum(far, np.float32(CLAMP) * radius[piece])
        shares = _shares(far.reshape(inner, around, count), pattern.reshape(inner, around, 3))
        shares = np.ascontiguousarray(shares.transpose(2, 0, 1))
        tangents = frames[:2].transpose(1, 0, 2)
        begin, end = np.searchsorted(point, [piece.start, piece.stop])
        step = min(POINTS, max(LANDED // (inner * around * columns * 4), 1))
        for at in range(int(begin), int(end), step):
            mine = slice(at, min(at + step, int(end)))
            own = point[mine] - piece.start
            landed = flat_tables.take(ids.T[own] + table[mine, None] * ids_of_table, axis=0)
            found = np.matmul(shares[own], landed)
            result[mine, 0] = found[:, 0]
            result[mine, 1:4] = np.einsum("nac,nad->ndc", found[:, 1:3], tangents[own])
            result[mine, 4:7] = np.einsum("nac,nad->ndc", found[:, 3:5], tangents[own])
        begun.done.add(piece.start)
        if tick is not None:
            tick(inner * around * count)

    in_threads(part, [piece for piece in chunks(len(points), POINTS) if piece.start not in begun.done])
    return result


def _land(gatherer, origins, flat, pattern, frames):
    """Ids and distances, (k, n) each, of k directions of a pattern (k, 3) from n points."""
    shape = len(pattern), len(origins)
    directions = product3(pattern, frames.reshape(3, -1)).reshape(-1, 3)
    flat = None if flat is None else np.tile(flat, shape[0])
    ids, far = gatherer.land(np.tile(origins, (shape[0], 1)), directions, flat)
    return ids.reshape(shape), far.reshape(shape)


def _pattern(inner, around, start, seed):
    """(rays, 3) float32 cosine directions, one in each cell; inner rings first."""
    index = np.arange(inner * around) + start * 8191
    depth = (np.repeat(np.arange(inner), around) + hash_uniform(index, 21, seed)) / inner
    angle = (np.tile(np.arange(around), inner) + hash_uniform(index, 22, seed)) * (2 * np.pi / around)
    sine = np.sqrt(depth)
    return np.stack([sine * np.cos(angle), sine * np.sin(angle), np.sqrt(1 - depth)], 1).astype(np.float32)


def _shares(far, pattern):
    """(5, rays, n) float32: what each ray adds to the value and, in the frame's plane, to the two gradients.

    far: (rings, sectors, n) m; pattern: (rings, sectors, 3).
    """
    inner, around, count = far.shape
    rays = inner * around
    shares = np.zeros((5, inner, around, count), np.float32)
    shares[0] = 1 / rays
    shares[1:3] = (np.moveaxis(pattern[..., :2], -1, 0) / np.maximum(pattern[..., 2], 1e-3) / rays)[..., None]
    middle = (np.arange(around) + 0.5) * (2 * np.pi / around)
    left = np.arange(around) * (2 * np.pi / around)
    edge = np.sqrt(np.arange(inner + 1) / inner)
    # across the ring's inner border: what is farther out comes in as one steps towards it
    outward = (2 / around * edge[1:-1] * (1 - edge[1:-1] ** 2))[:, None, None] / np.minimum(far[1:], far[:-1])
    # across the border to the sector before
    sideways = ((edge[1:] - edge[:-1]) / np.pi)[:, None, None] / np.minimum(far, np.roll(far, 1, axis=1))
    for axis, (u, v) in enumerate(((np.cos(middle), -np.sin(left)), (np.sin(middle), np.cos(left)))):
        step = outward * u[None, :, None]
        shares[3 + axis, 1:] += step
        shares[3 + axis, :-1] -= step
        step = sideways * v[None, :, None]
        shares[3 + axis] += step
        shares[3 + axis] -= np.roll(step, -1, axis=1)
    return shares.reshape(5, rays, count)
