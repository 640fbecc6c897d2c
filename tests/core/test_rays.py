"""Rays against a brute-force intersector in double precision."""

import sys
from threading import Event, Thread

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lightpanes.core import threads as workers
from lightpanes.core.rays import LAYERS, Bvh, Tracer, chunks, sample_map
from lightpanes.core.scene import Material, Scene, SceneObject
from lightpanes.core.threads import in_threads

from .shapes import quad, scene


def intersect(corners, origins, directions):
    """Closest triangle (n,), −1 for none, its u, v and distance: all pairs, float64 (Möller & Trumbore 1997)."""
    a, b, c = np.moveaxis(corners.astype(np.float64), 1, 0)
    origins, directions = origins.astype(np.float64)[:, None], directions.astype(np.float64)[:, None]
    first, second = b - a, c - a
    across = np.cross(directions, second)
    det = (first * across).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        start = origins - a
        u = (start * across).sum(-1) / det
        around = np.cross(start, first)
        v = (directions * around).sum(-1) / det
        t = (second * around).sum(-1) / det
    t[~((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0))] = np.inf
    best = t.argmin(1)
    rows = np.arange(len(t))
    distance = t[rows, best]
    return np.where(np.isfinite(distance), best, -1), u[rows, best], v[rows, best], distance


def soup(count=60, seed=0):
    random = np.random.default_rng(seed)
    middle = random.uniform(-1, 1, (count, 1, 3))
    return (middle + random.normal(0, 0.3, (count, 3, 3))).astype(np.float32)


def rays_around(count, seed=1):
    random = np.random.default_rng(seed)
    return random.uniform(-1.5, 1.5, (count, 3)).astype(np.float32), random.normal(size=(count, 3)).astype(np.float32)


def test_closest_hits_equal_brute_force():
    corners = soup()
    origins, directions = rays_around(2000)
    triangle, u, v, distance = intersect(corners, origins, directions)
    bvh = Bvh(corners)
    hits = bvh.hits(origins, directions)
    # float32 may decide otherwise on an edge
    same = hits.triangle == triangle
    assert same.mean() > 0.998
    assert (bvh.closest(origins, directions) == hits.triangle).all()
    rows = same & (triangle >= 0)
    for found, expected in ((hits.u, u), (hits.v, v), (hits.distance, distance)):
        assert np.allclose(found[rows], expected[rows], rtol=1e-3, atol=1e-3)
    near = bvh.hits(origins, directions, np.full(len(origins), 0.5, np.float32))
    assert (near.triangle >= 0).mean() == pytest.approx((distance < 0.5).mean(), abs=0.002)


def test_occlusion_is_a_hit_before_the_end():
    corners = soup()
    origins, vectors = rays_around(2000, 2)
    *_, distance = intersect(corners, origins, vectors)
    assert (Bvh(corners).occluded(origins, vectors) == (distance < 1)).mean() > 0.998


def test_the_surface_on_which_a_segment_ends_does_not_block_it():
    tracer = Tracer(scene((*quad((-1, -1, 0), (2, 0, 0), (0, 2, 0)), 0)))
    random = np.random.default_rng(3)
    origins = np.c_[random.uniform(-0.9, 0.9, (500, 2)), random.uniform(0.1, 2, 500)].astype(np.float32)
    ends = np.c_[random.uniform(-0.9, 0.9, (500, 2)), np.zeros(500)]
    assert tracer.visibility(origins, ends - origins).all()
    assert not tracer.visibility(origins, (ends - origins) * 1.01).any()


def test_a_mesh_of_shared_vertices_is_hit_like_its_corners():
    corners = soup()
    origins, directions = rays_around(2000)
    expected = Bvh(corners).hits(origins, directions)
    # the same vertices among others, in another order
    random = np.random.default_rng(4)
    place = random.permutation(400)[:180]
    positions = random.normal(size=(400, 3)).astype(np.float32)
    positions[place] = corners.reshape(-1, 3)
    found = Bvh(positions, place.reshape(-1, 3)).hits(origins, directions)
    for one, other in zip(found, expected, strict=True):
        assert np.array_equal(one, other)
    assert Bvh(positions, place.reshape(-1, 3)[:0]).closest(origins, directions).max() == -1


@pytest.mark.parametrize("shared", [False, True])
def test_other_threads_get_their_turn_while_embree_reads_a_mesh(shared):
    corners = soup(20_000)
    mesh = (corners.reshape(-1, 3), np.arange(60_000).reshape(-1, 3)) if shared else (corners,)
    turns, ended = [0], Event()

    def count():
        while not ended.is_set():
            turns[0] += 1
            ended.wait(1e-5)

    other, often = Thread(target=count), sys.getswitchinterval()
    other.start()
    try:
        sys.setswitchinterval(1e-5)
        before = turns[0]
        Bvh(*mesh)
        assert turns[0] > before + 100
    finally:
        sys.setswitchinterval(often)
        ended.set()
        other.join()


def test_nothing_to_hit():
    empty = Bvh(np.zeros((0, 3, 3), np.float32))
    origins, directions = rays_around(5)
    assert (empty.closest(origins, directions) == -1).all()
    assert (empty.hits(origins, directions).triangle == -1).all()
    assert not empty.occluded(origins, directions).any()
    tracer = Tracer(scene((*quad((0, 0, 0), (1, 0, 0), (0, 1, 0)), 0)))
    assert tracer.visibility(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)


@given(st.integers(0, 5000), st.integers(1, 700))
@settings(max_examples=40, deadline=None)
def test_chunks_cover_the_range_once(count, size):
    pieces = chunks(count, size)
    assert np.array_equal(np.concatenate([np.arange(count)[p] for p in pieces] or [np.arange(0)]), np.arange(count))
    assert all(0 < p.stop - p.start <= size for p in pieces)


def test_threads_keep_the_order_and_raise():
    assert in_threads(lambda x: x * x, range(50), 4) == [x * x for x in range(50)]
    assert in_threads(lambda x: x, [], 4) == []

    def fail(x):
        if x == 3:
            raise KeyError("three")
        return x

    with pytest.raises(KeyError, match="three"):
        in_threads(fail, range(8), 2)


def stack(heights, transmissions, **more):
    """Sheets of 2 × 2 m over a floor at z = 0."""
    materials = (Material("Floor"), *(Material(f"Sheet {k}", transmission=t) for k, t in enumerate(transmissions)))
    sheets = [(*quad((-1, -1, z), (2, 0, 0), (0, 2, 0)), k + 1) for k, z in enumerate(heights)]
    return scene((*quad((-1, -1, 0), (2, 0, 0), (0, 2, 0)), 0), *sheets, materials=materials, **more)


UP = (np.tile([0.1, 0.2, 1e-3], (64, 1)), np.tile([0.0, 0.0, 10.0], (64, 1)))


@pytest.mark.parametrize(
    ("heights", "transmissions", "expected"),
    [
        ([1], [(0.5, 0.5, 0.5)], 0.5),
        ([1, 2], [(0.5, 0.5, 0.5), (0.4, 0.4, 0.4)], 0.2),
        ([1, 2], [(0.5, 0.5, 0.5), (0, 0, 0)], 0),
        ([1, 2], [(1.0, 0.5, 0.25), (0.5, 0.5, 1.0)], (0.5, 0.25, 0.25)),
        ([11], [(0.5, 0.5, 0.5)], 1),
    ],
)
def test_sheets_pass_the_product_of_their_transmissions(heights, transmissions, expected):
    assert np.allclose(Tracer(stack(heights, transmissions)).visibility(*UP), expected, atol=1e-6)


def test_a_mapped_sheet_passes_what_its_map_says():
    # left half opaque, right half clear, the third quarter tinted
    image = np.zeros((8, 8, 3), np.float32)
    image[:, 4:] = 1
    image[:4, 4:] = (1, 0.5, 0)
    points, triangles, uv = quad((-1, -1, 1), (2, 0, 0), (0, 2, 0))
    made = Scene(
        points,
        triangles,
        atlas_uv=uv,
        materials=(Material("Curtain", transmission=(0.6, 0.5, 0.4), mapped=True),),
        transmission_map=image,
    )
    random = np.random.default_rng(0)
    place = random.uniform(-1, 1, (400, 2))
    found = Tracer(made).visibility(np.c_[place, np.zeros(400)], np.tile([0.0, 0.0, 2.0], (400, 1)))
    expected = sample_map(image, (place + 1) / 2 * 0.9 + 0.05)
    assert np.allclose(found, expected, atol=1e-6)


def test_more_sheets_than_a_ray_may_pass_block_it():
    heights = 0.1 + 0.1 * np.arange(LAYERS + 2)
    made = stack(heights, [(0.99, 0.99, 0.99)] * len(heights))
    assert not Tracer(made).visibility(*UP).any()


def test_objects_without_shadow_do_not_block():
    made = stack([1], [(0, 0, 0)])
    assert not Tracer(made).visibility(*UP).any()
    made.objects = (made.objects[0], SceneObject("Ghost", casts_shadow=False))
    assert (Tracer(made).visibility(*UP) == 1).all()


def test_threads_do_not_change_what_is_seen(monkeypatch):
    corners = soup(200)
    made = Scene(corners.reshape(-1, 3), np.arange(600).reshape(-1, 3))
    origins, vectors = rays_around(30_000, 5)
    alone, both = (Tracer(made, threads=n).visibility(origins, vectors) for n in (1, 2))
    assert np.array_equal(alone, both)
    monkeypatch.setattr(workers, "thread_count", lambda: 3)
    assert np.array_equal(Tracer(made).visibility(origins, vectors), alone)


@pytest.mark.parametrize(("size", "away"), [(1e-3, 0), (1, 0), (1e4, 0), (1, 1e4), (1e4, 1e4)])
def test_lifted_origins_do_not_hit_their_own_surface(size, away):
    # tilted, so that coordinates are rounded
    turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
    points, triangles, uv = quad((0, 0, 0), (size, 0, 0), (0, size, 0))
    made = scene((points @ turn.T + away, triangles, uv, 0))
    tracer = Tracer(made)
    random = np.random.default_rng(1)
    corners = made.positions[made.triangles[0]]
    places = (random.dirichlet((1, 1, 1), 500) @ corners).astype(np.float32)
    normal = made.corner_normals[0, 0]
    origins = places + normal * np.float32(tracer.offset)
    side = np.cross(normal, [0.3, 0.5, 0.8])
    grazing = normal * 0.02 + side / np.linalg.norm(side)
    assert tracer.visibility(origins, np.tile(grazing * max(size, 1), (500, 1))).all()
    assert tracer.offset < 0.05 * max(size, 1e-6 * away)


def test_threads_as_asked():
    every = workers.thread_count()
    try:
        workers.use_threads(1)
        assert workers.thread_count() == 1 and in_threads(lambda x: x + 1, range(5)) == [1, 2, 3, 4, 5]
        workers.use_threads(1000)
        assert workers.thread_count() == workers.MOST_THREADS
    finally:
        workers.use_threads(0)
    assert workers.thread_count() == every
