"""Gradients of a gather: against derivatives of closed forms."""

import numpy as np
import pytest
from lightpanes.core.panes.exits import gather_panes
from lightpanes.core.point_cache import gather_gradients
from lightpanes.core.point_cache.gradients import CLAMP, POINTS, rings
from lightpanes.core.rays import Bvh
from lightpanes.core.sampling import uniform_sphere
from lightpanes.core.scene import Scene
from lightpanes.core.surface import SurfaceSamples, make_patches
from lightpanes.core.transfer import Gatherer

from .shapes import box, globe, quad, room, room_parts, scene
from .test_interpolation import anywhere

RAYS = 8192


def at(place, normal, flat=None) -> SurfaceSamples:
    """Places in the air, (n, 3), that face `normal`."""
    place, normal = np.broadcast_arrays(np.asarray(place, np.float32), np.asarray(normal, np.float32))
    flat = normal if flat is None else np.broadcast_to(np.asarray(flat, np.float32), normal.shape)
    none = np.zeros(place.shape, np.float32)
    return SurfaceSamples(place.copy(), normal.copy(), flat.copy(), np.zeros(len(place), np.int32), none)


def by_object(made: Scene, bins=(1, 1)) -> Gatherer:
    """Names the object that a ray lands on, from either side, then black, then the sky."""
    patches = make_patches(made, 50)
    owner = made.triangle_object[patches.parent]
    return Gatherer(made, patches, Bvh(patches.corners), owner, owner, len(made.objects) + 1, bins, 1e-5)


def gathered(gatherer: Gatherer, points: SurfaceSamples, table, radius: float = 1e-4, rays: int = RAYS, seed: int = 1):
    """(n, 7) of a table with a value for each id."""
    table = np.asarray(table, np.float32)[None, :, None]
    reach = np.full(len(points), radius, np.float32)
    return gather_gradients(gatherer, points, reach, table, rays, seed)[..., 0]


def disc(radius: float, height: float, edges: int = 256):
    """A round lamp, facing down: positions, triangles, uv."""
    angle = np.arange(edges) * (2 * np.pi / edges)
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(edges, height)], 1)
    index = np.arange(edges)
    triangles = np.stack([np.full(edges, edges), (index + 1) % edges, index], 1)
    return np.r_[rim, [[0, 0, height]]], triangles, np.zeros((edges, 3, 2))


def disc_factor(radius: float, height: float, x: float) -> float:
    """Form factor of a disc for a place beside its axis that faces its plane (Howell, C-11)."""
    h, r = height / x, radius / x
    z = 1 + h * h + r * r
    return 0.5 * (1 - (1 + h * h - r * r) / np.sqrt(z * z - 4 * r * r))


def derivative(function, at_, step=1e-5):
    return (function(at_ + step) - function(at_ - step)) / (2 * step)


FAR_SPECK = (*quad((900, 900, 900), (0.1, 0, 0), (0, 0.1, 0)), 0)
"""For scenes of nothing but sky."""


# ---- the value ----


def test_rings_are_of_about_square_cells():
    for rays in (16, 64, 100, 257, 4096):
        inner, around = rings(rays)
        assert inner * around == pytest.approx(rays, rel=0.15)
        # all cells are of the same share; half-way out one is as wide as the ring is deep, about
        assert 0.4 < (2 * np.pi * 0.7 / around) / (0.35 * 2 / inner) < 2.5


def test_the_value_is_the_mean_that_a_gather_finds():
    # in a room, over tables at random, for more points than are gathered together
    made = room()
    patches = make_patches(made, 200)
    owner = np.arange(len(patches.parent))
    gatherer = Gatherer(made, patches, Bvh(patches.corners), owner, owner, len(owner) + 1, offset=1e-4)
    points = anywhere(made, POINTS + 90)
    table = np.random.default_rng(0).uniform(size=(1, gatherer.size, 3)).astype(np.float32)
    found = gather_gradients(gatherer, points, np.full(len(points), 0.1, np.float32), table, 1024, 3)
    expected = gather_panes(gatherer, points, np.array([0, len(points)]), table, 4096, 5)
    error = found[:, 0] - expected
    assert np.sqrt((error**2).mean()) < 0.012
    assert np.abs(error.mean(axis=0)).max() < 0.002
    assert np.isfinite(found).all()


def test_a_disc_above():
    place = np.stack([[0.2, 0.6, 1.1], [0, 0, 0], [0, 0, 0]], 1)
    gatherer = by_object(scene((*disc(0.7, 1.0), 0)))
    found = gathered(gatherer, at(place, (0, 0, 1)), [1, 0, 0])
    assert np.allclose(found[:, 0], [disc_factor(0.7, 1.0, x) for x in place[:, 0]], atol=0.004)


# ---- by the normal ----


@pytest.mark.parametrize("tilt", [0.0, 0.4, 1.0, np.pi / 2, 2.2])
def test_turning_under_half_a_sky(tilt):
    # a bright upper hemisphere brings (1 + n · z) / 2
    gatherer = by_object(scene(FAR_SPECK), bins=(2, 1))
    around = np.linspace(0, 5, 12)
    normal = np.stack([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.full(12, np.cos(tilt))], 1)
    found = gathered(gatherer, at((0, 0, 0), normal), [0, 0, 0, 1])
    assert np.allclose(found[:, 0], (1 + np.cos(tilt)) / 2, atol=0.01)
    slope = np.array([0, 0, 1]) / 2
    expected = slope - normal * (normal @ slope)[:, None]
    assert np.abs(found[:, 1:4] - expected).max() < 0.1 * 0.5
    assert np.abs(found[:, 1:4] - expected).mean() < 0.02 * 0.5
    # the sky is infinitely far: no step changes it
    assert np.abs(found[:, 4:7]).max() < 1e-6


def test_turning_away_from_a_small_lamp():
    # a far disc in direction l brings in proportion to n · l
    gatherer = by_object(scene((*disc(0.3, 1.0), 0)))
    tilt = np.array([0.0, 0.3, 0.6, 0.9])
    normal = np.stack([np.sin(tilt), 0 * tilt, np.cos(tilt)], 1)
    found = gathered(gatherer, at((0, 0, 0), normal), [1, 0, 0], rays=4 * RAYS)
    flux = disc_factor(0.3, 1.0, 1e-6)
    assert np.allclose(found[:, 0], flux * np.cos(tilt), atol=0.01 * flux)
    # by finite steps: the change that the gradient tells for a turn by 0.1
    other = np.stack([np.sin(tilt + 0.1), 0 * tilt, np.cos(tilt + 0.1)], 1)
    told = ((other - normal) * found[:, 1:4]).sum(axis=1)
    assert np.allclose(told, flux * (np.cos(tilt + 0.1) - np.cos(tilt)), atol=0.1 * 0.1 * flux)


# ---- by the place ----


@pytest.mark.parametrize("x", [0.3, 0.6, 1.0, 1.6])
def test_a_step_below_a_bright_disc(x):
    # the disc shines before a black sky; eight ways to stand about its axis
    gatherer = by_object(scene((*disc(0.8, 1.0), 0)))
    turn = np.arange(8) * (np.pi / 4)
    out = np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1)
    found = gathered(gatherer, at(x * out, (0, 0, 1)), [1, 0, 0], rays=2 * RAYS)
    slope = derivative(lambda x: disc_factor(0.8, 1.0, x), x)
    told = (found[:, 4:7] * out).sum(axis=1)
    assert told.mean() == pytest.approx(slope, rel=0.05)
    assert np.abs(told / slope - 1).max() < 0.15
    # and nothing across, nor up
    side = np.cross(out, (0, 0, 1))
    assert np.abs((found[:, 4:7] * side).sum(axis=1)).max() < 0.1 * abs(slope)
    assert np.abs(found[:, 6]).max() < 1e-6


@pytest.mark.parametrize("x", [0.4, 0.8, 1.5])
def test_a_step_in_a_black_disc_s_shadow(x):
    # the same disc, black before a bright sky: an occluder's edge moves with its own distance
    gatherer = by_object(scene((*disc(0.8, 1.0), 0)))
    found = gathered(gatherer, at([(x, 0, 0)] * 8, (0, 0, 1)), [0, 0, 1], rays=2 * RAYS)
    slope = -derivative(lambda x: disc_factor(0.8, 1.0, x), x)
    assert found[:, 4].mean() == pytest.approx(slope, rel=0.07)
    assert np.abs(found[:, 4] / slope - 1).max() < 0.2


@pytest.mark.parametrize("x", [0.2, 0.5, 1.5])
def test_a_step_away_from_a_bright_wall(x):
    # a long wall of height h brings (1 − x / √(x² + h²)) / 2
    wall = quad((0, -400, 0), (0, 800, 0), (0, 0, 1))
    gatherer = by_object(scene((*wall, 0)))
    angle = 0.7
    # the floor's points are turned about by the code; that changes nothing
    found = gathered(gatherer, at([(x, y, 0) for y in np.arange(8) * angle], (0, 0, 1)), [1, 0, 0], rays=2 * RAYS)
    slope = -0.5 / (x * x + 1) ** 1.5
    assert np.allclose(found[:, 0], 0.5 * (1 - x / np.hypot(x, 1)), atol=0.01)
    assert found[:, 4].mean() == pytest.approx(slope, rel=0.1)
    assert np.abs(found[:, 5]).max() < 0.12 * abs(slope)


def test_both_carry_a_value_over_a_floor():
    # half a disc's width on, the gradient is nearer to the truth than the value alone
    gatherer = by_object(scene((*disc(0.8, 1.0), 0)))
    known, there = 0.9, np.linspace(0.6, 1.2, 13)
    row = gathered(gatherer, at([(known, 0, 0)], (0, 0, 1)), [1, 0, 0])[0]
    truth = np.array([disc_factor(0.8, 1.0, x) for x in there])
    told = row[0] + (there - known) * row[4]
    assert np.abs(told - truth).max() < 0.2 * np.abs(row[0] - truth).max()


# ---- properties ----


def test_gradients_are_linear_in_the_tables():
    made = room()
    gatherer = by_object(made)
    points = anywhere(made, 300)
    radius = np.full(300, 0.2, np.float32)
    one, other = np.random.default_rng(0).normal(size=(2, 1, gatherer.size, 4)).astype(np.float32)
    rows = [gather_gradients(gatherer, points, radius, table, 256, 2) for table in (one, other, 2 * one - 3 * other)]
    assert np.allclose(2 * rows[0] - 3 * rows[1], rows[2], atol=1e-4 * np.abs(rows[0]).max())
    # what is the same everywhere has no gradient
    same = gather_gradients(gatherer, points, radius, np.ones_like(one), 1024, 2)
    assert np.allclose(same[:, 0], 1, atol=1e-5)
    assert np.abs(same[:, 4:]).max() < 1e-4
    assert np.abs(same[:, 1:4]).max() < 0.2


def test_points_and_tables_in_any_pairing():
    made = room()
    gatherer = by_object(made)
    points = anywhere(made, POINTS + 300)
    radius = np.full(len(points), 0.2, np.float32)
    tables = np.random.default_rng(0).uniform(size=(3, gatherer.size, 2)).astype(np.float32)
    each = [gather_gradients(gatherer, points, radius, table[None], 128, 2) for table in tables]
    point = np.sort(np.random.default_rng(1).integers(0, len(points), 900))
    table = np.random.default_rng(2).integers(0, 3, 900)
    found = gather_gradients(gatherer, points, radius, tables, 128, 2, point=point, table=table)
    assert np.allclose(found, np.stack(each)[table, point], atol=1e-5)
    none = gather_gradients(gatherer, points.take(slice(0, 0)), radius[:0], tables, 128, 2)
    assert none.shape == (0, 7, 2)


def test_near_things_do_not_shout():
    # 1 mm beside a bright wall, at every height, and in a corner: a step by the radius changes no more than there is
    gatherer = by_object(scene((*box((0, 0, 0), (1, 1, 1), True), 0), (*quad((0, 0, 0.2), (0, 1, 0), (0, 0, 0.3)), 0)))
    random = np.random.default_rng(0)
    place = random.uniform(0.001, 0.01, (200, 3))
    place[:, 2] = 0
    place[:100, 1] = random.uniform(0, 1, 100)
    for radius in (0.02, 0.2):
        found = gathered(gatherer, at(place, (0, 0, 1)), [0, 1, 0, 0], radius, 512)
        assert np.isfinite(found).all()
        assert np.linalg.norm(found[:, 4:7], axis=1).max() < 1 / (CLAMP * radius)
    # without a radius to speak of they do
    wild = gathered(gatherer, at(place, (0, 0, 1)), [0, 1, 0, 0], 1e-4, 512)
    assert np.linalg.norm(wild[:, 4:7], axis=1).max() > 1 / (CLAMP * 0.2)


def test_rays_below_the_surface_bring_nothing():
    # shading normals tilted by 45° out of an evenly bright globe: (1 + cos 45°) / 2 is left
    gatherer = by_object(scene((*globe(rings=16, radius=3.0), 0)))
    tilted = np.array([[np.sqrt(0.5), 0, np.sqrt(0.5)]] * 4)
    found = gathered(gatherer, at((0, 0, 0), tilted, (0, 0, 1)), [1, 0, 1])
    assert np.allclose(found[:, 0], (1 + np.sqrt(0.5)) / 2, atol=0.01)
    straight = gathered(gatherer, at((0, 0, 0), tilted), [1, 0, 1])
    assert np.allclose(straight[:, 0], 1, atol=1e-5)
    assert np.isfinite(found).all()


def test_neither_threads_nor_chunks_change_gradients(monkeypatch):
    from lightpanes.core import threads as workers

    made = scene(*room_parts(), materials=room().materials)
    gatherer = by_object(made)
    points = anywhere(made, 3 * POINTS)
    directions = uniform_sphere(np.random.default_rng(0).uniform(size=(gatherer.size, 2)))[:, :1]
    first = gathered(gatherer, points, directions[:, 0], 0.1, 64)
    monkeypatch.setattr(workers, "thread_count", lambda: 1)
    assert np.array_equal(first, gathered(gatherer, points, directions[:, 0], 0.1, 64))
    assert not np.array_equal(first, gathered(gatherer, points, directions[:, 0], 0.1, 64, seed=2))
