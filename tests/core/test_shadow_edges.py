"""Entries at the edge of a shadow see a lamp from all their places: against the part of them that is lit."""

import numpy as np
import pytest
from lightpanes.core.bake.steps import prepare
from lightpanes.core.panes.entry_light import EntryLight
from lightpanes.core.panes.sharing import Sharing

from .shapes import lamp, quad, quick, scene
from .uncompressed import WHITISH

EDGE = 1.37
"""m along x, up to which the floor lies in shadow."""


class Counting:
    """A tracer that counts the shadow rays to lamps."""

    def __init__(self, tracer):
        self.tracer, self.rays = tracer, 0

    def __getattr__(self, name):
        return getattr(self.tracer, name)

    def visibility(self, origins, vectors):
        self.rays += len(origins)
        return self.tracer.visibility(origins, vectors)


def floor_below_a_sheet(height):
    floor, sheet = quad((0, 0, 0), (4, 0, 0), (0, 3, 0)), quad((EDGE, 0, height), (-2, 0, 0), (0, 3, 0))
    made = scene((*floor, 0), (*sheet, 0), materials=(WHITISH,), lights=[lamp((1, 1.5, 1.2))])
    ready = prepare(made, quick(entries=400, lamps=30, regions=4, panes=2))
    return EntryLight(ready.surface, Counting(ready.tracer))


@pytest.fixture(scope="module")
def looks():
    return floor_below_a_sheet(1.0)


def test_power_stays_where_an_edge_passes_below_a_lamp(monkeypatch):
    """What an entry at the edge gives to one that the lamp is near is not lost."""
    looks = floor_below_a_sheet(0.3)
    area = looks.surface.size.astype(float) ** 2 * looks.surface.left
    for away in (-0.1, 0.05, 0.2):
        light = lamp((EDGE + away, 1.5, 0.45), 1.0)
        shared = looks.unit(light)
        with monkeypatch.context() as patch:
            patch.setattr(Sharing, "share", lambda *given: None)
            plain = looks.unit(light)
        assert not np.array_equal(shared, plain)
        assert shared @ area == pytest.approx(plain @ area, rel=1e-5)


@pytest.fixture
def zenith(monkeypatch):
    monkeypatch.setattr(Sharing, "share", lambda *given: None)
    return lamp((0, 0, 5), 1.0, "SUN")


def lit_part(surface):
    """(n,) of each entry, by many places on its pieces; 0 of entries that lie elsewhere than on the floor."""
    side = 24
    i, j = (v[np.add(*np.indices((side, side))) < side] + 1 / 3 for v in np.indices((side, side)))
    weights = np.stack([side - i - j, i, j], 1) / side
    places = weights @ surface.pieces.astype(float)
    lit = ((places[..., 0] > EDGE) & (np.abs(places[..., 2]) < 0.01)).mean(axis=1)
    corners = surface.pieces
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    own = np.repeat(np.arange(len(surface)), surface.counts)
    return np.bincount(own, lit * area) / np.bincount(own, area)


def test_the_part_that_is_lit(looks, zenith, monkeypatch):
    truth = lit_part(looks.surface)
    crossed = (truth > 0.02) & (truth < 0.98)
    up = looks.surface.normal.reshape(len(truth), -1, 3)[:, 0, 2] > 0.9
    floor = up & (looks.surface.middle[:, 2] < 0.5)
    found = looks.unit(zenith)
    with monkeypatch.context() as patch:
        patch.setattr(EntryLight, "_edges", lambda *given: np.zeros(0, np.int64))
        before = looks.unit(zenith)
    assert crossed.sum() > 8
    off, was = (np.sqrt(((unit - truth)[crossed] ** 2).mean()) for unit in (found, before))
    # of sixteen places at random; of two it is a quarter and more
    assert off < 0.12 and was > 1.8 * off
    assert np.array_equal(found[floor & ~crossed], before[floor & ~crossed])
    area = looks.surface.size.astype(float) ** 2
    assert (found * area)[floor].sum() == pytest.approx((4 - EDGE) * 3, rel=0.01)


def test_edges_take_no_more_rays_than_all_entries_do(looks, zenith):
    """However many edges there are: a sun through leaves, say."""
    looks.unit(zenith)
    tracer, few = looks.tracer, len(looks.surface) * looks.few
    for made in (zenith, lamp((2, 1.5, 0.6))):
        tracer.rays = 0
        looks.unit(made)
        assert 0 < tracer.rays
    lit = np.arange(len(looks.surface)) % 2 / 2
    tracer.rays = 0
    found = np.zeros(len(lit), np.float32)
    looks._across(zenith, np.arange(len(lit)), lit, found, np.zeros((len(lit), 3)))
    assert tracer.rays == 0 and not found.any()
    some = np.arange(0, len(lit), 3)
    looks._across(zenith, some, lit, found, np.zeros((len(lit), 3)))
    assert 0 < tracer.rays <= few
