"""Caustics against closed forms: what mirrors and glass send to a floor, and where all of the light goes."""

import numpy as np
import pytest
from lightpanes.core.caustics import CausticAtlas, casters
from lightpanes.core.metrics import relative_rmse
from lightpanes.core.scene import SceneError

from .caustic_scenes import MIRROR, ball, floor, floor_places, glass, panel, staged
from .shapes import GREY, lamp, room

RESOLUTION = 128


def closed(energy):
    """What all parts of the light sum up to, over what was emitted."""
    parts = energy.landed + energy.absorbed + energy.escaped + energy.missed + energy.untraced
    return parts / energy.emitted


def within(mask, margin=2):
    """Texels of a mask that are more than `margin` from its border."""
    for axis in (0, 1):
        for step in range(-margin, margin + 1):
            mask = mask & np.roll(mask, step, axis)
    return mask


def test_a_flat_mirror_is_a_mirrored_lamp():
    # a mirror stands at x = 1 and faces back; its lamp's image is at x = 1.5
    light = lamp((0.5, 0.1, 1.2))
    mirror = panel((1, -0.8, 0.3), (0, 0, 1.2), (0, 1.6, 0))
    atlas = CausticAtlas(staged(floor(), mirror, lights=[light]), RESOLUTION)
    image = atlas.image([light])[..., 0]
    place, inside = floor_places(RESOLUTION)
    way = np.concatenate([place, np.zeros_like(place[..., :1])], -1) - (1.5, 0.1, 1.2)
    cut = (1 - 1.5) / way[..., 0]
    y, z = 0.1 + way[..., 1] * cut, 1.2 + way[..., 2] * cut
    through = (0 < cut) & (cut < 1) & (np.abs(y) < 0.8) & (0.3 < z) & (z < 1.5)
    far2 = (way**2).sum(-1)
    expected = np.where(through, 100 / (4 * np.pi * far2) * 1.2 / np.sqrt(far2), 0)
    assert relative_rmse(image, expected, within(inside) & (within(through) | within(~through))) < 0.005
    energy = atlas.energy(light)
    assert np.isclose(closed(energy), 1, atol=0.005) and energy.untraced < 1e-4


def test_all_light_of_a_glass_ball_is_accounted_for():
    light = lamp((0.6, 0.2, 2.5))
    atlas = CausticAtlas(staged(floor(), ball((0, 0, 0.7), 0.4), materials=(GREY, glass())), RESOLUTION)
    atlas.image([light])
    energy = atlas.energy(light)
    met = energy.emitted - energy.missed
    assert np.isclose(closed(energy), 1, atol=0.005) and energy.untraced < 0.02 * met
    assert np.isclose(atlas.landings(light).power.sum(axis=0)[0], energy.landed, rtol=1e-5)


def test_a_scene_without_mirrors_or_glass_has_no_casters():
    assert casters(room()) is None
    with pytest.raises(SceneError, match="no caustics"):
        CausticAtlas(room(), 32)
    assert casters(staged(floor(), ball((0, 0, 1), 0.3))).objects == ("Ball",)
    assert not casters(staged(floor(), ball((0, 0, 1), 0.3), materials=(GREY, MIRROR))).triangles[:2].any()
