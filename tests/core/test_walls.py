"""Patches end at walls that stand on them."""

import numpy as np
import pytest
from lightpanes.core.bake import bake
from lightpanes.core.bake.steps import prepare
from lightpanes.core.panes.entry_light import EntryLight
from lightpanes.core.scene import Material
from lightpanes.core.surface import make_patches, make_texels, patches, walls

from .shapes import box, globe, grid, lamp, moved, quad, quick, relighter, room, scene
from .uncompressed import WHITISH

GLASS = Material("Glass", (0.1,) * 3, transmission=(0.8,) * 3)
AWAY = 0.6
"""m: texels farther than this from a wall lie in one room alone."""


def turned(part, angle, about):
    """A part, turned about the vertical line through a place."""
    points = np.asarray(part[0], float) - about
    cos, sin = np.cos(angle), np.sin(angle)
    around = np.stack(
        [points[:, 0] * cos - points[:, 1] * sin, points[:, 0] * sin + points[:, 1] * cos, points[:, 2]], 1
    )
    return (around + about, *part[1:])


def floor_with(*things, cells=1, materials=(WHITISH,)):
    """Things on a floor of 4 × 3 m."""
    floor = quad((0, 0, 0), (4, 0, 0), (0, 3, 0)) if cells == 1 else grid((0, 0, 0), (4, 0, 0), (0, 3, 0), cells)
    return scene((*floor, 0), *things, materials=materials)


def beyond(places, angle, about):
    """(n,) m: how far places (n, 2 or 3) are beyond a wall that was turned about one."""
    return (places[:, 0] - about[0]) * np.cos(angle) + (places[:, 1] - about[1]) * np.sin(angle)


def straddling(made, found, side, thick=0.0):
    """Area, as part of the mean patch's, that patches of the floor have on the lesser side; side(positions (p, 2)) is below 0 on
    one, above it on the other, and inside a wall less than half of what it is thick."""
    floor = made.triangle_object[found.parent] == 0
    where = side(found.corners.mean(axis=1)[:, :2])
    sides = floor & (where > thick / 2), floor & (where < -thick / 2)
    less = [np.bincount(found.patch[rows], found.piece_area[rows], len(found)) for rows in sides]
    return np.minimum(*less) / found.area.mean()


@pytest.mark.parametrize(
    ("entries", "thick", "angle"), [(300, 0.05, 0.0), (300, 0.0, 0.37), (1200, 0.0, 0.0), (1200, 0.05, 0.37)]
)
def test_no_light_below_a_wall_on_one_floor(entries, thick, angle):
    about = np.array([2.03, 1.5, 0])
    if thick:
        wall = box((2.03, -1, -0.01), (2.03 + thick, 4, 2.51))
    else:
        wall = quad((2.03, -1, -0.01), (0, 5, 0), (0, 0, 2.52))
    wall = turned(wall, angle, about)
    lights = [lamp((1, 1.5, 1.2)), lamp((3, 1.5, 1.2))]
    made = scene((*box((0, 0, 0), (4, 3, 2.5), True), 0), (*wall, 0), materials=(WHITISH,), lights=lights)
    baked = bake(made, quick(entries=entries))
    found = relighter(made, baked).relight(lights[:1])[..., 0].reshape(-1)
    texels = make_texels(made, baked.resolution)
    own = baked.own.reshape(-1)[texels.index] & (made.triangle_object[texels.samples.triangle] == 0)
    found, place = found[texels.index[own]], texels.samples.position[own]
    across = beyond(place[:, :2], angle, about)
    lit = found[across < -AWAY].mean()
    assert lit > 1
    assert np.abs(found[across > AWAY + thick]).mean() < 0.005 * lit
    # sheets have two sides
    assert 0.7 * entries < baked.report["entries"] < 1.4 * entries


@pytest.mark.parametrize("away", [0.05, 0.2])
def test_all_power_arrives_beside_a_wall(away):
    """Σ E A = Φ: none of it is lost below the wall."""
    wall = box((2, 0, 0), (2.1, 3, 2.5))
    made = scene(
        (*box((0, 0, 0), (4, 3, 2.5), True), 0), (*wall, 0), materials=(WHITISH,), lights=[lamp((1, 1.5, 1.2))]
    )
    ready = prepare(made, quick(entries=400))
    arrived = EntryLight(ready.surface, ready.tracer).unit(lamp((2 - away, 1.3, 0.01), 1.0)) @ ready.entries.area
    assert arrived == pytest.approx(1, rel=0.02)


WALLS = {
    "a sheet": (0.0, [quad((2, -1, 0), (0, 5, 0), (0, 0, 2))]),
    "a thick one": (0.4, [box((1.8, -1, 0), (2.2, 4, 2))]),
    "above the floor by a millimetre": (0.1, [box((1.95, -1, 0.001), (2.05, 4, 2))]),
    "sunk in": (0.1, [box((1.95, -1, -0.3), (2.05, 4, 2))]),
    "of many triangles": (0.0, [grid((2, -1, -0.005), (0, 5, 0), (0, 0, 2), 40)]),
    "leaning": (0.0, [quad((2, -1, 0), (0, 5, 0), (1.5, 0, 1.5))]),
    "of two parts": (0.1, [box((1.95, -1, 0), (2.05, 1.53, 2)), box((1.95, 1.53, 0), (2.05, 4, 2))]),
}
"""How thick about x = 2, m, and the parts."""


@pytest.mark.parametrize("name", WALLS)
@pytest.mark.parametrize("angle", [0.0, 0.3])
@pytest.mark.parametrize("cells", [1, 60])
def test_patches_have_one_side(name, angle, cells):
    about, (thick, parts) = np.array([2.03, 1.5, 0]), WALLS[name]
    things = [(*turned((part[0] + [0.03, 0, 0], *part[1:]), angle, about), 0) for part in parts]
    made = floor_with(*things, cells=cells)
    found = make_patches(made, 400)
    less = straddling(made, found, lambda places: beyond(places, angle, about), thick)
    size = np.sqrt(found.area.sum() / len(found))
    # below what leans over it a floor is seen no lower than the lowest height
    bound = walls.HEIGHTS[0] if name == "leaning" else 1e-3
    # a floor of many small triangles is not cut, and its patches end within one of them
    assert less.max() < bound + (0 if cells == 1 else 0.5 * 4 / 60 / size)
    assert np.allclose(np.bincount(found.patch, found.piece_area), found.area, rtol=1e-4)
    assert 0.7 * 400 < len(found) < 1.4 * 400


def test_walls_below_a_sheet_part_it_too():
    made = floor_with((*box((1.9, -1, -2), (2.0, 4, 0)), 0))
    assert straddling(made, make_patches(made, 400), lambda places: places[:, 0] - 1.95, 0.1).max() < 1e-3


def test_a_piece_keeps_its_place_on_its_triangle():
    made = floor_with((*turned(box((1.9, -1, 0), (2.0, 4, 2)), 0.3, np.array([2.0, 1, 0])), 0))
    found = make_patches(made, 200)
    corners = made.positions[made.triangles[found.parent]]
    assert np.allclose(np.einsum("pkc,pcd->pkd", found.weights, corners), found.corners, atol=1e-5)
    area = 0.5 * np.linalg.norm(made.triangle_cross(np.arange(len(made.triangles))), axis=1)
    assert np.allclose(np.bincount(found.parent, found.piece_area), area, rtol=1e-4)
    # as they were wound
    flat = np.cross(found.corners[:, 1] - found.corners[:, 0], found.corners[:, 2] - found.corners[:, 0])
    assert (np.einsum("pk,pk->p", flat, made.triangle_cross(found.parent)) >= 0).all()


def test_what_lies_below_a_block_is_no_part_of_the_floor():
    made = floor_with((*box((1.1, 0.7, 0), (2.4, 1.9, 0.8)), 0))
    found = make_patches(made, 400)

    def inside(places):
        return 0.5 - np.maximum(np.abs(places[:, 0] - 1.75) / 1.3, np.abs(places[:, 1] - 1.3) / 1.2)

    assert straddling(made, found, inside).max() < 1e-3


@pytest.mark.parametrize(
    "thing",
    [
        (*box((1.9, -1, 0), (2.0, 4, 0.02)), 0),
        (*quad((1.9, -1, 0), (0, 5, 0), (0, 0, 2)), 1),
        (*box((0.5, 0.5, 1.5), (2.5, 2.5, 1.9)), 0),
    ],
    ids=["low", "see-through", "in the air"],
)
def test_what_is_no_wall_parts_nothing(thing):
    made = floor_with(thing, materials=(WHITISH, GLASS))
    found = make_patches(made, 400)
    floor = np.unique(found.patch[made.triangle_object[found.parent] == 0])
    alone = make_patches(floor_with(), round(12 / (found.area[floor].mean())))
    assert len(floor) < 1.2 * len(alone)


def leaves(count=3000):
    """Small triangles at random."""
    rng = np.random.default_rng(3)
    points = rng.uniform(0, 2, (count, 1, 3)) + rng.normal(0, 0.002, (count, 3, 3))
    return points.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), np.zeros((count, 3, 2))


OPEN = {
    "a floor": floor_with,
    "a closed room": lambda: scene((*box((0, 0, 0), (4, 3, 2.5), True), 0)),
    "a ball": lambda: scene((*globe(), 0)),
    "a ball from outside": lambda: scene((*globe(rings=12, inward=False), 0)),
    "a tree": lambda: scene((*leaves(), 0)),
    "things in the air": lambda: floor_with((*box((0.5, 0.5, 1), (2.5, 2.5, 1.9)), 0)),
}


@pytest.mark.parametrize("name", OPEN)
@pytest.mark.parametrize("count", [60, 700])
def test_patches_in_the_open_are_as_if_nothing_looked_for_walls(name, count, monkeypatch):
    made = OPEN[name]()
    found = make_patches(made, count)
    monkeypatch.setattr(patches, "cut_at_walls", lambda pieces, *given: pieces)
    monkeypatch.setattr(patches, "part_at_walls", lambda corners, mesh, patch, count, *given: (patch, count))
    plain = make_patches(made, count)
    for field in ("corners", "parent", "weights", "patch", "area"):
        assert np.array_equal(getattr(found, field), getattr(plain, field))


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_walls_are_walls_in_scenes_of_any_size(size):
    made = floor_with((*box((1.9, -1, 0), (2.0, 4, 2)), 0))
    plain, found = make_patches(made, 400), make_patches(moved(made, size * np.eye(3)), 400)
    assert len(found) == len(plain)
    assert straddling(made, found, lambda places: places[:, 0] / size - 1.95, 0.1).max() < 1e-3


def test_patches_do_not_depend_on_threads(monkeypatch):
    made = room()
    found = make_patches(made, 500)
    monkeypatch.setattr(walls, "in_threads", lambda work, parts: [work(part) for part in parts])
    assert np.array_equal(make_patches(made, 500).patch, found.patch)
