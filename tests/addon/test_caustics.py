"""Caustics in a bake: there where glass or metal is, live, never twice, and gone without a trace."""

import json

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import caustics, commands, following, live_image, relight, sessions, store  # noqa: E402
from lightpanes.addon import panel as drawn_panel  # noqa: E402
from lightpanes.core.caustics import CausticAtlas  # noqa: E402

from .drawing import draw, texts  # noqa: E402
from .files import baked_once, reopen  # noqa: E402
from .glassware import ball, image, material  # noqa: E402
from .soft import EEVEE, camera, render  # noqa: E402
from .test_relight import update  # noqa: E402
from .windows import follow, look  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def glass(room):
    """The room with a glass ball under its lamp, not baked yet."""
    room.render.engine = EEVEE
    room.lightpanes.photons = 5000
    ball(room)
    return room


@pytest.fixture
def baked(glass, saved):
    return baked_once(glass, saved)


def centre(values):
    """Where its light is, in texels."""
    weight = values.sum(axis=2)
    grid = np.indices(weight.shape)
    return (grid * weight).sum(axis=(1, 2)) / weight.sum()


def test_it_is_there_and_follows_lamp_and_glass(baked):
    before, bounced = image(), image(store.IRRADIANCE)
    assert before.max() > 1
    assert caustics.held(baked).casters == ("Ball",)
    lamp = bpy.data.objects["Lamp"]
    lamp.location.x += 0.3
    update()
    moved = image()
    assert np.abs(moved - before).max() > 0.1 * before.max()
    lamp.data.energy *= 2
    update()
    assert np.allclose(image(), 2 * moved, rtol=1e-4, atol=1e-5)
    lamp.data.energy /= 2
    lamp.location.x -= 0.3
    update()
    assert np.allclose(image(), before, rtol=1e-4, atol=1e-5)
    assert np.allclose(image(store.IRRADIANCE), bounced, rtol=1e-3, atol=1e-4)
    bpy.data.objects["Ball"].location.y += 0.3
    update()
    assert np.abs(image() - before).max() > 0.1 * before.max()


def test_it_bounces(baked):
    """What falls on the floor lights the room: a bake without caustics lacks it, where light passes straight on."""
    before = image(store.IRRADIANCE)
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert np.allclose(image(store.IRRADIANCE), before, rtol=1e-3, atol=1e-4)
    current = sessions.of(baked)
    current.relighter.extra = lambda light: None
    shadowed = current.relighter.relight(tuple(current.last.values()))[..., :3]
    assert before.sum() > 1.005 * shadowed.sum()


def test_reopening_computes_nothing_and_then_follows(baked, tmp_path):
    before = image()
    bpy.data.objects["Lamp"].location.x += 0.3
    update()
    expected, bounced = image(), image(store.IRRADIANCE)
    bpy.data.objects["Lamp"].location.x -= 0.3
    update()
    scene = reopen(tmp_path)
    update()
    assert np.allclose(image(), before, rtol=1e-4, atol=1e-5)
    assert caustics.is_baked(scene) and caustics.held(scene).casters == ("Ball",)
    assert caustics.held(scene).atlas is None
    bpy.data.objects["Lamp"].location.x += 0.3
    update()
    assert np.allclose(image(), expected, rtol=1e-3, atol=1e-3)
    assert np.allclose(image(store.IRRADIANCE), bounced, rtol=1e-3, atol=1e-3)


def test_off_and_on_and_cleared(glass):
    names = sorted(item.name for item in bpy.data.images)
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    before, light = image(), image(store.IRRADIANCE)
    glass.lightpanes.caustics = False
    assert store.find_image(glass, store.CAUSTICS) is None and store.CAUSTICS not in bpy.data.images
    # light passes straight on now
    assert np.abs(image(store.IRRADIANCE) - light).max() > 1e-3
    glass.lightpanes.caustics = True
    assert np.allclose(image(), before, rtol=1e-4, atol=1e-5)
    assert np.allclose(image(store.IRRADIANCE), light, rtol=1e-3, atol=1e-4)
    (group,) = (group for group in bpy.data.node_groups if store.TAG in group)
    assert store.find_image(glass, store.CAUSTICS) in [getattr(node, "image", None) for node in group.nodes]
    glass.cycles.caustics_reflective = False
    glass.lightpanes.cycles = True
    assert not (glass.cycles.caustics_reflective or glass.cycles.caustics_refractive)
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert sorted(item.name for item in bpy.data.images) == names
    assert glass.cycles.caustics_refractive and not glass.cycles.caustics_reflective


def test_undo(baked):
    bpy.ops.ed.undo_push(message="Baked")
    before = image()
    bpy.data.objects["Lamp"].location.x += 0.3
    update()
    moved = image()
    bpy.ops.ed.undo_push(message="Moved")
    bpy.ops.ed.undo()
    assert np.allclose(image(), before, rtol=1e-4, atol=1e-5)
    bpy.ops.ed.redo()
    assert np.allclose(image(), moved, rtol=1e-4, atol=1e-5)


def test_undoing_the_switch(baked):
    before, light = image(), image(store.IRRADIANCE)
    bpy.ops.ed.undo_push(message="Baked")
    baked.lightpanes.caustics = False
    straight = image(store.IRRADIANCE)
    assert np.abs(straight - light).max() > 0.01
    bpy.ops.ed.undo_push(message="Switched")
    bpy.ops.ed.undo()
    assert bpy.context.scene.lightpanes.caustics
    assert np.allclose(image(), before, rtol=1e-4, atol=1e-5)
    assert np.allclose(image(store.IRRADIANCE), light, rtol=1e-3, atol=1e-4)
    bpy.ops.ed.redo()
    assert store.find_image(bpy.context.scene, store.CAUSTICS) is None
    assert np.allclose(image(store.IRRADIANCE), straight, rtol=1e-3, atol=1e-4)


def test_beside_the_blend(baked, tmp_path):
    before = image()
    baked.lightpanes.storage = "BESIDE"
    scene = reopen(tmp_path)
    assert store.path_of(store.find_image(scene, store.CAUSTICS)).exists()
    assert np.array_equal(image(), before)
    update()
    bpy.data.objects["Lamp"].location.x += 0.3
    update()
    assert np.abs(image() - before).max() > 0.1 * before.max()
    assert np.abs(image() - image(store.IRRADIANCE)).max() > 0


def test_nothing_without_casters(room, monkeypatch):
    """No image, no tracing, no reading of the scene."""
    monkeypatch.setattr(caustics, "CausticAtlas", None)
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert store.find_image(room, store.CAUSTICS) is None
    assert "caustics" not in store.read_meta(room)["report"]
    monkeypatch.setattr(sessions, "shapes_of", None)
    bpy.data.objects["Lamp"].location.x += 0.1
    update()
    assert sessions.of(room).error == ""
    bpy.data.objects["Block"].location.x += 0.1
    update()
    assert store.find_image(room, store.CAUSTICS) is None


def test_what_becomes_glass_after_the_bake(room):
    block = ball(room, made=material("Clay"))
    block.lightpanes.exclude = False
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    shader = block.data.materials[0].node_tree.nodes["Principled BSDF"]
    shader.inputs["Transmission Weight"].default_value = 1.0
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert image().max() > 0.5 and caustics.held(room).casters == ("Ball",)
    shader.inputs["Transmission Weight"].default_value = 0.0
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert store.find_image(room, store.CAUSTICS) is None


def test_a_deleted_ball_and_a_deleted_image(baked):
    bpy.data.images.remove(store.find_image(baked, store.CAUSTICS))
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert image().max() > 1
    bpy.data.objects.remove(bpy.data.objects["Ball"])
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert store.find_image(baked, store.CAUSTICS) is None


def test_a_lamp_that_is_baked_in(glass, monkeypatch):
    glass.lightpanes.photons = 20_000
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    live, bounced = image(), image(store.IRRADIANCE)
    bpy.data.lights["Lamp"].lightpanes.live = False
    asked, image_of = [], CausticAtlas.image
    monkeypatch.setattr(CausticAtlas, "image", lambda self, *given: asked.append(given[1:]) or image_of(self, *given))
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert (20_000,) in asked, "its bounces take as many photons as are asked for"
    assert np.allclose(image(), live, rtol=1e-4, atol=1e-5)
    # the entries' light, caustics included, whoever brings it
    own = store.load_bake(glass).own
    assert abs(image(store.IRRADIANCE)[own].mean() / bounced[own].mean() - 1) < 0.05
    bpy.data.objects["Lamp"].location.x += 0.3
    update()
    assert np.allclose(image(), live, rtol=1e-4, atol=1e-5)


def test_two_scenes(baked):
    """A copy shares the image; clearing one leaves the other its own."""
    before = image()
    bpy.ops.scene.new(type="LINK_COPY")
    other = bpy.context.scene
    assert other != baked and caustics.is_baked(other) and np.array_equal(image(), before)
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert not caustics.is_baked(other)
    bpy.context.window.scene = baked
    assert np.array_equal(image(), before)
    bpy.data.objects["Lamp"].location.x += 0.3
    update()
    assert np.abs(image() - before).max() > 0.1 * before.max()


# ---- in a window ----


@pytest.fixture
def window(baked, unwatched, monkeypatch):
    """Changes are followed by the timer alone."""
    monkeypatch.setattr(live_image, "REST", 1e9)
    monkeypatch.setattr(caustics, "SLICE", 0.0)
    monkeypatch.setattr(caustics, "STREAM", 0.0)
    return baked


def move(x):
    bpy.data.objects["Lamp"].location.x = x
    update()
    follow()


def test_a_dragged_lamp_is_followed_coarsely_and_then_in_full(window, monkeypatch):
    before, mine = image(), caustics.held(window)
    move(0.1)
    assert np.array_equal(image(), before), "the indirect light does not wait for it"
    bounced = image(store.IRRADIANCE)
    look(lambda: mine.coarse)
    coarse = image()
    assert not mine.shown and mine.atlas is not None
    shown = []
    show = caustics._image.show
    monkeypatch.setattr(caustics._image, "show", lambda *given: shown.append(given[-1]) or show(*given))
    monkeypatch.setattr(live_image, "REST", 0.0)
    look(lambda: mine.shown)
    assert mine.asked is None and live_image.look() is None
    assert np.abs(image() - coarse).max() > 0
    assert np.abs(coarse.mean() / image().mean() - 1) < 0.2
    assert np.abs(image(store.IRRADIANCE) - bounced).max() > 1e-4, "what bounces follows it"


def test_undo_and_another_lamp_while_one_is_dragged(window, monkeypatch):
    before, mine = image(), caustics.held(window)
    bpy.ops.ed.undo_push(message="Baked")
    move(0.1)
    live_image.look()
    bpy.ops.ed.undo_push(message="Moved")
    bpy.ops.ed.undo()
    monkeypatch.setattr(live_image, "REST", 0.0)
    look(lambda: mine.work is None and live_image.look() is None)
    assert np.allclose(image(), before, rtol=1e-4, atol=1e-5)


def test_glass_that_is_dragged(window, monkeypatch):
    before, mine = image(), caustics.held(window)
    ball_ = bpy.data.objects["Ball"]
    move(0.1)
    look(lambda: mine.coarse)
    assert mine.reading > 0
    assert caustics.can_follow(window, ball_) == (mine.reading < caustics.READING)
    monkeypatch.setattr(caustics, "READING", 0.0)
    assert not caustics.can_follow(window, ball_)
    monkeypatch.setattr(caustics, "READING", 1e9)
    assert caustics.can_follow(window, ball_) and not caustics.can_follow(window, bpy.data.objects["Block"])
    ball_.location.y += 0.3
    update()
    following._glass_later()
    look(lambda: mine.coarse)
    assert np.abs(image() - before).max() > 0.1 * before.max()
    assert "'Ball' was moved or edited since the bake; bake again." in relight.check_stale(bpy.context)


@pytest.mark.parametrize("way", ["save", "images", "frame", "render"])
def test_nothing_coarse_leaves_the_window(window, tmp_path, way):
    mine = caustics.held(window)
    move(0.1)
    look(lambda: mine.coarse)
    assert not mine.shown
    if way == "save":
        scene = reopen(tmp_path)
        assert caustics.held(scene).shown
        return
    if way == "images":
        assert bpy.ops.lightpanes.save_images(directory=str(tmp_path)) == {"FINISHED"}
        assert (tmp_path / "Lightpanes Caustics.exr").exists()
    elif way == "frame":
        window.frame_set(7)
    else:
        camera(window)
        window.render.engine, window.cycles.samples = "CYCLES", 1
        render(tmp_path)
    assert mine.shown


# ---- results for others ----


def test_commands(glass, tmp_path, capsys):
    lamp = bpy.data.objects["Lamp"]
    for frame, x in ((1, -0.3), (2, 0.1), (3, 0.1)):
        lamp.location.x = x
        lamp.keyframe_insert("location", frame=frame)
    glass.frame_start, glass.frame_end = 1, 3
    glass.frame_set(1)
    glass.lightpanes.resolution = 64
    path, out = tmp_path / "room.blend", tmp_path / "out"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert commands.main(["bake", str(path), "--output", str(out), "--caustics", "on"]) == 0
    report = json.loads((out / "room_lightpanes_report.json").read_text())
    found = report["caustics"]
    assert found["casters"] == ["Ball"] and found["photons"] == 5000
    energy = found["energy"]
    rest = sum(energy[part] for part in ("landed", "absorbed", "escaped", "missed", "untraced"))
    assert energy["emitted"] == pytest.approx(rest, rel=0.02) and energy["landed"] > 0
    assert (out / "room_lightpanes_caustics.exr").exists()
    lit = str(out / "room_lightpanes.blend")
    first = image()
    assert commands.main(["relight", lit, "--frame", "2", "--output", str(out)]) == 0
    second, bounced = image(), image(store.IRRADIANCE)
    assert np.abs(second - first).max() > 0.1 * first.max()
    assert json.loads((out / "room_lightpanes_relit_report.json").read_text())["caustics"]["energy"]["landed"] > 0
    assert (out / "room_lightpanes_relit_caustics.exr").exists()
    assert commands.main(["info", lit]) == 0
    assert "caustics of Ball" in capsys.readouterr().out
    assert commands.main(["animate", lit, "--output", str(tmp_path / "frames")]) == 0
    manifest = json.loads((tmp_path / "frames" / "lightpanes_animation.json").read_text("utf-8"))
    assert manifest["schema"] == 3
    assert [frame["caustics"] for frame in manifest["frames"]] == [f"caustics_000{k}.exr" for k in (1, 2, 3)]
    for name, expected in (("caustics_0002.exr", second), ("irradiance_0003.exr", bounced)):
        written = bpy.data.images.load(str(tmp_path / "frames" / name))
        pixels = np.array(written.pixels, np.float32).reshape(64, 64, 4)[..., :3]
        assert np.allclose(pixels, expected, rtol=3e-3, atol=3e-3)


def test_the_panel_says_who_focuses_light(baked):
    drawn = draw(drawn_panel.LIGHTPANES_PT_output)
    assert "caustics" in texts(drawn, "prop")
    labels = texts(drawn, "label")
    assert "Ball" in labels
    # how many there are once some were followed
    bpy.data.objects["Lamp"].location.x += 0.1
    update()
    assert "5,000" in texts(draw(drawn_panel.LIGHTPANES_PT_output), "label")
    assert store.CAUSTICS in labels
