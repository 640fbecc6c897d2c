"""Light by group of lamps: names, images, and that they sum up to the whole."""

import json

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import commands, groups, panel, relight, sessions, store  # noqa: E402

from .drawing import Context, draw, texts  # noqa: E402
from .files import baked_once, reopen  # noqa: E402
from .test_saving import read  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


def add(scene, name, place, group="", energy=10.0):
    lamp = bpy.data.objects.new(name, bpy.data.lights.new(name, "POINT"))
    lamp.location, lamp.data.energy, lamp.data.lightpanes.group = place, energy, group
    lamp.data.shadow_soft_size = 0.0
    scene.collection.objects.link(lamp)
    return lamp


@pytest.fixture
def grouped(room):
    """Two groups of two lamps and one, one lamp of none, one that is baked in, and a sky."""
    add(room, "Key 1", (0.5, 0.5, 0.5), "Key").data.color = (1, 0.2, 0.1)
    add(room, "Key 2", (-0.5, 0.5, 0.5), "Key")
    add(room, "Fill", (0.5, -0.5, 0.5), "Fill", 5.0)
    add(room, "Baked", (-0.5, -0.5, -0.5), "Key").data.lightpanes.live = False
    room.world = bpy.data.worlds.new("Sky")
    room.world.color = (0.1, 0.2, 0.3)
    room.frame_start, room.frame_end = 1, 3
    bpy.context.view_layer.update()
    return room


@pytest.fixture(params=["TEXELS", "POINTS"])
def baked(grouped, request, saved):
    grouped.lightpanes.exits = request.param
    return baked_once(grouped, saved.with_stem(request.param))


def rgb(path):
    return read(path).reshape(-1, 4)[:, :3].astype(np.float64)


def alone(scene, *names):
    """What the bake shows with these lamps and no other."""
    for item in scene.objects:
        if item.type == "LIGHT" and item.data.lightpanes.live:
            item.hide_render = item.name not in names
    bpy.ops.lightpanes.relight()
    found = np.array(store.find_image(scene, store.IRRADIANCE).pixels).reshape(-1, 4)[:, :3]
    for item in scene.objects:
        item.hide_render = store.TAG in item
    bpy.ops.lightpanes.relight()
    return found


def test_images_by_group(baked, tmp_path):
    assert bpy.ops.lightpanes.save_images(directory=str(tmp_path), groups=True) == {"FINISHED"}
    begin = "Lightpanes Irradiance"
    names = sorted(path.name for path in tmp_path.iterdir() if path.name.startswith(begin))
    assert names == sorted([f"{begin}.exr", *(f"{begin}_{word}.exr" for word in ("Key", "Fill", "Rest", "Steady"))])
    whole = rgb(tmp_path / f"{begin}.exr")
    parts = {word: rgb(tmp_path / f"{begin}_{word}.exr") for word in ("Key", "Fill", "Rest", "Steady")}
    assert np.allclose(sum(parts.values()), whole, rtol=1e-5, atol=1e-6 * whole.max())
    steady = alone(baked)
    assert np.allclose(parts["Steady"], steady, rtol=1e-5, atol=1e-6)
    for word, lamps in (("Key", ("Key 1", "Key 2")), ("Fill", ("Fill",)), ("Rest", ("Lamp",))):
        assert parts[word].mean() > 0.02
        off = np.abs(parts[word] - (alone(baked, *lamps) - steady))
        # but where noise would bring the whole below nothing
        assert (off > 1e-5 * parts[word].max()).mean() < 1e-3


def test_by_default_there_is_the_sum_alone(baked, tmp_path):
    bpy.ops.lightpanes.save_images(directory=str(tmp_path))
    assert not [path.name for path in tmp_path.iterdir() if "_" in path.name]


def test_saving_by_group_from_a_reopened_file(baked, tmp_path):
    scene = reopen(tmp_path)
    assert sessions.of(scene).relighter is None
    bpy.ops.lightpanes.save_images(directory=str(tmp_path / ".."), groups=True)
    folder = tmp_path / ".."
    parts = sum(rgb(folder / f"Lightpanes Irradiance_{word}.exr") for word in ("Key", "Fill", "Rest", "Steady"))
    whole = rgb(folder / "Lightpanes Irradiance.exr")
    assert np.allclose(parts, whole, rtol=1e-5, atol=1e-6 * whole.max())
    for path in folder.glob("Lightpanes *.exr"):
        path.unlink()


def test_animation_by_group(baked, tmp_path):
    lamp = bpy.data.objects["Fill"]
    for frame, energy in ((1, 0.0), (2, 5.0), (3, 5.0)):
        lamp.data.energy = energy
        lamp.data.keyframe_insert("energy", frame=frame)
    assert bpy.ops.lightpanes.bake_animation(directory=str(tmp_path), groups=True) == {"FINISHED"}
    told = json.loads((tmp_path / "lightpanes_animation.json").read_text("utf-8"))
    assert told["groups"] == [
        {"group": "Fill", "part": "Fill"},
        {"group": "Key", "part": "Key"},
        {"group": None, "part": "Rest"},
    ]
    assert told["steady"] == "irradiance_Steady.exr"
    steady = rgb(tmp_path / told["steady"])
    for entry in told["frames"]:
        assert entry["groups"]["Key"] == f"irradiance_{entry['frame']:04d}_Key.exr"
        whole = rgb(tmp_path / entry["file"])
        parts = {part: rgb(tmp_path / file) for part, file in entry["groups"].items()}
        # half floats
        assert np.allclose(sum(parts.values()) + steady, whole, rtol=4e-3, atol=4e-3 * whole.max())
        assert (np.abs(parts["Fill"]).max() > 1e-3 * whole.max()) == (entry["frame"] > 1)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        ["lightpanes_animation.json", told["steady"], *[e["file"] for e in told["frames"]]]
        + [file for e in told["frames"] for file in e["groups"].values()]
        + ["direct.exr"] * bool(told["direct"])
    )


def test_the_command(grouped, tmp_path, capsys):
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    file = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    assert commands.main(["animate", str(file), "--end", "1", "--groups", "--output", str(tmp_path / "out")]) == 0
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {
        "irradiance_0001.exr",
        "irradiance_0001_Key.exr",
        "irradiance_0001_Rest.exr",
        "irradiance_Steady.exr",
    } <= names


def test_where_no_lamp_is_left(grouped, tmp_path):
    for item in grouped.objects:
        if item.type == "LIGHT":
            item.data.lightpanes.live = False
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    bpy.ops.lightpanes.save_images(directory=str(tmp_path), groups=True)
    whole, steady = (rgb(tmp_path / f"Lightpanes Irradiance{word}.exr") for word in ("", "_Steady"))
    assert np.array_equal(whole, steady) and not rgb(tmp_path / "Lightpanes Irradiance_Rest.exr").any()


def test_names_of_files():
    given = ["Key", "key", "K/ey", "K:ey", "../up", "   ", "Rest", "steady", "Büro", "CON", ".", ""]
    parts = groups.file_parts(given)
    assert parts["Key"] == "Key" and parts["key"] == "key 2" and parts["K/ey"] == "K_ey" and parts["K:ey"] == "K_ey 2"
    assert parts[""] == "Rest" and parts["Rest"] == "Rest 2" and parts["steady"] == "steady 2"
    assert parts["Büro"] == "Büro" and "/" not in parts["../up"] and "." not in parts["../up"]
    assert len({part.lower() for part in parts.values()}) == len(given)
    assert all(part.strip() for part in parts.values())


def test_spaces_around_a_name_do_not_count(room):
    room.objects["Lamp"].data.lightpanes.group = " Key "
    assert groups.in_scene(room) == ["Key"]


def test_lamps_in_instances_have_their_group(room):
    inside = bpy.data.collections.new("Inside")
    lamp = add(room, "Inner", (0, 0, 0), "Shop")
    room.collection.objects.unlink(lamp)
    inside.objects.link(lamp)
    empty = bpy.data.objects.new("Shop", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", inside
    room.collection.objects.link(empty)
    assert groups.in_scene(room) == ["Shop", ""]


def test_the_panels(grouped):
    lamp = bpy.data.lights["Lamp"]
    assert texts(draw(panel.LIGHTPANES_PT_light, Context(light=lamp)), "prop") == ["live", "group", "samples"]
    labels = [text for text in texts(draw(panel.LIGHTPANES_PT_lamps)) if text]
    assert labels == ["Fill", "Fill", "Key", "Key 1", "Key 2", "Baked", "No Group", "Lamp"]


def test_a_group_needs_no_new_bake_and_no_relight(grouped):
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    shown = sessions.of(grouped).shown
    bpy.data.lights["Lamp"].lightpanes.group = "Late"
    bpy.context.view_layer.update()
    assert sessions.of(grouped).shown == shown and not relight.check_stale(bpy.context)
    assert groups.in_scene(grouped) == ["Fill", "Key", "Late"]
