"""Point sets: thinned out, and carried along when their surfaces move."""

import numpy as np
import pytest
from lightpanes.core.point_cache import guides, make_points
from lightpanes.core.scene import Scene

from .shapes import grid, room, scene
from .test_darts import as_points, crowded, everywhere, floor, pieces, room_ground, throw, too_near


def test_a_sparser_set_keeps_more_distance():
    ground = room_ground()
    points = make_points(ground, guides.by_occlusion(ground.ao), 2500)
    sparse = points.sparser(2.0)
    assert crowded(sparse) == 0
    # some of the points, with twice their radius, about as many as fit
    rows = (sparse.position[:, None] == points.position).all(axis=2).argmax(axis=1)
    assert np.array_equal(points.position[rows], sparse.position) and (np.diff(rows) > 0).all()
    assert np.allclose(sparse.radius, 2 * points.radius[rows])
    assert 0.2 * len(points) < len(sparse) < 0.35 * len(points)
    left = points.take(np.setdiff1d(np.arange(len(points)), rows))
    pair = too_near((left.position, left.normal, 2 * left.radius), (sparse.position, sparse.normal, sparse.radius))
    assert len(np.unique(pair[:, 0])) > 0.995 * len(left)


def test_points_are_stored_as_32_bits():
    """What a .blend's attributes hold; numpy 2 widens where a float64 number meets a float32 array."""
    ground = room_ground()
    points = make_points(ground, np.ones(len(ground.coarse), np.float32), 800)
    assert {a.dtype for a in (points.position, points.normal, points.radius, points.ao)} == {np.dtype(np.float32)}


def test_points_follow_an_object_that_moves():
    ground = room_ground()
    points = make_points(ground, guides.uniform(ground.coarse), 1000)
    angle = 0.4
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    made = room()
    own = np.unique(made.triangles[made.triangle_object == 1])
    place = made.positions.copy()
    place[own] = place[own] @ turn.T + (0.3, 0.2, 0.5)
    after = points.follow(scene_like(made, place))
    block = made.triangle_object[points.samples.triangle] == 1
    assert 20 < block.sum() < len(points)
    assert np.allclose(after.position[block], points.position[block] @ turn.T + (0.3, 0.2, 0.5), atol=1e-5)
    assert np.allclose(after.normal[block], points.normal[block] @ turn.T, atol=1e-5)
    assert np.array_equal(after.position[~block], points.position[~block])
    assert np.array_equal(after.samples.triangle, points.samples.triangle)
    assert crowded(after) == 0


def scene_like(made: Scene, positions: np.ndarray) -> Scene:
    return Scene(positions, made.triangles, triangle_object=made.triangle_object, objects=made.objects,
                 triangle_material=made.triangle_material, materials=made.materials)  # fmt: skip


def test_points_follow_a_mesh_that_bends():
    # a sheet with points on both sides is bent to half a tube
    made = scene((*grid((0, 0, 0), (np.pi, 0, 0), (0, 1, 0), 16), 0))
    points = as_points(throw(made, pieces(made, lambda middle: 0.15, back=True), everywhere))
    x, y, _ = made.positions.T
    bent = scene_like(made, np.stack([np.sin(x), y, 1 - np.cos(x)], 1))
    after = points.follow(bent)
    assert np.array_equal(after.samples.weights, points.samples.weights)
    # within the chord's sag of the tube, and on the side on which it was: fronts look at the axis
    middle = np.stack([0 * after.position[:, 0], after.position[:, 1], 1 + 0 * after.position[:, 0]], 1)
    inward = middle - after.position
    assert np.allclose(np.linalg.norm(inward, axis=1), 1, atol=0.006)
    assert np.array_equal((inward * after.normal).sum(axis=1) < 0, points.back)
    # barycentrics: each point lies where its triangle's corners put it
    corners = bent.positions[bent.triangles[after.samples.triangle]].astype(np.float64)
    assert np.allclose((corners * points.samples.weights[..., None]).sum(axis=1), after.position, atol=1e-6)


def test_another_mesh_is_refused():
    made = scene((*grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 4), 0))
    points = as_points(throw(made, pieces(made, lambda middle: 0.1), everywhere))
    with pytest.raises(ValueError, match="fewer triangles"):
        points.follow(floor())
