"""What even entries make wrong: nearness against its closed form, moments against the lamp's place, and both together
against light that leaves an entry where it really does."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from lightpanes.core.bake.steps import prepare
from lightpanes.core.panes.entry_light import EntryLight
from lightpanes.core.panes.unevenness import nearness, sensitivity, unevenness
from lightpanes.core.rays import Tracer

from .shapes import box, lamp, quick, room, scene


def test_nearness_below_a_ceiling():
    """16 / π ∫ sin³ θ cos⁷ θ dθ / h⁴ = 2 / 5π h⁴, the plane without end."""
    height = 0.9
    made = scene((*box((0, 0, 0), (8, 8, height), True), 0), lights=[lamp((4, 4, 0.5))])
    ready = prepare(made, quick(entries=700, lamps=30, regions=4, panes=2))
    near = nearness(ready.surface, ready.tracer)
    place, normal = ready.entries.position, ready.entries.normal
    middle = (np.abs(place[:, :2] - 4) < 2).all(axis=1) & (np.abs(normal[:, 2]) > 0.9)
    assert middle.sum() > 100 and ready.surface.size[middle].max() < height
    assert near[middle].mean() == pytest.approx(2 / (5 * np.pi * height**4), rel=0.05)
    corner = (np.abs(place[:, :2] - 4) > 3.6).any(axis=1)
    assert near[corner].mean() > 5 * near[middle].mean()
    assert np.array_equal(near, nearness(ready.surface, ready.tracer))


def test_moments_point_to_the_lamp():
    made = room(lights=[lamp((3, 1.5, 2))])
    ready = prepare(made, quick(lamps=30, regions=4, panes=2))
    eyes = EntryLight(ready.surface, Tracer(made))
    light = lamp((2.9, 0.7, 0.2))
    unit, moment = eyes.look(light)
    assert np.array_equal(unit, eyes.unit(light))
    middle = ready.surface.position.reshape(len(unit), -1, 3).mean(axis=1)
    foot = light.position - middle
    beside = (unit > 0.1 * unit.max()) & (np.abs(foot[:, 2]) < 0.3) & (np.linalg.norm(foot[:, :2], axis=1) > 0.15)
    assert beside.sum() > 2
    assert (np.einsum("nd,nd->n", moment, foot)[beside] > 0).all()
    # no light leaves from beyond an entry
    assert (np.linalg.norm(moment, axis=1) <= unit * ready.entries.span()).all()
    # linear in power, and nothing where nothing reflects
    near = nearness(ready.surface, ready.tracer)
    sensitive = sensitivity(ready.surface, near)
    assert np.allclose(unevenness(3 * moment, sensitive), 3 * unevenness(moment, sensitive))
    black = replace(ready.surface, albedo=0 * ready.surface.albedo)
    assert not unevenness(moment, sensitivity(black, near)).any()


def test_a_small_entry_below_a_ceiling():
    """Light that rises evenly along x over a square entry, by sums over the entry and over the ceiling."""
    height, side, albedo, slope = 0.9, 0.1, 0.6, 3.0
    x, y = ((np.arange(8) + 0.5) / 8 - 0.5) * side, np.linspace(-9, 9, 601)
    moment = slope * np.mean(x**2)
    rise = slope * x
    distance2 = (y[:, None, None] - x) ** 2 + y[None, :, None] ** 2 + height**2
    wrong = albedo * side**2 * (rise * height**2 / (np.pi * distance2**2)).mean(axis=2)
    expected = np.sqrt((wrong**2).sum() * (y[1] - y[0]) ** 2)
    one, near = np.array([moment, 0, 0])[None], np.array([2 / (5 * np.pi * height**4)])
    entry = SimpleNamespace(size=np.array([side]), albedo=np.full((1, 3), albedo))
    found = unevenness(one, sensitivity(entry, near))
    # of all surface, which is the entry here
    assert found * side == pytest.approx(expected, rel=0.01)
