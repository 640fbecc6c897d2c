"""Where world-space caches are known to fail: bounded there."""

import numpy as np
import pytest
from lightpanes.core.implicit_cache import Cache, ImplicitPoints, OnePointCache
from lightpanes.core.implicit_cache import keys as key_module


def floor(height=0.0, side=64, spacing=0.01, origin=(0.0, 0.0), normal=(0, 0, 1), dtype=np.float32):
    """A level floor as pixels see it, by rows: positions, normals."""
    y, x = np.mgrid[:side, :side].reshape(2, -1) * spacing
    position = np.stack([x + origin[0], y + origin[1], np.full(side * side, height)], axis=1).astype(dtype)
    return position, np.tile(np.float32(normal), (side * side, 1))


def noisy(truth, seed):
    return (np.random.default_rng(seed).random(len(truth)) < truth).astype(np.float32)


def settle(cache, position, normal, truth, frames=32, object_id=None, footprint=0.01):
    places = cache.look_up(position, normal, object_id, footprint)
    for k in range(frames):
        cache.add(places, noisy(truth, k))
    return cache.read(places)[:, 0]


# ---- surfaces aligned with the grid ----


@pytest.mark.parametrize("height", [0.0, 1 / 128, 1 / 64, 0.005, 1e-7, -1e-7])
def test_a_floor_on_the_grid_is_as_good_as_one_off_it(height):
    # rounding puts a floor at a cell's border now on one side, now on the other
    position, normal = floor(height)
    position[:, 2] += np.random.default_rng(0).uniform(-1e-7, 1e-7, len(position)).astype(np.float32)
    truth = 0.5 + 0.4 * np.sin(8 * position[:, 0])
    found = settle(Cache(slots=1 << 15), position, normal, truth)
    error = np.sqrt(((found - truth) ** 2).mean())
    assert error < 0.025
    # no lines along cells: neighbouring pixels differ as the truth does, but for the picture's borders
    image = (found - truth).reshape(64, 64)[:, 8:-8]
    steps = np.abs(np.diff(image, axis=1)).mean(axis=0)
    assert steps.max() < 4 * np.median(steps) + 0.005


# ---- thin walls ----


def wall(thickness=0.001):
    """The two sides of a wall, one lit a hundred times as much."""
    lit, up = floor(thickness)
    dark, down = floor(0.0, normal=(0, 0, -1))
    truth = np.repeat([1.0, 0.01], len(lit))
    return np.concatenate([lit, dark]), np.concatenate([up, down]), truth.astype(np.float32)


def test_light_does_not_pass_a_wall_of_a_millimetre():
    position, normal, truth = wall()
    cache = Cache(slots=1 << 15)
    found = cache.frame(position, normal, None, 0.01, truth)[:, 0]
    assert np.abs(found - truth).max() < 1e-4
    # and without the normal it does
    leaking = Cache(slots=1 << 15, by_normal=False)
    found = leaking.frame(position, normal, None, 0.01, truth)[:, 0]
    assert found[truth < 0.5].mean() > 0.3


def test_objects_keep_their_light_apart():
    # a floor that goes on under a thin wall: the rooms' floors face alike
    position, normal = floor()
    left = position[:, 0] < 0.32
    truth = np.where(left, 1.0, 0.01).astype(np.float32)
    apart = Cache(slots=1 << 15).frame(position, normal, left.astype(np.int32), 0.01, truth)[:, 0]
    assert np.abs(apart - truth).max() < 1e-4
    # as one object it leaks, but within a coarse cell, and less from frame to frame
    cache = Cache(slots=1 << 15)
    places = cache.look_up(position, normal, None, 0.01)
    reached = []
    for k in range(64):
        cache.add(places, truth)
        wrong = np.abs(cache.read(places)[:, 0] - truth) > 0.05
        if k in (0, 63):
            reached.append(np.abs(position[wrong, 0] - 0.32).max())
    assert reached[0] < 0.65 and reached[1] < 0.07


# ---- far from the origin ----


@pytest.mark.parametrize(("away", "bound"), [(1e3, 0.02), (1e4, 0.03)])
def test_ten_kilometres_from_the_origin(away, bound):
    near, normal = floor()
    truth = 0.5 + 0.4 * np.sin(8 * near[:, 0])
    usual = settle(Cache(slots=1 << 15), near, normal, truth)
    far, _ = floor(origin=(away, -away))
    found = settle(Cache(slots=1 << 15), far, normal, truth)
    assert np.sqrt(((found - truth) ** 2).mean()) < np.sqrt(((usual - truth) ** 2).mean()) + bound


@pytest.mark.parametrize("away", [1e5, 1e8])
def test_farther_away_float64_positions_are_as_good(away):
    near, normal = floor()
    truth = 0.5 + 0.4 * np.sin(8 * near[:, 0])
    usual = settle(Cache(slots=1 << 15), near, normal, truth)
    far, _ = floor(origin=(away, -away), dtype=np.float64)
    found = settle(Cache(slots=1 << 15), far, normal, truth)
    assert np.sqrt(((found - truth) ** 2).mean()) < np.sqrt(((usual - truth) ** 2).mean()) + 0.005


def test_places_far_apart_share_no_entries():
    # where 32-bit words of the thesis's method would begin again, and around
    cache = Cache(slots=1 << 15)
    normal = None
    for k, away in enumerate([0.0, 2.0**12, 2.0**20, 2.0**21, 2.0**31, 2.0**32, -(2.0**32), 2.0**40]):
        position, normal = floor(origin=(away, 0), side=16, dtype=np.float64)
        before = cache.entries
        found = cache.frame(position, normal, None, 0.01, np.full(256, k, np.float32))
        assert np.allclose(found, k, rtol=1e-4)
        assert cache.entries - before > 100


def test_the_thesis_s_words_overflow_and_say_so():
    position, normal = floor(origin=(1e7, 0), side=8)
    cache = OnePointCache(points=ImplicitPoints(coarsest=16.0, levels=16, bits=32), slots=1 << 12)
    with pytest.raises(ValueError, match="64-bit"):
        cache.look_up(position, normal, None, 0.01)
    cache = OnePointCache(points=ImplicitPoints(coarsest=16.0, levels=16, bits=64), slots=1 << 12)
    assert np.allclose(cache.frame(position, normal, None, 0.01, np.ones(64)), 1, atol=1e-3)


# ---- a full table ----


def test_a_table_too_small_for_the_picture():
    position, normal = floor(side=96)
    truth = (0.5 + 0.4 * np.sin(8 * position[:, 0])).astype(np.float32)
    roomy = settle(Cache(slots=1 << 16), position, normal, truth)
    # a third of the entries that the picture wants
    wanted = Cache(slots=1 << 16)
    wanted.look_up(position, normal, None, 0.01)
    small = Cache(slots=1 << int(np.log2(wanted.entries)))
    found = settle(small, position, normal, truth)
    assert small.occupancy <= 0.5
    assert np.isfinite(found).all()
    errors = [np.sqrt(((image - truth) ** 2).mean()) for image in (roomy, found)]
    assert errors[1] < 4 * errors[0] + 0.02
    # what found no entry at all shows its own sample, no hole
    value = noisy(truth, 99)
    tiny = Cache(slots=64)
    assert ((tiny.frame(position, normal, None, 0.01, value)[:, 0] > 0) | (value == 0)).mean() > 0.99


def test_a_full_table_forgets_where_the_camera_was():
    cache = Cache(slots=1 << 13)
    for k in range(12):
        position, normal = floor(origin=(0.6 * k, 0), side=48)
        found = settle(cache, position, normal, np.full(len(position), 0.5), 4)
        assert abs(found.mean() - 0.5) < 0.05 and found.std() < 0.1
    assert cache.occupancy <= 0.5
    old = cache.look_up(*floor(side=48), None, 0.01, create=False)
    assert cache.known(old).max() == 0


def test_places_that_were_forgotten_do_no_harm():
    cache = Cache(slots=1 << 13)
    position, normal = floor(side=32)
    kept = cache.look_up(position, normal, None, 0.01)
    cache.add(kept, np.ones(1024))
    assert cache.holds(kept)
    for k in range(1, 20):
        cache.frame(*floor(origin=(5.0 * k, 0), side=32), None, 0.01, np.zeros(1024))
    assert not cache.holds(kept)
    # neither do they write into others' entries nor read from them
    there = cache.look_up(*floor(origin=(95.0, 0), side=32), None, 0.01)
    cache.add(kept, np.full(1024, 7.0))
    assert (cache.read(there) == 0).all()
    assert (cache.read(kept, 3.0) == 3).all()


# ---- collisions of keys ----


def test_keys_of_neighbours_differ():
    # linear keys: no difference of cells within a million vanishes
    random = np.random.default_rng(0)
    cell = random.integers(-(10**6), 10**6, (3, 40_000))
    level, surface = random.integers(-12, 12, 40_000), random.integers(0, 4, 40_000).astype(np.uint64)
    keys = key_module.lattice_keys(cell, level, surface)
    names = set(zip(*cell.tolist(), level.tolist(), surface.tolist(), strict=True))
    assert len(np.unique(keys)) == len(names)
    # and what the table compares, a home and a tag, scatters like chance: no pair in this many
    scattered = key_module.mix(keys)
    assert len(np.unique(scattered)) == len(names)
    homes = np.bincount((scattered >> np.uint64(32)).astype(np.int64) & 1023, minlength=1024)
    assert abs(homes.var() / homes.mean() - 1) < 0.2


def test_a_hash_that_always_collides_only_costs_time(monkeypatch):
    # all keys begin at one of 8 slots
    from lightpanes.core.implicit_cache import table

    monkeypatch.setattr(table, "mix", lambda keys: key_module.mix(keys) & np.uint64((7 << 32) | 0xFFFFFFFF))
    position, normal = floor(side=8)
    truth = np.linspace(0.2, 0.8, 64).astype(np.float32)
    found = settle(Cache(slots=1 << 10, coarse=None), position, normal, truth, 200)
    # searches are bounded, so most corners are lost: what is left still tells the light
    assert np.isfinite(found).all() and np.sqrt(((found - truth) ** 2).mean()) < 0.25


# ---- changing level ----


def test_coming_nearer_does_not_begin_anew():
    position, normal = floor()
    truth = 0.5 + 0.3 * np.sin(8 * position[:, 0])
    cache = Cache(slots=1 << 16)
    settle(cache, position, normal, truth, 64, footprint=0.02)
    near = cache.frame(position, normal, None, 0.01, noisy(truth, 1))[:, 0]
    fresh = Cache(slots=1 << 16).frame(position, normal, None, 0.01, noisy(truth, 1))[:, 0]
    errors = [np.sqrt(((image - truth) ** 2).mean()) for image in (near, fresh)]
    assert errors[0] < 0.05 and errors[0] < 0.75 * errors[1]


def test_going_away_does_not_begin_anew():
    position, normal = floor()
    truth = 0.5 + 0.3 * np.sin(8 * position[:, 0])
    cache = Cache(slots=1 << 16)
    settle(cache, position, normal, truth, 64, footprint=0.01)
    # two octaves: fine cells are now as large as coarse ones were
    far = cache.frame(position, normal, None, 0.04, noisy(truth, 1))[:, 0]
    # between a first frame there and having been there all the time
    there = settle(Cache(slots=1 << 16), position, normal, truth, 64, footprint=0.04)
    fresh = Cache(slots=1 << 16).frame(position, normal, None, 0.04, noisy(truth, 1))[:, 0]
    errors = [np.sqrt(((image - truth) ** 2).mean()) for image in (far, fresh, there)]
    assert errors[0] < 0.9 * errors[1] and errors[0] < errors[2] + 0.025


def test_levels_side_by_side_show_no_edge():
    # footprints grow along the floor, through three levels
    position, normal = floor(side=128)
    truth = np.full(len(position), 0.5)
    footprint = (0.005 * 8.0 ** (position[:, 0] / position[:, 0].max())).astype(np.float32)
    found = settle(Cache(slots=1 << 16), position, normal, truth, 64, footprint=footprint).reshape(128, 128)
    columns = found.mean(axis=0)
    assert np.abs(columns - 0.5).max() < 0.02
    assert np.abs(np.diff(columns)).max() < 0.015


def test_footprints_of_nothing_and_of_no_end():
    position, normal = floor(side=8)
    footprint = np.tile(np.float32([0, np.inf, np.nan, 1e-30, 1e30, 0.01, 1e-3, 1]), 8)
    found = Cache(slots=1 << 14).frame(position, normal, None, footprint, np.full(64, 0.5))
    assert np.allclose(found, 0.5, atol=1e-3)
