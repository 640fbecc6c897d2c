"""Places that no point serves get points of their own."""

import numpy as np
import pytest
from lightpanes.core.point_cache import guides, make_points, serve
from lightpanes.core.point_cache.interpolation import KERNELS, REACH
from lightpanes.core.surface import SurfaceSamples

from .shapes import box, lamp, quad, scene
from .test_darts import room_ground, surveyed, too_near
from .test_interpolation import anywhere


@pytest.mark.parametrize("kernel", KERNELS)
def test_gaps_get_points_of_their_own(kernel):
    # half of the points are taken away
    ground = room_ground()
    points = make_points(ground, guides.by_occlusion(ground.ao), 1200)
    points = points.take(points.position[:, 0] < 2)
    places = ground.coarse
    more, weights = serve(points, places, ground, kernel)
    assert len(more) > 1.3 * len(points)
    assert np.array_equal(more.position[: len(points)], points.position)
    assert np.allclose(weights.weight.sum(axis=1), 1, atol=1e-5)
    # never a far neighbour
    apart = np.linalg.norm(more.position[weights.point] - places.position[:, None], axis=2)
    assert (apart <= REACH * 1.0001 * more.radius[weights.point])[weights.weight != 0].all()
    # each is one of the places, and looks around as the others do
    added = more.take(np.arange(len(points), len(more)))
    assert np.isfinite(added.radius).all() and (added.radius > 0).all()
    assert ((added.ao >= 0) & (added.ao <= 1)).all() and added.ao.std() > 0.05
    assert (np.linalg.norm(added.position[:, None] - places.position[None], axis=2).min(axis=1) == 0).all()
    assert not added.back.any()
    some, all_ = ((p.position, p.normal, p.radius) for p in (added, more))
    assert len(too_near(some, all_)) == len(added)
    # the same again
    again, other = serve(points, places, ground, kernel)
    assert np.array_equal(again.position, more.position) and np.array_equal(other.weight, weights.weight)


def test_no_gaps_no_points():
    ground = room_ground()
    points = make_points(ground, guides.uniform(ground.coarse), 1000)
    more, weights = serve(points, points.samples, ground)
    assert more is points
    assert (weights.weight.max(axis=1) > 0.3).all()


def test_buried_places_stay_empty():
    ground = room_ground()
    points = make_points(ground, guides.uniform(ground.coarse), 1000).take(np.arange(300))
    low = lambda samples: samples.position[:, 2] < 1  # noqa: E731
    more, weights = serve(points, ground.coarse, ground, buried=low)
    assert (low(ground.coarse)[weights.orphan]).all() and weights.orphan.any()
    assert (more.position[len(points) :, 2] >= 1).all()


def test_strips_that_see_nothing_are_their_own():
    # slots of 1 mm between sheets that stand on a floor: no place in one sees another's
    sheets = [(*quad((x, 0, 0), (0, 1, 0), (0, 0, 0.5)), 0) for x in 0.4 + 1e-3 * np.arange(12)]
    made = scene((*box((0, 0, 0), (1, 1, 1), True), 0), *sheets, lights=[lamp((0.8, 0.5, 0.8))])
    ground = surveyed(made)
    points = make_points(ground, guides.uniform(ground.coarse), 400)
    slots = anywhere(made, 3000, rows=np.flatnonzero((made.triangle_object == 0) & (made.triangle_cross()[:, 2] > 0)))
    x = np.linspace(0.3995, 0.4125, 14).astype(np.float32).repeat(10)
    place = np.stack([x, np.tile(np.linspace(0.05, 0.95, 10), 14), 0 * x], 1).astype(np.float32)
    rows = np.argmin(np.linalg.norm(slots.position[None] - place[:, None], axis=2), axis=1)
    slots = slots.take(rows)
    slots = SurfaceSamples(place, slots.normal, slots.flat, slots.triangle, slots.weights)
    more, weights = serve(points, slots, ground)
    assert not weights.orphan.any()
    used = weights.weight != 0
    slot = lambda position: np.floor((position[:, 0] - 0.4) / 1e-3 + 1e-3).clip(-1, 11)  # noqa: E731
    assert (slot(more.position)[weights.point] == slot(place)[:, None])[used].all()
