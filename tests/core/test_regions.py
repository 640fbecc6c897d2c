"""Regions end where light does, and none is large; the suns that teach a scene are those that reach in."""

import numpy as np
import pytest
from lightpanes.core.bake.steps import prepare
from lightpanes.core.panes.regions import LARGEST, make_regions, rooms, signature, split_regions
from lightpanes.core.panes.training import sun_lamps
from lightpanes.core.surface import make_patches

from .shapes import GREY, box, lamp, quad, quick, scene

GAP = 0.01


def two_rooms(joined: bool):
    """Two closed rooms a centimetre apart, of one mesh or of two."""
    left, right = box((0, 0, 0), (2, 3, 2.5), True), box((2 + GAP, 0, 0), (4 + GAP, 3, 2.5), True)
    if not joined:
        return scene((*left, 0), (*right, 0), lights=[lamp((1, 1.5, 1.2)), lamp((3, 1.5, 1.2))])
    points, triangles = np.concatenate([left[0], right[0]]), np.concatenate([left[1], right[1] + 8])
    uv = np.concatenate([left[2] * [0.5, 1], right[2] * [0.5, 1] + [0.5, 0]])
    return scene((points, triangles, uv, 0), lights=[lamp((1, 1.5, 1.2)), lamp((3, 1.5, 1.2))])


def test_rooms_of_one_mesh_share_no_patch():
    made = two_rooms(joined=True)
    patches = make_patches(made, 300)
    right = patches.corners[:, :, 0].mean(axis=1) > 2 + GAP / 2
    share = np.bincount(patches.patch, right) / np.bincount(patches.patch)
    assert np.isin(share, [0, 1]).all()


def test_small_parts_of_a_mesh_share_patches():
    # two hundred leaves of a centimetre: not a patch each
    parts = [quad((0.1 * (k % 20), 0.1 * (k // 20), 0), (0.01, 0, 0), (0, 0.01, 0)) for k in range(200)]
    points = np.concatenate([p[0] for p in parts])
    triangles = np.concatenate([p[1] + 4 * k for k, p in enumerate(parts)])
    leaves = (points, triangles, np.concatenate([p[2] for p in parts]), 0)
    made = scene((*box((-1, -1, -1), (3, 3, 3), True), 0), leaves)
    patches = make_patches(made, 300)
    mine = made.triangle_object[patches.parent] == 1
    assert len(np.unique(patches.patch[mine])) < 60


def test_rooms_are_what_no_light_leaves():
    between = np.zeros((7, 7), np.float32)
    for i, j in ((0, 3), (3, 5), (1, 2)):
        between[i, j] = between[j, i] = 0.1
    room = rooms(between)
    assert room[0] == room[3] == room[5] != room[1] == room[2]
    # 4 and 6 see nothing
    assert room[4] == room[6] and room[4] not in (room[0], room[1])
    assert not rooms(np.zeros((3, 3), np.float32)).any()


def test_no_region_reaches_through_a_wall():
    made = two_rooms(joined=False)
    ready = prepare(made, quick(entries=400))
    right = ready.entries.position[:, 0] + 1e-3 * ready.entries.normal[:, 0] > 2 + GAP / 2
    region = ready.modes.region
    share = np.bincount(region, right) / np.bincount(region)
    assert np.isin(share, [0, 1]).all()


def test_no_region_is_large():
    points = np.random.default_rng(0).uniform(size=(600, 3)).astype(np.float32)
    # all that lamps do, they do in one corner
    field = np.random.default_rng(1).uniform(size=(600, 50)).astype(np.float32) * (points[:, :1] < 0.1)
    start = make_regions(points, np.ones(600), 10)
    found = split_regions(start, points, np.ones(600), field, 40, 4)
    sizes = np.bincount(found)
    assert len(sizes) == 40 and sizes.min() > 0
    assert sizes.max() <= LARGEST * 600 / 40
    assert sizes[np.unique(found[points[:, 0] < 0.1])].mean() < sizes.mean()


def test_signatures_tell_who_is_lit_together():
    lamps = np.random.default_rng(2).uniform(0.5, 1, (6, 200)).astype(np.float32)
    lamps[:3, :100] = 0
    lamps[3:, 100:] = 0
    sign = signature(lamps)
    apart = np.linalg.norm(sign[:, None] - sign, axis=2)
    assert apart[:3, 3:].min() > 1.5 * max(apart[:3, :3].max(), apart[3:, 3:].max())
    assert np.isfinite(signature(np.zeros((2, 5), np.float32))).all()


def test_training_suns_reach_in():
    # a room with a window of half a metre: few of all directions come through it
    low, high = (0, 0, 0), (4, 3, 2.5)
    walls = box(low, high, True)
    keep = ~(walls[0][walls[1]][:, :, 1] < 1e-6).all(axis=1)
    frame = [
        quad((0, 0, 0), (0, 0, 2.5), (1.5, 0, 0)),
        quad((2, 0, 0), (0, 0, 2.5), (2, 0, 0)),
        quad((1.5, 0, 0), (0, 0, 1), (0.5, 0, 0)),
        quad((1.5, 0, 1.5), (0, 0, 1), (0.5, 0, 0)),
    ]
    parts = [(walls[0], walls[1][keep], walls[2][keep], 0), *((*f, 0) for f in frame)]
    made = scene(*parts, materials=(GREY,), lights=[lamp((2, 1, 2), 3.0, kind="SUN")])
    ready = prepare(made, quick(entries=300, lamps=60))
    suns = sun_lamps(made, ready.places, ready.bvh, 40, 3)
    assert len(suns) == 40
    inside = ready.places.position[:, 1] > 0.01
    places = ready.places.take(inside & (ready.places.normal[:, 1] < 0.99))
    for sun in suns:
        toward = np.tile(-sun.direction.astype(np.float32) * 20, (len(places), 1))
        origin = places.position + places.flat * np.float32(ready.tracer.offset)
        facing = np.einsum("nd,nd->n", places.normal, toward) > 0
        assert (ready.tracer.visibility(origin[facing], toward[facing]) > 0).any()
    assert sun_lamps(two_rooms(False), ready.places, ready.bvh, 40, 3) == []


@pytest.mark.parametrize("rows", [100, 300, 600])
@pytest.mark.parametrize("bright", [0, 1])
def test_the_region_that_loses_most_is_split_whatever_its_size(rows, bright):
    random = np.random.default_rng(0)
    half = np.repeat(np.arange(2, dtype=np.int32), rows)
    points, field = random.normal(size=(2 * rows, 3)), random.normal(size=(2 * rows, 20)).astype(np.float32)
    field[half == bright] *= 1.5
    found = split_regions(half, points, np.ones(2 * rows), field, 3, 4)
    assert (found[half != bright] == 1 - bright).all()
    assert sorted(np.bincount(found)) == [rows // 2, rows // 2, rows]
