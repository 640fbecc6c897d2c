"""Irradiance from masks against brute-force integrals and rays; see-through surfaces; the lamps' direct light."""

import numpy as np
import pytest
from lightpanes.core.lights import irradiance
from lightpanes.core.penumbra import (
    Cost,
    DirectLight,
    Occluders,
    Receivers,
    cast,
    is_soft,
    sample_ball,
    sample_lamp,
    samples_for,
    shade,
)
from lightpanes.core.penumbra import shading as rules
from lightpanes.core.penumbra.masks import bits_of
from lightpanes.core.rays import Tracer
from lightpanes.core.scene import Material, Scene

from ..bench.penumbra_scenes import grid, scene_of
from .test_penumbra import FLOOR, LAMPS, clutter, lamp_of, scattered

SOFT = [name for name, light in LAMPS.items() if is_soft(light)]


def brute(light, lamp, receivers, tracer):
    """E_free · Σ w V / Σ w in float64, the weights written out once more."""
    free = irradiance(light, receivers.position, receivers.normal, None).astype(float)
    targets = lamp.targets()[0].astype(float)
    away = targets if lamp.distant else targets - receivers.position[:, None]
    away = np.broadcast_to(away, (len(receivers), *targets.shape)).astype(float)
    distance = np.linalg.norm(away, axis=2)
    cosine = np.maximum(np.einsum("nkd,nd->nk", away, receivers.normal) / distance, 0)
    weight = cosine
    if not lamp.distant:
        emitted = np.maximum(-(away @ lamp.axes[2]), 0) / distance
        if light.spread < np.pi:
            beside = np.sqrt(np.maximum(1 - emitted**2, 0)) / np.maximum(emitted, 1e-12)
            emitted = emitted * np.maximum(np.tan(light.spread / 2) - beside, 0)
        weight = cosine * emitted / distance**2
    origins = np.repeat(receivers.position, lamp.count, axis=0)
    aims = np.tile(lamp.targets()[0], (len(receivers), 1))
    seen = ~tracer.blocked(origins, lamp.vectors(origins, aims)).reshape(weight.shape)
    total = weight.sum(axis=1)
    return free * (weight * seen).sum(axis=1) / np.where(total > 0, total, 1)


@pytest.mark.parametrize("name", SOFT)
def test_shading_is_the_sum_over_samples(name):
    scene = clutter(11)
    tracer, light = Tracer(scene), LAMPS[name]
    receivers, lamp = scattered(scene, 3000), sample_lamp(LAMPS[name], 64)
    masks = cast(receivers, lamp, Occluders.of(tracer), cost=Cost(64, "lines"))
    found, expected = shade(light, lamp, receivers, masks), brute(light, lamp, receivers, tracer)
    bright = expected[expected > 0].mean()
    several = (irradiance(light, receivers.position, receivers.normal, None) > 0) & (expected > 0)
    assert several.sum() > 100
    assert np.abs(found - expected)[several].max() < 0.01 * bright
    assert found.mean() == pytest.approx(expected.mean(), rel=0.002)


@pytest.mark.parametrize("name", ["square", "ellipse", "real sun"])
def test_interpolated_weights_are_the_samples_own(name):
    scene = clutter(12)
    light, lamp = LAMPS[name], sample_lamp(LAMPS[name], 256, sets=2)
    receivers = scattered(scene, 4000)
    receivers = Receivers(receivers.position, receivers.normal, (np.arange(4000) % 2).astype(np.uint8))
    receivers = receivers.take(np.flatnonzero(rules._smooth(light, lamp, receivers)))
    assert len(receivers) > 150
    seen = (np.random.default_rng(0).random((len(receivers), 256)) < 0.4).astype(np.float32)
    # a straight edge across the lamp: the worst of patterns is the usual one
    seen[::2] = lamp.places[0, :, 0] > 0.2
    near, far = rules._exactly(light, lamp, receivers, seen), rules._interpolated(light, lamp, receivers, seen)
    assert np.abs(near - far).max() < 2e-3


def test_a_ball_of_light():
    """An unoccluded ball is a point from afar, and its own far side brings nothing."""
    light = lamp_of("POINT", (0, 0, 3), radius=0.4)
    lamp = sample_lamp(light, 512)
    place = Receivers(np.float32([[0, 0, 0.0], [1, 0, 0]]), np.float32([[0, 0, 1], [0, 0, 1]]))
    weight = rules.weights(light, lamp, place, lamp.places[0])
    assert ((weight > 0).mean(axis=1) < 0.5).all() and ((weight > 0).mean(axis=1) > 0.35).all()
    assert sample_ball((0, 0, 3), 0.4, 16).one_sided is False


@pytest.mark.parametrize("name", ["square", "disk", "sun"])
def test_direct_light_is_what_rays_make(name):
    """Against lights.irradiance, whose samples differ at every receiver: unbiased but noisy."""
    scene = clutter(13, 12)
    tracer, light = Tracer(scene), LAMPS[name]
    receivers = scattered(scene, 3000)
    receivers = Receivers(receivers.position, receivers.normal, (np.arange(3000) % 4).astype(np.uint8))
    found = DirectLight(receivers, tracer, 256).unit(light)
    expected = irradiance(light, receivers.position, receivers.normal, tracer.visibility, 256)
    assert found.mean() == pytest.approx(expected.mean(), rel=0.004)
    assert np.sqrt(((found - expected) ** 2).mean()) < 0.015 * expected.mean() * 3


def test_direct_light_keeps_what_did_not_change():
    scene = clutter(14, 8)
    receivers = scattered(scene, 500)
    direct = DirectLight(receivers, Tracer(scene), 64)
    lamps = [LAMPS["square"], LAMPS["sun"], lamp_of("POINT")]
    whole = direct.irradiance(lamps)
    parts = [direct.unit(light)[:, None] * light.power.astype(np.float32) for light in lamps]
    assert np.allclose(whole, sum(parts), rtol=1e-5)
    calls = []
    direct.unit = lambda light: calls.append(light)
    assert np.array_equal(direct.irradiance(lamps), whole) and not calls


def test_accepted_error_decides_samples():
    assert [samples_for(error) for error in (0.1, 0.03, 0.01, 0.001)] == [64, 64, 256, 1024]
    assert not is_soft(lamp_of("AREA", size=(1, 1), casts_shadow=False))
    assert not is_soft(lamp_of("POINT", radius=0.2))


@pytest.mark.parametrize("tint", [(0.5, 0.5, 0.5), (0.9, 0.4, 0.1)])
def test_see_through_sheets(tint):
    """One sheet of glass over another, an opaque box beside: transmissions multiply, only where glass stands."""
    shapes = [FLOOR, grid((-1, -1, 1), (2, 0, 0), (0, 2, 0), 2, 2), grid((-0.5, -2, 1.2), (1, 0, 0), (0, 4, 0), 2, 2)]
    shapes.append(grid((0.2, 0.2, 0.5), (0.4, 0, 0), (0, 0.4, 0), 1, 1))
    corners = scene_of(shapes)
    material = np.repeat((0, 1, 1, 0), [len(s) for s in shapes])
    glass = Material("Glass", (0, 0, 0), transmission=tint)
    scene = Scene(corners.positions, corners.triangles, triangle_material=material, materials=(Material("Grey"), glass))
    tracer, light = Tracer(scene), LAMPS["square"]
    receivers = scattered(corners, 2500)
    found = DirectLight(receivers, tracer, 256).unit(light)
    expected = irradiance(light, receivers.position, receivers.normal, tracer.visibility, 256)
    assert found.shape == expected.shape
    assert found.mean(axis=0) == pytest.approx(expected.mean(axis=0), rel=0.01)
    assert np.sqrt(((found - expected) ** 2).mean()) < 0.03 * expected.mean()


def test_bits_in_and_out():
    random = np.random.default_rng(0)
    from lightpanes.core.penumbra.masks import words_from

    for samples in (1, 63, 64, 65, 200):
        bits = random.random((20, samples)) < 0.5
        words = words_from(bits)
        assert words.shape == (20, -(-samples // 64))
        assert (bits_of(words, samples) == bits).all()
