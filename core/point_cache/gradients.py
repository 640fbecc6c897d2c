"""Gather at points what their neighbours need as well: how light changes with the normal and with the place.

Rotation and translation gradients from one stratified hemisphere (Ward & Heckbert 1992, Irradiance Gradients). All
are linear in what the rays land on, so they hold for panes as they do for light.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..rays import in_threads, product3
from ..sampling import hash_uniform
from ..surface import SurfaceSamples
from ..transfer import Gatherer
from ..transfer.gather import turns

POINTS = 512
"""Points gathered together."""

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
    starts: np.ndarray,
    tables: np.ndarray,
    rays: int,
    seed: int,
    tick: Callable[[int], None] | None = None,
) -> np.ndarray:
    """(n, ROWS, c) float32: mean of table rows over what each point's rays land on, and its gradients.

    points: sorted by region; radius: (n,) m; starts: (regions + 1,), tables: (regions, ids, c) as for
    `exits.gather_panes`. The gradient by the normal, g, gives value + (n' − n) · g at normal n'; that by the place,
    1/m, gives value + (x' − x) · g at place x'.
    """
    inner, around = rings(rays)
    result = np.empty((len(points), ROWS, tables.shape[2]), np.float32)
    smooth = bool((np.einsum("nd,nd->n", points.normal, points.flat) < 0.9999).any())

    def part(piece):
        count = piece.stop - piece.start
        pattern = _pattern(inner, around, piece.start, seed)
        frames = turns(points.normal[piece], piece, seed)
        origins = np.ascontiguousarray(points.position[piece] + points.flat[piece] * np.float32(gatherer.offset))
        flat = np.ascontiguousarray(points.flat[piece].T) if smooth else None
        ids = np.empty((inner * around, count), np.int32)
        far = np.empty((inner * around, count), np.float32)
        for row, direction in enumerate(pattern):
            directions = product3(direction[None], frames.reshape(3, -1)).reshape(count, 3)
            ids[row], far[row] = gatherer.land(origins, directions, flat)
        far = np.maximum(far, np.float32(CLAMP) * radius[piece])
        shares = _shares(far.reshape(inner, around, count), pattern.reshape(inner, around, 3))
        first = int(np.searchsorted(starts, piece.start, side="right")) - 1
        at = piece.start
        while at < piece.stop:
            end = min(int(starts[first + 1]), piece.stop)
            if end > at:
                own = slice(at - piece.start, end - piece.start)
                landed = tables[first].take(ids[:, own].T, axis=0)
                result[at:end, :5] = np.einsum("arn,nrc->nac", shares[..., own], landed, optimize=True)
            at = end
            first += 1
        found = result[piece, :5].copy()
        tangents = frames[:2].transpose(1, 0, 2)
        result[piece, 1:4] = np.einsum("nac,nad->ndc", found[:, 1:3], tangents)
        result[piece, 4:7] = np.einsum("nac,nad->ndc", found[:, 3:5], tangents)
        if tick is not None:
            tick(inner * around * count)

    in_threads(part, _pieces(starts))
    return result


def _pieces(starts):
    """Slices of at most POINTS points."""
    return [slice(s, min(s + POINTS, int(starts[-1]))) for s in range(0, int(starts[-1]), POINTS)]


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
