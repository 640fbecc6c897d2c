"""Cut the surface into regions, each of which keeps its own few panes."""

from __future__ import annotations

import numpy as np

ROUNDS = 12
NORMAL_WEIGHT = 0.5
"""How far apart opposite normals count, in units of the scene's extent."""

LARGEST = 2.0
"""Most entries of a region over the mean. Texels in a large one see more than its panes can tell, beside a wall say."""

LIGHT_WEIGHT = 0.3
"""How far apart places that no lamp lights both count, in units of the scene's extent."""

SIGNS = 16
"""Coordinates that tell places apart by the lamps that light them."""

ROOMS = 64
"""Rooms told apart, at most."""

SHORT, SMALL = 200, 500
"""Rows of matrices whose eigenvalues take a while and for which numpy, thinking them small, holds the GIL; not for two."""


def features(position: np.ndarray, normal: np.ndarray, extent: float) -> np.ndarray:
    """(n, 6) float32 coordinates in which near means similarly lit."""
    return np.concatenate([position / np.float32(extent), normal * np.float32(0.5 * NORMAL_WEIGHT)], 1)


def signature(field: np.ndarray, seed: int = 0) -> np.ndarray:
    """(n, SIGNS) float32 coordinates in which entries are near when the same lamps light them.

    field: (n, s) float32 training fields. Places on either side of a thin wall are neighbours, and share no light.
    """
    length = np.linalg.norm(field, axis=1, keepdims=True)
    mix = np.random.default_rng(seed).standard_normal((field.shape[1], SIGNS)).astype(np.float32)
    # a random projection keeps distances (Johnson & Lindenstrauss 1984)
    return field @ mix * (np.float32(LIGHT_WEIGHT / np.sqrt(2 * SIGNS)) / np.maximum(length, 1e-30))


def rooms(between: np.ndarray) -> np.ndarray:
    """(n,) int32: entries between which no light passes, however often it bounces, are in different rooms.

    between: (n, n), its zeros symmetric. Entries that see no other are in one room together.
    """
    room = np.zeros(len(between), np.int32)
    left = between.any(axis=1)
    # one step a room and bounce: each entry's row is read once
    for number in range(1, ROOMS):
        if not left.any():
            break
        fresh = np.flatnonzero(left)[:1]
        while len(fresh):
            room[fresh] = number
            left[fresh] = False
            fresh = np.flatnonzero((between[fresh] > 0).any(axis=0) & left)
    return room


def starts_of(region: np.ndarray, regions: int) -> np.ndarray:
    """(regions + 1,) int: where each region's rows begin among those sorted by region; region: (n,)."""
    return np.concatenate([[0], np.cumsum(np.bincount(region, minlength=regions))])


def region_of(starts: np.ndarray) -> np.ndarray:
    """(n,) int: the region of each of the rows that `starts` (regions + 1,) cuts into regions."""
    return np.repeat(np.arange(len(starts) - 1), np.diff(starts))


def make_regions(points: np.ndarray, area: np.ndarray, count: int, seed: int = 0) -> np.ndarray:
    """(n,) int32 region of each point, by k-means weighted by area; at most `count`, none empty.

    points: (n, d) float32 features; area: (n,) weights. Seeds are spread by farthest-point picking.
    """
    count = min(count, len(points))
    centre = _spread(points, count, seed)
    for _ in range(ROUNDS):
        region = nearest(points, centre)
        weight = np.bincount(region, area, count)
        sums = np.stack([np.bincount(region, area * points[:, k], count) for k in range(points.shape[1])], 1)
        centre = np.where(weight[:, None] > 0, sums / np.maximum(weight, 1e-30)[:, None], centre).astype(np.float32)
    _, region = np.unique(nearest(points, centre), return_inverse=True)
    return region.reshape(-1).astype(np.int32)


def split_regions(
    region: np.ndarray, points: np.ndarray, area: np.ndarray, field: np.ndarray, count: int, panes: int
) -> np.ndarray:
    """(n,) int32: the regions, split where they are large or panes lose most, until there are `count`.

    region: (n,) int32 to begin with. points: (n, d) features. area: (n,) m². field: (n, s) float32 training
    fields. panes: modes that each region will keep. What a region loses is the energy of its part of the
    fields beyond those modes, so regions end up small where lamps make much detail.
    """
    root = np.sqrt(area / area.mean()).astype(np.float32)[:, None]
    mix = np.random.default_rng(0).standard_normal((field.shape[1], SHORT)).astype(np.float32) / np.sqrt(SHORT)

    def lost(rows):
        if len(rows) <= panes:
            return 0.0
        block = root[rows] * field[rows]
        if len(rows) > SMALL:
            # random mixtures of the fields tell about as much as all of them
            block = (block @ mix).T
        gram = block @ block.T
        if SHORT < len(gram) <= SMALL:
            gram = np.stack([gram, gram])
        return float(np.atleast_2d(np.linalg.eigvalsh(gram))[0, :-panes].sum())

    groups = [np.flatnonzero(region == r) for r in range(int(region.max()) + 1)]
    losses = [lost(rows) for rows in groups]
    # one split a step: which region is worst depends on the splits before
    while len(groups) < count and max(losses) > 0:
        sizes = [len(rows) for rows in groups]
        worst = int(np.argmax(sizes if max(sizes) > LARGEST * len(region) / count else losses))
        rows = groups[worst]
        centred = points[rows] - np.average(points[rows], axis=0, weights=area[rows])
        axis = np.linalg.eigh((centred * area[rows, None]).T @ centred)[1][:, -1]
        order = rows[np.argsort(centred @ axis, kind="stable")]
        halves = order[: len(order) // 2], order[len(order) // 2 :]
        groups[worst] = halves[0]
        groups.append(halves[1])
        losses[worst] = lost(halves[0])
        losses.append(lost(halves[1]))
    result = np.empty(len(region), np.int32)
    result[np.concatenate(groups)] = np.repeat(np.arange(len(groups), dtype=np.int32), [len(g) for g in groups])
    return result


def nearest(points: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(n,) index of the nearest of `centre` (m, d) to each of `points` (n, d)."""
    result = np.empty(len(points), np.int64)
    half = 0.5 * (centre**2).sum(axis=1)
    for start in range(0, len(points), 65536):
        piece = slice(start, start + 65536)
        result[piece] = (half - points[piece] @ centre.T).argmin(axis=1)
    return result


def _spread(points, count, seed):
    chosen = np.empty(count, np.int64)
    chosen[0] = np.random.default_rng(seed).integers(len(points))
    distance = np.full(len(points), np.inf, np.float32)
    # one step a centre, each over all points: farthest-point picking is sequential
    for k in range(1, count):
        distance = np.minimum(distance, ((points - points[chosen[k - 1]]) ** 2).sum(axis=1))
        chosen[k] = distance.argmax()
    return points[chosen]
