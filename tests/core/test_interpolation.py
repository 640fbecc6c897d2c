"""Spreading values from points: against slow loops over all pairs, linear fields and rays found in double precision."""

from functools import cache

import numpy as np
import pytest
from lightpanes.core.point_cache import Interpolator, PointSet, Weights
from lightpanes.core.point_cache import interpolation as settings
from lightpanes.core.point_cache.interpolation import KEEP, KERNELS, REACH, SHEPARD
from lightpanes.core.rays import Bvh, Tracer
from lightpanes.core.scene import Scene
from lightpanes.core.surface import SurfaceSamples, sample_triangles

from .shapes import box, globe, quad, room, scene
from .test_darts import as_points, everywhere, floor, pieces, throw
from .test_rays import intersect

HONEST = [kernel for kernel in KERNELS if not kernel.startswith("bare")]
"""Kernels that heed walls and normals."""


def anywhere(made: Scene, count: int, seed: int = 0, rows=None) -> SurfaceSamples:
    """Random places on the fronts of triangles `rows`, or of all, by area."""
    random = np.random.default_rng(seed)
    rows = np.arange(len(made.triangles)) if rows is None else rows
    area = np.linalg.norm(made.triangle_cross()[rows], axis=1).astype(np.float64)
    weights = random.dirichlet((1, 1, 1), count)
    return sample_triangles(made, random.choice(rows, count, p=area / area.sum()), weights).on_side(
        made, np.zeros(count, bool)
    )


@cache
def plane():
    """A floor of 1 m², its points, and places on it."""
    made = floor()
    points = as_points(throw(made, pieces(made, lambda middle: 0.04 + 0.06 * middle[:, 0], longest=0.05), everywhere))
    return made, points, anywhere(made, 2000)


def crowd(radius: float, position, made: Scene) -> PointSet:
    """Points of one radius at places (n, 3) on a scene's first triangle."""
    position = np.asarray(position, np.float32)
    up = np.tile(np.float32([0, 0, 1]), (len(position), 1))
    nowhere = np.zeros(len(position), np.int32)
    samples = SurfaceSamples(position, up, up, nowhere, np.zeros((len(position), 3), np.float32))
    whole = np.ones(len(position), np.float32)
    return PointSet(samples, np.float32(radius) * whole, whole, whole < 0)


# ---- the kernels ----


@pytest.mark.parametrize("kernel", KERNELS)
def test_weights_are_of_points_in_reach_and_sum_to_one(kernel):
    made, points, places = plane()
    weights = Interpolator(points, Bvh(made.positions[made.triangles]), 1e-5).weights(places, kernel)
    assert not weights.orphan.any()
    assert weights.point.dtype == np.int32 and weights.weight.dtype == np.float32
    assert np.allclose(weights.weight.sum(axis=1), 1, atol=1e-5)
    assert np.allclose(weights.apply(np.full((len(points), 2), 3.5, np.float32)), 3.5, rtol=1e-5)
    apart = np.linalg.norm(points.position[weights.point] - places.position[:, None], axis=2)
    used = weights.weight != 0
    assert (apart < REACH * 1.0001 * points.radius[weights.point])[used].all()
    if kernel != "affine":
        assert weights.weight.min() >= 0
    if kernel in ("ward", "affine", "nearest"):
        assert weights.point.shape[1] == (1 if kernel == "nearest" else KEEP)
    # each point is named once
    named = np.sort(np.where(used, weights.point, -1 - np.arange(weights.point.shape[1])), axis=1)
    assert (np.diff(named, axis=1) > 0).all()


def test_other_kernels_are_refused():
    _, points, places = plane()
    with pytest.raises(ValueError, match=r"no interpolation 'gauss'.*ward"):
        Interpolator(points, None, 1e-5).weights(places, "gauss")


def slow_weights(points: PointSet, place: SurfaceSamples, kernel: str, corners=None) -> np.ndarray:
    """(q, n): one place after another, over all points, in double precision."""
    bare = kernel.startswith("bare")
    where, normal, radius = (v.astype(np.float64) for v in (points.position, points.normal, points.radius))
    result = np.zeros((len(place), len(points)))
    for row in range(len(place)):
        apart = where - place.position[row]
        distance = np.linalg.norm(apart, axis=1)
        measure = distance / (REACH * radius)
        if not bare:
            alike = normal @ place.normal[row].astype(np.float64)
            off = np.abs((apart * (points.samples.flat + place.flat[row]) / 2).sum(axis=1))
            measure[(alike <= settings.FACING) | (off >= settings.RISE * distance + 4e-5)] = np.inf
            if kernel == "ward":
                measure += np.sqrt(np.maximum(2 - 2 * alike, 0)) * settings.TURN / REACH
            near = np.flatnonzero(measure < 1)
            if corners is not None and len(near):
                lift = np.maximum(settings.LIFT * distance[near, None], 1e-5)
                start = place.position[row] + lift * place.flat[row]
                ahead = apart[near] + lift * (points.samples.flat[near] - place.flat[row])
                with np.errstate(invalid="ignore"):
                    *_, met = intersect(corners, start, ahead)
                measure[near[met < 1]] = np.inf
        order = np.argsort(measure)[: KEEP + 1]
        if kernel == "ward":
            near = np.maximum(1 - measure[order[:KEEP]] / min(measure[order[KEEP]], 1), 0)
            result[row, order[:KEEP]] = near
        else:
            result[row] = np.maximum(1 - measure, 0) ** SHEPARD[kernel.split()[-1]]
    return result / np.maximum(result.sum(axis=1, keepdims=True), 1e-30)


def dense(weights: Weights, points: int) -> np.ndarray:
    """(q, points)."""
    result = np.zeros((len(weights.point), points))
    np.add.at(result, (np.arange(len(result))[:, None], weights.point), weights.weight)
    return result


@pytest.mark.parametrize("kernel", ["ward", *SHEPARD, *(f"bare {name}" for name in SHEPARD)])
def test_kernels_on_a_plane_equal_a_slow_loop(kernel):
    # with points on both sides, which no ray tells apart here
    _, points, places = plane()
    below = points.samples.flipped(np.ones(len(points), bool))
    points = points.join(PointSet(below, points.radius, points.ao, ~points.back))
    places = places.take(slice(0, 300))
    found = dense(Interpolator(points, None, 1e-5).weights(places, kernel), len(points))
    assert np.allclose(found, slow_weights(points, places, kernel), atol=2e-4)


@pytest.mark.parametrize("kernel", ["ward", "quadratic"])
def test_kernels_in_a_room_equal_a_slow_loop(kernel):
    # a block to see around, and edges where the normal turns
    made = room()
    points = as_points(throw(made, pieces(made, lambda middle: 0.3), everywhere))
    places = anywhere(made, 400)
    corners = made.positions[made.triangles]
    found = dense(Interpolator(points, Bvh(corners), 1e-5).weights(places, kernel), len(points))
    expected = slow_weights(points, places, kernel, corners)
    # a ray that grazes an edge may go either way
    same = (np.abs(found - expected) < 2e-3).all(axis=1)
    assert same.mean() > 0.99
    blocked = slow_weights(points, places, kernel)
    assert (np.abs(blocked - expected).max(axis=1) > 0.05).mean() > 0.01


def test_nearest_is_a_smoothed_voronoi_diagram():
    # with a random part of the radius added to each distance, the nearer of two points wins by chance
    made = floor()
    points = crowd(0.2, [(0.4, 0.5, 0), (0.6, 0.5, 0)], made)
    for ahead in (-0.08, 0.2, -0.03, 0.0, 0.05):
        place = np.tile(np.float32([0.5 + ahead / 2, 0.5, 0]), (20_000, 1))
        places = crowd(1, place, made).samples
        weights = Interpolator(points, None, 1e-5).weights(places, "nearest")
        # the difference of two uniform numbers is below t with the odds 1 − (1 − t)² / 2
        lead = min(abs(ahead) / 0.2, 1)
        odds = 1 - (1 - lead) ** 2 / 2
        second = (weights.point[:, 0] == 1).mean()
        assert second == pytest.approx(odds if ahead >= 0 else 1 - odds, abs=0.012)
        assert (weights.weight == 1).all()
    again, other = (Interpolator(points, None, 1e-5).weights(places, "nearest", seed=seed) for seed in (0, 1))
    assert np.array_equal(again.point, weights.point) and not np.array_equal(other.point, weights.point)


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_single_point_serves_its_reach(kernel):
    made = floor(4.0)
    points = crowd(0.5, [(2, 2, 0)], made)
    place = np.stack([np.linspace(0, 4, 81), np.full(81, 2.0), np.zeros(81)], 1)
    weights = Interpolator(points, None, 1e-5).weights(crowd(1, place, made).samples, kernel)
    within = np.abs(place[:, 0] - 2) < REACH * 0.5 - 1e-3
    assert np.allclose(weights.weight[within].sum(axis=1), 1)
    assert weights.orphan[np.abs(place[:, 0] - 2) > REACH * 0.5 + 1e-3].all()


@pytest.mark.parametrize("kernel", KERNELS)
def test_no_points_and_no_places(kernel):
    _, points, places = plane()
    none = points.take(np.zeros(0, int))
    assert Interpolator(none, None, 1e-5).weights(places, kernel).orphan.all()
    assert len(Interpolator(points, None, 1e-5).weights(places.take(slice(0, 0)), kernel).point) == 0


# ---- linear fields ----


def test_affine_weights_meet_a_slope():
    # at least away from the border, where points stand on all sides
    _, points, places = plane()
    slope = np.array([[1.0, -2.0, 0]]).T
    inner = (np.abs(places.position[:, :2] - 0.5) < 0.35).all(axis=1)
    error = {}
    for kernel in ("affine", "ward"):
        found = Interpolator(points, None, 1e-5).weights(places, kernel).apply(points.position @ slope)
        error[kernel] = np.abs(found - places.position @ slope)[inner, 0]
    step = np.linalg.norm(slope) * points.radius.mean()
    rms = {kernel: np.sqrt((values**2).mean()) for kernel, values in error.items()}
    assert rms["affine"] < 0.1 * step
    assert error["affine"].max() < 0.5 * step
    assert rms["affine"] < 0.4 * rms["ward"]


@pytest.mark.parametrize("kernel", ["ward", "affine", "linear", "nearest"])
def test_gradients_carry_what_is_linear_in_place_and_normal(kernel):
    # on a globe with smooth normals
    points, triangles, _ = globe(rings=24, inward=False)
    shading = points[triangles] / np.linalg.norm(points[triangles], axis=2, keepdims=True)
    made = Scene(points, triangles, corner_normals=shading)
    known = as_points(throw(made, pieces(made, lambda middle: 0.15), everywhere))
    places = anywhere(made, 1000)
    random = np.random.default_rng(0)
    by_normal, by_place, base = random.normal(size=(3, 2)), random.normal(size=(3, 2)), random.normal(size=2)
    field = lambda samples: samples.normal @ by_normal + samples.position @ by_place + base  # noqa: E731
    rows = np.empty((len(known), 7, 2))
    rows[:, 0] = field(known.samples)
    rows[:, 1:4], rows[:, 4:7] = by_normal, by_place
    weights = Interpolator(known, None, 1e-5).weights(places, kernel)
    served = ~weights.orphan
    assert served.mean() > 0.99
    assert np.allclose(weights.carry(rows, known, places)[served], field(places)[served], atol=2e-5)
    steps = weights.steps(known, places)
    assert np.allclose(np.einsum("qka,qkac->qc", steps, rows[weights.point]), weights.carry(rows, known, places))


# ---- walls and edges ----


def walled(kind: str) -> Scene:
    """Two rooms with 1 mm between them: each a mesh, or one room with a wall, or a sheet without thickness."""
    if kind == "two rooms":
        return scene((*box((0, 0, 0), (1, 1, 1), True), 0), (*box((1.001, 0, 0), (2.001, 1, 1), True), 0))
    if kind == "wall":
        return scene((*box((0, 0, 0), (2.001, 1, 1), True), 0), (*box((1, -0.1, -0.1), (1.001, 1.1, 1.1)), 0))
    return scene((*box((0, 0, 0), (2.001, 1, 1), True), 0), (*quad((1, -0.1, -0.1), (0, 1.2, 0), (0, 0, 1.2)), 0))


def beyond(samples: SurfaceSamples, kind: str = "") -> np.ndarray:
    """Whether places lie in the second room."""
    if kind == "sheet":
        return samples.position[:, 0] + 1e-3 * samples.flat[:, 0] > 1
    return samples.position[:, 0] + 1e-3 * samples.flat[:, 0] > 1.0005


@pytest.mark.parametrize("kind", ["two rooms", "wall", "sheet"])
@pytest.mark.parametrize("kernel", HONEST)
def test_nothing_crosses_a_thin_wall(kind, kernel):
    # 100 on one side, 1 on the other: less than 1 % of the difference may cross, at any place
    made = walled(kind)
    points = as_points(throw(made, pieces(made, lambda middle: 0.12, back=kind == "sheet"), everywhere))
    air = points.position + 1e-4 * points.samples.flat
    points = points.take(((air > 0) & (air < (2.001, 1, 1))).all(axis=1))
    bvh = Bvh(made.positions[made.triangles])
    places = anywhere(made, 6000)
    if kind == "sheet":
        places = places.join(places.take(slice(0, 1500)).flipped(np.ones(1500, bool)))
    # and many by the wall
    near = anywhere(made, 60_000, 1)
    places = places.join(near.take(np.abs(near.position[:, 0] - 1) < 0.05))
    light = np.where(beyond(points.samples, kind), 1.0, 100.0)[:, None]
    weights = Interpolator(points, bvh, Tracer(made).offset).weights(places, kernel)
    served = ~weights.orphan
    crossed = np.abs(weights.apply(light)[:, 0] - np.where(beyond(places, kind), 1.0, 100.0))[served]
    assert crossed.max() < 0.01 * 99
    assert crossed.mean() < 1e-4 * 99


def test_bare_weights_do_leak():
    # so the test above can tell
    made = walled("two rooms")
    points = as_points(throw(made, pieces(made, lambda middle: 0.12), everywhere))
    places = anywhere(made, 6000)
    light = np.where(beyond(points.samples), 1.0, 100.0)[:, None]
    found = Interpolator(points, None, 1e-5).weights(places, "bare linear").apply(light)[:, 0]
    assert found[beyond(places)].max() > 30


@pytest.mark.parametrize("kernel", HONEST)
def test_light_stays_on_its_face_of_a_box(kernel):
    made = scene((*box((0, 0, 0), (1, 1, 1)), 0))
    points = as_points(throw(made, pieces(made, lambda middle: 0.1), everywhere))
    places = anywhere(made, 4000)
    face = lambda samples: np.rint(samples.flat) @ np.array([1, 2, 4])  # noqa: E731
    weights = Interpolator(points, Bvh(made.positions[made.triangles]), 1e-5).weights(places, kernel)
    assert weights.orphan.mean() < 0.01
    used = weights.weight != 0
    assert (face(points.samples)[weights.point] == face(places)[:, None])[used].all()
