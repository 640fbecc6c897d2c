"""The cache's table against a dictionary."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lightpanes.core.implicit_cache.keys import mix
from lightpanes.core.implicit_cache.probing import EMPTY, PROBES, claim, find
from lightpanes.core.implicit_cache.table import CLOCK, FULL, KEPT, MOST, STEP, TICKS, Table


def keys_of(numbers) -> np.ndarray:
    """Keys that lie anywhere in the table."""
    return mix(np.asarray(numbers, np.uint64) + np.uint64(1 << 40))


def fill(table: Table, numbers) -> np.ndarray:
    """Insert what is missing; slots of all."""
    keys = keys_of(numbers)
    slot = table.find(keys)
    new = np.flatnonzero(slot == table.nowhere)
    slot[new] = table.insert(keys[new])
    return slot


@settings(max_examples=30, deadline=None)
@given(st.lists(st.lists(st.integers(0, 60), min_size=1, max_size=20, unique=True), min_size=1, max_size=12))
def test_it_holds_what_a_dictionary_holds(rounds):
    # never more than the table has room for, so nothing is forgotten
    table, truth = Table(2, 256), {}
    for k, numbers in enumerate(rounds):
        slot = fill(table, numbers)
        assert len(set(slot)) == len(slot)
        table.put(slot, np.stack([np.array(numbers, float), np.full(len(numbers), k)]), np.full(len(numbers), k + 1.0))
        table.tick()
        truth |= {n: (n, k, k + 1) for n in numbers}
        everything = sorted(truth)
        slot = table.find(keys_of(everything))
        held = np.vstack([table.mean[:, slot], table.counts(slot)])
        assert np.array_equal(held.T, [truth[n] for n in everything])
        assert table.used == len(truth)
        assert (table.find(keys_of(range(1000, 1040))) == table.nowhere).all()


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 7), st.integers(2, 2**32 - 1)), max_size=20, unique_by=lambda k: k[1]),
    st.integers(1, 20),
)
def test_keys_that_begin_at_one_slot_get_slots_of_their_own(wanted, parts):
    tags, truth = np.zeros(64, np.uint32), {}
    for part in np.array_split(np.array(wanted, np.int64).reshape(-1, 2), parts):
        home, tag = part[:, 0].astype(np.int32), part[:, 1].astype(np.uint32)
        slot = claim(tags, home, tag)
        assert (slot >= 0).all()
        truth |= dict(zip(tag.tolist(), slot.tolist(), strict=True))
    assert len(set(truth.values())) == len(truth)
    for home, tag in wanted:
        assert find(tags, np.array([home], np.int32), np.array([tag], np.uint32))[0] == truth[tag]
    assert np.count_nonzero(tags) == len(truth)


def test_a_search_goes_round_the_end_and_ends_at_empty_slots():
    tags = np.zeros(64, np.uint32)
    home = np.full(4, 62, np.int32)
    tag = np.array([10, 11, 12, 13], np.uint32)
    slot = claim(tags, home, tag)
    assert sorted(slot) == [0, 1, 62, 63]
    assert np.array_equal(find(tags, home, tag), slot)
    tags[62] = EMPTY
    assert (find(tags, home, tag) == -1).all()


def test_no_search_is_longer_than_it_may_be():
    tags = np.zeros(256, np.uint32)
    slot = claim(tags, np.zeros(100, np.int32), np.arange(2, 102, dtype=np.uint32))
    assert np.count_nonzero(slot >= 0) == PROBES


def test_a_full_table_forgets_what_was_not_seen_for_longest():
    table = Table(1, 1024)
    limit = int(FULL * 1024)
    part = limit // 4
    for k in range(4):
        slot = fill(table, range(part * k, part * k + part))
        table.put(slot, np.full((1, part), k), np.ones(part))
        for _ in range(TICKS):
            table.tick()
    assert table.used == 4 * part
    # the second part is seen again
    table.touch(fill(table, range(part, 2 * part)))
    for _ in range(TICKS):
        table.tick()
    slot = fill(table, range(1000, 1000 + part))
    assert (slot != table.nowhere).all()
    assert table.used <= limit
    there = table.find(keys_of(range(4 * part))) != table.nowhere
    kept = there.reshape(4, part).sum(axis=1)
    gone = 4 * part - int(KEPT * limit)
    assert np.array_equal(kept, [0, part, 2 * part - gone, part])
    # what stays is still itself
    assert (table.mean[0, table.find(keys_of(range(part, 2 * part)))] == 1).all()
    assert (table.mean[0, slot] == 0).all() and (table.counts(slot) == 0).all()


def test_a_table_full_of_what_is_seen_now_takes_no_more():
    table = Table(1, 1024)
    limit = int(FULL * 1024)
    slot = fill(table, range(2000))
    assert np.count_nonzero(slot != table.nowhere) == limit == table.used
    again = fill(table, range(2000, 2100))
    assert (again == table.nowhere).all()
    # nowhere holds nothing, whatever is put there
    table.put(again, np.ones((1, 100)), np.ones(100))
    assert table.counts(np.array([table.nowhere]))[0] == 0


def test_forgetting_again_and_again_keeps_what_is_left_in_order():
    table = Table(1, 1 << 12)
    for k in range(150):
        slot = fill(table, range(300 * k, 300 * k + 300))
        assert (slot != table.nowhere).all()
        table.put(slot, np.full((1, 300), k), np.full(300, 2.0))
        for _ in range(TICKS):
            table.tick()
    assert table.used == np.count_nonzero(table.tag)
    # every entry is found from its home, and by its key, and is its own
    held = np.flatnonzero(table.tag[:-1])
    assert np.array_equal(find(table.tag[:-1], table.homes(held), table.tag[held]), held)
    slot = table.find(keys_of(range(149 * 300, 150 * 300)))
    assert (table.mean[0, slot] == 149).all() and (table.counts(slot) == 2).all()
    every = table.find(keys_of(range(150 * 300)))
    there = every != table.nowhere
    assert there.sum() == table.used
    assert np.array_equal(table.mean[0, every[there]], np.flatnonzero(there) // 300)
    # the latest are those that are left
    assert np.flatnonzero(there).min() > 140 * 300


def test_the_clock_does_not_make_old_entries_young():
    table = Table(1, 1 << 10)
    old = fill(table, range(50))
    table.put(old, np.ones((1, 50)), np.full(50, 7.0))
    for k in range(2 * CLOCK * TICKS):
        table.tick()
        if k % 100 == 0:
            young = fill(table, range(100, 150))
            table.touch(young)
    fill(table, range(1000, 1000 + int(FULL * 1024) - 60))
    assert (table.find(keys_of(range(50))) == table.nowhere).sum() >= 40
    assert (table.find(keys_of(range(100, 150))) != table.nowhere).all()


@given(st.lists(st.floats(0, 2 * MOST), min_size=1, max_size=20), st.floats(0, 50), st.floats(0, 1))
@settings(max_examples=30, deadline=None)
def test_counts_round_to_their_unit(counts, most, factor):
    table = Table(1, 64)
    slot = fill(table, range(len(counts)))
    table.put(slot, np.zeros((1, len(counts))), np.array(counts, np.float32))
    held = table.counts(slot)
    wanted = np.minimum(np.array(counts, np.float32), np.float32(MOST))
    assert (np.abs(held - wanted) <= STEP).all()
    # some is never none
    assert ((held > 0) == (wanted > 0)).all()
    table.scale_counts(factor)
    assert (np.abs(table.counts(slot) - held * factor) <= STEP + 1e-3 * held).all()
    held = table.counts(slot)
    table.limit_counts(most)
    assert (table.counts(slot) <= most).all()
    assert (np.abs(table.counts(slot) - np.minimum(held, most)) <= STEP).all()


@pytest.mark.parametrize("slots", [0, 1000, 32])
def test_a_table_of_no_power_of_two_is_refused(slots):
    with pytest.raises(ValueError, match="power of two"):
        Table(1, slots)
