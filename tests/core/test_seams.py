"""Nothing shows where charts meet, nor where regions with panes of their own do."""

from functools import cache

import numpy as np
import pytest
from lightpanes.core.bake import bake

from .shapes import bilinear, box, globe, lamp, quick, relighter, scene

LAMPS = [lamp((0.3, 0.2, 0.4)), lamp((-0.5, -0.1, -0.2)), lamp((0.75, 0.0, 0.3))]


@cache
def ball():
    made = scene((*globe(), 0), lights=[lamp((0, 0, 0))])
    return made, bake(made, quick(resolution=96, entries=1200, regions=48, lamps=600, exit_rays=192))


@cache
def hall():
    made = scene((*box((0, 0, 0), (4, 3, 2.5), True), 0), lights=[lamp((3, 1.5, 2))])
    return made, bake(made, quick(resolution=128, entries=1500, regions=48, lamps=600, exit_rays=192))


@pytest.mark.parametrize("number", range(3))
def test_no_step_where_charts_meet_on_a_smooth_surface(number):
    made, baked = ball()
    image = relighter(made, baked).relight([LAMPS[number]])[..., :3].astype(float)
    # one meridian is the left and the right edge of the sphere's chart
    height = np.linspace(0.15, 0.85, 300)
    left = bilinear(image, np.stack([np.full(300, 0.02), height], 1)).mean(axis=1)
    right = bilinear(image, np.stack([np.full(300, 0.98), height], 1)).mean(axis=1)
    step = (left - right) / (0.5 * (left + right))
    assert np.abs(step).mean() < 0.02
    # single texels have grain as well; a step shows when neighbours share it, over four texels
    shown = np.abs(np.convolve(step, np.full(18, 1 / 18), "valid"))
    assert np.quantile(shown, 0.95) < 0.04


def across(image, table):
    """Relative jumps between neighbouring texels: of two regions, and of one. `table`: (H, W) region + 1, 0 for none."""
    apart, inside = [], []
    for axis in (0, 1):
        a, b = np.moveaxis(image, axis, 0)[:-1], np.moveaxis(image, axis, 0)[1:]
        first, second = np.moveaxis(table, axis, 0)[:-1], np.moveaxis(table, axis, 0)[1:]
        jump = np.abs(a - b) / np.maximum(0.5 * (a + b), 1e-9)
        both = (first > 0) & (second > 0)
        apart.append(jump[both & (first != second)])
        inside.append(jump[both & (first == second)])
    return np.concatenate(apart), np.concatenate(inside)


@pytest.mark.parametrize("light", [lamp((3, 1.5, 2)), lamp((0.4, 0.4, 1.2)), lamp((2, 1.5, 0.25))])
def test_region_borders_do_not_show(light):
    made, baked = hall()
    image = relighter(made, baked).relight([light])[..., 0].astype(float)
    apart, inside = across(image, baked.images["Lightpanes Interpolation"][1])
    assert len(apart) > 300
    # a border adds less than the grain and the gradient that are there anyway
    assert np.sqrt((apart**2).mean()) < 1.6 * np.sqrt((inside**2).mean())
    assert np.quantile(apart, 0.99) < 2 * np.quantile(inside, 0.99)


def test_grain_is_finer_than_the_eye():
    # an even ball: whatever varies is noise
    made, baked = ball()
    image = relighter(made, baked).relight([lamp((0, 0, 0))])[..., 0].astype(float)
    own = baked.images["Lightpanes Interpolation"][1] > 0
    assert np.std(image[own]) / image[own].mean() < 0.02
