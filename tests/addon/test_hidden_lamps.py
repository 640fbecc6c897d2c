"""Lamps that the viewport hides and a render shows: Blender doesn't evaluate them, and they move all the same."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import relight, visibility  # noqa: E402

from .files import baked_once  # noqa: E402
from .test_animation import load, moving, shown  # noqa: E402, F401
from .test_relight import add_camera  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")

FRAMES = (1, 2, 3, 5)


@pytest.fixture
def baked(moving, saved):  # noqa: F811
    """The lamp is in a collection, under a parent that moves it, too."""
    lamp = bpy.data.objects["Lamp"]
    collection = bpy.data.collections.new("Lamps")
    moving.collection.children.link(collection)
    collection.objects.link(lamp)
    moving.collection.objects.unlink(lamp)
    parent = bpy.data.objects.new("Parent", None)
    collection.objects.link(parent)
    lamp.parent = parent
    for frame, y in ((1, 0.0), (5, 0.3)):
        parent.location.y = y
        parent.keyframe_insert("location", frame=frame)
    target = bpy.data.objects.new("Target", None)
    collection.objects.link(target)
    for frame, z in ((1, 0.0), (5, 0.2)):
        target.location.z = z
        target.keyframe_insert("location", frame=frame)
    follow = parent.constraints.new("COPY_LOCATION")
    follow.target, follow.use_x, follow.use_y = target, False, False
    moving.frame_set(1)
    return baked_once(moving, saved)


def hide(how):
    """Hide the lamp in viewports; returns the switches that do it, each with its name."""
    lamp, layer = bpy.data.objects["Lamp"], bpy.context.view_layer.layer_collection.children["Lamps"]
    switches = {
        "screen": [(lamp, "hide_viewport")],
        "collection": [(layer.collection, "hide_viewport")],
        "layer": [(layer, "hide_viewport")],
        "all": [
            (o, "hide_viewport")
            for o in (lamp, *map(bpy.data.objects.get, ("Parent", "Target")), layer, layer.collection)
        ],
        "eye": [],
    }[how]
    for owner, name in switches:
        setattr(owner, name, True)
    if how == "eye":
        lamp.hide_set(True)
    bpy.context.view_layer.update()
    return switches


def light_of_frames(scene):
    found = {}
    for frame in FRAMES:
        scene.frame_set(frame)
        found[frame] = shown().copy()
    return found


@pytest.mark.parametrize("how", ["screen", "collection", "layer", "all", "eye"])
def test_their_light_follows_the_frame(baked, how):
    expected = light_of_frames(baked)
    assert len({round(float(light.mean()), 5) for light in expected.values()}) == 4
    baked.frame_set(1)
    switches = hide(how)
    found = light_of_frames(baked)
    for frame in FRAMES:
        assert np.allclose(found[frame], expected[frame], rtol=1e-4, atol=1e-5)
    assert all(getattr(owner, name) for owner, name in switches)


@pytest.mark.parametrize("how", ["screen", "collection"])
def test_relighting_by_hand(baked, how):
    baked.lightpanes.live = False
    baked.frame_set(5)
    bpy.ops.lightpanes.relight()
    expected = shown().copy()
    baked.frame_set(1)
    bpy.ops.lightpanes.relight()
    hide(how)
    baked.frame_set(5)
    bpy.ops.lightpanes.relight()
    assert np.allclose(shown(), expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("viewport", [True, False])
def test_images_of_an_animation(baked, tmp_path, monkeypatch, viewport):
    """A viewport, where a hidden lamp is off, changes nothing in what is written."""
    bpy.ops.lightpanes.bake_animation(directory=str(tmp_path / "shown"))
    baked.frame_set(1)
    switches = hide("all")
    monkeypatch.setattr(relight, "_is_viewport", lambda depsgraph: viewport)
    relight.update(baked, bpy.context.evaluated_depsgraph_get())
    before = shown().copy()
    bpy.ops.lightpanes.bake_animation(directory=str(tmp_path / "hidden"))
    for frame in FRAMES:
        first, second = (load(tmp_path / word / f"irradiance_{frame:04d}.exr") for word in ("shown", "hidden"))
        assert np.allclose(first, second, rtol=1e-3, atol=1e-5) and first.max() > 0.05
    assert all(getattr(owner, name) for owner, name in switches)
    relight.update(baked, bpy.context.evaluated_depsgraph_get())
    assert np.allclose(shown(), before, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("viewport", [True, False])
def test_renders(baked, monkeypatch, viewport):
    expected = light_of_frames(baked)
    baked.frame_set(1)
    hide("all")
    monkeypatch.setattr(relight, "_is_viewport", lambda depsgraph: viewport and depsgraph.mode == "VIEWPORT")
    add_camera(baked)
    seen = {}

    def look(scene, *_):
        seen[scene.frame_current] = shown(scene).copy()

    bpy.app.handlers.render_post.append(look)
    baked.render.filepath = bpy.app.tempdir
    try:
        bpy.ops.render.render(animation=True)
        animated, seen = seen, {}
        baked.frame_set(3)
        bpy.ops.render.render()
    finally:
        bpy.app.handlers.render_post.remove(look)
    for frame in FRAMES:
        assert np.allclose(animated[frame], expected[frame], rtol=1e-4, atol=1e-5)
    assert np.allclose(seen[3], expected[3], rtol=1e-4, atol=1e-5)


def test_moved_while_hidden(baked):
    lamp = bpy.data.objects["Lamp"]
    lamp.animation_data_clear()
    lamp.location.x = 0.4
    bpy.context.view_layer.update()
    expected = shown().copy()
    lamp.location.x = -0.4
    bpy.context.view_layer.update()
    assert not np.allclose(shown(), expected, rtol=0.05)
    hide("screen")
    lamp.location.x = 0.4
    bpy.ops.lightpanes.relight()
    assert np.allclose(shown(), expected, rtol=1e-4, atol=1e-5)


def test_what_needs_no_waking_stays_as_it_is(baked, monkeypatch):
    """A lamp that renders hide, or that nothing hides, costs nothing."""
    monkeypatch.setattr(visibility._Switches, "set", None)
    lamp = bpy.data.objects["Lamp"]
    for hidden in (False, True):
        lamp.hide_viewport = lamp.hide_render = hidden
        bpy.context.view_layer.update()
        with visibility.awake(bpy.context.view_layer):
            pass
