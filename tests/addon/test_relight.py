"""The light follows the lamps: on every kind of change, after reopening, in animation renders, and never into a crash."""

import itertools

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import relight, sessions, store  # noqa: E402
from lightpanes.core.scene import SceneError  # noqa: E402

from .files import baked_once, reopen  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def baked(room, saved):
    return baked_once(room, saved)


def image(scene=None):
    """(H, W, 3) what `Lightpanes Irradiance` shows."""
    found = store.find_image(scene or bpy.context.scene, store.IRRADIANCE)
    pixels = np.empty(len(found.pixels), np.float32)
    found.pixels.foreach_get(pixels)
    return pixels.reshape(found.size[1], found.size[0], 4)[..., :3]


def update():
    bpy.context.view_layer.update()


def test_baking_lights_the_room(baked):
    shown = image()
    assert np.isfinite(shown).all() and shown.max() > 0.1
    # more red than blue: the walls are
    assert shown[..., 0].mean() > 1.2 * shown[..., 2].mean()


def test_dimming_and_recolouring(baked):
    before = image()
    lamp = bpy.data.lights["Lamp"]
    lamp.energy *= 0.5
    update()
    assert np.allclose(image(), before / 2, rtol=1e-4, atol=1e-6)
    lamp.color = (1, 0, 0)
    update()
    shown = image()
    assert np.allclose(shown[..., 0], before[..., 0] / 2, rtol=1e-4, atol=1e-6)
    assert shown[..., 1:].max() == 0


def test_moving(baked):
    before = image()
    lamp = bpy.data.objects["Lamp"]
    lamp.location.x = 0.5
    update()
    moved = image()
    assert np.abs(moved - before).max() > 0.05 * before.max()
    lamp.location.x = -0.3
    update()
    assert np.allclose(image(), before, rtol=1e-5, atol=1e-6)


def test_moving_a_parent(baked):
    parent = bpy.data.objects.new("Parent", None)
    baked.collection.objects.link(parent)
    bpy.data.objects["Lamp"].parent = parent
    update()
    before = image()
    parent.location.x = 0.4
    update()
    assert np.abs(image() - before).max() > 0.05 * before.max()


@pytest.mark.parametrize("how", ["render", "collection", "delete", "unlink"])
def test_hiding_and_deleting_the_only_lamp(baked, how):
    lamp = bpy.data.objects["Lamp"]
    if how == "render":
        lamp.hide_render = True
    elif how == "collection":
        bpy.data.collections.new("Lamps").objects.link(lamp)
        baked.collection.children.link(bpy.data.collections["Lamps"])
        baked.collection.objects.unlink(lamp)
        bpy.data.collections["Lamps"].hide_render = True
    elif how == "delete":
        bpy.data.objects.remove(lamp)
    else:
        baked.collection.objects.unlink(lamp)
    update()
    assert image().max() == 0


@pytest.mark.parametrize("how", ["screen", "eye"])
def test_hiding_in_the_viewport(baked, monkeypatch, how):
    """Renders show what only the viewport hides, a viewport does not."""
    before = image()
    lamp = bpy.data.objects["Lamp"]

    def hide(hidden):
        if how == "screen":
            lamp.hide_viewport = hidden
        else:
            lamp.hide_set(hidden)
        update()

    hide(True)
    assert np.array_equal(image(), before)
    hide(False)
    monkeypatch.setattr(relight, "_is_viewport", lambda depsgraph: True)
    hide(True)
    assert image().max() == 0
    add_camera(baked)
    rendered = []
    bpy.app.handlers.render_pre.append(lambda scene, *_: rendered.append(image(scene)))
    try:
        bpy.ops.render.render()
    finally:
        bpy.app.handlers.render_pre.pop()
    assert np.array_equal(rendered[0], before)
    relight.update(baked, bpy.context.evaluated_depsgraph_get())
    assert image().max() == 0


def test_showing_again(baked):
    before = image()
    lamp = bpy.data.objects["Lamp"]
    for hidden in (True, False):
        lamp.hide_render = hidden
        update()
    assert np.array_equal(image(), before)


def test_adding_lamps_adds_light(baked):
    """Light is linear: two lamps give the sum of what each gives."""
    first = image()
    lamp = bpy.data.objects["Lamp"]
    second = bpy.data.objects.new("Second", bpy.data.lights.new("Second", "SPOT"))
    second.data.energy, second.data.spot_size = 15, 2.0
    second.location = (0.4, -0.5, 0.2)
    baked.collection.objects.link(second)
    update()
    both = image()
    lamp.hide_render = True
    update()
    # where neither lamp's noise dips below nothing, which is clamped
    lit = (first > 0.1) & (image() > 0.1)
    assert lit.mean() > 0.5
    assert np.allclose((first + image())[lit], both[lit], rtol=1e-4)


def test_nothing_changes_nothing(baked):
    lights = bpy.context.evaluated_depsgraph_get()
    assert not relight.update(baked, lights)
    baked.render.fps = 30
    bpy.data.objects["Lamp"].data.energy += 0
    update()
    assert not relight.update(baked, bpy.context.evaluated_depsgraph_get())


def test_not_live_until_asked(baked):
    before = image()
    baked.lightpanes.live = False
    bpy.data.lights["Lamp"].energy = 0.0
    update()
    assert np.array_equal(image(), before)
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert image().max() == 0


def test_switching_live_on_catches_up(baked):
    baked.lightpanes.live = False
    bpy.data.lights["Lamp"].energy = 0.0
    update()
    baked.lightpanes.live = True
    assert image().max() == 0


def test_a_lamp_that_is_not_live_stays(room):
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    before = image()
    lamp = bpy.data.lights["Lamp"]
    lamp.lightpanes.live = False
    update()
    lamp.energy = 1.0
    update()
    assert np.array_equal(image(), before)
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert np.allclose(image(), before / 20, rtol=1e-4, atol=1e-6)


def animate(scene):
    lamp = bpy.data.objects["Lamp"]
    for frame, x in ((1, -0.5), (3, 0.5)):
        lamp.location.x = x
        lamp.keyframe_insert("location", frame=frame)


def test_frames(baked):
    animate(baked)
    shown = []
    for frame in (1, 2, 3):
        baked.frame_set(frame)
        shown.append(image().copy())
    assert all(np.abs(a - b).max() > 0.02 * a.max() for a, b in itertools.pairwise(shown))
    baked.frame_set(1)
    assert np.allclose(image(), shown[0], rtol=1e-5, atol=1e-6)


def test_each_frame_of_a_render_shows_its_own_light(baked, tmp_path):
    """No light but ours, from a lamp that Cycles does not see: frames differ only if the image was new in time."""
    animate(baked)
    lamp = bpy.data.lights["Lamp"]
    lamp.cycles.max_bounces = 0
    add_camera(baked)
    baked.lightpanes.cycles = baked.render.use_persistent_data = True
    baked.frame_start, baked.frame_end = 1, 3
    seen = {}

    def expect(scene, *_):
        seen[scene.frame_current] = image(scene).mean()

    bpy.app.handlers.render_post.append(expect)
    baked.render.image_settings.file_format = "OPEN_EXR"
    baked.render.filepath = str(tmp_path / "frame_")
    try:
        bpy.ops.render.render(animation=True)
    finally:
        bpy.app.handlers.render_post.remove(expect)
    frames = {}
    for frame in (1, 2, 3):
        picture = bpy.data.images.load(str(tmp_path / f"frame_{frame:04d}.exr"))
        frames[frame] = np.array(picture.pixels, np.float32)
    assert len({round(float(v), 5) for v in seen.values()}) == 3
    assert np.abs(frames[1] - frames[3]).max() > 0.01


def add_camera(scene):
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    camera.location, camera.rotation_euler = (0, -0.9, 0), (np.pi / 2, 0, 0)
    scene.camera, scene.render.engine, scene.cycles.samples = camera, "CYCLES", 1
    scene.render.resolution_x = scene.render.resolution_y = 16


def test_relights_after_reopening(baked, tmp_path):
    """The .blend alone gives the same light as the session that baked it."""
    lamp = bpy.data.objects["Lamp"]
    lamp.location.x = 0.45
    update()
    expected = image().copy()
    lamp.location.x = -0.3
    update()
    reopen(tmp_path)
    bpy.data.objects["Lamp"].location.x = 0.45
    update()
    # the room is closed and diffuse; the atlas' shadow rays are traced anew
    assert np.allclose(image(), expected, rtol=1e-3, atol=1e-4 * expected.max())


def test_opening_computes_nothing(baked, tmp_path):
    before = image().copy()
    scene = reopen(tmp_path)
    update()
    assert np.array_equal(image(), before)
    assert sessions.of(scene).relighter is None


def test_two_scenes(baked):
    """Each scene's lamps light its own image."""
    before = image().copy()
    bpy.ops.scene.new(type="FULL_COPY")
    copy = bpy.context.scene
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    for item in copy.objects:
        if item.type == "LIGHT":
            item.data.energy = 0.0
    update()
    assert image(copy).max() == 0
    assert np.array_equal(image(baked), before)


def test_undo_and_redo(baked):
    bpy.ops.ed.undo_push(message="Baked")
    before = image().copy()
    bpy.data.lights["Lamp"].energy = 5.0
    update()
    bpy.ops.ed.undo_push(message="Dimmed")
    bpy.ops.ed.undo()
    assert bpy.data.lights["Lamp"].energy == 20
    assert np.allclose(image(), before, rtol=1e-5, atol=1e-6)
    bpy.ops.ed.redo()
    assert np.allclose(image(), before / 4, rtol=1e-4, atol=1e-6)


def test_edited_objects_are_named(baked):
    assert relight.check_stale(bpy.context) == ()
    bpy.data.objects["Block"].location.x += 0.1
    update()
    assert relight.check_stale(bpy.context) == ("'Block' was moved or edited since the bake; bake again.",)
    bpy.data.objects["Block"].location.x -= 0.1
    update()
    bpy.ops.mesh.primitive_cube_add(size=0.1)
    assert relight.check_stale(bpy.context) == ("'Cube' was added since the bake; bake again.",)


def test_deleted_object_is_named_and_light_still_follows(baked, tmp_path):
    bpy.data.objects.remove(bpy.data.objects["Block"])
    reopen(tmp_path)
    bpy.data.lights["Lamp"].energy = 0.0
    update()
    assert image().max() == 0
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    assert sessions.of(bpy.context.scene).stale == ("'Block' was deleted or hidden since the bake; bake again.",)


@pytest.mark.parametrize("way", ["undo", "delete"])
def test_what_was_there_for_a_while_leaves_no_shadow(baked, tmp_path, way):
    """A reopened file reads its surfaces at the first relight, with whatever has been added by then."""
    right = image()
    reopen(tmp_path)
    bpy.ops.ed.undo_push(message="Open")
    copy = bpy.data.objects["Block"].copy()
    copy.location = (-0.3, -0.2, 0.2)
    bpy.context.collection.objects.link(copy)
    update()
    relight.relight(bpy.context)
    assert np.abs(image() - right).max() > 0.05 * right.max(), "the copy is right under the lamp"
    bpy.ops.ed.undo_push(message="Copy")
    if way == "undo":
        bpy.ops.ed.undo()
    else:
        bpy.data.objects.remove(copy)
        update()
        assert relight.check_stale(bpy.context) == ()
        relight.update(bpy.context.scene, bpy.context.evaluated_depsgraph_get())
    assert np.allclose(image(), right, rtol=1e-3, atol=1e-4)


def test_all_meshes_deleted(baked, tmp_path, capfd):
    for name in ("Block", "Room"):
        bpy.data.objects.remove(bpy.data.objects[name])
    reopen(tmp_path)
    bpy.data.lights["Lamp"].energy = 1.0
    update()
    message = "All meshes of the bake are deleted or hidden; bring them back, or press Clear."
    assert sessions.of(bpy.context.scene).error == message
    update()
    assert capfd.readouterr().out.count(message) == 1
    with pytest.raises(RuntimeError, match=message):
        bpy.ops.lightpanes.relight()


@pytest.mark.parametrize("role", ["Lightpanes Panes", "Lightpanes Irradiance"])
def test_deleted_images(baked, role, tmp_path):
    bpy.data.images.remove(store.find_image(baked, role))
    reopen(tmp_path)
    bpy.data.lights["Lamp"].energy = 1.0
    update()
    with pytest.raises(RuntimeError, match=rf"{role}.*bake again"):
        bpy.ops.lightpanes.relight()


def test_no_bake(room):
    with pytest.raises(SceneError, match=r"Scene 'Scene' has no bake; press Bake first\."):
        relight.relight(bpy.context)


def edit(name="Block"):
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.objects.active = bpy.data.objects[name]
    bpy.ops.object.mode_set(mode="EDIT")


def leave():
    bpy.ops.object.mode_set(mode="OBJECT")
    update()


def test_in_edit_mode(baked):
    """Nothing has changed yet, and lamps still shine."""
    before = image().copy()
    edit()
    update()
    assert relight.check_stale(bpy.context) == ()
    bpy.data.lights["Lamp"].energy *= 2
    relight.relight(bpy.context)
    assert np.allclose(image(), 2 * before, rtol=1e-4, atol=1e-6)
    leave()
    assert relight.check_stale(bpy.context) == ()


@pytest.mark.parametrize("shared", [False, True])
def test_edited_in_edit_mode(baked, tmp_path, shared):
    """It is told afterwards, and shadows of a shape that is gone again go, too."""
    if shared:
        twin = bpy.data.objects.new("Twin", bpy.data.objects["Block"].data)
        baked.collection.objects.link(twin)
        twin.location = (-0.5, 0.5, 0.5)
        update()
        bpy.ops.lightpanes.bake()
    before = image().copy()
    scene = reopen(tmp_path)
    edit()
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.translate(value=(0, 0, 0.5))
    bpy.data.lights["Lamp"].energy *= 1.0001
    relight.relight(bpy.context)
    leave()
    assert "'Block' was moved or edited since the bake; bake again." in relight.check_stale(bpy.context)
    edit()
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.translate(value=(0, 0, -0.5))
    leave()
    bpy.data.lights["Lamp"].energy /= 1.0001
    relight.relight(bpy.context)
    relight.relight(bpy.context)
    assert np.allclose(image(scene), before, rtol=1e-3, atol=1e-5)


def test_light_at_vertices_after_edit_mode(room):
    block = bpy.data.objects["Block"]
    block.lightpanes.target = "VERTICES"
    bpy.ops.lightpanes.bake()

    def light():
        return np.array([tuple(value.color) for value in block.data.attributes["lightpanes_irradiance"].data])[:, :3]

    before = light()
    edit()
    bpy.data.lights["Lamp"].energy *= 2
    update()
    assert not sessions.of(room).error
    leave()
    assert np.allclose(light(), 2 * before, rtol=1e-4, atol=1e-6)
