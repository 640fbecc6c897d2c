"""Lamps that pass where panes are bad: a small version of `make bench ONLY=sweeps`, with bounds."""

import numpy as np
import pytest

from ..bench import sweeps
from .shapes import quick

FRAMES = 16

BOUNDS = {
    "surface at 1 cm": (0.3, 0.04),
    "an occluder's edge": (0.08, 0.004),
    "a door": (0.08, 0.008),
    "a wall": (0.1, 0.02),
}
"""Median error of the frames; flicker, at most."""


@pytest.fixture(scope="module")
def rooms():
    settings = quick(entries=900, lamps=400, regions=64, exits="texels", error_target=0.1)
    truth = quick(entries=2400, lamps=50, exits="texels")
    return sweeps.Sweeps(sweeps.rooms(), settings, truth, 192)


@pytest.mark.parametrize("name", BOUNDS)
def test_error_and_flicker_are_bounded(rooms, name):
    found = rooms.sweep(name, FRAMES)
    error, flicker = BOUNDS[name]
    ours = found.errors["eigenpanes"]
    assert np.nanmedian(ours) < error
    assert found.flicker["eigenpanes"] < flicker
    # where the lamp is in the wall the truth is black: the detector says so, there alone
    assert [bool(one.nowhere) for one in found.trusts] == np.isnan(ours).tolist()
    assert np.isnan(ours).any() == (name == "a wall")
