"""Dart throwing: against all pairs, against throwing one dart after another, and where light gets at all."""

from functools import cache

import numpy as np
import pytest
from lightpanes.core import rays
from lightpanes.core import threads as workers
from lightpanes.core.point_cache import PointSet, guides, make_points, make_points_by_darts, survey
from lightpanes.core.point_cache.build import COARSE, Ground
from lightpanes.core.point_cache.darts import FLAT, LIKE, PACKING, WINDOW, Darts, Fragments, throw
from lightpanes.core.rays import Bvh, Tracer
from lightpanes.core.scene import Scene
from lightpanes.core.surface import SurfaceSamples, make_patches
from lightpanes.core.surface.patches import bisect

from .shapes import box, globe, lamp, quad, room, room_parts, scene


def surveyed(made: Scene, **how) -> Ground:
    """The least coarse set that there is."""
    patches = make_patches(made, 500)
    return survey(made, patches, Bvh(patches.corners), Tracer(made).offset, **({"count": COARSE[0]} | how))


@cache
def room_ground() -> Ground:
    return surveyed(room(lights=[lamp((3, 1.5, 2))]))


def everywhere(samples: SurfaceSamples) -> np.ndarray:
    return np.ones(len(samples), bool)


def pieces(made: Scene, radius, back: bool = False, longest: float = np.inf) -> Fragments:
    """The scene's triangles as fragments; radius: (f, 3) middles → (f,) m, on their fronts, on both sides if `back`."""
    corners, parent, weights = bisect(made.positions[made.triangles], longest)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    front = np.broadcast_to(radius(corners.mean(axis=1)), len(parent))
    sides = np.stack([front, front if back else np.full(len(parent), np.nan)], 1)
    return Fragments(parent, weights, area.astype(np.float64), sides.reshape(-1).astype(np.float32))


def as_points(darts: Darts) -> PointSet:
    return PointSet(darts.samples, darts.radius, np.ones(len(darts.radius), np.float32), darts.back)


def too_near(a, b) -> np.ndarray:
    """(m, 2) rows of all pairs of places, (position, normal, radius) each, that are of like normals, on one surface, and
    closer to each other than the smaller radius."""
    (p, n, r), (q, m, s) = (tuple(v.astype(np.float64) for v in side) for side in (a, b))
    distance = np.sqrt(sum((q[:, k] - p[:, k, None]) ** 2 for k in range(3)))
    # what float32 rounds off
    i, j = np.nonzero(distance < np.minimum(r[:, None], s) * (1 - 1e-4) - 1e-6 * np.abs(p).max())
    rise = np.abs(((q[j] - p[i]) * (n[i] + m[j]) / 2).sum(axis=1))
    one = ((n[i] * m[j]).sum(axis=1) > LIKE) & (rise <= FLAT * distance[i, j])
    return np.stack([i[one], j[one]], 1)


def crowded(points) -> int:
    """Pairs of points (a PointSet or darts) that are too near each other, counted twice."""
    some = points.samples.position, points.samples.normal, points.radius
    # each is near itself
    return sum(len(too_near(tuple(v[s] for v in some), some)) for s in rays.chunks(len(some[2]), 500)) - len(some[2])


# ---- the set ----


@pytest.mark.parametrize(
    "shape", [(room_parts(), 0.13), (((*globe(rings=24), 0),), 0.1), (((*globe(rings=6, inward=False), 0),), 0.1)]
)
def test_no_two_points_are_nearer_than_the_smaller_radius(shape):
    parts, size = shape
    made = scene(*parts, materials=room().materials)
    darts = throw(made, pieces(made, lambda middle: size), everywhere)
    assert len(darts.radius) > 500
    assert crowded(darts) == 0


@pytest.mark.parametrize("back", [False, True])
def test_where_the_radius_varies(back):
    # it grows as fast as a guide may, away from a place on the floor; on fronts, or on both sides of all faces
    made = room()
    place = np.array([1, 1, 0])
    fragments = pieces(
        made, lambda middle: 0.03 + guides.SLOPE * np.linalg.norm(middle - place, axis=1), back, longest=0.1
    )
    darts = throw(made, fragments, everywhere)
    assert len(darts.radius) > 80
    assert darts.radius.max() > 5 * darts.radius.min()
    assert darts.back.any() == back
    assert crowded(darts) == 0


def test_a_wild_guide_keeps_the_distance():
    # radii at random, a factor of a hundred apart, are tamed
    ground = room_ground()
    random = np.random.default_rng(0)
    for radius in (
        np.exp(random.normal(0, 2, len(ground.coarse))),
        np.exp(4 * (random.uniform(size=len(ground.coarse)) < 0.02)),
    ):
        points = make_points(ground, radius.astype(np.float32), 2500)
        assert points.radius.max() <= guides.RATIO * 1.001 * points.radius.min()
        assert crowded(points) == 0


def one_by_one(samples: SurfaceSamples, radius: np.ndarray) -> np.ndarray:
    """Rows of the darts that stick when they are thrown one after another."""
    kept: list[int] = []
    for row in range(len(radius)):
        here, there = ((samples.position[k], samples.normal[k], radius[k]) for k in ([row], np.array(kept, int)))
        if not len(too_near(here, there)):
            kept.append(row)
    return np.array(kept)


@pytest.mark.parametrize("batch", [70, 65_536])
def test_the_set_is_what_throwing_one_by_one_gives(batch):
    # a pitched roof above a block, a radius for each triangle
    made = scene((*globe(rings=5, inward=False), 0), (*box((-0.5, -0.5, 1), (0.5, 0.5, 1.3)), 0))
    table = np.random.default_rng(1).uniform(0.2, 0.28, len(made.triangles)).astype(np.float32)
    fragments = pieces(made, lambda middle: table, back=True)
    thrown = []

    def record(samples):
        thrown.append(samples)
        return everywhere(samples)

    # the first batch is asked about whole, since nothing is in its way
    throw(made, fragments, record, seed=4)
    darts = throw(made, fragments, everywhere, seed=4, batch=batch)
    rows = one_by_one(thrown[0], table[thrown[0].triangle])
    assert len(thrown[0]) > 5 * len(rows) > 500
    assert np.array_equal(darts.number, rows)
    assert np.array_equal(darts.samples.position, thrown[0].position[rows])


@pytest.mark.parametrize("batch", [300, 65_536])
def test_darts_that_look_around_themselves(batch):
    """Bikker & Reijerse's own rule: a dart's radius comes from what it sees, and is not asked for where it cannot
    matter."""
    made = scene((*globe(rings=5, inward=False), 0), (*box((-0.5, -0.5, 1), (0.5, 0.5, 1.3)), 0))
    table = np.random.default_rng(1).uniform(0.2, 0.28, len(made.triangles)).astype(np.float32)
    fragments = pieces(made, lambda middle: 0.2 + 0 * middle[:, 0], back=True)
    thrown, asked = [], []

    def measure(samples, number):
        asked.append(len(number))
        return table[samples.triangle]

    throw(made, fragments, lambda samples: thrown.append(samples) or everywhere(samples), seed=4)
    asked.clear()
    darts = throw(made, fragments, everywhere, seed=4, batch=batch, least=0.2, measure=measure)
    rows = one_by_one(thrown[0], table[thrown[0].triangle])
    assert np.array_equal(darts.number, rows) and len(rows) > 300
    assert np.array_equal(darts.radius, table[darts.samples.triangle])
    if batch == 300:
        assert sum(asked) < 0.5 * len(thrown[0])


def test_ambient_occlusion_of_each_dart():
    ground = room_ground()
    points = make_points_by_darts(ground, 1500, seed=3)
    assert len(points) == pytest.approx(1500, rel=0.2)
    assert crowded(points) == 0
    # its own ambient occlusion, between a least radius and a most twelve times as large
    most = points.radius.max() / guides.by_occlusion(points.ao).max()
    assert np.allclose(points.radius, most * guides.by_occlusion(points.ao), rtol=1e-5)
    again = make_points_by_darts(ground, 1500, seed=3, batch=5000)
    assert np.array_equal(points.position, again.position) and np.array_equal(points.ao, again.ao)


@pytest.mark.parametrize(("batch", "threads"), [(997, 1), (20_000, 2), (65_536, 5)])
def test_neither_batches_nor_threads_change_the_set(monkeypatch, batch, threads):
    ground = room_ground()
    first = make_points(ground, guides.by_occlusion(ground.ao), 1500, seed=3, batch=8192)
    monkeypatch.setattr(workers, "thread_count", lambda: threads)
    again = make_points(ground, guides.by_occlusion(ground.ao), 1500, seed=3, batch=batch)
    for name in ("position", "normal", "radius", "ao", "back"):
        assert np.array_equal(getattr(first, name), getattr(again, name))
    other = make_points(ground, guides.by_occlusion(ground.ao), 1500, seed=4)
    assert not (other.position[:, None] == first.position).all(axis=2).any()
    assert len(other) == pytest.approx(len(first), rel=0.05)


def test_threads_do_not_change_the_coarse_set(monkeypatch):
    first = room_ground()
    monkeypatch.setattr(workers, "thread_count", lambda: 1)
    again = surveyed(first.scene)
    assert np.array_equal(first.coarse.position, again.coarse.position)
    assert np.array_equal(first.ao, again.ao) and np.array_equal(first.harmonic, again.harmonic)


def floor(side: float = 1.0) -> Scene:
    return scene((*quad((0, 0, 0), (side, 0, 0), (0, side, 0)), 0))


def test_a_number_of_points_ends_the_throwing():
    made = floor()
    fragments = pieces(made, lambda middle: 0.03)
    whole = throw(made, fragments, everywhere)
    for batch in (100, 65_536):
        some = throw(made, fragments, everywhere, count=200, batch=batch)
        assert np.array_equal(some.number, whole.number[:200])


def test_few_hits_end_the_throwing():
    # light gets to a corner only: most darts are in vain
    made = floor()
    fragments = pieces(made, lambda middle: 0.01)
    corner = lambda samples: (samples.position[:, :2] < 0.15).all(axis=1)  # noqa: E731
    sets = [throw(made, fragments, corner, batch=batch) for batch in (3000, WINDOW, 65_536)]
    assert len(sets[0].number) > 50
    assert all(np.array_equal(sets[0].number, other.number) for other in sets)
    assert sets[0].thrown < 0.7 * throw(made, fragments, everywhere, batch=3000).thrown


def test_nothing_to_throw_at():
    made = floor()
    none = throw(made, pieces(made, lambda middle: np.nan), everywhere)
    assert len(none.radius) == len(none.samples) == 0
    dark = throw(made, pieces(made, lambda middle: 0.1), lambda samples: ~everywhere(samples))
    assert len(dark.radius) == 0


# ---- how even it is ----


@cache
def even() -> tuple[float, np.ndarray]:
    """A radius, and the points' places on a floor of 1 m²."""
    made = floor()
    return 0.016, throw(made, pieces(made, lambda middle: 0.016), everywhere).samples.position[:, :2].astype(np.float64)


def test_the_floor_is_full():
    radius, place = even()
    # random discs of half the radius never cover more than 0.547 of it (Feder 1980)
    assert len(place) * radius**2 == pytest.approx(PACKING, rel=0.1)
    assert len(place) * radius**2 < 0.547 * 4 / np.pi * 1.02
    random = np.random.default_rng(2).uniform(size=(4000, 2))
    hole = np.concatenate([np.linalg.norm(p[:, None] - place, axis=2).min(axis=1) for p in np.split(random, 20)])
    assert np.quantile(hole, 0.99) < 1.1 * radius
    assert hole.max() < 1.6 * radius


def test_points_are_blue_noise():
    radius, place = even()
    inner = place[((place > 5 * radius) & (place < 1 - 5 * radius)).all(axis=1)]
    distance = np.concatenate([np.linalg.norm(p[:, None] - place, axis=2).ravel() for p in np.array_split(inner, 20)])
    edges = np.arange(0, 5.01, 0.1) * radius
    pairs = np.histogram(distance[distance > 0], edges)[0]
    correlation = pairs / (len(inner) * len(place) * np.pi * np.diff(edges**2))
    assert (correlation[:9] == 0).all()
    # next to the radius neighbours stand closer than by chance, far off they are as chance would have it
    assert correlation[10:12].mean() > 1.5
    assert correlation[40:].mean() == pytest.approx(1, abs=0.03)
    assert np.abs(correlation[40:] - 1).max() < 0.12


def test_no_low_frequencies():
    # the radial power spectrum: white noise has 1 everywhere
    radius, place = even()
    waves = np.array([(x, y) for x in range(-12, 13) for y in range(-12, 13) if 3 < np.hypot(x, y) < 12.5])
    window = np.prod(np.sin(np.pi * place) ** 2, axis=1)
    power = np.abs((window * np.exp(-2j * np.pi * waves @ place.T)).sum(axis=1)) ** 2 / (window**2).sum()
    assert np.hypot(*waves.T).max() < 0.25 / radius
    assert power.mean() < 0.15


def test_the_count_is_met_about():
    ground = room_ground()
    for count in (600, 2400):
        assert 0.8 * count < len(make_points(ground, guides.by_occlusion(ground.ao), count)) < 1.2 * count


# ---- where light gets ----


def boxed(**more) -> Scene:
    """A room with a closed box in the air and one on the floor."""
    parts = (
        (*box((0, 0, 0), (4, 3, 2.5), True), 0),
        (*box((1, 1, 0.8), (1.6, 1.6, 1.4)), 0),
        (*box((2.5, 1, 0), (3, 2, 0.6)), 0),
    )
    return scene(*parts, names=["Room", "Air box", "Floor box"], **more)


def inside(place, low, high):
    return ((place > low) & (place < high)).all(axis=1)


def test_no_point_inside_of_solid_things_nor_outside_of_the_room():
    ground = surveyed(boxed(lights=[lamp((3.5, 0.5, 2))]))
    points = make_points(ground, guides.uniform(ground.coarse), 4000)
    air = points.position + 1e-3 * points.samples.flat
    assert len(points) > 3000
    assert inside(air, (0, 0, 0), (4, 3, 2.5)).all()
    assert not inside(air, (1, 1, 0.8), (1.6, 1.6, 1.4)).any()
    assert not inside(air, (2.5, 1, 0), (3, 2, 0.6)).any()
    # but on all faces of the box in the air
    owner = ground.scene.triangle_object[points.samples.triangle]
    facing = np.rint(points.samples.flat[owner == 1]).astype(int)
    assert len(np.unique(facing, axis=0)) == 6


def test_a_sealed_dark_room_gets_points_when_lamps_may_go_there():
    left, right = box((0, 0, 0), (2, 2, 2), True), box((2.1, 0, 0), (4.1, 2, 2), True)
    made = scene((*left, 0), (*right, 0), lights=[lamp((1, 1, 1))])
    places = make_patches(made, 500)
    seen = places.sample(made, np.arange(len(places)), 1)
    there = {}
    for name, how in {"lamps": {}, "seen": {"seen": seen}, "place": {"places": np.array([[3.1, 1, 1]])}}.items():
        ground = surveyed(made, **how)
        points = make_points(ground, guides.uniform(ground.coarse), 1000)
        there[name] = (points.position[:, 0] > 2.05).mean()
        assert inside(points.position + 1e-3 * points.samples.flat, (0, 0, 0), (4.1, 2, 2)).all()
    assert there["lamps"] == 0
    assert there["seen"] == pytest.approx(0.5, abs=0.05)
    assert there["place"] == pytest.approx(0.5, abs=0.05)
