"""Lamps that are not live when baking: baked in, faster; and said so when they change afterwards."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import relight, store  # noqa: E402

from .test_relight import image, update  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def still(room):
    """A bake whose only lamp is baked in."""
    bpy.data.lights["Lamp"].lightpanes.live = False
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    return room


def test_the_light_is_that_of_a_live_lamp(still):
    shown = image().copy()
    assert store.read_meta(still)["report"]["skipped"] == {"panes": "no lamp is live"}
    bpy.data.lights["Lamp"].lightpanes.live = True
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert shown.mean() == pytest.approx(image().mean(), rel=0.03)


def test_it_stays_as_it_is_and_says_so(still):
    before = image().copy()
    assert relight.check_stale(bpy.context) == ()
    bpy.data.lights["Lamp"].energy *= 2
    update()
    assert np.array_equal(image(), before)
    assert relight.check_stale(bpy.context) == ("Lamp 'Lamp' is baked in, and was changed since; bake again.",)
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert np.array_equal(image(), before)
    bpy.data.lights["Lamp"].energy /= 2
    bpy.data.lights["Lamp"].lightpanes.live = True
    update()
    assert np.array_equal(image(), before)
    assert relight.check_stale(bpy.context) == ("Lamp 'Lamp' is baked in; bake again to make it live.",)
    bpy.data.objects["Lamp"].hide_render = True
    update()
    assert relight.check_stale(bpy.context) == (
        "Lamp 'Lamp' is baked in, and was deleted, hidden or switched off since; bake again.",
    )


def test_another_lamp_cannot_be_shown_and_that_is_said(still):
    before = image().copy()
    other = bpy.data.objects.new("Other", bpy.data.lights.new("Other", "POINT"))
    other.data.energy = 50
    still.collection.objects.link(other)
    update()
    assert np.array_equal(image(), before)
    assert relight.check_stale(bpy.context) == ("This bake has no live lamp, so it cannot show 'Other'; bake again.",)


def test_a_live_lamp_beside_it(room):
    other = bpy.data.objects.new("Other", bpy.data.lights.new("Other", "POINT"))
    other.data.energy, other.location = 30, (0.4, 0.4, 1.0)
    room.collection.objects.link(other)
    bpy.data.lights["Lamp"].lightpanes.live = False
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    both = image().copy()
    other.data.energy = 0
    update()
    dark = image().copy()
    assert 0 < dark.mean() < both.mean()
    other.data.energy = 60
    update()
    assert np.allclose(image() - dark, 2 * (both - dark), rtol=1e-3, atol=1e-5)


def test_it_survives_reopening(still, tmp_path):
    before = image().copy()
    path = str(tmp_path / "still.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert np.allclose(image(), before, rtol=1e-5)
    assert relight.check_stale(bpy.context) == ()
