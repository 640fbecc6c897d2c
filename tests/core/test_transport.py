"""Form factors against closed forms, the solve against a dense one, random walks against the solve."""

import numpy as np
import pytest
from lightpanes.core.rays import Bvh, Tracer
from lightpanes.core.scene import Material
from lightpanes.core.surface import SurfaceSamples, make_patches, make_texels
from lightpanes.core.transfer import Transport, find_entries, make_gatherer, make_transport
from lightpanes.core.transfer.pairs import far_pairs, sample_pairs
from lightpanes.core.transfer.reach import flood
from lightpanes.core.transfer.transport import _balance
from lightpanes.core.transfer.virtual_lights import gather_virtual_lights, walk

from .shapes import box, lamp, quad, room, scene

OFFSET = 1e-5


def parallel(gap):
    """View factor of parallel unit squares (Howell, configuration C-11)."""
    x = 1 / gap
    s = 1 + x * x
    return (
        2
        / (np.pi * x * x)
        * (np.log(s / np.sqrt(1 + 2 * x * x)) + 2 * x * np.sqrt(s) * np.arctan(x / np.sqrt(s)) - 2 * x * np.arctan(x))
    )


PERPENDICULAR = 0.20004378
"""View factor of unit squares that share an edge (Howell, configuration C-14)."""

FLOOR = quad((0, 0, 0), (1, 0, 0), (0, 1, 0))


def ceiling(height):
    return quad((0, 0, height), (0, 1, 0), (1, 0, 0))


WALL = quad((0, 0, 0), (0, 1, 0), (0, 0, 1))


def transport_of(made, count, rays=512):
    patches = make_patches(made, count)
    bvh = Bvh(patches.corners)
    entries, _, _ = find_entries(made, patches, bvh, patches.sample(made, np.arange(len(patches)), 1), OFFSET)
    gatherer = make_gatherer(made, patches, entries, bvh, OFFSET)
    return patches, bvh, entries, gatherer, make_transport(entries, gatherer, rays)


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (ceiling(1.0), parallel(1.0)),
        (ceiling(0.3), parallel(0.3)),
        (ceiling(4.0), parallel(4.0)),
        (WALL, PERPENDICULAR),
    ],
)
def test_view_factors_of_squares(other, expected):
    made = scene((*FLOOR, 0), (*other, 0))
    patches, _, entries, _, transport = transport_of(made, 200)
    owner = made.triangle_object[patches.parent[np.unique(patches.patch, return_index=True)[1]]][entries.patch]
    flow = entries.area[:, None] * transport.between
    floor, other = owner == 0, owner == 1
    assert flow[floor][:, other].sum() == pytest.approx(expected, rel=0.01)
    assert flow[other][:, floor].sum() == pytest.approx(expected, rel=0.01)


def test_parallel_view_factor_is_the_published_one():
    assert parallel(1.0) == pytest.approx(0.199825, abs=1e-6)


def test_reciprocity_and_energy_in_a_closed_room():
    _, _, entries, _, transport = transport_of(room(), 400)
    flow = entries.area[:, None] * transport.between
    assert np.abs(flow - flow.T).max() < 1e-5 * flow.max()
    # nothing appears and nothing is lost, but at entries in the crack under the block
    total = transport.between.sum(axis=1)
    assert total.max() < 1.02
    assert np.average(total, weights=entries.area) == pytest.approx(1, abs=0.01)
    assert transport.between.min() >= 0


def test_clear_glass_takes_no_light():
    """Surfaces that let nearly all light pass change nothing, however many entries they have."""
    walls, block = box((0, 0, 0), (4, 3, 2.5), inward=True), box((1, 1, 0.5), (3, 2, 2))
    clear = Material("Clear", albedo=(0, 0, 0), transmission=(0.98,) * 3)
    means = []
    for parts in (((*walls, 0),), ((*walls, 0), (*block, 1))):
        made = scene(*parts, materials=(Material("Wall", albedo=(0.7,) * 3), clear))
        patches, _, entries, _, transport = transport_of(made, 600)
        wall = made.triangle_object[patches.parent[np.unique(patches.patch, return_index=True)[1]]][entries.patch] == 0
        source = (wall & (entries.normal[:, 2] > 0.5))[:, None].astype(np.float32)
        light = transport.solve(entries.albedo[:, :1], source)[:, 0] - source[:, 0]
        means.append(np.average(light[wall], weights=entries.area[wall]))
    # a fifth of the rays meets the block, whose two faces keep 4 %, at each bounce
    assert 0.95 < means[1] / means[0] < 1.0


def test_slivers_make_no_light():
    # a strip a hundred times as long as wide: by its area it is small, but its places are far apart
    strips = [(*quad((0, 0.02 * k, 0), (2, 0, 0), (0, 0.02, 0)), k % 2) for k in range(50)]
    wall = (*quad((0, 1, 0), (2, 0, 0), (0, 0, 1)), 0)
    made = scene(*strips, wall, materials=(Material("White", (1,) * 3), Material("Whiter", (1,) * 3)))
    _, _, entries, _, transport = transport_of(made, 300)
    assert transport.between.sum(axis=1).max() < 1.02
    assert np.isfinite(transport.solve(entries.albedo, np.ones((len(entries), 3), np.float32))).all()


def test_what_cannot_be_balanced_does_not_multiply_light():
    between = np.full((50, 50), 0.02, np.float32)
    between[0, 1] = between[1, 0] = 60
    _balance(between, np.ones(50, np.float32), 512)
    assert between.sum(axis=1).max() < 1.03
    assert np.average(between.sum(axis=1)[2:]) == pytest.approx(1, abs=0.05)


def test_pairs_equal_the_integral_over_both():
    # two small squares askew, and a third that hides half
    random = np.random.default_rng(0)

    def places(corner, along, across, normal, count):
        u = random.uniform(size=(count, 2))
        position = np.array(corner) + u[:, :1] * along + u[:, 1:] * across
        normals = np.tile(np.asarray(normal, np.float32) / np.linalg.norm(normal), (count, 1))
        return SurfaceSamples(
            position.astype(np.float32), normals, normals, np.zeros(count, np.int32), np.zeros((count, 3))
        )

    first = places((0, 0, 0), (0.2, 0, 0), (0, 0.2, 0), (0, 0, 1), 300)
    second = places((0.5, 0, 0.6), (0, 0.2, 0), (-0.1, 0, 0.1), (-1, 0, -1), 300)
    joined = SurfaceSamples(
        *(np.concatenate(pair) for pair in zip(vars(first).values(), vars(second).values(), strict=True))
    )
    blocker = quad((0.28, -1, 0.3), (0, 2, 0), (-1, 0, 0))
    tracer = Tracer(scene((*blocker, 0)))
    terms = sample_pairs([joined], np.ones(600), 0.0, tracer.visibility)
    assert np.array_equal(terms, terms.T)
    a, b = (s.position.astype(np.float64) for s in (first, second))
    way = b[None] - a[:, None]
    r2 = (way**2).sum(-1)
    expected = np.maximum(way @ first.normal[0], 0) * np.maximum(-(way @ second.normal[0]), 0) / (np.pi * r2**2)
    at = a[:, None] + way * ((0.3 - a[:, None, 2]) / way[..., 2])[..., None]
    expected = expected * (at[..., 0] > 0.28)
    assert 0.1 < (expected == 0).mean() < 0.9
    assert np.allclose(terms[:300, 300:], expected, rtol=1e-3, atol=1e-4)


def test_far_pairs_are_far_for_their_size():
    position = np.array([[0, 0, 0], [1, 0, 0], [10, 0, 0]], np.float32)
    far = far_pairs(position, np.array([0.5, 0.5, 4.0], np.float32), slice(0, 2), slice(0, 3), times=3)
    assert far.tolist() == [[False, False, True], [False, False, True]]


@pytest.mark.parametrize("albedo", [0.0, 0.5, 0.98])
def test_all_bounces_equal_a_dense_solve(albedo):
    random = np.random.default_rng(1)
    between = random.uniform(0, 1, (80, 80)).astype(np.float32)
    between /= between.sum(axis=1, keepdims=True)
    shade = albedo * random.uniform(0.8, 1, (80, 2)).astype(np.float32)
    source = random.uniform(0, 1, (80, 2)).astype(np.float32)
    found = Transport(between, np.zeros((80, 1), np.float32)).solve(shade, source, tolerance=1e-6)
    for c in range(2):
        exact = np.linalg.solve(np.eye(80) - shade[:, c, None] * between.astype(np.float64), source[:, c])
        assert np.allclose(found[:, c], exact, rtol=2e-3)


def test_random_walks_and_the_solve_agree():
    # the paper's virtual lights are unbiased up to their spikes: the means over the room must meet
    made = room(lights=[lamp((3, 1.5, 1.5))])
    patches, bvh, entries, gatherer, transport = transport_of(made, 400)
    tracer = Tracer(made)
    exits = make_texels(made, 32).samples
    exits = exits.take((exits.position[:, 2] > 0.2) & (exits.position[:, 2] < 2.4))
    lights = walk(made, patches, entries, bvh, OFFSET)
    found = gather_virtual_lights(lights, np.zeros(len(entries), np.int32), 1, exits, tracer)[0]
    source = entries.albedo * np.ones((len(entries), 3), np.float32)
    radiosity = np.stack(
        [transport.solve(entries.albedo[:, c : c + 1], source[:, c : c + 1])[:, 0] for c in range(3)], 1
    )
    total = np.zeros((len(exits), 3))
    table = np.append(radiosity, np.zeros((2, 3)), axis=0)
    gatherer.gather(exits, 64, 3, lambda piece, ids: np.add(total[piece], table[ids].sum(axis=0), out=total[piece]))
    assert np.allclose(np.median(found, axis=0), np.median(total / 64, axis=0), rtol=0.1)


def test_light_floods_both_sides_of_a_sheet_and_no_solid():
    sheet = quad((0.5, 0.5, 1.2), (1, 0, 0), (0, 1, 0))
    made = scene(
        (*box((0, 0, 0), (4, 3, 2.5), True), 0),
        (*box((2.5, 1, 0.5), (3.5, 2, 1.5)), 0),
        (*sheet, 0),
        lights=[lamp((2, 1.5, 2))],
    )
    patches = make_patches(made, 300)
    met = flood(made, patches, Bvh(patches.corners), OFFSET)
    owner = made.triangle_object[patches.parent[np.unique(patches.patch, return_index=True)[1]]]
    front, back = met[0::2], met[1::2]
    assert (front > 0).all()
    assert back[owner == 2].all()
    assert not back[owner != 2].any()


def test_without_lamps_light_is_expected_before_the_faces():
    made = scene(
        (*box((0, 0, 0), (4, 3, 2.5), True), 0),
        (*box((2.5, 1, 0.5), (3.5, 2, 1.5)), 0),
        (*box((0.2, 0.2, 0), (0.8, 0.8, 0.6)), 0),
        (*quad((1, 1, 1.2), (1, 0, 0), (0, 1, 0)), 0),
    )
    patches = make_patches(made, 200)
    met = flood(made, patches, Bvh(patches.corners), OFFSET)
    owner = made.triangle_object[patches.parent[np.unique(patches.patch, return_index=True)[1]]]
    # all but the floor under the standing box, and its bottom
    hidden = (np.abs(patches.position - [0.5, 0.5, 0]) < [0.35, 0.35, 0.01]).all(axis=1)
    assert (met[0::2][~hidden] > 0).all()
    assert (met[1::2] > 0).tolist() == (owner == 3).tolist()


def test_glowing_and_tinted_patches():
    # radiosity of emission, and the opaque part's albedo of a half-clear sheet
    materials = (
        Material("Glow", (0.5,) * 3, emission=(2.0, 1.0, 0.5)),
        Material("Net", (0.3,) * 3, transmission=(0.5,) * 3),
    )
    made = scene(
        (*box((0, 0, 0), (2, 2, 2), True), 0), (*quad((0.5, 0.5, 1), (1, 0, 0), (0, 1, 0)), 1), materials=materials
    )
    patches, _, entries, _, _ = transport_of(made, 100, 64)
    net = made.triangle_object[patches.parent[np.unique(patches.patch, return_index=True)[1]]][entries.patch] == 1
    assert np.allclose(entries.radiosity[~net], np.pi * np.array([2, 1, 0.5]), rtol=1e-5)
    assert np.allclose(entries.albedo[net], 0.6, rtol=1e-5)
