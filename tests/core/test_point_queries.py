"""Point set queries and what keeps radii in order, against all pairs."""

import numpy as np
import pytest
from lightpanes.core.point_cache import guides
from lightpanes.core.point_cache.grid import THICK, DiscGrid, LevelGrid, expand, in_chunks, nearest_first
from lightpanes.core.sampling import uniform_sphere

from .test_darts import as_points, everywhere, floor, pieces, room_ground, throw


def cloud(count: int, seed: int = 0, ratio: float = 6.0):
    """Places, normals and radii of points all over a box."""
    random = np.random.default_rng(seed)
    place = random.uniform((-1, 0, 5), (1, 1, 5.5), (count, 3))
    normal = uniform_sphere(random.uniform(size=(count, 2)))
    normal[: count // 4] = (0, 0, 1)
    radius = 0.03 * ratio ** random.uniform(size=count)
    return tuple(v.astype(np.float32) for v in (place, normal, radius))


def distances(a, b) -> np.ndarray:
    return np.linalg.norm(a[:, None].astype(np.float64) - b[None], axis=2)


def names(query, point, points: int) -> np.ndarray:
    """Each pair as one number."""
    return query.astype(np.int64) * points + point


def apart_from(values, threshold) -> np.ndarray:
    """Below the threshold, and not so near to it that float32 may think otherwise."""
    return values < threshold * (1 - 1e-5) - 1e-6


# ---- the paper's grid of discs ----


@pytest.mark.parametrize(("count", "ratio"), [(1, 1.0), (2, 3.0), (900, 1.0), (900, 8.0)])
def test_a_disc_that_holds_a_place_is_found_once(count, ratio):
    place, normal, reach = cloud(count, ratio=ratio)
    # some queries are outside of all, some far outside
    random = np.random.default_rng(1)
    query = random.uniform((-1.3, -0.3, 4.7), (1.3, 1.3, 5.8), (1500, 3)).astype(np.float32)
    query[:50] += random.normal(0, 50, (50, 3)).astype(np.float32)
    query = np.concatenate([query, place])
    found, point = DiscGrid(place, normal, reach).pairs(query)
    assert (np.diff(found) >= 0).all()
    pairs = names(found, point, count)
    assert len(np.unique(pairs)) == len(pairs)
    height = np.abs(((query[:, None].astype(np.float64) - place) * normal).sum(axis=2))
    holds = apart_from(distances(query, place), reach) & apart_from(height, THICK * reach)
    assert holds.any()
    assert np.isin(names(*np.nonzero(holds), count), pairs).all()
    # and not much beside: what is found is within a cell of the disc
    grid = DiscGrid(place, normal, reach)
    assert (distances(query, place)[found, point] < reach[point] + 1.75 * grid.cell).all()


def test_a_cell_lists_the_disc_and_not_its_ball():
    # on a floor, most of the balls' cells are empty air
    place = np.random.default_rng(0).uniform(0, 1, (2000, 3)).astype(np.float32) * np.float32([1, 1, 0])
    up, reach = np.tile(np.float32([0, 0, 1]), (2000, 1)), np.full(2000, 0.1, np.float32)
    query = np.random.default_rng(1).uniform((0, 0, -0.3), (1, 1, 0.3), (4000, 3)).astype(np.float32)
    found, _ = DiscGrid(place, up, reach).pairs(query)
    high = np.abs(query[:, 2]) > 0.05 * 2 * 1.5 + 0.15
    assert not high[found].any()


@pytest.mark.parametrize("away", [0, 1e4])
def test_discs_of_any_size_and_place(away):
    for size in (1e-5, 1e4):
        if size < 1 and away:
            continue
        place, normal, reach = cloud(300)
        place, reach = (place * np.float32(size) + np.float32(away)).astype(np.float32), reach * np.float32(size)
        found, point = DiscGrid(place, normal, reach).pairs(place)
        assert np.isin(np.arange(300) * 301, names(found, point, 300)).all()


# ---- the grid by levels of radius ----


@pytest.mark.parametrize("ratio", [1.0, 2.5, 40.0])
def test_all_pairs_within_the_smaller_radius_are_found(ratio):
    place, _, radius = cloud(1500, ratio=ratio)
    query, _, reach = cloud(1500, seed=1, ratio=2 * ratio)
    # the lowest corner need not be the lowest
    found, point = LevelGrid(np.array([0, 0.5, 5.1])).fill(place, radius).pairs(query, reach)
    near = apart_from(distances(query, place), np.minimum(reach[:, None], radius))
    assert near.any()
    assert np.isin(names(*np.nonzero(near), 1500), names(found, point, 1500)).all()


def test_only_like_radii_are_looked_through():
    # large queries among small points: few of the points within the query's own radius
    place, _, radius = cloud(3000, ratio=1.0)
    reach = np.full(50, 0.5, np.float32)
    found, _ = LevelGrid(place.min(axis=0)).fill(place, radius).pairs(place[:50], reach)
    assert len(found) < 0.3 * (distances(place[:50], place) < 0.5).sum()


def test_a_cell_of_its_own():
    place, _, radius = cloud(1000, ratio=1.0)
    grid = LevelGrid(place.min(axis=0)).fill(place, radius)
    every, own = (names(*grid.pairs(place, radius, own), 1000) for own in (False, True))
    assert np.isin(np.arange(1000) * 1001, own).all()
    assert np.isin(own, every).all()
    assert len(own) < 0.5 * len(every)


def test_a_grid_can_be_filled_anew():
    first, _, radius = cloud(500)
    second, *_ = cloud(400, seed=2)
    grid = LevelGrid(first.min(axis=0)).fill(first, radius)
    again = LevelGrid(first.min(axis=0)).fill(second, radius[:400])
    for one, other in zip(
        grid.fill(second, radius[:400]).pairs(first, radius), again.pairs(first, radius), strict=True
    ):
        assert np.array_equal(one, other)


# ---- runs, orders, nothing ----


def test_runs():
    first, count = np.array([5, 0, 9, 2]), np.array([2, 3, 0, 1])
    slot, row = expand(first, count)
    assert slot.tolist() == [5, 6, 0, 1, 2, 2]
    assert row.tolist() == [0, 0, 1, 1, 1, 3]


def test_nearest_first():
    random = np.random.default_rng(0)
    query = random.integers(0, 50, 3000)
    query[query == 17] = 18
    distance = (random.uniform(size=3000) ** 20 * 1e6).astype(np.float32)
    distance[:100] = 0
    order, first = nearest_first(query, distance, 60)
    expected = np.lexsort((distance, query))
    assert np.array_equal(query[order], query[expected])
    assert np.array_equal(distance[order], distance[expected])
    assert np.array_equal(np.sort(order), np.arange(3000))
    assert np.array_equal(np.diff(first), np.bincount(query, minlength=60))
    assert first[0] == 0 and first[-1] == 3000


def test_nothing_to_find_and_nothing_asked():
    place, normal, radius = cloud(20)
    none, thin = np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
    discs = DiscGrid(none, none, thin), DiscGrid(place, normal, radius)
    levels = LevelGrid(np.zeros(3)).fill(none, thin), LevelGrid(np.zeros(3)).fill(place, radius)
    assert len(discs[0].pairs(place)[0]) == len(discs[1].pairs(none)[0]) == 0
    assert len(levels[0].pairs(place, radius)[0]) == len(levels[1].pairs(none, thin)[0]) == 0
    order, first = nearest_first(np.zeros(0, np.int32), thin, 3)
    assert len(order) == 0 and first.tolist() == [0, 0, 0, 0]
    assert in_chunks(lambda s: s, 0) == []


# ---- radii ----


def test_a_limited_radius_grows_no_faster_than_its_slope():
    ground = room_ground()
    some, size = ground.coarse.take(slice(None, None, 4)), 3 * ground.size
    radius = np.exp(np.random.default_rng(0).normal(0, 1.5, len(some))).astype(np.float32)
    given = radius.copy()
    limited = guides.limit(radius, some, size)
    assert np.array_equal(radius, given)
    assert (limited <= radius).all()
    assert limited.max() <= guides.RATIO * limited.min() * (1 + 1e-5)
    assert limited.min() == radius.min()
    distance = distances(some.position, some.position)
    beside = (distance < 0.999 * size) & (some.flat @ some.flat.T > 0.51) & (distance > 0)
    growth = limited[:, None] - limited
    assert (growth <= guides.SLOPE * distance + 2e-3 * limited[:, None])[beside].all()
    # as large as it may be: each is its own wish, or held down by a neighbour, or by the smallest
    held = np.where(beside, limited + guides.SLOPE * distance, np.inf).min(axis=1)
    cause = np.minimum(np.minimum(radius, held), guides.RATIO * radius.min())
    assert np.allclose(limited, cause, rtol=3e-3)


def test_an_even_radius_is_left_alone():
    ground = room_ground()
    even = np.full(len(ground.coarse), 0.3, np.float32)
    assert np.array_equal(guides.limit(even, ground.coarse, 0.2), even)
    assert len(guides.limit(even[:0], ground.coarse.take(slice(0, 0)), 0.2)) == 0


def test_the_nearest_radius():
    # fine points on one half of a floor, coarse ones on the other
    made = floor()
    sizes = lambda middle: np.where(middle[:, 0] < 0.5, 0.02, 0.08)  # noqa: E731
    points = as_points(throw(made, pieces(made, sizes, longest=0.05), everywhere))
    place = np.random.default_rng(0).uniform((0, 0, 0), (1, 1, 0), (3000, 3)).astype(np.float32)
    place[-500:] += np.float32([0, 0, 7])
    found = guides.nearest_radius(points, place)
    distance = distances(place, points.position)
    holds = distance < points.radius
    expected = np.where(holds, points.radius, np.inf).min(axis=1)
    expected[~holds.any(axis=1)] = points.radius.min()
    clear = (np.abs(distance - points.radius) > 1e-5).all(axis=1)
    assert np.array_equal(found[clear], expected[clear])
