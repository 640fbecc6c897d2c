"""What steers the points' density, against closed forms and all pairs."""

import numpy as np
import pytest
from lightpanes.core.point_cache import guides, lamp_radius
from lightpanes.core.rays import Bvh
from lightpanes.core.surface import make_patches
from lightpanes.core.transfer import Gatherer

from .shapes import box, globe, quad, scene
from .test_darts import room_ground
from .test_gradients import at


def looked(made, place, normal, reach, rays=1024):
    """Openness and harmonic mean distance at places in the air; the openness alone, found otherwise, must agree."""
    what = at(place, normal), Bvh(made.positions[made.triangles]), reach, rays, 1e-5
    ao, harmonic = guides.surroundings(*what)
    assert np.allclose(guides.openness(*what), ao, atol=0.015)
    return ao, harmonic


# ---- openness and harmonic mean distance ----


def test_an_open_floor():
    ao, harmonic = looked(
        scene((*quad((-5, -5, 0), (10, 0, 0), (0, 10, 0)), 0)), [(0, 0, 0), (4, 4, 0)], (0, 0, 1), 2.0
    )
    assert np.allclose(ao, 1) and np.allclose(harmonic, 2)


@pytest.mark.parametrize("reach", [1.5, 3.0, 10.0])
def test_the_middle_of_a_globe(reach):
    # all rays are as long as the radius, or as far as one looks
    ao, harmonic = looked(scene((*globe(radius=3.0), 0)), [(0, 0, 0)] * 5, (0, 0.6, 0.8), reach)
    assert np.allclose(ao, min(3 / reach, 1), rtol=0.01)
    assert np.allclose(harmonic, min(3, reach), rtol=0.01)


@pytest.mark.parametrize("part", [0.2, 0.5, 0.9, 1.0])
def test_under_a_ceiling(part):
    # at height h = part · reach, by the cosine: openness 2p − p², reach over the harmonic mean p² + 2 (1 − p³) / 3p
    reach = 2.0
    ceiling = quad((-300, -300, part * reach), (0, 600, 0), (600, 0, 0))
    ao, harmonic = looked(scene((*ceiling, 0)), [(0, 0, 0)] * 5, (0, 0, 1), reach)
    assert np.allclose(ao, 2 * part - part**2, atol=0.01)
    assert np.allclose(reach / harmonic, part**2 + 2 * (1 - part**3) / (3 * part), rtol=0.01)


@pytest.mark.parametrize("x", [0.01, 0.1, 0.4, 0.9])
def test_beside_a_wall(x):
    # by a sum over a fine pattern of directions
    reach = 1.0
    wall = quad((0, -300, -1), (0, 600, 0), (0, 0, 300))
    ao, harmonic = looked(scene((*wall, 0)), [(x, 0, 0)] * 5, (0, 0, 1), reach)
    u, v = (np.stack(np.meshgrid(*[(np.arange(1500) + 0.5) / 1500] * 2), 0)).reshape(2, -1)
    toward = np.sqrt(u) * np.cos(2 * np.pi * v)
    length = np.minimum(np.where(toward > 0, x / np.maximum(toward, 1e-9), np.inf) / reach, 1)
    assert np.allclose(ao, length.mean(), atol=0.01)
    assert np.allclose(harmonic, reach / (1 / np.maximum(length, 1e-3)).mean(), rtol=0.03)


def test_corners_are_darker_than_floors():
    ground = room_ground()
    place = ground.coarse.position
    assert ((ground.ao >= 0) & (ground.ao <= 1)).all()
    assert ((ground.harmonic > 0) & (ground.harmonic <= ground.reach * 1.0001)).all()
    # how many of the room's walls are near
    walls = sum(((np.abs(place[:, k]) < 0.15) | (np.abs(place[:, k] - s) < 0.15)) for k, s in enumerate((4, 3, 2.5)))
    for value in (ground.ao, ground.harmonic):
        means = [value[walls == count].mean() for count in (1, 2, 3)]
        assert means[0] > 1.1 * means[1] > 1.1**2 * means[2]


# ---- radii ----


def test_the_paper_s_radius():
    ao = np.linspace(0, 1, 11).astype(np.float32)
    radius = guides.by_occlusion(ao, 8.0)
    assert radius[0] == pytest.approx(1 / 8) and radius[-1] == pytest.approx(1)
    assert np.allclose(np.diff(radius), np.diff(radius)[0], rtol=1e-4)
    assert guides.by_occlusion(ao)[0] == pytest.approx(1 / guides.RATIO)


def test_the_gradient_of_occlusion():
    # denser where it changes, by as much as a slow sum over the neighbours says
    ground = room_ground()
    rows = np.arange(0, len(ground.coarse), 3)
    some, ao, size = ground.coarse.take(rows), ground.ao[rows], 3 * ground.size
    found = guides.by_occlusion_gradient(ao, some, size)
    distance = np.linalg.norm(some.position[:, None] - some.position, axis=2)
    beside = (distance < size) & (some.flat @ some.flat.T > 0.5) & (distance > 0)
    steep = np.where(beside, np.abs(ao[:, None] - ao) / np.maximum(distance, 1e-3 * size), 0)
    change = steep.sum(axis=1) / np.maximum(beside.sum(axis=1), 1)
    expected = guides.by_occlusion(ao) / np.sqrt(1 + change / change.mean())
    # now and then the grid names a pair twice
    assert np.quantile(np.abs(found / expected - 1), 0.98) < 1e-4
    assert np.abs(found / expected - 1).max() < 0.3
    even = guides.by_occlusion_gradient(np.full_like(ao, 0.5), some, size)
    assert np.allclose(even, guides.by_occlusion(np.full_like(ao, 0.5)))


def test_lamps_radius():
    harmonic = np.array([1, 16, 1, 16, 2], np.float32)
    gradient = np.array([1, 1, 16, 16, 0], np.float32)
    radius = guides.by_lamps(harmonic, gradient)
    assert np.allclose(radius[:4] / radius[0], [1, 2, 0.5, 1], rtol=1e-5)
    # no change at all is no reason for infinite discs
    assert radius[1] < radius[4] < 10 * radius[1]
    assert np.isfinite(guides.by_lamps(harmonic, 0 * gradient)).all()


def test_lamps_ask_for_points_where_their_light_changes():
    # a glowing block: its light fades fast beside it
    ground = room_ground()
    made = ground.scene
    patches = make_patches(made, 500)
    owner = made.triangle_object[patches.parent]
    gatherer = Gatherer(made, patches, Bvh(patches.corners), owner, owner, 3, offset=ground.offset)
    table = np.array([0, 1, 0, 0], np.float32)[None, :, None]
    # the block's own top gets nothing
    with np.errstate(all="raise"):
        radius = lamp_radius(ground, gatherer, table)
    assert radius.shape == ground.ao.shape and np.isfinite(radius).all() and (radius > 0).all()
    place = ground.coarse.position
    floor = (place[:, 2] < 1e-3) & (np.abs(place[:, :2] - (2, 1.5)) < (1.6, 1.1)).all(axis=1)
    apart = np.maximum(np.abs(place[:, :2] - (1.4, 1.485)) - (0.4, 0.495), 0)
    apart = np.linalg.norm(apart, axis=1)
    near, far = (np.median(radius[floor & row]) for row in (apart < 0.25, apart > 1.2))
    assert near < 0.6 * far
    # brighter lamps ask for the same; the mean over lamps counts, not their number
    assert np.allclose(lamp_radius(ground, gatherer, 50 * table), radius, rtol=1e-3)
    assert np.allclose(lamp_radius(ground, gatherer, np.repeat(table, 3, axis=2)), radius, rtol=1e-3)


# ---- from coarse points to any place ----


def test_values_spread_by_a_mean_of_logarithms():
    ground = room_ground()
    known = ground.coarse.take(slice(None, None, 5))
    values = np.exp(np.random.default_rng(0).normal(size=len(known))).astype(np.float32)
    random = np.random.default_rng(1)
    place = random.uniform((-0.3, -0.3, -0.3), (4.3, 3.3, 2.8), (500, 3)).astype(np.float32)
    place[:250] = known.position[:250] + random.normal(0, 0.02, (250, 3))
    normal = random.normal(size=(500, 3))
    normal[:250] = known.flat[:250] * np.where(random.uniform(size=250) < 0.5, -1, 1)[:, None]
    normal = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32)
    size = 3 * ground.size
    found = guides.spread(values, known, size, place, normal)
    near = np.maximum(1 - (np.linalg.norm(place[:, None] - known.position, axis=2) / size) ** 2, 0)
    facing = normal @ known.flat.T
    for side, sign in enumerate((1, -1)):
        weight = near * np.maximum(sign * facing - 0.3, 0)
        none = weight.sum(axis=1) < 1e-9
        assert none.any() and np.isnan(found[none, side]).all()
        expected = np.exp((weight @ np.log(values))[~none] / weight.sum(axis=1)[~none])
        error = np.abs(np.log(found[~none, side] / expected))
        assert np.quantile(error, 0.98) < 1e-4
    flat = guides.spread(np.full_like(values, 7.0), known, size, place, normal)
    assert np.allclose(flat[np.isfinite(flat)], 7, rtol=1e-5)
    assert guides.spread(values, known, size, place[:0], normal[:0]).shape == (0, 2)


def test_the_back_of_a_thin_thing_has_its_own_radius():
    # values of opposite faces of a board 1 cm thick do not mix
    board = scene((*box((0, 0, 0), (1, 1, 0.01)), 0))
    place = np.random.default_rng(0).uniform((0, 0, 0), (1, 1, 0), (800, 3))
    low = np.arange(800) % 2 == 0
    place[~low, 2] = 0.01
    facing = np.where(low[:, None], (0, 0, -1), (0, 0, 1))
    known = at(place, facing)
    found = guides.spread(np.where(low, 0.1, 5).astype(np.float32), known, 0.3, place.astype(np.float32), known.normal)
    assert np.allclose(found[low], (0.1, 5), rtol=1e-4)
    assert np.allclose(found[~low], (5, 0.1), rtol=1e-4)
    assert len(board.triangles) == 12
