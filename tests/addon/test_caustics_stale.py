"""Caustics never show what is no more: after errors, edits, other scenes, frames and switches."""

import time

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import caustics, extract, live_image, store  # noqa: E402

from .files import baked_once  # noqa: E402
from .glassware import ball, image  # noqa: E402
from .soft import EEVEE  # noqa: E402
from .test_relight import update  # noqa: E402
from .windows import follow, look  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def baked(room, saved):
    """The room with a glass ball under its lamp."""
    room.render.engine = EEVEE
    room.lightpanes.photons = 5000
    ball(room)
    return baked_once(room, saved)


@pytest.fixture
def live(baked):
    """The same, which follows its lamp already: a bake that was only opened knows no surfaces yet."""
    lamp = bpy.data.objects["Lamp"]
    for x in (0.2, -0.2):
        lamp.location.x += x
        update()
    assert caustics.held(baked).atlas is not None
    return baked


@pytest.fixture
def window(baked, unwatched, monkeypatch):
    """Changes are followed by the timer alone."""
    monkeypatch.setattr(live_image, "REST", 0.0)
    return baked


def drag(x):
    """Move the lamp, as in a window."""
    bpy.data.objects["Lamp"].location.x = x
    update()
    follow()


def differs(first, second):
    return np.abs(first - second).max() > 0.1 * second.max()


def test_an_error_beside_blender_is_told_and_nothing_counts_as_shown(window, monkeypatch, capsys):
    before, mine = image(), caustics.held(window)
    key = mine.shown

    def broken(self, atlas, asked, full):
        yield from ()
        raise MemoryError("not enough for the photons")

    with monkeypatch.context() as patched:
        patched.setattr(type(caustics._image), "images", broken)
        drag(0.1)
        look(lambda: mine.error)
    assert mine.shown == key and np.array_equal(image(), before)
    (told,) = caustics.sentences(window)
    assert "not enough for the photons" in told and store.CAUSTICS in told
    assert "Traceback" in capsys.readouterr().err
    # the next change tries again
    drag(0.15)
    look(lambda: mine.shown not in ("", key))
    assert not caustics.sentences(window) and differs(image(), before)


def test_what_is_dropped_ends_between_two_steps(window, monkeypatch):
    """Who drops work waits for it: for one step of it, not for the next picture."""
    drag(0.1)
    mine = caustics.held(window)
    look(lambda: mine.shown and mine.work is None)
    atlas, taken = mine.atlas, []
    refine = atlas.atlas.refine

    def counted(lights, photons):
        for step in refine(lights, photons):
            taken.append(step)
            # who starts a thread may hear of it later than the thread itself
            while mine.work is None:
                time.sleep(0.001)
            mine.work.dropped = True
            yield step

    monkeypatch.setattr(atlas.atlas, "refine", counted)
    monkeypatch.setattr(caustics, "STREAM", 1e9)
    drag(0.2)
    look(lambda: taken)
    live_image.settle(mine)
    assert len(taken) == 1 and taken[0].done < 1


def test_copies_of_a_scene_show_their_own(live):
    """They share the images: who has written one last shows in both, until the other is asked again."""
    before = image()
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    bpy.ops.scene.new(type="LINK_COPY")
    other, lamp = bpy.context.scene, bpy.data.objects["Lamp"]
    second = lamp.copy()
    second.location.x += 0.4
    other.collection.objects.link(second)
    (home,) = (
        found for found in (other.collection, *other.collection.children_recursive) if lamp.name in found.objects
    )
    home.objects.unlink(lamp)
    update()
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert differs(image(), before)
    bpy.context.window.scene = live
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert np.allclose(image(), before, rtol=1e-3, atol=1e-4)


def test_frames_that_were_written_leave_no_bounces(live, tmp_path):
    lamp = bpy.data.objects["Lamp"]
    for frame, x in ((1, -0.3), (2, 0.3)):
        lamp.location.x = x
        lamp.keyframe_insert("location", frame=frame)
    live.frame_start, live.frame_end = 1, 2
    live.frame_set(1)
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    before, bounced = image(), image(store.IRRADIANCE)
    assert bpy.ops.lightpanes.bake_animation("EXEC_DEFAULT", directory=str(tmp_path / "frames")) == {"FINISHED"}
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert np.allclose(image(), before, rtol=1e-3, atol=1e-4)
    assert np.allclose(image(store.IRRADIANCE), bounced, rtol=1e-3, atol=1e-4)


def test_shading_flat_is_another_shape(live):
    before, item = image(), bpy.data.objects["Ball"]
    item.data.polygons.foreach_set("use_smooth", [False] * len(item.data.polygons))
    item.data.update()
    update()
    # small faces: the spot breaks up a little; what is not noticed stays as it is to the last bit
    assert np.abs(image() - before).max() > 0.005 * before.max()


@pytest.mark.parametrize("way", ["edges", "normals", "shadow"])
def test_how_things_are_shaded_is_part_of_their_fingerprint(room, way):
    item, before = bpy.data.objects["Block"], extract.fingerprint(bpy.context)
    if way == "edges":
        item.data.shade_smooth()
        before = extract.fingerprint(bpy.context)
        item.data.edges[0].use_edge_sharp = True
    elif way == "normals":
        item.data.normals_split_custom_set([(0.6, 0.0, 0.8)] * len(item.data.loops))
    else:
        item.visible_shadow = False
    item.data.update()
    item.update_tag()
    update()
    assert extract.changed_objects(before, extract.fingerprint(bpy.context)) == ["Block"]


@pytest.mark.parametrize("way", ["shadow", "hide", "rough", "swap"])
def test_what_is_glass_no_more_leaves_no_caustics(live, way):
    item, (glass,) = bpy.data.objects["Ball"], bpy.data.objects["Ball"].data.materials
    if way == "shadow":
        item.visible_shadow = False
    elif way == "hide":
        item.hide_render = True
    elif way == "rough":
        glass.node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.6
    else:
        item.data.materials[0] = bpy.data.materials["Block"]
    update()
    assert store.find_image(live, store.CAUSTICS) is None


def test_glass_in_an_instance_outlives_an_edit(room):
    room.render.engine, room.lightpanes.photons = EEVEE, 5000
    item, glassware = ball(room), bpy.data.collections.new("Glassware")
    for former in list(item.users_collection):
        former.objects.unlink(item)
    glassware.objects.link(item)
    maker = bpy.data.objects.new("Maker", None)
    maker.instance_type, maker.instance_collection = "COLLECTION", glassware
    room.collection.objects.link(maker)
    update()
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    before = image()
    assert caustics.held(room).casters == ("Maker: Ball",) and before.max() > 1
    assert caustics.can_follow(room, maker) and caustics.can_follow(room, item)
    bpy.data.objects["Block"].location.x += 0.02
    update()
    assert np.allclose(image(), before, rtol=0.2, atol=0.2)
    maker.location.y += 0.3
    update()
    assert differs(image(), before)


def test_switched_off_and_on_while_nothing_follows(live):
    before, bounced = image(), image(store.IRRADIANCE)
    live.lightpanes.live = False
    live.lightpanes.caustics = False
    assert store.find_image(live, store.CAUSTICS) is None
    assert np.abs(image(store.IRRADIANCE) - bounced).max() > 1e-3
    live.lightpanes.caustics = True
    assert np.allclose(image(), before, rtol=1e-3, atol=1e-4)
    assert np.allclose(image(store.IRRADIANCE), bounced, rtol=1e-3, atol=1e-3)


def test_light_that_is_lost_between_mirrors_is_told(live):
    assert caustics.sentences(live) == []
    held = caustics.held(live)
    assert 0 <= held.energy["untraced"] < caustics.UNTRACED * held.energy["emitted"]
    held.energy["untraced"] = 0.07 * held.energy["emitted"]
    (told,) = caustics.sentences(live)
    assert "7 %" in told
