"""Borders across patches, where light of one way ends: against shapes whose measure is known, and the ledger of light."""

import numpy as np
import pytest
from lightpanes.core.caustics import CausticAtlas
from lightpanes.core.caustics.borders import sharpen
from lightpanes.core.caustics.deposit import deposit
from lightpanes.core.caustics.quadtree import Forest, Photons

from .caustic_scenes import ball, floor, glass, staged
from .shapes import GREY, lamp

SIZE = 64


class Blank:
    """An atlas that is one chart."""

    resolution = SIZE
    inner = np.ones(SIZE * SIZE, bool)


def forest(lit, level: int = 3) -> Forest:
    """1 W/m² that falls straight onto the atlas through a stencil: lit (x, y) → bool or number of the way, 0 for none."""

    def trace(tree, s, t):
        way = np.asarray(lit(s, t), int)
        power = np.where(way > 0, np.float32(1), np.float32(0))
        place = np.stack([0.1 + 0.8 * s, 0.1 + 0.8 * t], 1).astype(np.float32) * SIZE
        blank = np.zeros((len(s), 1), np.float32)
        return Photons(place, power[:, None], power, np.where(way > 0, 2 * way + 1, 0).astype(np.int32),
                       (way > 0).astype(np.int32), blank)  # fmt: skip

    return Forest(trace, np.array([level]))


def spread(made: Forest) -> np.ndarray:
    return deposit(made, np.arange(len(made)), Blank(), 8.0)[:, 0].reshape(SIZE, SIZE)


def test_bisection_halves_the_error_of_a_border():
    """Half planes at all angles and places: how much of the square each lights, with and without photons between."""
    errors = {True: [], False: []}
    for k in range(40):
        turn, away = 2.4 * k, 0.1 * np.sin(3.7 * k)

        def lit(s, t, turn=turn, away=away):
            return (s - 0.5) * np.cos(turn) + (t - 0.5) * np.sin(turn) < away

        fine = (np.arange(1000) + 0.5) / 1000
        expected = lit(*np.meshgrid(fine, fine)).mean()
        for found in (False, True):
            made = forest(lit)
            before = len(made.photons)
            if found:
                assert sharpen(made, 1000)
                assert len(made.photons) < before + 60
                assert not sharpen(made, 1000)
            errors[found].append(spread(made).sum() / expected - 1)
    assert np.sqrt(np.square(errors[True]).mean()) < 0.6 * np.sqrt(np.square(errors[False]).mean()) < 0.01
    assert abs(np.mean(errors[True])) < 0.002


def test_a_border_is_straight_and_its_sides_are_full():
    """No steps of the photons' grid: each texel has the part of it that is lit."""
    made = forest(lambda s, t: s + 0.37 * t < 0.61)
    sharpen(made, 1000)
    found = spread(made)
    fine = ((np.arange(8 * SIZE) + 0.5) / (8 * SIZE) - 0.1) / 0.8
    x, y = np.meshgrid(fine, fine)
    lit = (x > 0) & (x < 1) & (y > 0) & (y < 1) & (x + 0.37 * y < 0.61)
    expected = lit.reshape(SIZE, 8, SIZE, 8).mean(axis=(1, 3)) / (0.8 * SIZE) ** 2
    # the grid's step is 3.2 texels
    assert np.abs(found - expected).max() < 1.0 * expected.max()
    assert np.sqrt(((found - expected) ** 2).mean() / (expected**2).mean()) < 0.15


@pytest.mark.parametrize("ways", [2, 3, 7])
def test_many_ways_have_all_light_between_them(ways):
    """Stripes and chequers of ways that all land: the square is bright all over, bisected or not."""
    for step in (0.031, 0.11, 0.27):
        made = forest(lambda s, t, step=step: 1 + (np.floor(s / step) + 3 * np.floor(t / step)).astype(int) % ways)
        for _ in range(2):
            assert np.isclose(spread(made).sum(), 1, atol=0.02)
            sharpen(made, 1e6)


@pytest.mark.parametrize("photons", [10_000, 40_000])
def test_the_picture_holds_what_the_ledger_says_landed(photons):
    """A ball of 576 facets, each of them a way of its own."""
    light = lamp((0.6, 0.2, 2.5))
    name, p, t, _, _, material = ball((0, 0, 0.7), 0.4, 24)
    atlas = CausticAtlas(staged(floor(), (name, p, t, None, None, material), materials=(GREY, glass())), SIZE)
    atlas.image([light], photons)
    lit = atlas._lamps[light.geometry]
    power = deposit(lit._forest, np.arange(len(lit._forest)), atlas._receivers, 8.0)
    assert np.isclose(power.sum(), atlas.energy(light).landed, rtol=0.005)
