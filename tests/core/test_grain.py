"""The gather's grain is smoothed away, the light's own shape is not."""

import numpy as np
import pytest
from lightpanes.core.bake import bake
from lightpanes.core.panes.exits import STEPS, joined, smooth_panes
from lightpanes.core.scene import Material
from lightpanes.core.surface import make_texels

from .shapes import box, quad, quick, scene

SIDE = 48


@pytest.fixture(scope="module")
def sheet():
    """An even sheet's texels, their place (t, 2) in the atlas, and which are two texels from its border at least."""
    texels = make_texels(scene((*quad((0, 0, 0), (1, 0, 0), (0, 1, 0)), 0)), SIDE)
    middle = np.zeros((SIDE, SIDE), bool)
    middle.reshape(-1)[texels.index[texels.centred]] = True
    for _ in range(2):
        padded = np.pad(middle, 1)
        middle = middle & np.all([padded[1 + y : SIDE + 1 + y, 1 + x : SIDE + 1 + x] for y, x in STEPS], axis=0)
    place = np.stack([texels.index % SIDE, texels.index // SIDE], 1) / SIDE
    return texels, place, middle.reshape(-1)[texels.index]


def smoothed(texels, rows, starts=None):
    starts = np.array([0, len(texels)]) if starts is None else starts
    return smooth_panes(rows.astype(np.float32), texels, starts, joined(texels))


def test_fields_up_to_the_third_degree_stay(sheet):
    texels, place, middle = sheet
    x, y = place.T
    fields = np.stack([np.ones_like(x), x - y, x * y, x**2, 2 * y**2 - x, x**3 - x * y**2, y**3], 1)
    found = smoothed(texels, fields)
    assert np.abs(found - fields)[middle].max() < 2e-5


def test_a_peak_a_few_texels_wide_is_hardly_dimmed(sheet):
    texels, place, _ = sheet
    for wide, loss in ((3, 0.02), (5, 0.003)):
        peak = np.exp(-((place - 0.5) ** 2).sum(axis=1) / 2 / (wide / SIDE) ** 2)[:, None]
        assert smoothed(texels, peak).max() > (1 - loss) * peak.max()


def test_a_quarter_of_the_noise_stays(sheet):
    texels, _, middle = sheet
    noise = np.random.default_rng(3).normal(size=(len(texels), 64))
    # of (2 s − s²)², s the binomial mean's answer to waves of all directions: 4 · 9/64 − 4 · 25/256 + 35²/128²
    assert (smoothed(texels, noise)[middle] ** 2).mean() == pytest.approx(0.2466, rel=0.02)


def test_an_even_field_stays_even_to_its_border(sheet):
    texels, _, _ = sheet
    assert np.abs(smoothed(texels, np.full((len(texels), 2), 3.0)) - 3).max() < 1e-6


def test_regions_do_not_mix(sheet):
    texels, _, _ = sheet
    half = len(texels) // 2
    rows = np.where(np.arange(len(texels)) < half, 1.0, 100.0)[:, None]
    found = smoothed(texels, rows, np.array([0, half, len(texels)]))
    assert np.abs(found / rows - 1).max() < 1e-6


def test_light_seen_at_first_is_never_negative():
    """A small glowing block lights a room with an edge to its light, beside which smoothing undershoots."""
    glow = Material("Glow", (0.5,) * 3, emission=(20.0,) * 3)
    parts = (*box((0, 0, 0), (4, 3, 2.5), True), 0), (*box((1.9, 1.4, 0), (2.1, 1.6, 0.1)), 1)
    shade = (*box((1, 0.6, 0.3), (3, 2.4, 0.35)), 0)
    made = scene(*parts, shade, materials=(Material("Wall"), glow))
    baked = bake(made, quick(entries=200, regions=8, exit_rays=32, exits="texels"))
    assert baked.direct.min() == 0 < baked.direct.max()
