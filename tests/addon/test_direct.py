"""The lamps' direct light in the bake: as Cycles has it, live, never twice, and gone without a trace."""

import json

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import commands, direct, linking, live_image, relight, sessions, store  # noqa: E402
from lightpanes.addon import panel as drawn_panel  # noqa: E402
from lightpanes.core.metrics import relative_rmse  # noqa: E402
from lightpanes.core.penumbra import DirectLight  # noqa: E402

from .drawing import draw, texts  # noqa: E402
from .files import reopen  # noqa: E402
from .soft import EEVEE, camera, error, image, linked, render, shine, sky, yard  # noqa: E402
from .test_nodes import tree_state  # noqa: E402
from .test_relight import update  # noqa: E402
from .windows import follow, look  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


def test_an_area_lamp_is_as_cycles_has_it(baked_panel):
    assert error() < 0.03


def test_a_sun_with_an_angle_and_points_as_exits(room):
    yard(room)
    room.lightpanes.direct, room.lightpanes.exits = "BAKED", "POINTS"
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert store.load_bake(room).points
    assert error() < 0.03


def test_it_moves_with_the_lamp(baked_panel):
    before = image()
    lamp = bpy.data.objects["Panel"]
    lamp.location.x = 0.4
    update()
    assert np.abs(image() - before).max() > 0.1 * before.max()
    assert error() < 0.03
    lamp.data.energy *= 2
    lamp.location.x = -0.3
    update()
    assert np.allclose(image(), 2 * before, rtol=1e-5, atol=1e-6)


def test_only_lamps_that_changed_are_cast_again(fresh_panel, monkeypatch):
    cast = []
    unit = DirectLight.unit
    monkeypatch.setattr(
        DirectLight, "unit", lambda self, light, *more: cast.append(light.name) or unit(self, light, *more)
    )
    second = shine(fresh_panel, "Second", (0.5, 0.5, 0.5))
    update()
    assert cast == ["Second"]
    second.data.energy = 5.0
    bpy.data.objects["Panel"].data.color = (1, 0, 0)
    update()
    assert cast == ["Second"]
    second.data.lightpanes.samples = 128
    assert cast == ["Second"] * 2


def test_the_sky_stays_as_it_was_baked(room):
    """Switching on and off, moving lamps: what sky and emissive faces bring is stored once, and only added to."""
    yard(room)
    room.render.engine = EEVEE
    sky(room)
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    own = store.load_bake(room).own
    steady = image()
    assert steady[own].mean() > 0.05
    room.lightpanes.direct = "BAKED"
    sun = bpy.data.objects["Sun"]
    both = image()
    assert (both - steady)[own].min() > -1e-5 and (both - steady)[own].mean() > 0.5
    assert np.array_equal(store.load_bake(room).direct, steady)
    assert np.array_equal(image(store.STEADY), steady)
    sun.data.energy = 6.0
    update()
    assert np.allclose(image() - steady, 2 * (both - steady), rtol=1e-4, atol=1e-5)
    sun.hide_render = True
    update()
    assert np.array_equal(image(), steady)
    room.lightpanes.direct = "OFF"
    assert np.array_equal(image(), steady) and store.find_image(room, store.STEADY) is None
    assert np.array_equal(store.load_bake(room).direct, steady)


def states():
    """Of all trees, ours included."""
    trees = [item.node_tree for item in bpy.data.materials if item.node_tree]
    groups = [group for group in bpy.data.node_groups if store.TAG in group]
    return [tree_state(tree) for tree in trees] + [sorted(node.bl_idname for node in group.nodes) for group in groups]


@pytest.mark.parametrize("light", ["sky", "none"])
def test_off_again_restores_everything(panel, light):
    if light == "sky":
        sky(panel)
        bpy.data.objects["Room"].data.materials[0].use_backface_culling = True
    panel.lightpanes.direct = "OFF"
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    before = states(), sorted(image.name for image in bpy.data.images), len(bpy.data.collections)
    panel.lightpanes.direct = "BAKED"
    assert linked() == {"Panel": ["Block", "Room"]}
    panel.lightpanes.direct = "OFF"
    assert linked() == {} and panel.lightpanes.receivers is None
    assert before == (states(), sorted(image.name for image in bpy.data.images), len(bpy.data.collections))


def test_clear_restores_everything(panel):
    before = states(), len(bpy.data.images), len(bpy.data.collections)
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert linked()
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert linked() == {} and before == (states(), len(bpy.data.images), len(bpy.data.collections))
    update()
    assert panel.lightpanes.direct == "BAKED" and not sessions.of(panel)


def test_a_bake_has_cast_the_lamps_when_it_ends(panel, monkeypatch):
    """So a window need not wait for them."""
    atlases, make = [], direct.make_atlas
    monkeypatch.setattr(direct, "make_atlas", lambda *given: atlases.append(make(*given)) or atlases[-1])
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert atlases == [direct.held(panel).atlas]


def test_baking_again_changes_nothing(baked_panel):
    before = image()
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert np.allclose(image(), before, rtol=1e-5, atol=1e-6) and before.max() > 1
    assert [group.name for group in bpy.data.collections if store.TAG in group] == [
        store.COLLECTION,
        linking.RECEIVERS,
    ]


def test_undo(baked_panel):
    bpy.ops.ed.undo_push(message="Baked")
    before = image()
    bpy.data.objects["Panel"].location.x = 0.4
    update()
    moved = image()
    bpy.ops.ed.undo_push(message="Moved")
    bpy.ops.ed.undo()
    assert np.allclose(image(), before, rtol=1e-5, atol=1e-6)
    bpy.ops.ed.redo()
    assert np.allclose(image(), moved, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("light", ["sky", "none"])
def test_undoing_the_switch(room, light):
    yard(room)
    if light == "sky":
        sky(room)
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="Baked")
    before = store.load_bake(room).direct
    room.lightpanes.direct = "BAKED"
    room.render.engine = EEVEE
    update()
    shown = image()
    assert linked()
    bpy.ops.ed.undo_push(message="Switched")
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert scene.lightpanes.direct == "OFF" and linked() == {}
    after = store.load_bake(scene).direct
    assert (before is None and after is None and store.find_image(scene, store.DIRECT) is None) or np.array_equal(
        before, after
    )
    bpy.ops.ed.redo()
    assert bpy.context.scene.lightpanes.direct == "BAKED"
    assert np.allclose(image(), shown, rtol=1e-5, atol=1e-6)
    assert list(linked()) == ["Sun"]


def test_reopening_computes_nothing_and_then_follows(baked_panel, tmp_path):
    bpy.data.objects["Panel"].location.x = 0.4
    update()
    expected = image()
    bpy.data.objects["Panel"].location.x = -0.3
    update()
    before = image()
    scene = reopen(tmp_path)
    update()
    assert np.array_equal(image(), before)
    assert direct.held(scene).atlas is None and linked() == {"Panel": ["Block", "Room"]}
    bpy.data.objects["Panel"].location.x = 0.4
    update()
    assert np.allclose(image(), expected, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("way", ["baked", "reopened"])
def test_an_object_that_moves_takes_its_light_along(fresh_panel, tmp_path, way):
    if way == "reopened":
        reopen(tmp_path)
        update()
    bpy.data.objects["Block"].location.x -= 0.4
    update()
    assert error() < 0.04


def test_a_lamp_that_is_baked_in_stays(panel):
    bpy.data.lights["Panel"].lightpanes.live = False
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    before = image()
    assert error() < 0.03
    lamp = bpy.data.objects["Panel"]
    lamp.location.x = 0.4
    update()
    assert np.allclose(image(), before, rtol=1e-5) and list(linked()) == ["Panel"]
    bpy.data.objects.remove(lamp)
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert np.allclose(image(), before, rtol=1e-5)


def test_not_live_until_asked(baked_panel):
    before = image()
    baked_panel.lightpanes.live = False
    bpy.data.objects["Panel"].location.x = 0.4
    update()
    assert np.array_equal(image(), before)
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert np.abs(image() - before).max() > 0.1 * before.max()


# ---- in a window ----


@pytest.fixture
def window(baked_panel, unwatched, monkeypatch):
    """Changes are followed by the timer alone."""
    monkeypatch.setattr(live_image, "REST", 1e9)
    return baked_panel


def move(x):
    bpy.data.objects["Panel"].location.x = x
    update()
    follow()


def test_a_dragged_lamp_is_followed_coarsely_and_then_in_full(window, monkeypatch):
    before, mine = image(), direct.held(window)
    move(0.4)
    assert np.array_equal(image(), before), "the indirect light does not wait for it"
    look(lambda: not mine.shown)
    coarse, key = image(), mine.coarse
    monkeypatch.setattr(live_image, "REST", 0.0)
    look(lambda: mine.shown)
    assert mine.shown == key and mine.asked is None and live_image.look() is None
    # neighbours share a value, so that a coarse image lags by a texel, which is 10 cm here
    assert relative_rmse(coarse, image(), store.load_bake(window).own, 4) < 0.2
    assert error() < 0.03


def test_an_image_that_nobody_wants_any_more_is_dropped(window):
    before, mine = image(), direct.held(window)
    move(0.4)
    live_image.look()
    move(-0.3)
    look(lambda: mine.work is None)
    assert np.array_equal(image(), before)


def test_an_edit_while_a_lamp_is_dragged(window, monkeypatch):
    mine = direct.held(window)
    move(0.4)
    bpy.data.objects["Block"].location.x -= 0.4
    update()
    relight.check_stale(bpy.context)
    follow()
    monkeypatch.setattr(live_image, "REST", 0.0)
    look(lambda: mine.shown)
    assert error() < 0.04


def test_undo_while_a_lamp_is_dragged(window, monkeypatch):
    bpy.ops.ed.undo_push(message="Baked")
    before, mine = image(), direct.held(window)
    move(0.4)
    bpy.ops.ed.undo_push(message="Moved")
    bpy.ops.ed.undo()
    monkeypatch.setattr(live_image, "REST", 0.0)
    look(lambda: mine.work is None and live_image.look() is None)
    assert np.allclose(image(), before, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("way", ["save", "images", "frame", "render"])
def test_nothing_coarse_leaves_the_window(window, tmp_path, way):
    mine = direct.held(window)
    move(0.4)
    look(lambda: not mine.shown)
    if way == "save":
        scene = reopen(tmp_path)
        assert direct.held(scene).shown
    elif way == "images":
        assert bpy.ops.lightpanes.save_images(directory=str(tmp_path)) == {"FINISHED"}
    elif way == "frame":
        window.frame_set(7)
    else:
        camera(window)
        window.render.engine, window.cycles.samples = "CYCLES", 1
        render(tmp_path)
    assert direct.held(bpy.context.scene).shown
    assert error() < 0.03


# ---- results for others ----


def test_animations_have_direct_light_of_each_frame(panel, tmp_path):
    sky(panel)
    bpy.data.objects["Room"].hide_render = True
    bpy.ops.mesh.primitive_plane_add(size=2, location=(0, 0, -1))
    lamp = bpy.data.objects["Panel"]
    for frame, x in ((1, -0.5), (2, 0.5), (3, 0.5)):
        lamp.location.x = x
        lamp.keyframe_insert("location", frame=frame)
    panel.frame_start, panel.frame_end = 1, 3
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert bpy.ops.lightpanes.bake_animation(directory=str(tmp_path / "out")) == {"FINISHED"}
    manifest = json.loads((tmp_path / "out" / "lightpanes_animation.json").read_text("utf-8"))
    assert manifest["schema"] == 2 and manifest["direct"] is None
    assert [frame["direct"] for frame in manifest["frames"]] == [f"direct_000{k}.exr" for k in (1, 2, 3)]
    for frame in (1, 2, 3):
        panel.frame_set(frame)
        written = bpy.data.images.load(str(tmp_path / "out" / f"direct_000{frame}.exr"))
        pixels = np.array(written.pixels, np.float32).reshape(64, 64, 4)[..., :3]
        assert np.allclose(pixels, image(), rtol=2e-3, atol=1e-3)
    first, second, third = ((tmp_path / "out" / f"direct_000{k}.exr").read_bytes() for k in (1, 2, 3))
    assert first != second == third


def test_saved_images_hold_the_lamps(baked_panel, tmp_path):
    assert bpy.ops.lightpanes.save_images(directory=str(tmp_path)) == {"FINISHED"}
    written = bpy.data.images.load(str(tmp_path / "Lightpanes Direct.exr"))
    assert np.allclose(np.array(written.pixels, np.float32).reshape(64, 64, 4)[..., :3], image(), rtol=1e-3, atol=1e-4)


def test_the_command_line(panel, tmp_path):
    panel.lightpanes.direct = "OFF"
    path = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    told = tmp_path / "report.json"
    words = ["--error", "0.5", "--resolution", "64", "--direct", "baked", "--json", str(told)]
    assert commands.main(["bake", str(path), *words]) == 0
    report = json.loads(told.read_text())
    assert report["settings"]["direct"] == "baked" and report["direct_ms"] > 0


def test_relighting_from_the_command_line(baked_panel, tmp_path, capsys):
    before = image()
    bpy.data.objects["Panel"].keyframe_insert("location", frame=1)
    bpy.data.objects["Panel"].location.x = 0.4
    bpy.data.objects["Panel"].keyframe_insert("location", frame=2)
    baked_panel.frame_set(1)
    path = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    folder = tmp_path / "out"
    assert commands.main(["relight", str(path), "--frame", "2", "--output", str(folder)]) == 0
    assert np.abs(image() - before).max() > 0.1 * before.max()
    assert (folder / "room_relit_direct.exr").exists()
    report = json.loads((folder / "room_relit_report.json").read_text())
    assert report["direct_ms"] > 0 and report["warnings"] == []
    assert commands.main(["info", str(path)]) == 0
    assert "direct_ms" in capsys.readouterr().out


def test_deleted_images(baked_panel):
    bpy.data.images.remove(store.find_image(baked_panel, store.DIRECT))
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert image().max() > 1
    (group,) = (group for group in bpy.data.node_groups if store.TAG in group)
    assert store.find_image(baked_panel, store.DIRECT) in [getattr(node, "image", None) for node in group.nodes]


def test_the_panel_says_what_it_took_and_what_is_left_out(fresh_panel):
    drawn = draw(drawn_panel.LIGHTPANES_PT_output)
    labels = texts(drawn, "label")
    assert "direct" in texts(drawn, "prop") and "Last Direct Light" in labels
    shine(fresh_panel, "Second").light_linking.receiver_collection = bpy.data.collections.new("Mine")
    update()
    said = " ".join(texts(draw(drawn_panel.LIGHTPANES_PT_output), "label"))
    assert "Lamp 'Second' has light linking of its own" in said
