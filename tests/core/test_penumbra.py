"""Penumbra casting against the rays that it stands for: not one relation may differ."""

from dataclasses import replace

import numpy as np
import pytest
from lightpanes.core.penumbra import (
    AWAY,
    LIT,
    UMBRA,
    Cost,
    Occluders,
    Receivers,
    cast,
    cast_adaptively,
    cast_rays,
    sample_ball,
    sample_lamp,
    sample_quad,
)
from lightpanes.core.rays import Bvh, Tracer
from lightpanes.core.scene import Light, SceneError

from ..bench import penumbra_scenes as stages
from ..bench.penumbra_scenes import area_lamp, box, column, grid, room, scene_of, sphere


def differing(masks, other) -> int:
    return int(np.unpackbits((masks.packed() ^ other.packed()).view(np.uint8)).sum())


def compare(scene, receivers, lamp, merge=True, **more):
    """Masks, all lines where those are possible, after a comparison with brute force."""
    tracer = Tracer(scene)
    occluders = Occluders.of(tracer, merge)
    masks = cast(receivers, lamp, occluders, cost=Cost(lamp.count, "lines"), **more)
    brute = cast_rays(receivers, lamp, tracer.blocked)
    assert differing(masks, brute) == 0
    assert (masks.index == brute.index)[masks.index < 0].all()
    return masks


def scattered(scene, count, seed=0):
    """Receivers all over a scene's surfaces, on both sides, lifted as Tracer.offset says."""
    random = np.random.default_rng(seed)
    corners = scene.positions[scene.triangles].astype(float)
    cross = scene.triangle_cross().astype(float)
    area = np.linalg.norm(cross, axis=1)
    triangle = random.choice(len(corners), count, p=area / area.sum())
    weight = random.dirichlet((1, 1, 1), count)
    normal = cross[triangle] / area[triangle, None] * random.choice((-1, 1), (count, 1))
    place = np.einsum("nk,nkd->nd", weight, corners[triangle]) + normal * Tracer(scene).offset
    return Receivers(place.astype(np.float32), normal.astype(np.float32))


def lamp_of(kind, place=(0.3, 0.2, 2.5), target=(0, 0, 0), **settings):
    matrix = area_lamp(place, 1.0, target).matrix
    return Light(kind, kind, matrix, 1.0, **settings)


FLOOR = grid((-4, -4, 0), (8, 0, 0), (0, 8, 0), 3, 3)


def clutter(seed=0, count=25):
    """Boxes of all sizes over a floor, some through one another and through the floor."""
    random = np.random.default_rng(seed)
    shapes = [FLOOR]
    for _ in range(count):
        turn, _r = np.linalg.qr(random.normal(size=(3, 3)))
        axes = turn * random.uniform(0.05, 0.6, 3)
        shapes.append(box(random.uniform((-1.5, -1.5, -0.1), (1.2, 1.2, 1.4)), *axes.T, int(random.integers(1, 4))))
    return scene_of(shapes)


LAMPS = {
    "square": lamp_of("AREA", size=(0.8, 0.8)),
    "rectangle": lamp_of("AREA", (0.5, -1, 2.2), (-0.5, 0.5, 0.3), shape="RECTANGLE", size=(1.5, 0.2)),
    "disk": lamp_of("AREA", (1.5, 1, 2), (0, 0, 0.4), shape="DISK", size=(0.7, 0.7)),
    "ellipse": lamp_of("AREA", (-2.5, 0.1, 0.6), (0, 0, 0.5), shape="ELLIPSE", size=(0.9, 0.3)),
    "soft box": lamp_of("AREA", size=(0.8, 0.8), spread=2.0),
    "huge": lamp_of("AREA", (0, 0, 2.5), size=(5, 5)),
    "tiny": lamp_of("AREA", size=(1e-3, 1e-3)),
    "among": lamp_of("AREA", (0.1, 0.1, 0.7), (0.5, 0.3, 0), size=(1, 1)),
    "sun": lamp_of("SUN", (1, 0.5, 2), angle=0.2),
    "real sun": lamp_of("SUN", (2, 0.5, 0.6), angle=0.0092),
    "wide sun": lamp_of("SUN", (0.1, 0.5, 2), angle=2.0),
}


@pytest.mark.parametrize("merge", [True, False], ids=["polygons", "triangles"])
@pytest.mark.parametrize("name", LAMPS)
def test_every_lamp(name, merge):
    scene = clutter()
    masks = compare(scene, scattered(scene, 6000), sample_lamp(LAMPS[name], 64), merge)
    statistics = masks.statistics
    parts = statistics.lit + statistics.umbra + statistics.away + statistics.geometry + statistics.rays
    assert parts == statistics.relations == 6000 * 64
    # geometry decides most, even of receivers this far apart
    assert statistics.rays < 0.25 * statistics.relations


@pytest.mark.parametrize("samples", [1, 7, 64, 65, 256, 1000])
def test_any_number_of_samples(samples):
    scene = clutter(1)
    masks = compare(scene, scattered(scene, 1500), sample_lamp(LAMPS["square"], samples))
    assert masks.words.shape[1] == -(-samples // 64)


@pytest.mark.parametrize("name", ["disk", "sun"])
def test_sets_of_samples(name):
    scene = clutter(2)
    receivers = scattered(scene, 4000)
    receivers = Receivers(receivers.position, receivers.normal, (np.arange(4000) % 4).astype(np.uint8))
    lamp = sample_lamp(LAMPS[name], 64, sets=4)
    assert len(np.unique(lamp.places[:, :, 0], axis=0)) == 4
    compare(scene, receivers, lamp)


def test_emissive_quad():
    corners = np.array([(-0.5, -0.2, 2.4), (-0.4, 0.6, 2.2), (0.5, 0.9, 2.3), (0.4, 0.1, 2.5)])
    lamp = sample_quad(corners, 64)
    places = lamp.targets()[0]
    u, v = corners[1] - corners[0], corners[3] - corners[0]
    inside = np.linalg.lstsq(np.stack([u, v], 1), (places - corners[0]).T, rcond=None)[0]
    assert inside.min() > -1e-5 and inside.max() < 1 + 1e-5
    assert np.abs((places - corners[0]) @ np.cross(u, v)).max() < 1e-5
    scene = clutter(3)
    compare(scene, scattered(scene, 3000), lamp)
    with pytest.raises(SceneError, match="no parallelogram"):
        sample_quad(corners * (1, 1, 1) + np.eye(4, 3), 64, name="Bent")


@pytest.mark.parametrize("place", [(0.2, 0.1, 2.0), (0.3, 0.3, 0.4)])
def test_lamps_with_a_volume(place):
    scene = clutter(4)
    lamp = sample_ball(place, 0.3, 64)
    radius = np.linalg.norm(lamp.targets()[0] - place, axis=1)
    assert radius.max() <= 0.3 + 1e-6 and np.median(radius) == pytest.approx(0.3 * 0.5 ** (1 / 3), rel=0.05)
    compare(scene, scattered(scene, 3000), lamp)
    compare(scene, scattered(scene, 3000), sample_lamp(lamp_of("POINT", place, radius=0.2), 64))


@pytest.mark.parametrize("stage", stages.STAGES)
def test_the_stages(stage):
    found = stages.STAGES[stage]()
    place, normal = stages.receivers(found, 64)
    masks = compare(found.scene, Receivers(place, normal), sample_lamp(found.lamp, 256))
    assert masks.statistics.rays < 0.1 * masks.statistics.relations


def test_one_occluder_in_closed_form():
    """What a floor sees of a square lamp past a square sheet: an overlap of rectangles, counted in samples."""
    sheet = grid((-0.5, -0.5, 1), (1, 0, 0), (0, 1, 0), 3, 2)
    scene = scene_of([FLOOR, sheet])
    place = np.stack(np.meshgrid(np.linspace(-1.4, 1.4, 40), np.linspace(-1.4, 1.4, 40), [1e-3]), -1).reshape(-1, 3)
    receivers = Receivers(place.astype(np.float32), np.tile(np.float32([0, 0, 1]), (len(place), 1)))
    masks = compare(scene, receivers, sample_lamp(area_lamp((0, 0, 3), 1.0), 4096))
    # the sheet's edges, as seen from a receiver, on the lamp's plane
    t = (3 - place[:, 2:]) / (1 - place[:, 2:])
    low, high = (np.clip(place[:, :2] + (edge - place[:, :2]) * t, -0.5, 0.5) for edge in (-0.5, 0.5))
    hidden = (high - low).prod(axis=1)
    assert np.abs(masks.seen() - (1 - hidden)).max() < 0.005
    assert (masks.index == UMBRA).any() and (masks.index == LIT).any() and (masks.index >= 0).any()


# ---- where penumbra casting fails (design) ----


def test_lamp_cutting_through_geometry():
    shapes = [FLOOR, box(np.array([-0.5, -0.5, 0.5]), *np.diag([1.0, 1.0, 1.0]), 2)]
    scene = scene_of(shapes)
    for height in (0.5, 0.8, 1.5):
        compare(scene, scattered(scene, 3000), sample_lamp(lamp_of("AREA", (0.4, 0.3, height), size=(1.2, 1.2)), 64))


def test_lamp_on_a_ceiling_and_on_a_wall():
    scene = scene_of([*room((-2, -2, 0), (2, 2, 2.5), 2), column((0.5, 0.3, 0), 0.2, 2.5, 12)])
    receivers = scattered(scene, 3000)
    for lift in (0, 1e-6, 1e-4, 1e-3):
        compare(scene, receivers, sample_lamp(area_lamp((0, 0, 2.5 - lift), 1.0), 64))
        wall = lamp_of("AREA", (-2 + lift, 0.2, 1), (2, 0.2, 1), size=(1, 0.5))
        compare(scene, receivers, sample_lamp(wall, 64))


def test_receivers_on_the_lamp_and_behind_it():
    scene = clutter(5)
    random = np.random.default_rng(1)
    place = np.concatenate(
        [
            random.uniform((-0.2, -0.3, 2.5), (0.8, 0.7, 2.5), (200, 3)),
            np.array((0, 0, 4)) + random.normal(size=(200, 3)),
        ]
    )
    normal = random.normal(size=(400, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    receivers = Receivers(place.astype(np.float32), normal.astype(np.float32))
    masks = compare(scene, receivers, sample_lamp(area_lamp((0.3, 0.2, 2.5), 1.0), 64))
    assert (masks.index[200:][place[200:, 2] > 2.5] == AWAY).all()


def test_degenerate_triangles():
    random = np.random.default_rng(2)
    needle = random.uniform((-1, -1, 0), (1, 1, 2), (40, 3, 3))
    needle[:20, 2] = needle[:20, 1]
    needle[20:30, 2] = (needle[20:30, 0] + needle[20:30, 1]) / 2
    needle[30:, 2] = needle[30:, 1] + 1e-6
    scene = clutter(6, 5)
    tracer = Tracer(scene)
    corners = np.concatenate([tracer.solid_corners, needle.astype(np.float32)])
    bvh = Bvh(corners)
    lamp, receivers = sample_lamp(LAMPS["square"], 64), scattered(scene, 3000)
    masks = cast(receivers, lamp, Occluders(corners, bvh.occluded), cost=Cost(64, "lines"))
    assert differing(masks, cast_rays(receivers, lamp, bvh.occluded)) == 0


def test_coplanar_and_touching_polygons():
    """Sheets in one plane, one on another, edges on edges; receivers between them."""
    sheets = [grid((x, y, 1), (0.5, 0, 0), (0, 0.5, 0), 1, 1) for x in (-1, -0.5, 0.2) for y in (-0.5, 0, 0.1)]
    stack = [grid((-0.5, -0.5, 0.5 + k * 1e-3), (1, 0, 0), (0, 1, 0), 1, 1) for k in range(4)]
    scene = scene_of([FLOOR, *sheets, *stack])
    compare(scene, scattered(scene, 5000), sample_lamp(LAMPS["square"], 64))


def test_contact():
    """Receivers along the foot of a box: edges closer than float32 can tell at the lamp go to rays."""
    shapes = [FLOOR, box(np.array([0.0, 0, 0]), *np.diag([1.0, 1.0, 1.0]), 1)]
    scene = scene_of(shapes)
    offset = Tracer(scene).offset
    away = np.geomspace(1e-6, 0.3, 500)
    place = np.stack([-away, np.linspace(0.1, 0.9, 500), np.full(500, offset)], axis=1)
    receivers = Receivers(place.astype(np.float32), np.tile(np.float32([0, 0, 1]), (500, 1)))
    for name in ("square", "disk", "sun", "huge"):
        compare(scene, receivers, sample_lamp(LAMPS[name], 256))


@pytest.mark.parametrize("scale", [1e-3, 1e3])
@pytest.mark.parametrize("shift", [0, 30])
def test_scenes_in_millimetres_and_kilometres(scale, shift):
    scene = clutter(7, 10)
    moved = scene_of([(scene.positions[scene.triangles] + shift) * scale])
    matrix = LAMPS["square"].matrix.copy()
    matrix[:3, 3] = (matrix[:3, 3] + shift) * scale
    lamp = Light("Lamp", "AREA", matrix, 1.0, size=(0.8 * scale, 0.8 * scale))
    masks = compare(moved, scattered(moved, 2000), sample_lamp(lamp, 64))
    assert masks.statistics.rays < 0.5 * masks.statistics.relations


def test_many_tiny_triangles():
    scene = scene_of([FLOOR, sphere((0, 0, 1), 0.5, 40, 80), sphere((0.7, 0.2, 0.6), 0.4, 24, 48)])
    compare(scene, scattered(scene, 4000), sample_lamp(LAMPS["square"], 64))


def test_inverted_and_nested_and_open_solids():
    inner, outer = (box(np.array((-s, -s, 1 - s)), *np.diag([2 * s] * 3), 1) for s in (0.2, 0.5))
    aside = np.array((1.5, 0, 0))
    # inside out, one in the other, and one without its lid
    shapes = [FLOOR, inner[:, ::-1], outer + aside, inner + aside, outer[2:] - aside]
    scene = scene_of(shapes)
    compare(scene, scattered(scene, 5000), sample_lamp(LAMPS["square"], 64))
    # the lamp inside of a closed solid
    inside = sample_lamp(lamp_of("AREA", (1.5, 0, 1.3), size=(0.3, 0.3)), 64)
    compare(scene, scattered(scene, 5000), inside)


def test_coincidences():
    """Triangles, receivers and lamps on one lattice: edges through receivers and samples, planes through everything."""
    for seed in range(80):
        random = np.random.default_rng(seed)
        corners = random.integers(-4, 5, (int(random.integers(1, 50)), 3, 3)) * 10.0 ** random.integers(-2, 3)
        scale = np.abs(corners).max() / 4
        if random.random() < 0.3:
            corners = corners @ np.linalg.qr(random.normal(size=(3, 3)))[0]
        corners = corners.astype(np.float32)
        matrix = np.eye(4)
        matrix[:3, 3] = random.integers(-8, 9, 3) / 2 * scale
        size = float(random.choice([0.01, 1, 4])) * scale
        light = (
            Light("Lamp", "SUN", matrix, 1.0, angle=0.3)
            if seed % 4 == 0
            else replace(LAMPS["disk" if seed % 2 else "square"], matrix=matrix, size=(size, size))
        )
        receivers = Receivers((random.integers(-8, 9, (300, 3)) / 2 * scale).astype(np.float32))
        lamp, bvh = sample_lamp(light, 32), Bvh(corners)
        masks = cast(receivers, lamp, Occluders(corners, bvh.occluded, bool(seed % 3)), cost=Cost(32, "lines"))
        assert differing(masks, cast_rays(receivers, lamp, bvh.occluded)) == 0, seed


def test_nothing_there():
    scene = scene_of([FLOOR])
    lamp = sample_lamp(LAMPS["square"], 64)
    empty = Receivers(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32))
    assert len(compare(scene, empty, lamp)) == 0
    one = Receivers(np.float32([[0, 0, 0.1]]), np.float32([[0, 0, 1]]))
    assert compare(scene, one, lamp).index[0] == LIT
    away = Receivers(one.position, -one.normal)
    assert compare(scene, away, lamp).index[0] == AWAY
    none = Occluders(np.zeros((0, 3, 3), np.float32), lambda o, v: np.zeros(len(o), bool))
    assert cast(one, lamp, none, cost=Cost(64, "lines")).index[0] == LIT


def test_without_normals():
    scene = clutter(8, 10)
    receivers = Receivers(scattered(scene, 2000).position)
    compare(scene, receivers, sample_lamp(LAMPS["square"], 64))


def test_threads_and_cost_change_nothing():
    scene = clutter(9)
    tracer = Tracer(scene)
    occluders, receivers = Occluders.of(tracer), scattered(scene, 40000)
    lamp = sample_lamp(LAMPS["square"], 128)
    results = [
        cast(receivers, lamp, occluders, threads, Cost(128, always))
        for threads, always in ((1, "lines"), (3, "lines"), (2, ""), (1, "rays"))
    ]
    for other in results[1:]:
        assert (other.packed() == results[0].packed()).all()
    assert results[0].statistics.rays < results[3].statistics.rays


class _Torn(Cost):
    """Lines where a cluster has few candidates, rays elsewhere, whatever either takes."""

    def most_candidates(self):
        return 20.0

    def worth(self, receivers):
        return True

    def worth_preparing(self, *_):
        return True


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_some_clusters_by_lines_and_some_by_rays(threads):
    scene = clutter(9, 60)
    tracer = Tracer(scene)
    receivers, lamp = scattered(scene, 20000), sample_lamp(LAMPS["square"], 64)
    masks = cast(receivers, lamp, Occluders.of(tracer), threads, _Torn(64))
    assert differing(masks, cast_rays(receivers, lamp, tracer.blocked)) == 0
    statistics = masks.statistics
    assert 0.1 < statistics.by_rays < 0.9
    assert min(statistics.geometry, statistics.rays) > 0.05 * statistics.relations


def test_cost_weighs_what_it_learns():
    cost = Cost(256)
    cost.learn_rays(10**6, 0.1)
    assert not cost.worth(1000) and cost.worth(10_000)
    assert not Cost(64).worth(10_000) and Cost(64).worth(100_000) and not Cost(16).worth(100_000)
    none, all_ = np.zeros(16), np.full(16, 1e6)
    assert cost.worth_preparing(none, 1000, 10_000, 2) and not cost.worth_preparing(all_, 1000, 10_000, 2)
    # too many polygons for so few receivers, though lines would win
    assert not cost.worth_preparing(none, 60, 10**6, 2) and cost.worth_preparing(none, 6000, 10**6, 2)
    before = cost.most_candidates()
    cost.learn_lines(10**5, 1.0)
    assert cost.most_candidates() < before
    assert cost.prefers_rays(np.array([1, 10**5])).tolist() == [False, True]
    before = cost.most_candidates()
    cost.learn_rays(10**6, 1.0)
    assert cost.most_candidates() > before
    assert Cost(64, "lines").worth_preparing(all_, 1, 10**6, 2) and not Cost(64, "rays").worth(10**6)


def test_lamps_that_have_no_samples():
    for light, words in (
        (lamp_of("AREA", size=(0, 1)), "no size"),
        (lamp_of("AREA", spread=0.0), "sharp"),
        (lamp_of("SUN"), "angle"),
        (lamp_of("POINT"), "radius"),
    ):
        with pytest.raises(SceneError, match=words):
            sample_lamp(light, 16)
    with pytest.raises(SceneError, match="at least one sample"):
        sample_lamp(LAMPS["square"], 0)


def test_adaptive_resolution():
    """A floor under some boxes: fewer receivers are cast, and what they leave out sees what it would have seen."""
    random = np.random.default_rng(3)
    shapes = [FLOOR]
    for _ in range(6):
        shapes.append(box(random.uniform((-1.5, -1.5, 0), (1, 1, 0.3)), *np.diag(random.uniform(0.3, 0.6, 3)), 1))
    scene = scene_of(shapes)
    side = 192
    across = np.linspace(-2, 2, side)
    place = np.stack([*np.meshgrid(across, across, indexing="xy"), np.full((side, side), 1e-3)], -1).reshape(-1, 3)
    receivers = Receivers(place.astype(np.float32), np.tile(np.float32([0, 0, 1]), (side * side, 1)))
    lamp, occluders = sample_lamp(area_lamp((0.2, 0.1, 3), 0.5), 64), Occluders.of(Tracer(scene))
    full = cast(receivers, lamp, occluders)
    grid_rows = np.arange(side * side).reshape(side, side)
    surface = (place[:, 0] > 0.5).astype(int)
    masks, was_cast = cast_adaptively(receivers, grid_rows, surface, lamp, occluders)
    assert was_cast.mean() < 0.6
    assert (masks.packed()[was_cast] == full.packed()[was_cast]).all()
    assert masks.statistics.relations == was_cast.sum() * 64
    # nothing here is narrower than the step but a shadow's last traces
    gap = np.abs(masks.seen() - full.seen())
    assert gap.max() < 0.1 and (gap > 0).mean() < 0.01
    # what has no place in the raster is cast
    grid_rows[:, ::2] = -1
    masks, was_cast = cast_adaptively(receivers, grid_rows, surface, lamp, occluders)
    assert was_cast.reshape(side, side)[:, ::2].all()
    assert (masks.packed()[was_cast] == full.packed()[was_cast]).all()
