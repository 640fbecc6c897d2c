"""The points that hold a bake's light: shown, relit, moved along with their surfaces, drawn; and what the user sets."""

import json

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import colours, commands, overlay, picture, points, relight, store  # noqa: E402
from lightpanes.core.scene import SceneError  # noqa: E402

from .files import baked_once, reopen  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def baked(room, saved):
    room.lightpanes.exits = "POINTS"
    return baked_once(room, saved)


def update():
    bpy.context.view_layer.update()


def held(name, scene=None):
    return points.read(scene or bpy.context.scene, name)


def light(scene=None):
    """(n, 3) irradiance of the points."""
    return held("irradiance", scene)[:, :3]


def image(scene):
    found = store.find_image(scene, store.IRRADIANCE)
    return np.array(found.pixels, np.float32).reshape(found.size[1], found.size[0], 4)[..., :3]


def on_block():
    """(n,) bool: the points on the block."""
    names = store.read_meta(bpy.context.scene)["report"]["objects"]
    return held("object") == names.index("Block")


def test_a_texel_bake_has_no_points(room):
    room.lightpanes.exits = "TEXELS"
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert points.mesh_of(room) is None and store.read_meta(room)["report"]["exits"] == "texels"
    assert relight.check_stale(bpy.context) == ()
    with pytest.raises(SceneError, match="has no points; bake with Light At set to Points"):
        colours.read(room, "radius")


def test_points_show_the_light_that_texels_do(baked):
    """Where texels and points are near each other, and on the mean."""
    shown = light()
    assert len(shown) == store.read_meta(baked)["report"]["stored_points"] and shown.min() >= 0
    walls = ~on_block()
    lit = image(baked)[image(baked).sum(axis=2) > 0]
    # by area, a point stands for what its radius keeps free
    area = held("radius")[walls] ** 2
    mean = (shown[walls] * area[:, None]).sum(axis=0) / area.sum()
    assert np.allclose(mean, lit.mean(axis=0), rtol=0.12)
    assert shown[..., 0].mean() > 1.2 * shown[..., 2].mean()


def test_they_follow_the_lamps(baked):
    before = light()
    lamp = bpy.data.objects["Lamp"]
    lamp.data.energy *= 0.5
    update()
    assert np.allclose(light(), before / 2, rtol=1e-3, atol=1e-5)
    lamp.location.x = 0.5
    update()
    assert np.abs(2 * light() - before).max() > 0.05 * before.max()
    lamp.data.energy = 0.0
    update()
    assert light().max() == 0


def test_they_follow_after_reopening(baked, tmp_path):
    lamp = bpy.data.objects["Lamp"]
    lamp.location.x = 0.45
    update()
    expected = light()
    lamp.location.x = -0.3
    update()
    before = light()
    reopen(tmp_path)
    assert np.array_equal(light(), before)
    bpy.data.objects["Lamp"].location.x = 0.45
    update()
    assert np.allclose(light(), expected, rtol=1e-3, atol=1e-4 * expected.max())


def test_deleted_points_are_no_crash(baked):
    bpy.data.objects.remove(store.find_points(baked))
    bpy.data.lights["Lamp"].energy = 5.0
    update()
    assert relight.check_stale(bpy.context) == ()
    with pytest.raises(SceneError, match="has no points"):
        picture.draw(bpy.context, "radius")
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}


def test_a_moved_object_takes_its_points_along(baked, tmp_path):
    first, normal, mine = held("position"), held("normal"), on_block()
    bake = store.load_bake(baked)
    block = bpy.data.objects["Block"]
    block.location.x -= 0.4
    block.rotation_euler.z = np.pi / 2
    update()
    told = relight.check_stale(bpy.context)
    assert told[0] == "'Block' was moved or edited since the bake; bake again."
    share = round(100 * mine.mean())
    assert told[1].startswith(f"{share} % of the points have moved with their surfaces since the bake, by up to 0.")
    now = held("position")
    assert np.array_equal(now[~mine], first[~mine])
    # a quarter turn about the block's middle, then the move
    middle = np.array([0.3, 0.2, 0], np.float32)
    turned = (first[mine] - middle) @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], np.float32) + middle
    assert np.allclose(now[mine], turned - (0.4, 0, 0), atol=1e-5)
    turned = normal[mine] @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], np.float32)
    assert np.allclose(held("normal")[mine], turned, atol=1e-5)
    # what was baked is still known, and relights
    again = store.load_bake(baked)
    assert all(np.array_equal(bake.points[name], again.points[name]) for name in bake.points)
    assert relight.check_stale(bpy.context) == told
    bpy.data.lights["Lamp"].energy = 10.0
    update()
    assert light().max() > 0.05
    scene = reopen(tmp_path)
    assert np.array_equal(held("position"), now)
    bpy.data.lights["Lamp"].energy = 0.0
    update()
    assert light(scene).max() == 0


def test_points_go_back_with_their_object(baked):
    first = held("position")
    block = bpy.data.objects["Block"]
    for height in (0.2, 0.3):
        block.location.z += height
        update()
        relight.check_stale(bpy.context)
    assert held("position")[on_block(), 2] == pytest.approx(first[on_block(), 2] + 0.5, abs=1e-5)
    block.location.z = -0.75
    update()
    assert relight.check_stale(bpy.context) == ()
    assert np.array_equal(held("position"), first)
    assert not any(name.startswith("rest") for name in points.mesh_of(baked).attributes.keys())


def test_points_on_both_sides_follow_a_bent_sheet(room):
    """A sheet that hangs in the room has points on both sides; each stays on its own."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=8, y_subdivisions=8, size=0.8, location=(-0.4, 0.3, 0.1))
    sheet = bpy.context.object
    room.lightpanes.exits = "POINTS"
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    names = store.read_meta(room)["report"]["objects"]
    mine = held("object") == names.index(sheet.name)
    up = held("normal")[mine, 2]
    assert (up > 0.9).any() and (up < -0.9).any()
    for vertex in sheet.data.vertices:
        vertex.co.z += 0.3 * vertex.co.x
    sheet.data.update()
    update()
    told = relight.check_stale(bpy.context)
    assert "by up to 0.12 m" in told[1]
    now = held("position")[mine]
    assert np.allclose(now[:, 2], 0.1 + 0.3 * (now[:, 0] + 0.4), atol=1e-5)
    assert np.array_equal(held("normal")[mine, 2] > 0, up > 0)


def test_points_of_changed_faces_stay(baked):
    first, mine = held("position"), on_block()
    bpy.data.objects["Room"].location.z += 0.1
    block = bpy.data.objects["Block"]
    block.modifiers.new("Finer", "SUBSURF")
    update()
    told = relight.check_stale(bpy.context)
    assert np.array_equal(held("position")[mine], first[mine])
    assert np.allclose(held("position")[~mine], first[~mine] + (0, 0, 0.1), atol=1e-5)
    assert told[-1] == (
        f"{round(100 * mine.mean())} % of the points are on objects that are gone or have other faces since the bake."
    )


def test_an_animated_object_moves_its_points_at_each_look(baked):
    block = bpy.data.objects["Block"]
    for frame, z in ((1, -0.75), (5, 0.0)):
        block.location.z = z
        block.keyframe_insert("location", frame=frame)
    baked.frame_set(5)
    relight.check_stale(bpy.context)
    assert held("position")[on_block(), 2].max() == pytest.approx(0.25, abs=1e-3)
    baked.frame_set(1)
    assert relight.check_stale(bpy.context) == ()


def test_what_does_not_move_reads_nothing(baked, monkeypatch):
    def fail(*_, **__):
        raise AssertionError("the scene was read")

    bpy.data.objects["Block"].location.z += 0.1
    update()
    told = relight.check_stale(bpy.context)
    monkeypatch.setattr(relight.extract, "extract", fail)
    assert relight.check_stale(bpy.context) == told


@pytest.fixture
def file(baked, tmp_path):
    path = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def read_png(path):
    found = bpy.data.images.load(str(path))
    return np.array(found.pixels, np.float32).reshape(found.size[1], found.size[0], -1)[..., :3]


def test_pictures(file, tmp_path, capsys, monkeypatch):
    """Fitted from outside: the room is closed, and still one sees into it."""
    monkeypatch.setattr(picture, "LONGER", 400)
    out = tmp_path / "out"
    report = tmp_path / "report.json"
    assert commands.main(["info", "--points", str(file), "--output", str(out), "--json", str(report)]) == 0
    assert json.loads(report.read_text())["picture"] == str(out / "room_points.png")
    assert [path.name for path in out.iterdir()] == ["room_points.png"]
    shown = read_png(out / "room_points.png")
    assert max(shown.shape[:2]) == picture.LONGER
    vivid = np.ptp(shown[colours.LEGEND :], axis=2) > 0.2
    assert 0.005 < vivid.mean() < 0.5
    assert "Wrote" in capsys.readouterr().out
    for kind in ("ao", "irradiance"):
        assert commands.main(["info", str(file), "--points", kind, "--output", str(out)]) == 0
        assert not np.array_equal(read_png(out / "room_points.png"), shown)


def test_only_points_that_the_camera_sees_are_drawn(baked):
    """From outside: the wall that is nearest faces away and hides nothing; the block hides what is behind it."""
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    baked.collection.objects.link(camera)
    baked.camera = camera
    baked.render.resolution_x, baked.render.resolution_y = 200, 100
    camera.location, camera.rotation_euler = (0.3, -4, -0.75), (np.pi / 2, 0, 0)
    update()
    where = [held(name) for name in ("position", "normal", "radius")]
    view = picture.view_of(bpy.context, where[0])
    assert (view.width, view.height) == (picture.FINER * 1280, picture.FINER * 640)
    surfaces = relight.extract.extract(bpy.context, resolution=16, looks=False)
    rows, far = picture.seen(view, picture.Lit(surfaces, *where), *where)
    place = where[0][rows]
    assert far.min() > 2.5 and (where[1][rows, 1] < 0.5).all()
    block = on_block()
    assert block[rows].sum() == (block & (where[1][:, 1] < -0.5)).sum(), "its front, all of it and no more"
    behind = (np.abs(place[:, 0] - 0.3) < 0.25) & (np.abs(place[:, 2] + 0.75) < 0.25)
    assert not (behind & (place[:, 1] > 0.5)).any()
    assert (place[:, 1] > 0.99).any()


def test_bad_kinds_of_picture(file, capsys):
    assert commands.main(["info", "--points", "depth", str(file)]) == 2
    assert "invalid choice: 'depth'" in capsys.readouterr().err


def test_exits_on_the_command_line(room, tmp_path):
    path = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    report = tmp_path / "report.json"
    words = ["bake", str(path), "--error", "0.5", "--exits", "points", "--json", str(report)]
    assert commands.main(words) == 0
    said = json.loads(report.read_text())
    assert said["exits"] == "points" and said["settings"]["exits"] == "points" and said["stored_points"] > 100
    assert bpy.context.scene.lightpanes.exits == "POINTS"


def test_scales():
    scale = colours.Scale(0.01, 1.0, True)
    shown = scale.colours(np.array([0.001, 0.01, 0.1, 1.0, 7.0]))
    assert np.array_equal(shown[0], shown[1]) and np.array_equal(shown[3], shown[4])
    # lightness rises all the way
    assert (np.diff(shown[1:4].sum(axis=1)) > 0.2).all()
    assert all(0.01 <= tick <= 1 for tick in scale.ticks()) and len(scale.ticks()) >= 3
    assert colours.Scale(0.5, 0.5005, True).ticks()


def test_the_viewport_draws_points_where_they_are(baked):
    place, colour = overlay.arrays(baked, "ao")
    assert place.shape == (len(light()), 3) and colour.shape == (len(light()), 4)
    assert np.allclose(place, held("position"), atol=0.05) and colour.min() >= 0 and colour.max() <= 1
    for kind in ("RADIUS", "AO", "IRRADIANCE"):
        baked.lightpanes.show_points = kind  # harmless without a window
    before = overlay._key(baked, "IRRADIANCE")
    bpy.data.lights["Lamp"].energy = 5.0
    update()
    assert overlay._key(baked, "IRRADIANCE") != before
