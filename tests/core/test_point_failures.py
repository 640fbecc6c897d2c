"""Where a point cache is known to fail: bounded there, the worst place too.

What is spread from the points is the direct light of a small lamp, whose truth at any place is one sum over it.
"""

from functools import cache

import numpy as np
import pytest
from lightpanes.core.bake import bake
from lightpanes.core.bake.clock import Clock
from lightpanes.core.bake.steps import prepare
from lightpanes.core.bake.stored import bake_points
from lightpanes.core.lights import irradiance
from lightpanes.core.panes import Relighter
from lightpanes.core.point_cache import Ground, PointSet, guides, make_points, serve
from lightpanes.core.point_cache.interpolation import REACH
from lightpanes.core.rays import Tracer
from lightpanes.core.sampling import frame
from lightpanes.core.scene import Scene
from lightpanes.core.surface import SurfaceSamples, make_patches

from .shapes import box, lamp, moved, quad, quick, room, room_parts, scene
from .test_darts import crowded, inside, surveyed
from .test_interpolation import anywhere

pytestmark = pytest.mark.thorough


def lit(ground: Ground, samples: SurfaceSamples, lights=None) -> np.ndarray:
    """(n,) W/m² of the scene's lamps, or of these."""
    tracer, total = Tracer(ground.scene), 0
    for light in ground.scene.lights if lights is None else lights:
        start = samples.position + tracer.offset * samples.flat
        total = total + irradiance(light, start, samples.normal, tracer.visibility, 64) * light.power[0]
    return total


def spread(ground: Ground, points: PointSet, places: SurfaceSamples, kernel: str = "ward"):
    """Light at places as the points tell it, the points used, and their weights."""
    points, weights = serve(points, places, ground, kernel)
    assert np.allclose(weights.weight.sum(axis=1), 1, atol=1e-5)
    near = np.linalg.norm(points.position[weights.point] - places.position[:, None], axis=2)
    assert (near <= 1.001 * REACH * points.radius[weights.point])[weights.weight != 0].all()
    return weights.apply(lit(ground, points.samples)[:, None])[:, 0], points, weights


# ---- the shadow of a lone pillar on an open floor ----


@cache
def pillar():
    """An open floor, a pillar and a low lamp beside it; places on the floor, and their light."""
    floor = quad((-2, -3, 0), (6, 0, 0), (0, 6, 0))
    light = lamp((-3, 0, 1.5), radius=0.3)
    made = scene((*floor, 0), (*box((-0.15, -0.15, 0), (0.15, 0.15, 2)), 0), lights=[light])
    ground = surveyed(made)
    places = anywhere(made, 4000, rows=np.flatnonzero(made.triangle_object == 0))
    places = places.take((np.abs(places.position[:, :2]) > 0.16).any(axis=1))
    return ground, places, lit(ground, places)


def steepness(ground: Ground) -> np.ndarray:
    """(coarse points,) 1/m: |∇E| over the mean, by steps of a few centimetres."""
    some, total = ground.coarse, 0
    for along in frame(some.flat):
        there = [
            SurfaceSamples(some.position + step * along, some.normal, some.flat, some.triangle, some.weights)
            for step in (-0.03, 0.03)
        ]
        total = total + (np.subtract(*(lit(ground, s) for s in there)) / 0.06) ** 2
    return (np.sqrt(total) / lit(ground, some).mean()).astype(np.float32)


@cache
def pillar_errors(guide: str) -> tuple[float, float]:
    """RMSE over the mean light, of three sets together, and the worst error over the most light."""
    ground, places, truth = pillar()
    radius = {
        "even": guides.uniform,
        "occlusion": lambda some: guides.by_occlusion(ground.ao),
        "lamps": lambda some: guides.by_lamps(ground.harmonic, steepness(ground)),
    }[guide](ground.coarse)
    sets = [make_points(ground, radius, 1000, seed) for seed in range(3)]
    error = np.abs(np.stack([spread(ground, points, places, "affine")[0] for points in sets]) - truth)
    return float(np.sqrt((error**2).mean()) / truth.mean()), float(error.max() / truth.max())


@pytest.mark.parametrize("guide", ["even", "occlusion", "lamps"])
def test_the_shadow_of_a_pillar_is_bounded(guide):
    mean, worst = pillar_errors(guide)
    assert mean < 0.05
    assert worst < 0.15


def test_occlusion_does_not_see_a_shadow_s_edge_and_lamps_do():
    # the paper's first figure turned round
    (even, _), (occlusion, _), (lamps, _) = (pillar_errors(guide) for guide in ("even", "occlusion", "lamps"))
    assert occlusion > 0.8 * even
    assert lamps < 0.75 * even
    assert lamps < 0.85 * occlusion


def test_the_floor_far_from_the_shadow_is_right():
    ground, places, truth = pillar()
    found, *_ = spread(ground, make_points(ground, guides.by_occlusion(ground.ao), 2000), places, "affine")
    x, y, _ = places.position.T
    # off the shadow and its penumbra, off the floor's border, off the lamp's foot
    open_ = (np.abs(y) > 0.3 + 0.4 * np.maximum(x, 0)) & (np.abs(places.position[:, :2] - (1, 0)) < (2.7, 2.7)).all(
        axis=1
    )
    open_ &= np.hypot(x, y) > 0.6
    error = np.abs(found[open_] / truth[open_] - 1)
    assert open_.mean() > 0.3
    assert error.max() < 0.1 and np.sqrt((error**2).mean()) < 0.01


# ---- a wire ----


@pytest.mark.parametrize("count", [300, 3000])
def test_a_wire_two_millimetres_thick(count):
    wire = box((0.2, 2.2, 1.8), (3.8, 2.202, 1.802))
    made = scene(*room_parts(), (*wire, 1), materials=room().materials, lights=[lamp((3, 1, 2))])
    ground = surveyed(made)
    points = make_points(ground, guides.by_occlusion(ground.ao), count)
    places = anywhere(made, 1500, rows=np.flatnonzero(made.triangle_object == 2))
    found, more, weights = spread(ground, points, places)
    # the wire's light comes from the wire, each side's from that side
    used = weights.weight != 0
    assert (made.triangle_object[more.samples.triangle][weights.point] == 2)[used].all()
    facing = np.einsum("qkd,qd->qk", more.normal[weights.point], places.normal)
    assert (facing > 0.9)[used].all()
    assert len(more) - len(points) < 400
    truth = lit(ground, places)
    assert np.sqrt(((found - truth) ** 2).mean()) < 0.15 * truth.mean()
    assert np.abs(found - truth).max() < 0.35 * truth.max()
    # and no wire point serves a wall
    walls = anywhere(made, 3000, rows=np.flatnonzero(made.triangle_object == 0))
    _, more, weights = spread(ground, more, walls)
    assert (made.triangle_object[more.samples.triangle][weights.point] != 2)[weights.weight != 0].all()


# ---- sheets and sealed rooms ----


def test_the_back_of_a_sheet_stays_dark():
    # a sheet in a room's middle, and the wall-to-wall kind, each without thickness
    for sheet in (quad((1, 1, 1.2), (2, 0, 0), (0, 1, 0)), quad((-0.1, -0.1, 1.2), (4.2, 0, 0), (0, 3.2, 0))):
        made = scene(
            (*box((0, 0, 0), (4, 3, 2.5), True), 0), (*sheet, 0), lights=[lamp((2, 1.5, 2)), lamp((2, 1.5, 0.1), 1e-9)]
        )
        ground = surveyed(made)
        points = make_points(ground, guides.by_occlusion(ground.ao), 1000)
        front = anywhere(made, 1500, rows=np.flatnonzero(made.triangle_object == 1))
        front = front.take(inside(front.position, (0, 0, 0), (4, 3, 2.5)))
        back = front.flipped(np.ones(len(front), bool))
        bright, *_ = spread(ground, points, front)
        dark, more, weights = spread(ground, points, back)
        assert np.allclose(bright.mean(), lit(ground, front).mean(), rtol=0.03)
        assert np.abs(dark).max() < 0.01 * bright.mean()
        assert more.back[weights.point][weights.weight != 0].all()
        assert crowded(points) == 0


def test_a_sealed_room_takes_nothing_from_its_neighbour():
    left, right = box((0, 0, 0), (2, 2, 2), True), box((2.001, 0, 0), (4.001, 2, 2), True)
    made = scene((*left, 0), (*right, 0), lights=[lamp((1.9, 1, 1))])
    ground = surveyed(made)
    points = make_points(ground, guides.by_occlusion(ground.ao), 1000)
    places = anywhere(made, 3000)
    there = made.triangle_object[places.triangle] == 1
    found, more, _ = spread(ground, points, places)
    assert (points.position[:, 0] < 2.0005).all()
    assert np.abs(found[there]).max() < 1e-6 * found[~there].mean()
    # its own points are about as many as the lit room's
    own = (more.position[:, 0] > 2.0005).sum()
    assert 0.3 * len(points) < own < 1.5 * len(points)


# ---- sizes and places ----


@cache
def set_of(size: float, away: float) -> tuple[PointSet, int, float]:
    """Points in a room of this size and place; how many gaps add; the error of a smooth field that they carry."""
    made = moved(room(lights=[lamp((3, 1.5, 2))]), size * np.eye(3), (away, -away, 0))
    ground = surveyed(made)
    points = make_points(ground, guides.by_occlusion(ground.ao), 1500)
    places = anywhere(made, 1500, rows=np.flatnonzero(made.triangle_object == 0))
    local = lambda samples: (samples.position.astype(np.float64) - (away, -away, 0)) / size  # noqa: E731
    # what lies under the block is inside of it
    places = places.take(~inside(local(places), (0.97, 0.96, -0.1), (1.83, 2.01, 0.1)))
    _, more, weights = spread(ground, points, places)
    assert all(np.isfinite(getattr(more, name)).all() for name in ("position", "normal", "radius", "ao"))
    field = lambda samples: np.sin(2 * local(samples) + 1).sum(axis=1)  # noqa: E731
    error = weights.apply(field(more.samples)[:, None])[:, 0] - field(places)
    return points, len(more) - len(points), float(np.sqrt((error**2).mean()))


SIZES = [(2.5e-4, 0), (1e-2, 0), (2.5e3, 0), (1, 1e4), (1, 300)]
"""1 mm across, 10 km across, 10 km away."""


@pytest.mark.parametrize(("size", "away"), SIZES)
def test_a_scene_of_any_size_and_place_has_the_same_points(size, away):
    points, added, error = set_of(size, away)
    usual, usual_added, usual_error = set_of(1, 0)
    assert len(points) == pytest.approx(len(usual), rel=0.03)
    assert abs(added - usual_added) < 0.02 * len(points)
    order = [0.02, 0.1, 0.5, 0.9, 1]
    assert np.allclose(np.quantile(points.radius, order) / size, np.quantile(usual.radius, order), rtol=0.08)
    assert error == pytest.approx(usual_error, rel=0.15)
    assert usual_error < 0.1
    assert usual_added < 0.02 * len(usual)


@pytest.mark.parametrize(("size", "away"), [(1, 0), *SIZES])
def test_points_keep_their_distance_and_to_the_room(size, away):
    points, *_ = set_of(size, away)
    assert crowded(points) == 0
    # 10 km away float32 steps by 1 mm
    air = (points.position.astype(np.float64) - (away, -away, 0)) / size + 0.01 * points.samples.flat
    assert inside(air, (0, 0, 0), (4, 3, 2.5)).all()
    assert not inside(air, (1, 0.99, 0), (1.8, 1.98, 1)).any()


# ---- coincident floors ----


def test_floors_that_coincide_share_their_points():
    floor, turned = quad((0, 0, 0), (4, 0, 0), (0, 3, 0)), quad((0, 0, 0), (0, 3, 0), (4, 0, 0))
    lights = [lamp((3, 1.5, 2))]
    plain = surveyed(scene(*room_parts(), materials=room().materials, lights=lights))
    made = scene(*room_parts(), (*floor, 0), (*floor, 0), (*turned, 0), materials=room().materials, lights=lights)
    ground = surveyed(made)
    points, usual = (make_points(g, guides.uniform(g.coarse), 1500) for g in (ground, plain))
    assert crowded(points) == 0
    # four times the darts fill the floor better, but no more than a floor can be
    low = lambda p: (p.position[:, 2] < 1e-3) & (p.normal[:, 2] > 0.5)  # noqa: E731
    share = [(low(p) * p.radius.astype(float) ** 2).sum() for p in (points, usual)]
    assert share[1] * 0.95 < share[0] < 1.25 * share[1]
    for owner in (2, 3, 4):
        places = anywhere(made, 500, rows=np.flatnonzero(made.triangle_object == owner))
        places = places.flipped(places.flat[:, 2] < 0)
        places = places.take(~inside(places.position, (0.97, 0.96, -1), (1.83, 2.01, 1)))
        found, *_ = spread(ground, points, places)
        truth = lit(ground, places)
        assert np.isfinite(found).all()
        assert np.sqrt(((found - truth) ** 2).mean()) < 0.15 * truth.mean()
        assert np.abs(found - truth).max() < 0.7 * truth.max()


# ---- no lamps ----


def test_without_lamps_all_that_looks_into_a_room_gets_points():
    ground = surveyed(room())
    points = make_points(ground, guides.by_occlusion(ground.ao), 1000)
    assert len(points) > 700
    assert inside(points.position + 1e-3 * points.samples.flat, (0, 0, 0), (4, 3, 2.5)).all()
    # the block's inside does not
    assert not inside(points.position + 1e-3 * points.samples.flat, (1, 0.99, 0), (1.8, 1.98, 1)).any()


@pytest.mark.parametrize("kind", ["no lamp", "a lamp that shines away"])
def test_where_no_light_gets_each_place_is_its_own(kind):
    # particles meet nothing; the bake still has to answer for all places
    away = lamp((0.5, 0.5, 1), kind="AREA")
    away.matrix[:3, :3] = np.diag([1, -1, -1])
    made = scene((*quad((0, 0, 0), (1, 0, 0), (0, 1, 0)), 0), lights=[away] if kind != "no lamp" else [])
    ground = surveyed(made)
    points = make_points(ground, guides.by_occlusion(ground.ao), 300)
    assert len(points) == 0
    places = anywhere(made, 3000)
    more, weights = serve(points, places, ground)
    assert np.allclose(weights.weight.sum(axis=1), 1)
    assert 0 < len(more) <= len(places)
    assert np.isfinite(more.radius).all() and np.allclose(more.ao, 1)
    # with places that a lamp may light, it is a floor as any other
    patches = make_patches(made, 200)
    seen = surveyed(made, seen=patches.sample(made, np.arange(len(patches)), 1))
    points = make_points(seen, guides.uniform(seen.coarse), 300)
    assert len(points) == pytest.approx(300, rel=0.25)
    assert not points.back.any()


@pytest.mark.parametrize("lights", [(), (lamp((3, 0.5, 0.5)),), (lamp((3, 0.5, 0.5), power=1e-30),)])
def test_a_block_alone_has_points_and_no_bounced_light(lights):
    """It is convex, so nothing lights it but lamps, and no lamp steers its points."""
    made = scene((*box((0, 0, 0), (1, 1, 1)), 0), lights=lights)
    result = bake(made, quick(exits="points", points=300, point_rays=64))
    assert result.meta["report"]["stored_points"] > 500
    assert not Relighter(result.panes(), Tracer(made)).relight(made.lights)[..., :3].any()


def test_a_lamp_in_a_sealed_box_lights_that_box_alone():
    parts = (*box((0, 0, 0), (4, 3, 2.5), True), 0), (*box((1, 1, 1), (1.5, 1.5, 1.5)), 0)
    made: Scene = scene(*parts, lights=[lamp((1.25, 1.25, 1.25))])
    ground = surveyed(made)
    points = make_points(ground, guides.uniform(ground.coarse), 300)
    assert inside(points.position - 1e-3 * points.samples.flat, (0.99, 0.99, 0.99), (1.51, 1.51, 1.51)).all()
    assert points.back.all()
    found, *_ = spread(ground, points, anywhere(made, 2000))
    assert np.abs(found).max() < 1e-3


def test_a_bake_puts_no_points_into_solid_things():
    # lamps may go anywhere in the room, not into the block
    settings = quick(exits="points", points=500, point_rays=16)
    points = bake_points(prepare(room(lights=[lamp((3, 1.5, 2))]), settings), settings, Clock()).points
    air = points.position + 1e-3 * points.samples.flat
    assert not inside(air, (1, 0.99, 0), (1.8, 1.98, 1)).any()
