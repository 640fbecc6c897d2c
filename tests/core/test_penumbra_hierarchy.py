"""The paper's penumbra casting against a ray for each relation: not one bit may differ."""

from functools import cache

import numpy as np
import pytest
from lightpanes.core.penumbra.casting import cast_rays
from lightpanes.core.penumbra.hierarchy import LEAF, Optimisations, Tree, Work, blocking_power, cast_hierarchically
from lightpanes.core.penumbra.lamp import LampSamples, sample_ball, sample_lamp, sample_quad
from lightpanes.core.penumbra.masks import AWAY, LIT, UMBRA, bits_of
from lightpanes.core.penumbra.receivers import Receivers
from lightpanes.core.penumbra.volumes import Space, hard_shadows, light_hierarchy, penumbra_volumes
from lightpanes.core.rays import Bvh

from .shapes import box, globe, grid, lamp, quad

PLACE = (0.3, 0.2, 2.4)


def corners_of(*parts) -> np.ndarray:
    return np.concatenate([points[triangles] for points, triangles, _ in parts]).astype(np.float32)


def floor():
    return quad((-2, -2, 0), (4, 0, 0), (0, 4, 0))


@cache
def shape(name: str) -> np.ndarray:
    """(T, 3, 3) float32, a floor of 4 × 4 m and what stands on it or hangs over it."""
    random = np.random.default_rng(sum(map(ord, name)))
    if name == "boxes":
        low = np.append(random.uniform(-1.5, 1, (4, 2)), random.choice([0, 0.5], (4, 1)), axis=1)
        return corners_of(floor(), *(box(at, at + random.uniform(0.1, 0.7, 3)) for at in low))
    if name == "bars":
        across = [box((-1.2, y, 0.7), (1.2, y + 0.08, 0.75)) for y in (-0.8, 0.4)]
        along = [box((x, -1.2, 0.75), (x + 0.08, 1.2, 0.8)) for x in (-0.8, 0.1)]
        return corners_of(floor(), *across, *along)
    if name == "sphere":
        points, triangles, uv = globe(4, 0.5, inward=False)
        return corners_of(floor(), (points + np.array([0, 0, 0.7]), triangles, uv))
    if name == "touching":
        # on a lattice: shared corners and edges, planes in common, edges that cut through faces
        return np.concatenate([corners_of(floor()), random.integers(-3, 4, (40, 3, 3)).astype(np.float32) / 2])
    sheets = [
        grid((-1, -1, 0.6), (1.2, 0, 0), (0, 1.2, 0.3), 3),
        quad((0.2, 0, 0), (0.8, 0, 0), (0, 0.3, 1)),
        grid((-0.5, 0.2, 0.1), (0, 1, 0), (0.2, 0, 1.1), 3),
    ]
    return corners_of(floor(), *sheets)


def tilted(kind: str, **more):
    light = lamp(PLACE, kind=kind, **more)
    turn, _ = np.linalg.qr(np.array([[1, 0.2, -0.1], [-0.3, 1, 0.3], [0.1, -0.2, 1]]))
    light.matrix[:3, :3] = turn * np.sign(np.diag(turn))
    return light


def lamp_of(name: str, count: int = 32, sets: int = 1) -> LampSamples:
    if name == "quad":
        corners = np.array([(0, 0, 2), (0.4, 0.9, 2.1), (1.2, 0.9, 2.1), (0.8, 0, 2)])
        return sample_quad(corners, count, sets)
    if name == "volume":
        return sample_ball(PLACE, 0.4, count, sets)
    light = {
        "rectangle": lambda: tilted("AREA", shape="RECTANGLE", size=(1.0, 0.5)),
        "disk": lambda: lamp(PLACE, kind="AREA", shape="DISK", size=(0.8, 0.8)),
        "sun": lambda: tilted("SUN", angle=0.3),
        "point": lambda: lamp(PLACE, kind="POINT", radius=0.3),
        "spot": lambda: tilted("SPOT", radius=0.25),
    }[name]()
    return sample_lamp(light, count, sets)


def receivers_on(
    corners, count: int = 200, lift: float = 1e-4, sets: int = 1, normals: bool = True, seed=0
) -> Receivers:
    """Places all over triangles, on either side, and a fifth of them in the air."""
    random = np.random.default_rng(seed)
    side = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(float)
    area = np.linalg.norm(side, axis=1)
    chosen = random.choice(len(corners), count, p=np.sqrt(area) / np.sqrt(area).sum())
    normal = side[chosen] / area[chosen, None] * random.choice([1, 1, 1, -1], (count, 1))
    place = np.einsum("nk,nkd->nd", random.dirichlet(np.ones(3), count), corners[chosen]) + lift * normal
    air = slice(None, None, 5)
    place[air] = random.uniform((-2, -2, 0.01), (2, 2, 2), place[air].shape)
    group = random.integers(0, sets, count).astype(np.uint8) if sets > 1 else None
    return Receivers(place.astype(np.float32), normal.astype(np.float32) if normals else None, group)


def same(first, second) -> bool:
    """Whether masks are equal to the last bit, and told in the same way."""
    return (
        (first.index == second.index).all()
        and first.words.shape == second.words.shape
        and (first.words == second.words).all()
    )


def compare(receivers, samples, corners, optimisations=None):
    """The cast, checked against brute force, and its work."""
    bvh, work, asked = Bvh(corners), Work(), []

    def occluded(origins, vectors):
        asked.append(len(origins))
        return bvh.occluded(origins, vectors)

    found = cast_hierarchically(receivers, samples, corners, occluded, optimisations, work)
    expected = cast_rays(receivers, samples, bvh.occluded, 1)
    differing = bits_of(found.packed() ^ expected.packed(), samples.count).sum()
    assert differing == 0
    assert same(found, expected)
    numbers = found.statistics
    assert numbers.relations == len(receivers) * samples.count == expected.statistics.relations
    assert numbers.rays == sum(asked)
    assert numbers.away == np.count_nonzero(expected.index == AWAY) * samples.count
    parts = (numbers.lit, numbers.umbra, numbers.away, numbers.geometry, numbers.rays)
    assert min(parts) >= 0 and sum(parts) == numbers.relations
    return found, work


@pytest.mark.parametrize("name", ["rectangle", "disk", "quad", "sun", "point", "volume"])
@pytest.mark.parametrize("scene", ["boxes", "bars", "sphere", "touching", "sheets"])
def test_no_bit_differs_from_rays(scene, name):
    corners = shape(scene)
    compare(receivers_on(corners), lamp_of(name), corners)


def test_few_relations_go_to_rays():
    mixed = 0
    for scene in ("boxes", "bars", "sphere"):
        corners = shape(scene)
        for name in ("rectangle", "point", "sun"):
            found, _ = compare(receivers_on(corners), lamp_of(name), corners)
            numbers = found.statistics
            assert numbers.rays < 0.02 * (numbers.relations - numbers.away)
            mixed += np.count_nonzero(found.index >= 0)
    assert mixed > 120, "no penumbra, no test"


@pytest.mark.parametrize("name", ["disk", "sun", "volume"])
def test_sets_of_samples_alternate(name):
    corners = shape("bars")
    # more samples than a word holds, and a number that does not fill it
    samples = lamp_of(name, count=71, sets=3)
    receivers = receivers_on(corners, sets=3)
    found, _ = compare(receivers, samples, corners)
    first = Receivers(receivers.position, receivers.normal)
    assert not same(found, compare(first, samples, corners)[0])


def test_lamp_that_shines_through_triangles():
    corners = shape("boxes")
    for height in (0.0, 0.5):
        # through the floor, then in the plane of boxes' undersides
        through = lamp((0.2, 0.1, height), kind="AREA", shape="RECTANGLE", size=(3, 2))
        compare(receivers_on(corners, normals=False), sample_lamp(through, 32), corners)
        compare(receivers_on(corners, normals=False), sample_ball((0.2, 0.1, height), 0.8, 32), corners)


def test_receivers_in_planes_edges_and_corners_of_triangles():
    corners = shape("touching")
    place = np.concatenate([corners.reshape(-1, 3), corners.mean(axis=1), (corners[:, 0] + corners[:, 1]) / 2])
    for name in ("rectangle", "point", "sun"):
        compare(Receivers(place), lamp_of(name), corners)


def test_degenerate_triangles():
    random = np.random.default_rng(5)
    points = np.repeat(random.uniform(-1, 1, (3, 1, 3)), 3, axis=1)
    needles = random.uniform(-1, 1, (12, 3, 3))
    part, off = random.uniform(-0.2, 1.2, (12, 1)), 10.0 ** -random.integers(2, 9, (12, 1))
    needles[:, 2] = needles[:, 0] * (1 - part) + needles[:, 1] * part + off * random.normal(size=(12, 3))
    lines = random.uniform(-1, 1, (4, 3, 3))
    lines[:, 2] = lines[:, 1]
    broken = np.full((1, 3, 3), np.nan)
    corners = np.concatenate([points, needles, lines, shape("sheets"), broken]).astype(np.float32)
    receivers = receivers_on(shape("sheets"), 150)
    for name in ("rectangle", "volume", "sun"):
        compare(receivers, lamp_of(name, 16), corners)


@pytest.mark.parametrize("shift, scale", [(1000, 1), (0, 0.01), (0, 300)])
def test_far_from_the_origin_small_and_large(shift, scale):
    corners = shape("boxes") * np.float32(scale) + np.float32(shift)
    given = receivers_on(shape("boxes"), 200)
    receivers = Receivers(given.position * np.float32(scale) + np.float32(shift), given.normal)
    for name in ("rectangle", "spot", "sun"):
        samples = lamp_of(name, 16)
        if not samples.distant:
            centre, half = samples.centre * scale + shift, samples.half * scale
            samples = LampSamples(name, samples.axes, centre, half, samples.places, one_sided=samples.one_sided)
        compare(receivers, samples, corners)


def umbra_scene():
    """A floor in small triangles under a large lid of some layers: much of it sees nothing of the lamp."""
    layers = [grid((-1.6, -1.6, z), (3.2, 0, 0), (0, 3.2, 0), 3) for z in (0.3, 0.45, 0.6)]
    return corners_of(floor(), *layers)


def test_umbra_bits_and_rebuilding_save_work_and_change_nothing():
    corners = umbra_scene()
    receivers = receivers_on(corners[:2], 600)
    samples = lamp_of("disk")
    plain, without = compare(receivers, samples, corners, Optimisations(umbra=False))
    kept, umbra = compare(receivers, samples, corners, Optimisations(rebuild=1))
    built, rebuilt = compare(receivers, samples, corners)
    assert same(plain, kept) and same(plain, built)
    assert np.count_nonzero(plain.index == UMBRA) > 150
    assert without.rebuilds == umbra.rebuilds == 0 < rebuilt.rebuilds
    assert umbra.relations < 0.7 * without.relations
    assert umbra.nodes < without.nodes
    # those in umbra left the tree, so it takes fewer nodes and planes to find the rest
    assert rebuilt.nodes < umbra.nodes and rebuilt.planes < umbra.planes


def test_active_plane_sets_save_tests():
    corners = shape("bars")
    receivers = receivers_on(corners, 500)
    for name in ("disk", "point"):
        found, active = compare(receivers, lamp_of(name), corners)
        other, all_planes = compare(receivers, lamp_of(name), corners, Optimisations(plane_sets=False))
        assert same(found, other)
        assert active.planes < 0.85 * all_planes.planes
        assert (active.nodes, active.relations) == (all_planes.nodes, all_planes.relations)


def test_sorting_finds_umbra_earlier():
    # the lids' triangles last
    clutter = [box((x, -1.9, 0.05), (x + 0.02, 1.9, 0.1)) for x in np.linspace(-1.5, 1.5, 8)]
    corners = np.concatenate([corners_of(*clutter), umbra_scene()[2:]])
    receivers = receivers_on(corners_of(floor()), 400)
    found, sorted_work = compare(receivers, lamp_of("disk"), corners)
    other, work = compare(receivers, lamp_of("disk"), corners, Optimisations(sort=False))
    assert same(found, other)
    assert sorted_work.relations < 0.8 * work.relations


def test_triangles_in_any_order_give_the_same():
    corners = shape("boxes")
    receivers = receivers_on(corners)
    bvh = Bvh(corners)
    first = cast_hierarchically(receivers, lamp_of("rectangle"), corners, bvh.occluded)
    random = np.random.default_rng(3)
    for sort in (True, False):
        mixed = random.permuted(corners[random.permutation(len(corners))], axis=1) if sort else corners[::-1]
        mixed = corners[random.permutation(len(corners))] if sort else mixed
        options = Optimisations(sort=sort)
        assert same(first, cast_hierarchically(receivers, lamp_of("rectangle"), mixed, bvh.occluded, options))


def test_masks_only_where_something_comes_near():
    corners = corners_of(floor(), box((-0.2, -0.2, 0.2), (0.2, 0.2, 0.4)))
    receivers = receivers_on(corners[:2], 1000, normals=False)
    found, work = compare(receivers, lamp_of("rectangle"), corners)
    assert 0 < np.count_nonzero((found.index != LIT) & (found.index != AWAY)) <= work.masks < 400
    assert found.statistics.lit > 0.5 * found.statistics.relations


def test_nothing_to_do():
    corners, samples = shape("boxes"), lamp_of("rectangle")
    receivers = receivers_on(corners, 50)
    found, work = compare(receivers, samples, corners[:0])
    assert set(found.index) == {LIT, AWAY} and work == Work()
    nobody = Receivers(np.zeros((0, 3), np.float32))
    assert len(cast_hierarchically(nobody, samples, corners, Bvh(corners).occluded)) == 0
    # behind a lamp that shines to one side
    behind = Receivers(np.array([[0, 0, 3], [0, 1, 4]], np.float32))
    found, work = compare(behind, lamp_of("disk"), corners)
    assert (found.index == AWAY).all() and work == Work()


@pytest.mark.parametrize("name", ["rectangle", "sun", "volume"])
def test_penumbra_volumes_hold_what_is_hidden(name):
    """Places behind a triangle as seen from samples are within the volumes of all light nodes above these samples."""
    random = np.random.default_rng(1)
    samples = lamp_of(name, 64, 2)
    space = Space.around(shape("boxes"), lamp_of("volume").targets())
    lights = light_hierarchy(samples, space)
    group = lights.group
    held = 0
    for triangle in space.local(
        random.uniform((-1, -1, 0), (1, 1, 1.5), (20, 1, 3)) + random.normal(0, 0.3, (20, 3, 3))
    ):
        of_set, sample = random.integers(0, 2, 200), random.integers(0, 64, 200)
        hidden_by = random.dirichlet(np.ones(3), 200) @ triangle
        away = hidden_by * lights.near - lights.samples[of_set, sample]
        points = hidden_by + random.uniform(0.1, 2, (200, 1)) * away
        point, flat = np.arange(200), np.zeros_like(points)
        for nodes, owner in ((lights.root, np.zeros(200, int)), (lights.groups, group[of_set, sample])):
            volumes = penumbra_volumes(triangle, nodes, lights, space.band)
            active = np.ones((200, len(nodes)), bool)
            volumes.meet(points, flat, active, np.ones((200, len(volumes.planes)), bool), True)
            assert active[point, owner].all()
            # and not what is between them and the light
            active[:] = True
            volumes.meet(hidden_by - 0.5 * away, flat, active, np.ones((200, len(volumes.planes)), bool), True)
            held += active[point, owner].sum()
        blocked, undecided = hard_shadows(triangle, lights, np.arange(128), space.band).test(
            points, of_set * 64 + sample
        )
        assert (blocked | undecided).all() and undecided.mean() < 0.1
    assert held < 0.1 * 20 * 400


def test_tree_of_receivers():
    points = np.random.default_rng(0).normal(size=(203, 3))
    rows = np.arange(3, 203)
    tree = Tree.build(points, rows)
    assert (np.sort(tree.order) == rows).all()
    leaves = np.flatnonzero(tree.child < 0)
    assert (tree.last - tree.first)[leaves].max() <= LEAF
    found, node = tree.receivers(leaves)
    assert (np.sort(found) == rows).all()
    leaf = leaves[node]
    assert (np.abs(points[found] - tree.middle[leaf]) <= tree.half[leaf] + 1e-12).all()
    full = np.zeros(203, bool)
    full[tree.order[: tree.last[1]]] = True
    assert tree.darken(full) == 200 - tree.last[1]
    assert tree.dark[1] and not tree.dark[0] and not tree.dark[2]


def test_blocking_power_prefers_the_large_and_near():
    samples = lamp_of("disk")
    corners = corners_of(
        quad((-1, -1, 0.5), (2, 0, 0), (0, 2, 0)), quad((0, 0, 0.5), (0.1, 0, 0), (0, 0.1, 0)), floor()
    )
    space = Space.around(corners, samples.targets())
    probes = space.local(receivers_on(corners[-2:], 40).position)
    power = blocking_power(space.local(corners), probes, light_hierarchy(samples, space))
    assert power[:2].min() > 10 * power[2:4].max()
