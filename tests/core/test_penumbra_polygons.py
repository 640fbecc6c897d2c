"""Triangles joined to convex polygons: the same surface, fewer pieces."""

import numpy as np
import pytest
from lightpanes.core.penumbra.polygons import make_polygons

from ..bench.penumbra_scenes import box, column, grid, sphere


def turned(corners, seed=0):
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return (corners @ turn.T * np.sign(np.linalg.det(turn)) + (3, -2, 5)).astype(np.float32)


def area(polygons):
    start = np.repeat(polygons.first[:-1], polygons.sides)
    following = np.arange(len(polygons.vertices)) + 1
    following[polygons.first[1:] - 1] = polygons.first[:-1]
    v = polygons.vertices
    cross = np.cross(v - v[start], v[following] - v[start])
    owner = np.repeat(np.arange(len(polygons)), polygons.sides)
    return np.bincount(owner, np.einsum("nd,nd->n", cross, polygons.normal[owner])) / 2


def convex(polygons):
    """Whether each corner turns left."""
    owner = np.repeat(np.arange(len(polygons)), polygons.sides)
    place = np.arange(len(owner)) - polygons.first[owner]
    after = polygons.first[owner] + (place + 1) % polygons.sides[owner]
    beyond = polygons.first[owner] + (place + 2) % polygons.sides[owner]
    v = polygons.vertices
    turn = np.einsum("nd,nd->n", np.cross(v[after] - v, v[beyond] - v[after]), polygons.normal[owner])
    return (turn > 0).all()


def surface(corners):
    corners = corners.astype(float)
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2


SHAPES = {
    "a cut-up rectangle": (grid((0, 0, 0), (3, 0, 0), (0, 1, 0), 7, 5), [4]),
    "a cut-up box": (box(np.zeros(3), *np.diag([3.0, 1, 2]), 9), [4] * 6),
    "a prism": (column((0, 0, 0), 1, 3, 12)[:48], [12] * 2 + [4] * 12),
    "a sphere": (sphere((0, 0, 0), 1, 10, 20), None),
    "one triangle": (np.array([[(0, 0, 0), (1, 0, 0), (0, 1, 0)]], float), [3]),
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("seed", [0, 1])
def test_shapes(name, seed):
    corners, sides = SHAPES[name]
    corners = turned(corners, seed)
    polygons = make_polygons(corners)
    assert convex(polygons)
    assert (area(polygons) > 0).all() and area(polygons).sum() == pytest.approx(surface(corners), rel=1e-5)
    if sides is not None:
        assert sorted(polygons.sides) == sorted(sides)
    else:
        assert len(polygons) < 0.6 * len(corners)
    assert polygons.closed.all() == (name not in ("a cut-up rectangle", "one triangle"))


def test_what_is_not_convex_stays_in_pieces():
    ring = [grid((x, y, 0), (1, 0, 0), (0, 1, 0), 1, 1) for x in range(3) for y in range(3) if (x, y) != (1, 1)]
    corners = turned(np.concatenate(ring))
    polygons = make_polygons(corners)
    assert sorted(polygons.sides) == [4] * 8
    assert convex(polygons) and area(polygons).sum() == pytest.approx(8, rel=1e-5)


def test_a_fold_is_no_plane():
    bent = np.concatenate([grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 1, 1), grid((1, 0, 0), (1, 0, 1e-4), (0, 1, 0), 1, 1)])
    assert sorted(make_polygons(bent.astype(np.float32)).sides) == [4, 4]
    # nor are two faces of one sheet, back to back
    double = np.concatenate([grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 1, 1), grid((0, 0, 0), (0, 1, 0), (1, 0, 0), 1, 1)])
    assert area(make_polygons(double.astype(np.float32))).sum() == pytest.approx(2)


def test_normals_point_out_of_what_is_closed():
    inside_out = box(np.zeros(3), *np.eye(3), 2)[:, ::-1].astype(np.float32)
    polygons = make_polygons(inside_out)
    assert polygons.closed.all()
    middle = np.add.reduceat(polygons.vertices, polygons.first[:-1]) / polygons.sides[:, None]
    assert (np.einsum("nd,nd->n", middle - 0.5, polygons.normal) > 0).all()
    lidless = box(np.zeros(3), *np.eye(3), 2).astype(np.float32)[1:]
    assert not make_polygons(lidless).closed.any()


def test_without_merging_and_without_anything():
    corners = turned(SHAPES["a cut-up box"][0])
    plain = make_polygons(corners, merge=False)
    assert (plain.sides == 3).all() and len(plain) == len(corners)
    assert len(make_polygons(np.zeros((0, 3, 3), np.float32))) == 0


def test_slivers_join_nothing_wrong():
    random = np.random.default_rng(4)
    needles = random.uniform(-1, 1, (200, 3, 3)).astype(np.float32)
    needles[:, 2] = needles[:, 0] + (needles[:, 1] - needles[:, 0]) * np.float32(0.5)
    corners = np.concatenate([needles, turned(SHAPES["a cut-up box"][0])])
    polygons = make_polygons(corners)
    assert area(polygons).sum() == pytest.approx(surface(corners), rel=1e-4)
