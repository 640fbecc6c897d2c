"""The transport between entries, and all bounces by a linear solve.

Radiosity x = ρ (b + F x) + e, with b the direct irradiance of the entries, ρ their albedo, e what they
emit, and F the form factors (design, "Gather, then solve").
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..caustics.bending import Bending
from ..rays import CHUNK, Bvh
from ..scene import Scene
from ..surface import Patches
from .entries import MAX_ALBEDO, PLACES, Entries
from .gather import Gatherer
from .onward import find_bending
from .pairs import far_pairs, sample_pairs
from .spots import Spots

PAIR_SAMPLES = 2
"""Rays between each pair of entries at middling distance."""

PAIR_ERROR = 0.005
"""Relative error of a row's sum over sampled pairs."""


class Bounces:
    """All bounces, by what `arriving` says of one."""

    @abstractmethod
    def arriving(self, values: np.ndarray) -> np.ndarray:
        """(n, c) float32 irradiance by radiosity `values` (n, c)."""

    def solve(self, albedo: np.ndarray, source: np.ndarray, tolerance: float = 1e-4) -> np.ndarray:
        """Radiosity (n, c) of all bounces, W/m², for `source` (n, c): light that leaves the entries first.

        albedo: (n, c) or (n, 1), below 1. Neumann series until a bounce adds less than `tolerance` of all bounces
        before it in every column, at most 1000 bounces.
        """
        total = source.astype(np.float32)
        bounce = total
        # sums, not maxima: a lamp near a surface makes one entry shine a thousand times brighter than what it lights
        gained = np.zeros(total.shape[1], np.float32)
        for _ in range(1000):
            bounce = albedo * self.arriving(bounce)
            total = total + bounce
            gained += bounce.sum(axis=0)
            if (bounce.sum(axis=0) <= tolerance * gained).all():
                break
        return total


@dataclass(frozen=True)
class Transport(Bounces):
    """between: (n, n) float32, the part of the cosine-weighted hemisphere of entry i that entry j fills.
    sky: (n, k) float32, the part that each bin of the sky fills."""

    between: np.ndarray
    sky: np.ndarray

    def __len__(self) -> int:
        return len(self.sky)

    def arriving(self, values: np.ndarray) -> np.ndarray:
        """(n, c) float32 irradiance by radiosity `values` (n, c)."""
        return self.between @ values

    def from_sky(self, values: np.ndarray) -> np.ndarray:
        """(n, c) float32 irradiance by the sky's bins, `values` (k, c) π · radiance."""
        return self.sky @ values

    def leaving(self, rows: np.ndarray | slice, values: np.ndarray) -> np.ndarray:
        """(k, n) float32: what `values` (rows, k) of entries `rows` make of each one's radiosity, values.T @ between[rows]."""
        return values.T @ self.between[rows]

    def spots(self, rows: np.ndarray, glow: np.ndarray) -> Spots:
        """Single entries of radiosity `glow` (n,), as `rows` see them."""
        return Spots(self.between[rows] * glow, lambda values: glow[:, None] * values)


def make_transport(
    entries: Entries,
    gatherer: Gatherer,
    rays: int,
    seed: int = 0,
    tick: Callable[[int], None] | None = None,
) -> Transport:
    """Form factors: near pairs by where `rays` cosine rays of each entry land, far pairs by sampling the pair; what comes
    by mirrors and glass, by such rays alone.

    Reciprocity, A_i F_ij = A_j F_ji, makes one estimate of both directions.
    """
    count, columns = len(entries), gatherer.size
    places, points = PLACES, entries.places
    each = max(1, rays // places)
    counts = np.zeros((count, columns), np.float32)
    share = CHUNK // places
    pending: dict[int, list[np.ndarray]] = {}
    going: dict[int, list[np.ndarray]] = {}
    bent: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    blocks = -(-each // 16)

    def consume(piece, ids):
        blocks_here = pending.setdefault(piece.start, [])
        row = (np.arange(ids.shape[1], dtype=np.int32) // places) * columns
        if gatherer.bends:
            ids, keys = _apart(ids, columns, count, piece.start // places, places)
            going.setdefault(piece.start, []).append(keys)
        blocks_here.append((ids + row).reshape(-1))
        if len(blocks_here) == blocks:
            if gatherer.bends:
                bent[piece.start] = np.unique(np.concatenate(going.pop(piece.start)), return_counts=True)
            keys = np.concatenate(pending.pop(piece.start))
            rows = -(-ids.shape[1] // places)
            first = piece.start // places
            found = np.bincount(keys, minlength=rows * columns).reshape(rows, columns)
            np.multiply(found, np.float32(1 / (each * places)), out=counts[first : first + rows], casting="unsafe")

    assert share * places == CHUNK
    gatherer.gather(points, each, seed + 32, consume, tick, apart=gatherer.bends)
    between = counts[:, :count]
    sky = np.ascontiguousarray(counts[:, count + 1 :])
    # what the hemisphere's rays say about the sum over all entries is exact where no ray escapes
    reach = between.sum(axis=1)
    roundabout = _pairs_of(bent, count, each * places)
    reach += np.bincount(roundabout[0], roundabout[2], count).astype(np.float32)
    samples = [points.take(np.arange(count) * places + k) for k in range(PAIR_SAMPLES)]
    size = entries.span()
    terms = sample_pairs(samples, size, gatherer.offset, gatherer.visible, tick)
    # by which reciprocity holds: of what is see-through others see only the opaque part
    area = entries.area.astype(np.float32) * entries.opaque
    middle = entries.position - entries.position.mean(axis=0)
    for start in range(0, count, 512):
        # block by block of the upper triangle, in place: a second full matrix would double the memory
        rows = slice(start, min(start + 512, count))
        for left in range(start, count, 512):
            cols = slice(left, min(left + 512, count))
            # each direction weighted by its certainty: a sliver that few rays of a large entry find must not
            # be given more light than there is
            mean = (between[rows, cols] + between[cols, rows].T) / (area[rows, None] + area[cols])
            mean = np.where(far_pairs(middle, size, rows, cols), terms[rows, cols], mean)
            between[rows, cols] = mean * area[cols]
            between[cols, rows] = mean.T * area[rows]
    between = np.ascontiguousarray(between)
    row, col, part = roundabout
    if gatherer.both_ways:
        mean = (part / (area[row] + area[col])).astype(np.float32)
        between[row, col] += mean * area[col]
        between[col, row] += mean * area[row]
    else:
        between[row, col] += part.astype(np.float32)
    _balance(between, reach, each * places)
    return Transport(between, sky)


def _apart(ids, columns, count, first, places):
    """Ids (rows, m) without those of rays that were bent and landed on entries, dead ends in their stead; and (k,) int64
    entry from × count + entry to of these. first: the entry of the first `places` of the m points."""
    row, point = np.nonzero(ids >= columns)
    to = ids[row, point] - columns
    on = to < count
    ids = ids.copy()
    ids[row, point] = np.where(on, count, to)
    return ids, (first + point[on] // places) * np.int64(count) + to[on]


def _pairs_of(found, count, rays):
    """(p,) entry from, (p,) entry to and (p,) float64 part of the `rays` of each: of keys as from `_apart` and how often
    each was found, for pieces of their own entries."""
    keys, times = np.zeros(0, np.int64), np.zeros(0)
    if found:
        keys, times = (np.concatenate([found[k][part] for k in sorted(found)]) for part in (0, 1))
    return *np.divmod(keys, count), times / rays


def _balance(between: np.ndarray, reach: np.ndarray, rays: int) -> None:
    """Scale in place, symmetrically, so that rows sum to what their rays say: no light appears or is lost (Sinkhorn).

    reach: (n,) part of each entry's `rays` that landed on entries. It is exact where none escaped; elsewhere it and
    the sum of the pairs are two estimates, weighted by their certainty.
    """
    found = between.sum(axis=1)
    # the rays are stratified: about a quarter of the binomial variance
    of_rays = reach * (1 - reach) / (4 * rays)
    of_pairs = np.square(PAIR_ERROR * found)
    target = np.where(found > 0, (reach * of_pairs + found * of_rays) / np.maximum(of_pairs + of_rays, 1e-30), reach)
    target = np.minimum(target, 1).astype(np.float32)
    scale = np.ones(len(reach), np.float32)
    for _ in range(8):
        found = scale * (between @ scale)
        scale *= np.sqrt(np.where(found > 0, target / np.maximum(found, 1e-20), 1))
    # a row that all but nothing reaches must not be blown up
    np.clip(scale, 0.7, 1.4, out=scale)
    between *= scale[:, None]
    between *= scale
    # what could not be balanced may at least not multiply light: the solve would diverge
    over = np.flatnonzero(between.sum(axis=1) > 1 / MAX_ALBEDO)
    between[over] /= between[over].sum(axis=1, keepdims=True)


def make_gatherer(
    scene: Scene,
    patches: Patches,
    entries: Entries,
    bvh: Bvh,
    offset: float,
    bins: tuple[int, int] = (1, 1),
    bending: Bending | None = None,
) -> Gatherer:
    """Rays that name entries: ids 0 … n−1; n is a dead end; the sky follows.

    A side that no path needs shares its other side's entry. bending: the scene's mirrors and glass, looked for if not given.
    """
    front, back, bare = _sides(patches, entries)
    bending = bending or find_bending(scene)
    return Gatherer(scene, patches, bvh, front, back, len(entries) + 1, bins, offset, bare, bending)


def make_piece_gatherer(
    scene: Scene,
    patches: Patches,
    entries: Entries,
    bvh: Bvh,
    offset: float,
    bins: tuple[int, int] = (1, 1),
    bending: Bending | None = None,
) -> tuple[Gatherer, np.ndarray]:
    """Rays that name sides of pieces: 2k and 2k + 1 of piece k, then a dead end and the sky as in `make_gatherer`.

    Also (2 × pieces,) int32 the entry of each side, n for none.
    """
    front, back, bare = _sides(patches, entries)
    piece = 2 * np.arange(len(front), dtype=np.int32)
    other, miss = piece + (front != back), 2 * len(front) + 1
    bending = bending or find_bending(scene)
    gatherer = Gatherer(scene, patches, bvh, piece, other, miss, bins, offset, bare, bending)
    return gatherer, np.stack([front, back], 1).reshape(-1)


def _sides(patches, entries):
    """Entry of each piece's front and back, and which of them are bare of one."""
    front, back = entries.front_id[patches.patch], entries.back_id[patches.patch]
    none = len(entries)
    bare = front == none, back == none
    return np.where(bare[0], back, front), np.where(bare[1], front, back), bare
