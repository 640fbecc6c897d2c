"""The world-space cache against a slow clear version, and what its users rely on."""

from collections import defaultdict
from functools import cache
from itertools import product
from math import floor, prod

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lightpanes.core.implicit_cache import Cache
from lightpanes.core.implicit_cache.keys import normal_bins
from lightpanes.core.implicit_cache.lattice import distinct


class SlowCache:
    """The same by dictionaries and loops over samples: entries by (lattice point, level, bin of the normal, object)."""

    def __init__(self, channels, fine, octaves, trust, most):
        self.channels, self.fine, self.octaves, self.trust, self.most = channels, fine, octaves, trust, most
        self.mean, self.count = {}, defaultdict(float)

    @staticmethod
    @cache
    def corners(position, level, facing, object_id):
        place = [x / 2.0**level - 0.5 for x in position]
        low = [floor(x) for x in place]
        found = []
        for step in product((0, 1), repeat=3):
            weight = prod(x - i if k else 1 - (x - i) for x, i, k in zip(place, low, step, strict=True))
            corner = tuple(i + k for i, k in zip(low, step, strict=True))
            found.append(((corner, level, facing, object_id), weight))
        return found

    def of_sample(self, position, normal, object_id, footprint):
        level = int(np.rint(np.log2(np.float32(footprint) * np.float32(self.fine))))
        facing = None if normal is None else tuple(round(3.5 * float(x)) for x in normal)
        return self.corners(tuple(position.tolist()), level, facing, object_id)

    def of_entry(self, key, octaves):
        cell, level, *surface = key
        return self.corners(tuple((i + 0.5) * 2.0**level for i in cell), level + octaves, *surface)

    def add(self, places, values):
        tier = defaultdict(lambda: np.zeros(self.channels + 1))
        for place, value in zip(places, values, strict=True):
            for key, weight in self.of_sample(*place):
                tier[key] += weight * np.append(value, 1)
        tiers = [tier]
        for octaves in self.octaves:
            tiers.append(defaultdict(lambda: np.zeros(self.channels + 1)))
            for entry, sums in tiers[-2].items():
                for key, weight in self.of_entry(entry, octaves):
                    tiers[-1][key] += weight * sums
        self.hand_down({key for tier in tiers for key in tier if key not in self.count})
        for tier in tiers:
            for key, sums in tier.items():
                count = self.count[key] + sums[-1]
                self.mean[key] = (self.mean.get(key, 0) * self.count[key] + sums[:-1]) / max(count, 1e-30)
                # counts are kept in steps of 1/16, and some is never none
                self.count[key] = max(np.rint(16 * min(count, self.most)), 1) / 16

    def hand_down(self, new):
        made = {}
        for key in new:
            (i, j, k), level, facing, object_id = key
            parent = ((i >> 1, j >> 1, k >> 1), level + 1, facing, object_id)
            if self.count.get(parent):
                made[key] = (self.mean[parent], min(self.count[parent], 16))
        for key, (mean, count) in made.items():
            self.mean[key], self.count[key] = mean, count

    def read(self, places):
        @cache
        def known(key, tier):
            """Sums and count at an entry, those of coarser ones as so many samples."""
            total = np.zeros(self.channels + 1)
            if tier < len(self.octaves):
                for parent, weight in self.of_entry(key, self.octaves[tier]):
                    total += weight * known(parent, tier + 1)
                if total[-1]:
                    total *= min(total[-1], self.trust[tier]) / total[-1]
            if key in self.mean:
                total += self.count[key] * np.append(self.mean[key], 1)
            return total

        result = []
        for place in places:
            *sums, count = sum(weight * known(key, 0) for key, weight in self.of_sample(*place))
            result.append(np.array(sums) / (count or 1))
        return np.array(result)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, 40), max_size=200), st.sampled_from([1, 1 << 40, 0x9E3779B97F4A7C15]))
def test_keys_once_each(numbers, step):
    keys = np.array(numbers, np.uint64) * np.uint64(step)
    chosen, which = distinct(keys)
    assert sorted(keys[chosen]) == sorted(set(keys.tolist()))
    assert np.array_equal(keys[chosen][which], keys)


def some_places(count, seed, objects=True):
    """Places in rows along a few lines, so that neighbours share cells; footprints of three levels."""
    random = np.random.default_rng(seed)
    along = np.linspace(0, 1, count)[:, None]
    position = random.normal(size=3) + along * random.normal(size=3) * 0.3 + 0.002 * random.normal(size=(count, 3))
    normal = random.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    footprint = 0.004 * 2.0 ** random.integers(0, 3, count)
    return (
        position.astype(np.float32),
        normal.astype(np.float32),
        random.integers(0, 3, count).astype(np.int32) if objects else None,
        footprint.astype(np.float32),
    )


def listed(position, normal, object_id, footprint):
    return [
        (position[k], None if normal is None else normal[k], None if object_id is None else object_id[k], footprint[k])
        for k in range(len(position))
    ]


@pytest.mark.parametrize(
    ("channels", "coarse", "with_normal", "with_object"),
    [(1, None, True, True), (3, (14.0, 56.0), True, False), (1, (7.0, 56.0), False, True)],
)
def test_it_does_what_the_slow_one_does(channels, coarse, with_normal, with_object):
    position, normal, object_id, footprint = some_places(50, 5)
    normal, object_id = normal if with_normal else None, object_id if with_object else None
    fast = Cache(channels, coarse=coarse, measured=False, slots=1 << 15, most=30)
    slow = SlowCache(channels, fast.fine, fast.octaves, fast.trust, 30)
    random = np.random.default_rng(1)
    for _ in range(4):
        # the camera moves by a few cells and over what it saw, nearer and farther
        moved = (position + random.integers(-1, 2, 3) * 0.01).astype(np.float32)
        near = (footprint * 2.0 ** random.integers(-1, 2)).astype(np.float32)
        values = random.uniform(0, 5, (50, channels)).astype(np.float32)
        found = fast.frame(moved, normal, object_id, near, values)
        slow.add(listed(moved, normal, object_id, near), values)
        assert np.allclose(found, slow.read(listed(moved, normal, object_id, near)), rtol=2e-3, atol=2e-3)
    # somewhere else, where only some corners are known, and nothing is made
    entries = fast.entries
    elsewhere = fast.look_up(position + np.float32(0.02), normal, object_id, footprint, create=False)
    wanted = slow.read(listed(position + np.float32(0.02), normal, object_id, footprint))
    assert np.allclose(fast.read(elsewhere), wanted, rtol=2e-3, atol=2e-3)
    assert fast.entries == entries == len(slow.count)


def frames_of(cache, count=5000, frames=3, seed=0):
    """Pictures of a wavy floor, frame after frame, by a camera that moves."""
    random = np.random.default_rng(seed)
    x = np.linspace(0, 4, count, dtype=np.float32)
    for k in range(frames):
        y = np.float32(0.01 * k)
        position = np.stack([x, y + 0 * x, 0.1 * np.sin(3 * x)], axis=1)
        normal = np.stack([-0.3 * np.cos(3 * x), 0 * x, 1 + 0 * x], axis=1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        value = random.random((count, cache.channels), dtype=np.float32)
        yield cache.frame(position, normal, None, np.float32(0.004), value)


@pytest.mark.parametrize("channels", [1, 3])
def test_the_same_on_one_thread_or_many(channels):
    # several pieces
    one, many = (list(frames_of(Cache(channels, threads=n, slots=1 << 16), 40_000)) for n in (1, 4))
    assert all(np.array_equal(a, b) for a, b in zip(one, many, strict=True))


def test_the_same_seed_gives_the_same_and_another_seed_the_same_but_for_the_last_digits():
    first, again, other = (list(frames_of(Cache(seed=s, slots=1 << 16))) for s in (1, 1, 2))
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert all(np.allclose(a, b, atol=1e-3) for a, b in zip(first, other, strict=True))


def patch(side=48, spacing=0.002, shift=0.0):
    """A tilted floor as a camera sees it, by rows: positions and normals (side², 3)."""
    y, x = np.mgrid[:side, :side].astype(np.float32).reshape(2, -1) * np.float32(spacing)
    position = np.stack([x + np.float32(shift), y, 0.2 * x + 0.1 * y], axis=1)
    normal = np.float32([-0.2, -0.1, 1]) / np.float32(np.sqrt(1.05))
    return position, np.tile(normal, (side * side, 1))


def test_places_at_rest_give_what_new_ones_give():
    position, normal = patch()
    truth = (0.5 + 0.4 * np.sin(40 * position[:, 0])).astype(np.float32)
    # without measured trust, which remembers how samples scattered at a place
    kept, anew = Cache(slots=1 << 16, measured=False), Cache(slots=1 << 16, measured=False)
    places = kept.look_up(position, normal, None, 0.002)
    random = np.random.default_rng(0)
    for _ in range(5):
        value = (random.random(len(truth)) < truth).astype(np.float32)
        kept.add(places, value)
        assert np.array_equal(kept.read(places), anew.frame(position, normal, None, 0.002, value))
    assert kept.holds(places)


def test_noise_goes_with_the_frames_and_no_bias_stays():
    position, normal = patch()
    truth = (0.5 + 0.4 * np.sin(40 * position[:, 0])).astype(np.float32)
    random = np.random.default_rng(0)
    cache = Cache(slots=1 << 16)
    places = cache.look_up(position, normal, None, 0.002)
    errors = []
    for k in range(64):
        cache.add(places, (random.random(len(truth)) < truth).astype(np.float32))
        if k + 1 in (4, 16, 64):
            errors.append(float(np.sqrt(((cache.read(places)[:, 0] - truth) ** 2).mean())))
    # of one pixel alone it would be 0.42 / √frames: 0.21, 0.10, 0.05
    assert errors[0] < 0.09 and errors[1] < 0.06 and errors[2] < 0.03
    assert abs(cache.read(places).mean() - truth.mean()) < 0.005


def test_trust_is_measured():
    # one half is flat, the other has stripes of a few cells: soon the stripes are sharp and the flat calm
    position, normal = patch(96)
    fine, flat = position[:, 0] > 0.096, position[:, 0] < 0.08
    stripes = np.sin(position[:, 0] * 2 * np.pi / 0.048) > 0
    truth = np.where(fine, 0.5 + 0.4 * stripes, 0.5).astype(np.float32)
    rmse = {}
    for measured in (False, True):
        random = np.random.default_rng(0)
        cache = Cache(slots=1 << 16, measured=measured)
        places = cache.look_up(position, normal, None, 0.002)
        for _ in range(16):
            cache.add(places, (random.random(len(truth)) < truth).astype(np.float32))
        error = (cache.read(places)[:, 0] - truth) ** 2
        rmse[measured] = np.sqrt([error[flat].mean(), error[fine].mean()])
    assert rmse[True][0] < 0.85 * rmse[False][0]
    assert rmse[True][1] < 0.9 * rmse[False][1]


def test_strong_light_is_kept():
    position, normal = patch(10, 0.01)
    cache = Cache(3, slots=1 << 14)
    value = np.tile(np.float32([1e5, 3.0, 1e-4]), (100, 1))
    for _ in range(20):
        found = cache.frame(position, normal, None, 0.01, value)
    assert np.allclose(found, value, rtol=1e-4)


def test_bytes_of_an_entry():
    assert Cache(1).bytes_per_entry == 12
    assert Cache(3).bytes_per_entry == 20
    # and there is nothing else that stays
    table = Cache(3, slots=1 << 14).table
    held = sum(value.nbytes for value in vars(table).values() if isinstance(value, np.ndarray) and value.base is None)
    assert held == 20 * (table.slots + 1)


def settled(value, frames=30):
    position, normal = patch()
    cache = Cache(slots=1 << 16)
    places = cache.look_up(position, normal, None, 0.002)
    for _ in range(frames):
        cache.add(places, np.full(len(position), value, np.float32))
    return cache, places


def test_what_changed_is_followed_after_dropping_counts():
    cache, places = settled(1.0, 60)
    cache.drop()
    shown = []
    for _ in range(20):
        cache.add(places, np.zeros(places.count))
        shown.append(1 - float(cache.read(places).mean()))
    assert shown[0] > 0.5 and shown[9] > 0.8 and shown[15] > 0.88
    slow, places = settled(1.0, 60)
    for _ in range(10):
        slow.add(places, np.zeros(places.count))
    assert slow.read(places).mean() > 0.8


def test_a_limit_of_counts_forgets_by_itself():
    position, normal = patch()
    cache = Cache(slots=1 << 16, most=8.0)
    for k in range(36):
        found = cache.frame(position, normal, None, 0.002, np.full(len(position), k >= 20, np.float32))
    assert found.mean() > 0.9


def test_age_scales_and_clear_empties():
    cache, places = settled(0.7)
    known = cache.known(places)
    cache.age(0.5)
    finest = places.pieces[0].tiers[0]
    assert np.allclose(cache.table.counts(finest.slot).max(), 0.5 * 30 * finest.share.max(), rtol=0.05)
    assert (cache.known(places) < known).all()
    assert np.allclose(cache.read(places), 0.7, atol=1e-3)
    cache.clear()
    assert (cache.known(places) == 0).all()
    assert (cache.read(places, 9.0) == 9).all()
    assert cache.holds(places)
    cache.add(places, np.full(places.count, 0.2))
    assert np.allclose(cache.read(places), 0.2, atol=1e-3)


def test_where_nothing_is_known():
    cache, _ = settled(0.7)
    position, normal = patch(shift=50.0)
    entries = cache.entries
    places = cache.look_up(position, normal, None, 0.002, create=False)
    own = np.random.default_rng(0).random((len(position), 1), dtype=np.float32)
    assert np.array_equal(cache.read(places, own), own)
    assert (cache.known(places) == 0).all()
    assert cache.entries == entries


def test_no_places_at_all():
    cache = Cache(3)
    nothing = np.zeros((0, 3), np.float32)
    assert cache.frame(nothing, nothing, None, np.zeros(0, np.float32), nothing).shape == (0, 3)


def test_values_of_another_shape_are_refused():
    cache, places = settled(0.5)
    with pytest.raises(ValueError, match="2304 places take 1"):
        cache.add(places, np.zeros((2304, 3)))
    with pytest.raises(ValueError, match="grow"):
        Cache(coarse=(1.0,))
    with pytest.raises(ValueError, match="trust"):
        Cache(coarse=(7.0, 14.0, 28.0))
    with pytest.raises(ValueError, match="powers of two"):
        Cache(coarse=(8.0, 32.0))


@settings(max_examples=60, deadline=None)
@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_bins_of_normals(direction):
    normal = (np.array(direction) / np.linalg.norm(direction)).astype(np.float32)[:, None]
    bin_ = int(normal_bins(normal)[0])
    assert 0 <= bin_ <= 728 and bin_ != 364
    # opposite sides never share one, and a bin's directions lie within 17° of its middle
    assert int(normal_bins(-normal)[0]) == 728 - bin_
    middle = np.array([bin_ // 81 - 4, bin_ // 9 % 9 - 4, bin_ % 9 - 4], float)
    assert middle @ normal[:, 0] / np.linalg.norm(middle) > np.cos(np.radians(17))
