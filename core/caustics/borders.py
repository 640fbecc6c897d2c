"""Where one way of the light ends and another begins: borders across patches whose photons differ, found by bisection.

Four photons of a quad that went different ways tell that a border runs between them, and where to half a step. One more
halfway along an edge that it crosses halves that, where refining the patch takes ten photons; and it says how the beam
ends. What each way has of the quad is cut out as marching squares do (Lorensen and Cline, 1987, in the plane).
"""

from __future__ import annotations

import numpy as np

from .quadtree import LEVELS, Forest, kinds_of

LONE = 3.0
"""Texels that a photon is spread over, in each direction, at most, when nothing says how wide its beam is."""

QUADS = np.array([[0, 1, 3, 4], [1, 2, 4, 5], [3, 4, 6, 7], [4, 5, 7, 8]])
"""The four quads of a patch; of each corner k, k ^ 1 is across one side and k ^ 2 across the other."""

RISE = 2.0
"""A way's power at its end is at most so many times that of the photon next to it."""

_PLACE = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.float32)


def lands_in_atlas(signature: np.ndarray) -> np.ndarray:
    """Whether photons with such signatures (see Forest) landed where texels are; any shape."""
    return (signature > 0) & (signature & 1 == 1)


def sharpen(forest: Forest, photons: float) -> bool:
    """Trace about so many photons along the edges that borders cross, where most power is at stake. False where there is
    nothing to do. A border that is found already costs none."""
    signature = forest.photons.signature
    _, divided = kinds_of(signature[forest.corner])
    rows = np.flatnonzero(divided & (forest.level < LEVELS))
    power = forest.photons.carried[forest.corner[rows]].max(axis=1) * forest.measure[rows]
    rows = rows[np.argsort(-power, kind="stable")]
    corners = forest.corner[rows][:, QUADS].reshape(-1, 4)
    one = corners[:, [0, 2, 0, 1]].ravel()
    other = corners[:, [1, 3, 2, 3]].ravel()
    crossed = (signature[one] != signature[other]) & (lands_in_atlas(signature[one]) | lands_in_atlas(signature[other]))
    pairs = np.stack([one[crossed], other[crossed]], 1)
    # each edge once, the strongest first
    name = np.minimum(*pairs.T).astype(np.int64) * len(signature) + np.maximum(*pairs.T)
    _, first = np.unique(name, return_index=True)
    pairs = pairs[np.sort(first)[: max(0, int(photons))]]
    if not len(pairs):
        return False
    before = len(forest.photons)
    forest.halfway(*pairs.T)
    return len(forest.photons) > before


def pieces(
    forest: Forest, values: np.ndarray, corner: np.ndarray, share: np.ndarray, sharp: np.ndarray, lead: int = 2
) -> tuple[np.ndarray, np.ndarray]:
    """What each way that lands has of quads whose corners differ: (4, m, 2 + c) vertices, the first of which is a photon
    on the way, and (m,) rows of those photons.

    values: (n, 2 + c) float32 of all photons, places in texels and W. corner: (q, 4) rows of photons. share: (q,) float32
    part of its square that each quad is. sharp: (q,) bool, edges may have been bisected.
    """
    signature = forest.photons.signature[corner]
    lands = lands_in_atlas(signature)
    # beside[a]: whether the neighbour along side a went the same way
    beside = [signature == signature[:, np.arange(4) ^ side] for side in (1, 2)]
    across = signature == signature[:, ::-1]
    reach, end = _ends(forest, values, corner, lands, beside, sharp, lead)
    own = values[corner]
    beams, rows = [], []

    def add(quad, k, places, vertices):
        beams.append(_beam(places, vertices, share[quad], lead))
        rows.append(corner[quad, k])

    for k in range(4):
        n = k ^ 1, k ^ 2
        way = _PLACE[[*n]] - _PLACE[k]
        free = [lands[:, k] & ~same[:, k] for same in beside]
        joined = [lands[:, k] & same[:, k] for same in beside]
        # alone: a corner cut off, or where more than two ways meet a rectangle
        alone = free[0] & free[1]
        cut = alone & (signature[:, n[0]] == signature[:, n[1]]) & (signature[:, n[0]] == signature[:, k ^ 3])
        for kind, part in ((cut, 0.5), (alone & ~cut, 1.0)):
            q = np.flatnonzero(kind)
            places = [np.broadcast_to(_PLACE[k], (len(q), 2))]
            places += [_PLACE[k] + reach[q, k, a, None] * way[a] for a in (0, 1)]
            vertices = [own[q, k], end[q, k, 0], end[q, k, 1]]
            for known in (places, vertices):
                known.append(known[0] + np.float32(part) * (known[1] - known[0] + known[2] - known[0]))
            add(q, k, places, vertices)
        for a, b in ((0, 1), (1, 0)):
            if n[a] < k:
                continue
            # two side by side
            q = np.flatnonzero(joined[a] & free[b] & ~beside[b][:, n[a]])
            places = [np.broadcast_to(_PLACE[j], (len(q), 2)) for j in (k, n[a])]
            places += [_PLACE[j] + reach[q, j, b, None] * way[b] for j in (k, n[a])]
            add(q, k, places, [own[q, k], own[q, n[a]], end[q, k, b], end[q, n[a], b]])
        # the middle one of three: two beams with a side in common
        q = np.flatnonzero(joined[0] & joined[1] & ~across[:, k])
        tips = [_PLACE[n[a]] + reach[q, n[a], 1 - a, None] * way[1 - a] for a in (0, 1)]
        ends = [end[q, n[a], 1 - a] for a in (0, 1)]
        for a in (0, 1):
            places = [np.broadcast_to(_PLACE[j], (len(q), 2)) for j in (k, n[a])]
            vertices = [own[q, k], own[q, n[a]], (ends[0] + ends[1]) / 2, ends[a]]
            add(q, k, [*places, (tips[0] + tips[1]) / 2, tips[a]], vertices)
    return np.concatenate(beams, axis=1), np.concatenate(rows)


def _beam(places, vertices, share, lead):
    """(4, m, 2 + c) vertices, their powers times the part of the square that they stand for.

    places: four (m, 2) of the vertices in their quad. A bilinear map is denser at one end than at the other, by a
    Jacobian that is linear itself.
    """
    one, other, third, last = places
    cross = [
        a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        for a, b in (
            (other - one, third - one), (other - one, last - other),
            (last - third, third - one), (last - third, last - other),
        )
    ]  # fmt: skip
    beam = np.stack(vertices)
    beam[:, :, lead:] *= (np.abs(np.stack(cross)) * share).astype(np.float32)[:, :, None]
    return beam


def _ends(forest, values, corner, lands, beside, sharp, lead):
    """How far along both sides each corner's way goes, (q, 4, 2) float32 in parts of the side, and what a photon at its end
    would bring, (q, 4, 2, 2 + c); where the neighbour went the same way neither is set."""
    reach = np.zeros((len(corner), 4, 2), np.float32)
    end = np.zeros((len(corner), 4, 2, values.shape[1]), np.float32)
    told = np.zeros((len(corner), 4, 2), bool)
    quad, k, a = np.nonzero(lands[:, :, None] & ~np.stack(beside, 2))
    inside, outside = corner[quad, k], corner[quad, k ^ (a + 1)]
    signature = forest.photons.signature
    low, low_at = inside.astype(np.int64), np.zeros(len(quad), np.float32)
    before, before_at = forest.beyond(outside, inside), np.full(len(quad), -1, np.float32)
    before = np.where((before >= 0) & (signature[before] == signature[inside]), before, -1)
    rows = np.flatnonzero(sharp[quad])
    middle = forest.between(low[rows], outside[rows])
    rows, middle = rows[middle >= 0], middle[middle >= 0]
    same = signature[middle] == signature[inside[rows]]
    # where a third way lies between them each keeps its half, or together they had less than there is
    on, off = rows[same], rows[signature[middle] == signature[outside[rows]]]
    before[on], before_at[on] = low[on], 0
    low[on], low_at[on] = middle[same], 0.5
    at = np.full(len(quad), 0.5, np.float32)
    at[on], at[off] = 0.75, 0.25
    found = values[low].copy()
    known = before >= 0
    part = np.where(known, (at - low_at) / (low_at - before_at), 0)[:, None].astype(np.float32)
    step = (values[low] - values[before]) * part
    found += step
    # the way's power may rise or fall steeply towards its end, but not below nothing
    found[:, lead:] = np.clip(found[:, lead:], 0, RISE * values[low, lead:])
    found[:, 2:lead] = values[low, 2:lead]
    reach[quad, k, a], end[quad, k, a], told[quad, k, a] = at, found, known
    # a photon all of whose neighbours went elsewhere: as wide as others, so that it is no speck
    free = lands[:, :, None] & ~np.stack(beside, 2)
    alone = free.all(axis=2) & ~told.any(axis=2)
    if known.any() and alone.any():
        wide = min(float(np.median(np.abs(step[known, :2]).max(axis=1) / at[known])), 2 * LONE)
        quad, k = np.nonzero(alone)
        for axis in (0, 1):
            sign = np.where(k >> axis & 1, -1, 1)
            end[quad, k, axis, axis] += sign * wide * reach[quad, k, axis]
    return reach, end
