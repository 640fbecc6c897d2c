"""The detector: what it says of lamps against the full solve, which has no panes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from lightpanes.core.bake import Bake, bake
from lightpanes.core.bake.check import compression_error
from lightpanes.core.bake.steps import prepare
from lightpanes.core.panes.trust import Expected, contrast, expected_of, trust

from .shapes import box, lamp, quick, relighter, room, scene

pytestmark = pytest.mark.thorough

PLACES = [(3, 1.5, 2), (0.5, 0.5, 0.3), (3.3, 1.2, 0.01), (2.2, 2.9, 1.2), (0.01, 0.01, 2.4)]


@cache
def coarse():
    """A room baked with few panes, and what was ready before its exits."""
    made, settings = room(lights=[lamp((3, 1.5, 2))]), quick(panes=6)
    return made, bake(made, settings), prepare(made, settings)


def asked(runtime, lights, expected=Expected(contrast=1.0)):  # noqa: B008
    runtime.light(lights)
    return trust(runtime, lights, expected)


@pytest.mark.parametrize("place", PLACES)
def test_it_knows_what_the_panes_leave_out(place):
    made, baked, ready = coarse()
    runtime = relighter(made, baked)
    light = lamp(place)
    found = asked(runtime, [light])
    # red, green and blue of one lamp
    direct = np.repeat(runtime.known(light).unit[:, None] * 100, 3, axis=1).astype(np.float32)
    lost = compression_error(ready.entries, ready.transport, ready.modes, ready.weights, direct)
    assert lost > 0.004
    # 32 mixtures tell an RMS to an eighth
    assert found.panes == pytest.approx(lost, rel=0.4)


def test_lamps_together_err_together():
    made, baked, _ = coarse()
    runtime = relighter(made, baked)
    first, second = lamp(PLACES[1]), lamp(PLACES[3])
    alone = [asked(runtime, [light]) for light in (first, second)]
    both = asked(runtime, [first, second])
    assert min(t.panes for t in alone) / 2 < both.panes < max(t.panes for t in alone)
    # a bright one drowns the other's error, and is the one to blame
    bright = lamp(PLACES[1], 1e5)
    drowned = asked(runtime, [bright, second])
    assert drowned.panes == pytest.approx(alone[0].panes, rel=0.01) and drowned.worst is bright
    assert np.isclose(asked(runtime, [lamp(PLACES[1], 1.0)]).panes, alone[0].panes, rtol=1e-3)


def test_an_ordinary_lamp_errs_as_the_bake_says():
    made, baked, ready = coarse()
    runtime, expected = relighter(made, baked), expected_of(baked.report)
    assert expected.error == baked.report["error"] and expected.contrast > 0.3
    found = [asked(runtime, [replace(light, power=np.full(3, 100.0))], expected).error for light in ready.test_lamps]
    # a bake's error is a mean over lamps
    assert np.mean(found) == pytest.approx(expected.error, rel=0.15)


def test_error_grows_with_contrast():
    made, baked, _ = coarse()
    runtime, expected = relighter(made, baked), expected_of(baked.report)
    far, near = (asked(runtime, [lamp(place)], expected) for place in (PLACES[0], PLACES[2]))
    grown = [np.sqrt(found.error**2 - found.panes**2 - expected.still**2) for found in (far, near)]
    assert grown[0] == pytest.approx(expected.grows, rel=0.3) and grown[1] > 1.5 * expected.grows
    assert near.close and not far.close


def test_contrast():
    """Light that comes from everywhere alike has all but none; from a tenth of the surface alone, that of rays of which one
    in ten finds it."""
    assert contrast(1.0) == 0.5
    hits = np.random.default_rng(0).random(100_000) < 0.1
    assert contrast(np.sqrt(np.mean((10.0 * hits) ** 2))) == pytest.approx((10.0 * hits).std(), rel=0.01)


def test_warnings():
    made, baked, _ = coarse()
    runtime, expected = relighter(made, baked), expected_of(baked.report)
    asked_for = replace(expected, target=1.5 * expected.error)
    assert not asked(runtime, [lamp(PLACES[0])], asked_for).warns(asked_for)
    found = asked(runtime, [lamp(PLACES[0]), lamp(PLACES[4])], asked_for)
    assert found.warns(asked_for) and found.worst.position[2] > 2.3
    # one that meets its target: whatever does not is news
    met = replace(expected, target=1.01 * expected.error)
    assert met.limit == met.target and replace(expected, target=0.99 * expected.error).limit > 1.4 * expected.error
    # a bake that misses its target has said so: ordinary lamps are not news
    missed = replace(expected, target=0.1 * expected.error)
    assert not asked(runtime, [lamp(PLACES[0])], missed).warns(missed)


def test_lamps_that_light_nothing():
    made = scene((*box((0, 0, 0), (4, 3, 2.5), True), 0), (*box((1, 1, 0), (2, 2, 1)), 0), lights=[lamp((3, 1.5, 2))])
    runtime = relighter(made, bake(made, quick()))
    inside, outside, fine, off = lamp((1.5, 1.5, 0.5)), lamp((9, 9, 9)), lamp((3, 1.5, 2)), lamp((1.5, 1.5, 0.5), 0.0)
    found = asked(runtime, [inside, outside, fine, off])
    assert found.nowhere == (inside, outside) and found.worst is fine
    found = asked(runtime, [inside])
    assert found.nowhere == (inside,) and found.error == 0 and found.worst is None
    assert asked(runtime, []).error == 0


def test_bakes_without_a_sketch_say_nothing(tmp_path):
    made, baked, _ = coarse()
    light = lamp(PLACES[2])
    expected = relighter(made, baked).texels([light])
    baked.save(tmp_path / "new.npz")
    assert asked(relighter(made, Bake.load(tmp_path / "new.npz")), [light]).error is not None
    # as bakes were before
    images = dict(baked.images)
    lost = int(np.prod(baked.meta["shapes"][4]))
    images["Lightpanes Weights"] = images["Lightpanes Weights"][:-lost]
    old = Bake(baked.resolution, images, baked.entries, None, baked.meta | {"shapes": baked.meta["shapes"][:4]})
    runtime = relighter(made, old)
    found = asked(runtime, [light])
    assert found.error is None and not found.warns(Expected(target=1e-3))
    assert np.array_equal(runtime.texels([light]), expected)
