"""How samples are shared out among lattice points, against sums in float64 over all pairs of both."""

import numpy as np
import pytest
from lightpanes.core.implicit_cache.keys import PARTS, mix, parts_of
from lightpanes.core.implicit_cache.lattice import share_points, share_samples
from lightpanes.core.implicit_cache.levels import cell_size
from lightpanes.core.implicit_cache.shares import GROUP, grouped


def samples(count, seed=0):
    """Along a few lines, so that neighbours share cells; on two surfaces and levels."""
    random = np.random.default_rng(seed)
    along = np.linspace(0, 1, count)
    position = random.normal(size=(3, 1)) + along * random.normal(size=(3, 1)) + 0.01 * random.normal(size=(3, count))
    level = random.integers(-4, -2, count).astype(np.int32)
    return position.astype(np.float32), level, (along > 0.4).astype(np.uint64)


def hats(place, level, surface, points):
    """(m, n) float64: what each of m lattice points weighs at places (3, n), m: a product of hats, each as wide as a cell to
    both sides, for points of the wanted level (n,) and surface (n,)."""
    size = cell_size(points.level).astype(float)[:, None]
    away = np.abs(place[:, None].astype(float) / size - (points.cell[..., None] + 0.5))
    alike = (points.level[:, None] == level) & (points.surface[:, None] == surface)
    return np.clip(1 - away, 0, None).prod(axis=0) * alike


def compare(shares, weights):
    entries, count = weights.shape
    assert shares.entries == entries and len(shares.place) == count
    random = np.random.default_rng(1)
    value, known = (random.normal(size=(2, k)).astype(np.float32) for k in (count, entries))
    assert np.allclose(shares.weights(), weights.sum(axis=1), atol=1e-3)
    assert np.allclose(shares.sums(value), value.astype(float) @ weights.T, atol=2e-3)
    assert np.allclose(shares.mixtures(known), known.astype(float) @ weights, atol=1e-3)


@pytest.mark.parametrize("count", [0, 1, 2, 300])
def test_samples_and_points_among_those_of_lattices(count):
    position, level, tags = samples(count)
    shares, points = share_samples(position, level, tags)
    compare(shares, hats(position, level, mix(tags), points))
    for octaves in (2, 1, 3):
        at = (points.cell + 0.5) * cell_size(points.level)
        wider = points.level + octaves
        shares, coarse = share_points(points, octaves)
        weights = hats(at, wider, points.surface, coarse)
        compare(shares, weights)
        if count:
            assert np.array_equal(shares.nearest_entries(), weights.argmax(axis=0))
        points = coarse


def test_points_stand_by_parts():
    shares, points = share_samples(*samples(300))
    part = parts_of(points.key)
    assert len(np.unique(part)) == PARTS
    for k in range(PARTS):
        assert (part[shares.part(k)] == k).all()
    assert shares.bounds[-1] == len(part) == len(np.unique(points.key))


@pytest.mark.parametrize("cells", [1, 7, 70_000])
def test_groups_hold_each_sample_once_and_only_such_of_one_cell(cells):
    random = np.random.default_rng(cells)
    cell = random.permutation(np.concatenate([np.arange(cells), random.integers(0, cells, 3 * cells)]))
    sample, place, owner, filled = grouped(cell, cells)
    assert np.array_equal(sample.reshape(-1)[place], np.arange(len(cell)))
    assert len(np.unique(place)) == len(cell)
    assert (cell[sample] == owner).all()
    assert np.array_equal(np.flatnonzero(filled), np.sort(place))
    assert len(owner) == np.ceil(np.bincount(cell) / GROUP).sum()


def test_what_is_not_finite_stays_in_its_cell():
    position = np.float32([[0.1, 0.2, 5.1, 5.2], [0, 0, 0, 0], [0, 0, 0, 0]])
    shares, _ = share_samples(position, np.zeros(4, np.int32), np.zeros(4, np.uint64))
    sums = shares.sums(np.float32([[np.inf, 1, 2, 3]]))[0]
    far = shares.mixtures(np.isfinite(sums)[None].astype(np.float32))[0]
    assert np.allclose(far, [0, 0, 1, 1])
