"""Parts of a cancelled bake in files: the next one goes on from there, whatever happens to the files."""

import os
import pickle
import shutil
import time
from dataclasses import replace

import numpy as np
import pytest
from lightpanes.core import footprint
from lightpanes.core.bake import Bake, Cache, Cancelled, Kept, bake
from lightpanes.core.bake.cache import decode, encode
from lightpanes.core.files import replacing
from lightpanes.core.transfer import Begun, Links, Transport

from .shapes import quick
from .test_kept import cancel_at, long, made, plain, same, whole

pytestmark = pytest.mark.usefixtures("frugal")

KEY, NAME = bytes(range(16)), bytes(range(16, 32))
LIMIT = 10**9


@pytest.fixture
def cache(tmp_path):
    return Cache(tmp_path / "cache", LIMIT)


def files(cache):
    return sorted(path.name for path in cache.folder.iterdir()) if cache.folder.exists() else []


def cancelled(cache, settings, stage="Exits", part=0.02):
    """A bake that is cancelled in a process that ends then."""
    with pytest.raises(Cancelled):
        bake(made(), settings, cancel_at(stage, part, []), Kept(cache))


@pytest.fixture(scope="module")
def folder(frugal, tmp_path_factory):
    """What a cancelled bake leaves."""
    place = tmp_path_factory.mktemp("cancelled") / "cache"
    cancelled(Cache(place, LIMIT), quick())
    return place


@pytest.fixture
def left(cache, folder):
    """A cache of which a bake that was cancelled has left parts."""
    shutil.copytree(folder, cache.folder)
    return cache


@pytest.mark.parametrize("exits", ["texels", "points"])
def test_a_bake_goes_on_in_another_process(cache, exits):
    settings = long(exits)
    for stage, part in (("Transport", 0.01), ("Lamps", 0.01), ("Exits", 0.02), ("Exits", 0.02), ("Check", 0.0)):
        cancelled(cache, settings, stage, part)
    assert files(cache)
    seen, kept = [], Kept(cache)
    again = bake(made(), settings, lambda now: seen.append((now.stage, now.rays)), kept)
    assert same(whole(exits), again) and isinstance(again, Bake)
    assert seen[-1][1] < 0.4 * whole(exits).meta["report"]["rays"]
    # done, but perhaps not stored yet
    assert files(cache)
    kept.clear()
    assert not files(cache)


def test_a_bake_with_elements_goes_on_in_another_process(cache, monkeypatch):
    monkeypatch.setattr(footprint, "BALANCED", 150)
    settings = quick(entries=500)
    alone = bake(made(), settings)
    cancelled(cache, settings, "Lamps", 0.0)
    rays = []
    again = bake(made(), settings, lambda now: rays.append((now.stage, now.rays)), Kept(cache))
    assert same(alone, again)
    # neither the entries' transport nor their elements' was traced again
    assert max(count for stage, count in rays if stage == "Transport") == 0


def test_another_scene_or_other_settings_have_their_own(left):
    cache, before = left, files(left)
    assert same(bake(made(), quick(seed=3), kept=Kept(cache)), plain(3))
    assert files(cache) == before
    kept = Kept(cache)
    assert same(bake(made(), quick(), kept=kept), plain())
    kept.clear()
    assert not files(cache)


def test_without_a_cancel_nothing_is_written(cache):
    bake(made(), quick(), kept=Kept(cache))
    assert not files(cache)


def test_an_error_leaves_nothing(left):
    cache = left

    def fail(now):
        if now.stage == "Exits":
            raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        bake(made(), quick(), fail, Kept(cache))
    assert not files(cache)


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "text", "pickle", "others", "folder"])
def test_damaged_files_are_deleted_and_made_anew(left, damage):
    cache = left
    for place in cache.folder.iterdir():
        data = bytearray(place.read_bytes())
        if damage == "cut":
            place.write_bytes(data[: len(data) // 2])
        elif damage == "flipped":
            data[len(data) // 2] ^= 255
            place.write_bytes(data)
        elif damage == "empty":
            place.write_bytes(b"")
        elif damage == "text":
            place.write_text("not arrays")
        elif damage == "pickle":
            with open(place, "wb") as file:
                np.savez(file, array=np.array([Boom()], object))
        elif damage == "others":
            with open(place, "wb") as file:
                np.savez(file, between=np.zeros((3, 2)), rows=np.zeros(3), other=np.zeros(3))
        else:
            place.unlink()
            place.mkdir()
    assert same(bake(made(), quick(), kept=Kept(cache)), plain())
    assert damage == "folder" or not files(cache)


class Boom:
    """What runs when it is unpickled."""

    def __reduce__(self):
        return pytest.fail, ("a file was run",)


def test_no_file_is_ever_run(cache):
    cache.folder.mkdir()
    place = cache._place(KEY, NAME)
    place.write_bytes(pickle.dumps(Boom()))
    assert cache.load(KEY, NAME) is None and not place.exists()


def test_parts_of_another_size_count_for_nothing():
    begun = Begun(np.ones((3, 2), np.float32), {0})
    assert not begun.rows_of((4, 2)).any() and not begun.done


def test_what_arrays_are_made_of():
    rng = np.random.default_rng(0)
    for part in (rng.random((3, 4)).astype(np.float32), 0.25):
        assert np.array_equal(decode(encode(part)), part)
    transport = Transport(rng.random((4, 4)).astype(np.float32), rng.random((4, 2)).astype(np.float32))
    again = decode(encode(transport))
    assert np.array_equal(again.between, transport.between) and np.array_equal(again.sky, transport.sky)
    begun = decode(encode(Begun(np.ones((2, 3), np.float32), {0, 8192})))
    assert begun.done == {0, 8192} and begun.rows.shape == (2, 3)
    near = np.array([1, 0, 1], np.int32), np.ones(3, np.float32)
    links = Links(transport.between[:2, :2], np.ones(2, np.float32), np.array([0, 1, 3]), *near)
    again = decode(encode(links))
    assert all(
        np.array_equal(one, other) for one, other in zip(vars(links).values(), vars(again).values(), strict=True)
    )
    with pytest.raises(ValueError, match="not links"):
        decode(encode(replace(links, starts=np.array([0, 1, 2]))))
    for part in (Begun(), object(), "text", np.array([object()], object)):
        assert encode(part) is None


def test_the_least_recently_used_go_first(tmp_path):
    part = np.zeros(1000, np.float32)
    cache = Cache(tmp_path, 3 * 4600)
    other = tmp_path / "lightpanes-notes.npz"
    other.write_bytes(bytes(100_000))
    keys = [bytes([k] * 16) for k in range(4)]
    for age, key in enumerate(keys[:3]):
        assert cache.save(key, NAME, part)
        stamp = time.time() - 100 + age
        os.utime(cache._place(key, NAME), (stamp, stamp))
    assert cache.load(keys[0], NAME) is not None
    assert cache.save(keys[3], NAME, part)
    assert [cache.load(key, NAME) is not None for key in keys] == [True, False, True, True]
    # what is too large for all of it drives nothing out
    assert not cache.save(KEY, NAME, np.zeros(10_000, np.float32))
    assert len(files(cache)) == 4 and other.exists()


def test_what_a_crash_left_is_deleted(cache):
    cache.save(KEY, NAME, np.zeros(3))
    with replacing(cache._place(KEY, NAME)) as old:
        old.touch()
    fresh = old.with_stem(f"{old.stem}0")
    for place in (old, fresh):
        place.write_bytes(b"half")
    os.utime(old, (0, 0))
    cache.trim()
    assert not old.exists() and fresh.exists()


def test_where_no_file_can_be_written(tmp_path):
    (tmp_path / "cache").write_text("in the way")
    cache = Cache(tmp_path / "cache", LIMIT)
    assert not cache.save(KEY, NAME, np.zeros(3)) and cache.load(KEY, NAME) is None
    cache.forget(KEY)
    cancelled(cache, quick())
    assert same(bake(made(), quick(), kept=Kept(cache)), plain())


def test_writing_that_fails_leaves_the_old_file(cache, monkeypatch):
    cache.save(KEY, NAME, np.ones(3))

    def full(file, **_):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    assert not cache.save(KEY, NAME, np.zeros(3))
    assert np.array_equal(cache.load(KEY, NAME), np.ones(3)) and len(files(cache)) == 1
