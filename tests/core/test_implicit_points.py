"""The thesis's method, piece by piece, against plain numbers and brute force (Delaere 2021, chapter 3)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lightpanes.core.implicit_cache import ImplicitPoints, OnePointCache
from lightpanes.core.implicit_cache.choice import areas, jittered, pick, three_nearest
from lightpanes.core.implicit_cache.fixed_point import nest, pcg, voxel_words
from lightpanes.core.implicit_cache.frame_table import MEAN_BITS, FixedTable, merge, sum_frame, values_at
from lightpanes.core.implicit_cache.implicit_points import noise
from lightpanes.core.implicit_cache.reconstruction import interpolate


def plain_pcg(value: int) -> int:
    """The hash's definition in unbounded integers."""
    state = (value * 747796405 + 2891336453) % 2**32
    word = ((state >> ((state >> 28) + 4)) ^ state) * 277803737 % 2**32
    return (word >> 22) ^ word


@given(st.lists(st.integers(0, 2**32 - 1), min_size=3, max_size=3))
@settings(max_examples=40, deadline=None)
def test_the_nested_hash(words):
    x, y, z = (np.array([w], np.uint32) for w in words)
    found = nest(x, nest(y, nest(z)))
    wanted = plain_pcg((words[0] + plain_pcg((words[1] + plain_pcg(words[2])) % 2**32)) % 2**32)
    assert found[0] == wanted and pcg(x)[0] == plain_pcg(words[0])


@given(st.integers(-(2**20), 2**20), st.integers(0, 9))
@settings(max_examples=60, deadline=None)
def test_a_word_is_sign_integer_and_fraction(voxel, level):
    levels = 10
    word = int(voxel_words(np.array([voxel >> 9 - level]), level, levels)[0])
    # the middle of the voxel, in coarsest voxels, by its bits
    middle = ((voxel >> 9 - level) + 0.5) / 2**level
    value = (word & 2**31 - 1) / 2**levels
    assert (-value if word >> 31 else value) == middle


def test_no_two_voxels_share_a_word():
    words = np.concatenate([voxel_words(np.arange(-(2**k), 2**k), k, 8) for k in range(8)])
    assert len(np.unique(words)) == len(words)


def test_words_of_32_bits_end_far_away_and_of_64_do_not():
    near = np.array([2**8 - 1])
    assert voxel_words(near, 0, 23).dtype == np.uint32
    with pytest.raises(ValueError, match="64-bit"):
        voxel_words(near + 1, 0, 23)
    assert voxel_words(near + 1, 0, 23, 64).dtype == np.uint64
    # what 32 bits cannot tell apart, 64 can: 2,560 m × 2^40 away
    far = voxel_words(np.array([5, 5 + 2**40]), 0, 10, 64)
    assert nest(far)[0] != nest(far)[1]


def everywhere(count=2000, seed=0, size=3.0):
    random = np.random.default_rng(seed)
    return random.uniform(-size, size, (3, count))


def listed(points, place, level, reach=1):
    """Keys (k, n) and places (3, k, n) of all candidates."""
    found = list(points.candidates(place, np.full(place.shape[1], level), np.zeros(place.shape[1], np.uint32), reach))
    return np.stack([key for key, _ in found]), np.stack([place + offset for _, offset in found], axis=1)


@pytest.mark.parametrize("bits", [32, 64])
@pytest.mark.parametrize("shared", [False, True])
def test_every_octant_holds_one_point_wherever_it_is_asked_for(bits, shared):
    points = ImplicitPoints(coarsest=4.0, levels=8, neighbourhood=26, bits=bits, shared=shared)
    place = everywhere(100)
    keys, at = listed(points, place, 4)
    assert keys.shape[0] == 216
    octant = np.floor(at / points.octant_size(4)).reshape(3, -1).astype(int)
    names, first, where = np.unique(octant, axis=1, return_index=True, return_inverse=True)
    where = where.reshape(-1)
    # the same key and place from every voxel that looks at it, to the last digits of float32
    assert (keys.reshape(-1) == keys.reshape(-1)[first][where]).all()
    assert np.abs(at.reshape(3, -1) - at.reshape(3, -1)[:, first][:, where]).max() < 1e-6
    # the own voxel's and its neighbours' octants
    own = np.floor(place / (2 * points.octant_size(4))).astype(int)
    assert (np.abs(octant.reshape(3, 216, -1) // 2 - own[:, None]) <= 1).all()
    assert len(np.unique(keys.reshape(-1)[first])) == names.shape[1]


@pytest.mark.parametrize(("neighbourhood", "count"), [(0, 8), (6, 56), (18, 152), (26, 216), (None, 27)])
def test_neighbourhoods(neighbourhood, count):
    points = ImplicitPoints(coarsest=4.0, neighbourhood=neighbourhood)
    keys, _ = listed(points, everywhere(50), 5)
    assert len(keys) == count
    assert all(len(np.unique(column)) == count for column in keys.T)


def test_27_octants_hold_the_three_nearest_of_216_points():
    place = everywhere(8000)
    level, surface = np.full(8000, 5), np.zeros(8000, np.uint32)
    all_keys, squared = three_nearest(ImplicitPoints(4.0, neighbourhood=26).candidates(place, level, surface))
    keys, _ = three_nearest(ImplicitPoints(4.0).candidates(place, level, surface))
    assert (np.diff(squared, axis=0) >= 0).all()
    assert (keys == all_keys).all(axis=0).mean() > 0.995
    assert (keys[0] == all_keys[0]).mean() > 0.9999


def test_the_three_nearest_are_those_that_sorting_gives():
    points, place = ImplicitPoints(4.0), everywhere(500)
    keys, at = listed(points, place, 5)
    distance = ((at - place[:, None]) ** 2).sum(axis=0)
    order = np.argsort(distance, axis=0)[:3]
    found, squared = three_nearest(points.candidates(place, np.full(500, 5), np.zeros(500, np.uint32)))
    assert np.array_equal(found, np.take_along_axis(keys, order, 0))
    assert np.allclose(squared, np.take_along_axis(distance, order, 0), rtol=1e-4, atol=1e-9)


def test_points_are_spread_more_evenly_than_at_random():
    # variance of counts in boxes of 4 octants' edge, whose mean is 64: 64 at random
    points = ImplicitPoints(coarsest=4.0)
    _, at = listed(points, everywhere(8000, size=0.6), 5)
    at = np.unique(np.round(at.reshape(3, -1).T, 5), axis=0)
    edge = 4 * points.octant_size(5)
    middles = np.random.default_rng(1).uniform(-0.4, 0.4, (200, 3))
    counts = [(np.abs(at - m).max(axis=1) < edge / 2).sum() for m in middles]
    assert abs(np.mean(counts) - 64) < 3
    assert np.var(counts) < 0.6 * 64
    # and along an axis seeds in a row are, too: the mean of their gaps' squares, 2/65 at random
    rows = np.stack([noise(np.arange(start, start + 64, dtype=np.uint32)) for start in range(0, 64_000, 64)])
    gaps = np.diff(np.sort(rows, axis=2), axis=2)
    assert (gaps**2).sum(axis=2).mean() < 0.85 * 2 / 65


def test_a_point_stays_when_its_voxel_is_divided():
    points = ImplicitPoints(coarsest=2.0, levels=9, shared=True)
    place = everywhere(200, size=0.5)
    coarse_keys, coarse = listed(points, place, 3, reach=1)
    # every point of the coarser level is one of the finer ones around itself
    own = coarse[:, 13]
    keys, at = listed(points, own.astype(np.float64), 4, reach=0)
    assert np.array_equal(keys[0], coarse_keys[13])
    assert np.abs(at[:, 0] - own).max() < 1e-5
    # without the option hardly any is
    keys, _ = listed(ImplicitPoints(coarsest=2.0, levels=9), own.astype(np.float64), 4, reach=0)
    assert (keys[0] == coarse_keys[13]).mean() < 0.01


@given(st.lists(st.floats(0, 10), min_size=3, max_size=3))
@settings(max_examples=60, deadline=None)
def test_areas_are_barycentric(distances):
    a, b, c = np.float32(distances)
    weights = areas(np.float32(distances)[:, None])[:, 0]
    assert (weights >= 0).all() and abs(weights.sum() - 1) < 1e-4
    total = float(b) * c + float(a) * c + float(a) * b
    if total > 1e-3:
        assert np.allclose(weights, [b * c / total, a * c / total, a * b / total], atol=1e-4)
    # on a point, it takes all
    assert np.allclose(areas(np.float32([[0], [1], [2]]))[:, 0], [1, 0, 0])


def test_points_are_picked_as_often_as_their_areas_say():
    weights = np.tile(np.float32([[0.6], [0.3], [0.1]]), 100_000)
    row = pick(weights, np.random.default_rng(0).random(100_000, dtype=np.float32))
    assert np.allclose(np.bincount(row) / 1e5, [0.6, 0.3, 0.1], atol=0.006)
    assert (pick(weights[:, :3], np.float32([0, 0.6, 0.95])) == [0, 1, 2]).all()


def test_jitter_stays_in_the_disc_of_the_tangent_plane():
    random = np.random.default_rng(0)
    normal = random.normal(size=(3, 5000)).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=0)
    moved = jittered(np.zeros((3, 5000)), normal, np.full(5000, 0.2), random.random((5000, 2)))
    assert np.abs((moved * normal).sum(axis=0)).max() < 1e-6
    distance = np.linalg.norm(moved, axis=0)
    assert distance.max() < 0.2001
    # even over the disc
    assert abs((distance < 0.1).mean() - 0.25) < 0.02


def test_merging_is_the_thesis_s():
    table = FixedTable(1, 64)
    truth, count = 0.0, 0
    random = np.random.default_rng(0)
    for _ in range(12):
        values = random.random((random.integers(1, 30), 1)).astype(np.float32)
        frame = sum_frame(np.full(len(values), 77, np.uint32), values)
        assert frame.count.sum() == len(values)
        merge(table, frame, 1.0, 0.9)
        truth = (truth * count + float(values.sum())) / (count + len(values))
        count = int((count + len(values)) * 0.9) or 1
        slot = table.find(np.array([77], np.uint32))
        # 11 bits of fraction a sample
        assert abs(values_at(table, slot, 1.0)[0, 0] - truth) < 2**-10
        assert table.count[slot[0]] == count
    assert table.bytes_per_entry == 12 and FixedTable(3, 64).bytes_per_entry == 20
    assert MEAN_BITS == 31


def test_a_frame_s_sums_are_those_of_a_dictionary():
    random = np.random.default_rng(3)
    keys = random.integers(0, 2**32, 300, dtype=np.uint32)[random.integers(0, 300, 5000)]
    values = random.random((5000, 3)).astype(np.float32)
    frame = sum_frame(keys, values)
    slot = frame.find(np.unique(keys))
    assert (slot >= 0).all() and frame.used == len(slot)
    for key, s in zip(np.unique(keys), slot, strict=True):
        assert frame.count[s] == (keys == key).sum()
        wanted = np.rint(values[keys == key] * 2048).sum(axis=0)
        assert (frame.value[:, s] == wanted).all()


def test_light_beyond_the_scale_saturates():
    table = FixedTable(1, 64)
    merge(table, sum_frame(np.array([5], np.uint32), np.float32([[9.0]])), 4.0, 1.0)
    assert np.allclose(values_at(table, table.find(np.array([5], np.uint32)), 4.0), 4.0)


def test_reconstruction_is_shepard_s():
    random = np.random.default_rng(0)
    place = everywhere(60)
    points = ImplicitPoints(4.0)
    keys, at = listed(points, place, 5, reach=2)
    names = np.unique(keys)
    value, known = random.random(len(names)), random.random(len(names)) < 0.8
    radius = np.full(60, 2 * points.octant_size(5), np.float32)

    def value_of(wanted):
        row = np.searchsorted(names, wanted)
        return value[row][None].astype(np.float32), known[row]

    around = points.candidates(place, np.full(60, 5), np.zeros(60, np.uint32), 2)
    found, weights = interpolate(around, radius, value_of)
    row = np.searchsorted(names, keys)
    weight = np.maximum(radius - np.linalg.norm(at - place[:, None], axis=0), 0) * known[row]
    assert np.allclose(weights, weight.sum(axis=0), rtol=1e-4, atol=1e-7)
    assert np.allclose(found[0], (weight * value[row]).sum(axis=0) / weight.sum(axis=0), rtol=1e-3)


@pytest.mark.parametrize("choice", ["nearest", "barycentric", "jitter"])
@pytest.mark.parametrize("even", [False, True])
def test_a_sheet_s_light_comes_through_noise(choice, even):
    y, x = np.mgrid[:64, :64].reshape(2, -1) * 0.01
    position = np.stack([x, y, 0.1 * x], axis=1).astype(np.float32)
    normal = np.tile(np.float32([-0.0995, 0, 0.995]), (len(x), 1))
    truth = 0.5 + 0.4 * np.sin(6 * x)
    random = np.random.default_rng(0)
    cache = OnePointCache(points=ImplicitPoints(even=even), choice=choice, cell=4.0, ageing=1.0, slots=1 << 15)
    places = cache.look_up(position, normal, None, 0.01)
    for _ in range(32):
        keys = cache.add(places, (random.random(len(x)) < truth).astype(np.float32))
    raw = np.sqrt(((cache.at(keys)[:, 0] - truth) ** 2).mean())
    filtered = np.sqrt(((cache.read(places)[:, 0] - truth) ** 2).mean())
    assert filtered < 0.04 and filtered < 0.8 * raw
    assert 0 < cache.occupancy < 0.2


def test_points_projected_onto_the_surface_are_as_near_as_their_shadows():
    # a sheet between two layers of points: with projection these count as if they lay on it
    y, x = np.mgrid[:48, :48].reshape(2, -1) * 0.01
    position = np.stack([x, y, 0 * x + 1e-4], axis=1).astype(np.float32)
    normal = np.tile(np.float32([0, 0, 1]), (len(x), 1))
    truth, random, errors = 0.5 + 0.4 * np.sin(6 * x), np.random.default_rng(0), {}
    for projected in (False, True):
        cache = OnePointCache(projected=projected, cell=2.0, ageing=1.0, slots=1 << 15, by_normal=True)
        places = cache.look_up(position, normal, np.zeros(len(x), np.int32), 0.01)
        for _ in range(32):
            cache.add(places, (random.random(len(x)) < truth).astype(np.float32))
        errors[projected] = np.sqrt(((cache.read(places)[:, 0] - truth) ** 2).mean())
    # more points within the radius, so less noise
    assert errors[True] < errors[False] < 0.05


def test_normals_and_objects_in_the_thesis_s_key():
    position = np.zeros((2, 3), np.float32)
    normal = np.float32([[0, 0, 1], [0, 0, -1]])
    for objects, sides in (([0, 0], normal), ([0, 1], normal[[0, 0]])):
        cache = OnePointCache(by_normal=True, slots=1 << 10)
        found = cache.frame(position, sides, np.array(objects), 0.01, np.float32([1.0, 0.01]))
        assert np.allclose(found[:, 0], [1, 0.01], atol=1e-3)
    leaking = OnePointCache(slots=1 << 10, choice="nearest").frame(
        position, normal, None, 0.01, np.float32([1.0, 0.01])
    )
    assert np.allclose(leaking, 0.505, atol=1e-3)
