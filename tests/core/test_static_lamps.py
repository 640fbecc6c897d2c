"""Lamps that are not live: baked in like the sky, without panes where no lamp is live at all."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from lightpanes.core.bake import Bake, bake
from lightpanes.core.planner import Settings, needs_panes, plan
from lightpanes.core.scene import Material

from .shapes import box, globe, lamp, quick, relighter, room, scene

FIRST, SECOND = lamp((3, 1.5, 2)), lamp((0.6, 0.5, 1.2), 60.0)


def still(light):
    return replace(light, live=False)


@cache
def _baked(names):
    lights = {"first": FIRST, "second": SECOND, "still first": still(FIRST)}
    made = room(lights=[lights[name] for name in names])
    return made, bake(made, quick())


def baked(*names):
    """The room with some of the lamps "first", "second" and "still first", and its bake."""
    return _baked(names)


def test_a_scene_without_lamps_gets_panes_for_those_that_may_come():
    assert needs_panes(room())
    assert needs_panes(room(lights=[FIRST, still(SECOND)]))
    assert not needs_panes(room(lights=[still(FIRST)]))
    assert plan(room(lights=[still(FIRST)]), Settings()).entries < plan(room(lights=[FIRST]), Settings()).entries


def test_baked_in_light_is_what_a_live_lamp_gives():
    made, result = baked("still first")
    live = room(lights=[FIRST])
    fine = bake(live, quick(panes=32, regions=48, lamps=800))
    found, expected = relighter(made, result).texels(()), relighter(live, fine).texels([FIRST])
    assert found.shape == expected.shape
    # the rows are in another order
    assert np.allclose(found.mean(axis=0), expected.mean(axis=0), rtol=0.01)
    for q in (0.1, 0.5, 0.9):
        assert np.allclose(np.quantile(found, q, axis=0), np.quantile(expected, q, axis=0), rtol=0.04)


def test_without_live_lamps_there_are_no_panes(tmp_path):
    made, result = baked("still first")
    assert result.report["skipped"] == {"panes": "no lamp is live"}
    assert "panes" not in result.report["error_parts"] and result.report["error"] > 0
    assert result.bytes < 0.3 * bake(room(lights=[FIRST]), quick(lamps=400)).bytes
    runtime = relighter(made, result)
    before = runtime.relight(()).copy()
    assert np.array_equal(runtime.relight([SECOND]), before)
    result.save(tmp_path / "bake.npz")
    assert np.array_equal(relighter(made, Bake.load(tmp_path / "bake.npz")).relight(()), before)


def test_one_baked_in_and_one_live():
    made, result = baked("still first", "second")
    runtime = relighter(made, result)
    dark, both = runtime.texels(()), runtime.texels([SECOND])
    assert result.report["skipped"] == {}
    # the live one alone, from a bake that knows no other
    alone = relighter(*baked("second")).texels([SECOND])
    assert np.allclose((both - dark).mean(axis=0), alone.mean(axis=0), rtol=0.02)
    assert np.allclose(dark.mean(axis=0), relighter(*baked("first")).texels([FIRST]).mean(axis=0), rtol=0.02)
    # a scene's own list may be handed over as it is: what is baked in is not added again
    assert np.array_equal(runtime.texels(made.lights), both)


@pytest.mark.parametrize("place", [(0, 0, 0), (0.5, 0.2, -0.4), (0, 0, 0.9)])
def test_integrating_sphere(place):
    # Φ / 4πR² · ρ / (1 − ρ), wherever the lamp is
    made = scene((*globe(), 0), lights=[still(lamp(place))])
    found = relighter(made, bake(made, quick(entries=900, exit_rays=256))).texels(())
    assert found.mean() == pytest.approx(100 / (4 * np.pi), rel=0.01)


def test_light_near_a_lamp_leaves_from_where_it_falls():
    # a lamp 20 cm above the floor beside a wall: few entries with a row a piece against many without
    white = Material("White", (0.8,) * 3)
    light = lamp((0.35, 1.5, 0.2))
    made = scene((*box((0, 0, 0), (4, 3, 2.5), True), 0), materials=(white,), lights=[light])
    truth = bake(replace(made, lights=(still(light),)), quick(entries=3000, exit_rays=1024))
    static = bake(replace(made, lights=(still(light),)), quick(entries=400, exit_rays=512))
    live = bake(made, quick(entries=400, exit_rays=512, panes=24))
    expected = relighter(made, truth).relight(())[..., 0].copy()
    fine = relighter(made, static).relight(())[..., 0].copy()
    coarse = relighter(made, live).relight([light])[..., 0].copy()

    def error(found):
        return np.sqrt(((found - expected) ** 2).mean()) / expected.mean()

    assert error(fine) < 0.5 * error(coarse)
    assert error(fine) < 0.06
