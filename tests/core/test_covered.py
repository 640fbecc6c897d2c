"""Texels that something lies on, closer than they are wide, borrow their neighbours' light."""

import numpy as np
import pytest
from lightpanes.core.bake import bake
from lightpanes.core.rays import Tracer
from lightpanes.core.surface import make_texels
from lightpanes.core.transfer.covered import covered

from .caustic_scenes import MIRROR, floor, glass, panel, staged
from .shapes import GREY, box, lamp, quick, relighter, scene

RESOLUTION = 64
TEXEL = 2.0 / 0.9 / RESOLUTION  # m, of the floor


def found(*plates, materials=(GREY, MIRROR)):
    """(n, 3) places on the floor and which of them are covered."""
    made = staged(floor(), *plates, materials=materials)
    texels = make_texels(made, RESOLUTION)
    return texels.samples.position, covered(made, texels, Tracer(made), 0)


def plate(height, material=1):
    return panel((-0.5, -0.5, height), (0, 1, 0), (1, 0, 0), material)


def test_under_a_plate():
    place, hidden = found(plate(0.1 * TEXEL))
    inside = np.abs(place[:, :2]).max(axis=1)
    assert hidden[inside < 0.5 - 0.5 * TEXEL].all() and not hidden[inside > 0.5].any()


@pytest.mark.parametrize("plates", [(), (plate(2 * TEXEL),)], ids=["none", "above"])
def test_in_the_open(plates):
    assert not found(*plates)[1].any()


def test_what_lies_under_glass_is_seen():
    assert not found(plate(0.1 * TEXEL), materials=(GREY, glass()))[1].any()


@pytest.mark.usefixtures("frugal")
def test_a_thin_plate_on_the_floor_leaves_no_dark_texels_beside_it():
    """Its own light there is next to none; what is shown is that of the floor around it, or of its top's edge."""
    walls, things = box((0, 0, 0), (2, 2, 2), inward=True), box((0.6, 0.6, 0.002), (1.4, 1.4, 0.05))
    made = scene((*walls, 0), (*things, 0), lights=[lamp((0.4, 0.4, 1.2))])
    result = bake(made, quick(resolution=96))
    assert result.report["buried_texels"] > 50
    texels = make_texels(made, 96)
    light = relighter(made, result).relight(made.lights)[..., :3].reshape(-1, 3)[texels.index].mean(axis=1)
    place, up = texels.samples.position, texels.samples.normal[:, 2]
    own_floor = (place[:, 2] < 1e-3) & (up > 0.9)
    under = own_floor & (np.abs(place[:, :2] - 1).max(axis=1) < 0.37)
    beside = own_floor & (np.abs(place[:, :2] - 1).max(axis=1) > 0.45)
    assert under.sum() > 30
    assert light[under].min() > 0.4 * light[beside].mean()


@pytest.mark.usefixtures("frugal")
def test_points_neither_serve_nor_judge_what_is_covered():
    """A rug that is lit from above, and the floor under it, which is as bright to points beside it as it is dark to Cycles."""
    walls, rug = box((0, 0, 0), (2, 2, 2), inward=True), box((0.5, 0.5, 0.002), (1.5, 1.5, 0.02))
    made = scene((*walls, 0), (*rug, 0), lights=[lamp((0.4, 0.4, 1.2))])
    by_texels, by_points = (bake(made, quick(resolution=96, exits=exits)) for exits in ("texels", "points"))
    texels = make_texels(made, 96)
    place = texels.samples.position
    under = (place[:, 2] < 1e-3) & (np.abs(place[:, :2] - 1).max(axis=1) < 0.47) & (texels.samples.normal[:, 2] > 0.9)
    assert under.sum() > 40
    for result in (by_texels, by_points):
        assert not result.own.reshape(-1)[texels.index[under]].any()
    assert by_points.report["buried_texels"] == pytest.approx(by_texels.report["buried_texels"], rel=0.2)
