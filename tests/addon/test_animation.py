"""Animations: the images that are written for engines hold each frame's own light, and so does each rendered frame."""

import json

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import animation, commands, extract, relight, sequence, sessions, store  # noqa: E402
from lightpanes.core.panes import Relighter  # noqa: E402
from lightpanes.core.rays import Tracer  # noqa: E402
from lightpanes.core.scene import SceneError  # noqa: E402

from .files import REFUSES, baked_once, empty, needs_a_refusing_folder, reopen  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")

HALF = 2.0**-11
"""Relative error of a half float."""


@pytest.fixture
def moving(room):
    """The room, whose lamp moves from frame 1 to 3 and is a quarter as bright from frame 4 on; frame 3 lasts to 3.5."""
    lamp = bpy.data.objects["Lamp"]
    for frame, x in ((1, -0.5), (3, 0.5), (4, 0.5)):
        lamp.location.x = x
        lamp.keyframe_insert("location", frame=frame)
    for frame, energy in ((3, 20.0), (4, 5.0)):
        lamp.data.energy = energy
        lamp.data.keyframe_insert("energy", frame=frame)
    room.frame_start, room.frame_end = 1, 5
    room.frame_set(2)
    return room


@pytest.fixture
def baked(moving, saved):
    return baked_once(moving, saved)


def shown(scene=None):
    """(H, W, 3) of what `Lightpanes Irradiance` shows."""
    return pixels_of(store.find_image(scene or bpy.context.scene, store.IRRADIANCE))


def pixels_of(image):
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], 4)[..., :3]


def load(path):
    """(H, W, 3) of a file, as Blender reads it."""
    image = bpy.data.images.load(str(path))
    try:
        return pixels_of(image)
    finally:
        bpy.data.images.remove(image)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def manifest(folder):
    return json.loads((folder / "lightpanes_animation.json").read_text("utf-8"))


def write(folder, **options):
    return bpy.ops.lightpanes.bake_animation(directory=str(folder), **options)


def refused(folder, **options):
    """What the user reads."""
    with pytest.raises(RuntimeError) as caught:
        write(folder, **options)
    return str(caught.value).strip().removeprefix("Error: ")


def test_each_image_is_what_core_makes_of_that_frame(baked, tmp_path):
    """Against relighters made anew, from the stored bake and the scene as it is at that frame."""
    assert write(tmp_path / "out") == {"FINISHED"}
    bake, different = store.load_bake(baked), []
    for frame in range(1, 6):
        baked.frame_set(frame)
        surfaces = extract.extract(bpy.context, resolution=bake.resolution, albedo=False)
        expected = Relighter(bake.panes(), Tracer(surfaces)).relight(surfaces.lights)[..., :3]
        found = load(tmp_path / "out" / f"irradiance_{frame:04d}.exr")
        assert found.max() > 0.05
        assert np.allclose(found, expected, rtol=1.01 * HALF, atol=1e-7)
        different.append(round(float(found.mean()), 5))
    assert len(set(different[:4])) == 4 and different[3] == different[4]


def test_each_image_is_what_the_operator_relight_shows(baked, tmp_path):
    baked.lightpanes.live = False
    write(tmp_path, frame_start=3, frame_end=4)
    images = {}
    for frame in (3, 4):
        baked.frame_set(frame)
        bpy.ops.lightpanes.relight()
        images[frame] = load(tmp_path / f"irradiance_{frame:04d}.exr")
        assert np.allclose(images[frame], shown(), rtol=1.01 * HALF, atol=1e-7)
    assert np.allclose(images[4], images[3] / 4, rtol=1e-2, atol=1e-5)


def test_what_stands_beside_the_images(baked, tmp_path):
    baked.render.fps, baked.render.fps_base = 30, 1.001
    assert write(tmp_path, frame_start=-2, frame_end=4, frame_step=3) == {"FINISHED"}
    files = ["irradiance_-0002.exr", "irradiance_0001.exr", "irradiance_0004.exr"]
    assert names(tmp_path) == sorted([*files, "lightpanes_animation.json"])
    said = manifest(tmp_path)
    assert said["schema"] == 1 and said["unit"] == "W/m²" and said["uv_layer"] == "Lightpanes"
    assert said["frames"] == [{"frame": f, "file": n} for f, n in zip((-2, 1, 4), files, strict=True)]
    assert said["fps"] == pytest.approx(29.97, abs=1e-3) and said["resolution"] == [64, 64]
    assert said["direct"] is None and said["without_texture"] == [] and said["warnings"] == []
    places = {item["name"]: item for item in said["objects"]}
    assert sorted(places) == ["Block", "Room"]
    for name, item in places.items():
        assert item["scale"] == list(bpy.data.objects[name]["lightpanes_scale"])
        assert item["offset"] == list(bpy.data.objects[name]["lightpanes_offset"])


def test_an_engine_finds_an_objects_light_by_what_is_said(baked, tmp_path):
    """The floor under the lamp is brighter than the ceiling's corner; looked up by UV × scale + offset alone."""
    write(tmp_path, frame_start=3, frame_end=3)
    place = next(item for item in manifest(tmp_path)["objects"] if item["name"] == "Block")
    mesh = bpy.data.objects["Block"].data
    uv = np.empty(2 * len(mesh.loops), np.float32)
    mesh.uv_layers[manifest(tmp_path)["uv_layer"]].uv.foreach_get("vector", uv)
    light = load(tmp_path / "irradiance_0003.exr")
    means = {}
    for face in mesh.polygons:
        middle = uv.reshape(-1, 2)[list(face.loop_indices)].mean(axis=0) * place["scale"] + place["offset"]
        column, row = (middle * 64).astype(int)
        means[tuple(round(v) for v in face.normal)] = light[row, column].mean()
    # the block stands on the floor, where no light comes
    assert means[0, 0, 1] > 5 * means[0, 0, -1]


def test_scene_range_and_folder_beside_the_file(baked, tmp_path):
    baked.frame_start, baked.frame_end, baked.frame_step = 1, 4, 3
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    assert bpy.ops.lightpanes.bake_animation() == {"FINISHED"}
    assert [entry["frame"] for entry in manifest(tmp_path / "lightpanes_irradiance")["frames"]] == [1, 4]


@pytest.mark.parametrize("live", [True, False])
def test_frame_and_light_are_as_before(baked, tmp_path, live):
    baked.lightpanes.live = live
    baked.frame_set(2, subframe=0.25)
    before = shown()
    assert write(tmp_path) == {"FINISHED"}
    assert (baked.frame_current, baked.frame_subframe) == (2, 0.25)
    assert np.allclose(shown(), before, rtol=1e-5, atol=1e-7) if live else np.array_equal(shown(), before)


def test_from_a_reopened_file(baked, tmp_path):
    write(tmp_path / "a")
    scene = reopen(tmp_path)
    assert sessions.of(scene).relighter is None
    write(tmp_path / "b")
    for number in (1, 4):
        name = f"irradiance_{number:04d}.exr"
        first, second = load(tmp_path / "a" / name), load(tmp_path / "b" / name)
        assert np.allclose(first, second, rtol=2e-3, atol=1e-4 * first.max())


class Stop(Exception):
    pass


@pytest.mark.parametrize("at", [0.0, 0.5, 1.0])
def test_stopped_midway_nothing_has_changed(baked, tmp_path, at):
    write(tmp_path / "old", frame_start=3)
    before = {path.name: path.read_bytes() for path in (tmp_path / "old").iterdir()}
    light = shown()

    def stop(step):
        if step.fraction >= at:
            raise Stop

    for folder in ("old", "new"):
        with pytest.raises(Stop):
            sequence.write(bpy.context, tmp_path / folder, range(1, 6), stop)
    assert {path.name: path.read_bytes() for path in (tmp_path / "old").iterdir()} == before
    assert names(tmp_path) == ["old"]
    assert baked.frame_current == 2 and np.allclose(shown(), light, rtol=1e-5, atol=1e-7)


def test_progress_goes_up_and_ends(baked, tmp_path):
    seen = []
    sequence.write(bpy.context, tmp_path, range(1, 4), lambda step: seen.append(step.fraction))
    assert seen == sorted(seen) and seen[0] == 0 and seen[-1] == 1
    assert not animation.running() and animation.progress() == 0


def test_an_earlier_run_is_replaced_and_what_it_leaves_is_named(baked, tmp_path, capfd):
    write(tmp_path)
    (tmp_path / "irradiance_0001.exr").write_bytes(b"old")
    write(tmp_path, frame_end=3)
    told = f"'{tmp_path}' also holds 'irradiance_0004.exr' and 1 more of an earlier run"
    assert told in manifest(tmp_path)["warnings"][0] and told in capfd.readouterr().out
    assert (tmp_path / "irradiance_0001.exr").stat().st_size > 1000
    assert len(manifest(tmp_path)["frames"]) == 3


@needs_a_refusing_folder
def test_a_folder_that_refuses(baked):
    assert refused(f"{REFUSES}/lightpanes").startswith(f"Can't write to folder '{REFUSES}/lightpanes': ")
    assert baked.frame_current == 2


def test_a_file_where_the_folder_should_be(baked, tmp_path):
    (tmp_path / "out").write_text("mine")
    assert refused(tmp_path / "out").startswith(f"Can't write to folder '{tmp_path / 'out'}': File exists.")
    assert (tmp_path / "out").read_text() == "mine"


def test_a_full_disk(baked, tmp_path, monkeypatch):
    def full(path, picture):
        path.write_bytes(b"half of it")
        yield 0.5
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(sequence.exr, "writing", full)
    folder = tmp_path / "out"
    assert refused(folder) == f"Can't write to '{folder}': No space left on device. Choose another folder."
    assert not folder.exists() and baked.frame_current == 2


def test_a_frame_is_relit_once(baked, tmp_path, monkeypatch):
    """For its file; the image that the user sees stays, and shows the frame at which the scene stands."""
    calls, light = [], Relighter.light
    monkeypatch.setattr(Relighter, "light", lambda self, lamps: (calls.append(1), light(self, lamps))[1])
    relight.relight(bpy.context)
    before = shown().copy()
    calls.clear()
    seen = []
    sequence.write(bpy.context, tmp_path, range(1, 5), lambda _: seen.append(np.array_equal(shown(), before)))
    assert len(calls) == 4 and all(seen) and np.array_equal(shown(), before)
    baked.frame_set(4)
    assert len(calls) == 5 and not np.allclose(shown(), before, rtol=0.1)


def test_all_files_or_none(baked, tmp_path, monkeypatch):
    """Where one can't be moved, those of an earlier run come back."""
    write(tmp_path, frame_end=2)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    bpy.data.lights["Lamp"].animation_data_clear()
    bpy.data.lights["Lamp"].energy = 3
    (tmp_path / "irradiance_0003.exr").mkdir()
    refused(tmp_path)
    (tmp_path / "irradiance_0003.exr").rmdir()
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_file_that_cannot_be_replaced(baked, tmp_path):
    """The manifest is the last to be moved: it never names what is not there."""
    (tmp_path / "irradiance_0003.exr").mkdir()
    assert f"'{tmp_path / 'irradiance_0003.exr'}'" in refused(tmp_path)
    assert not [name for name in names(tmp_path) if "json" in name or name.startswith(".")]


def test_no_bake(room, tmp_path):
    assert refused(tmp_path / "out") == "Scene 'Scene' has no bake; press Bake first."
    assert names(tmp_path) == []


def test_an_unsaved_file(baked, tmp_path):
    empty()
    told = refused("//lightpanes_irradiance/")
    assert told.startswith(
        "The folder '//lightpanes_irradiance/' lies beside the .blend, which has not been saved yet."
    )
    assert refused("  ") == "No folder is named for the images; name one."


def test_no_frames(baked, tmp_path):
    told = "The last frame, 2, is before the first, 5; name them the other way round."
    assert refused(tmp_path, frame_start=5, frame_end=2) == told


@pytest.mark.parametrize("how", ["clear", "bake", "leave"])
def test_another_bake_meanwhile(moving, tmp_path, how):
    bpy.ops.lightpanes.bake()
    steps = sequence.writing(bpy.context, tmp_path / "out", range(1, 6))
    while next(steps).fraction < 0.4:
        pass
    if how == "leave":
        bpy.context.window.scene = bpy.data.scenes.new("Other")
    else:
        moving.lightpanes.seed = 5
        getattr(bpy.ops.lightpanes, how)()
    with pytest.raises(SceneError, match="'Scene' was left, or its bake replaced or cleared, meanwhile; start again"):
        list(steps)
    assert names(tmp_path) == [] and moving.frame_current == 2


def test_the_first_hit_of_emissive_faces_is_written_once(moving, tmp_path):
    shader = bpy.data.materials["Block"].node_tree.nodes["Principled BSDF"]
    shader.inputs["Emission Color"].default_value = (1, 0.5, 0, 1)
    shader.inputs["Emission Strength"].default_value = 3
    bpy.ops.lightpanes.bake()
    scene = reopen(tmp_path)
    write(tmp_path / "out", frame_end=2)
    assert manifest(tmp_path / "out")["direct"] == "direct.exr"
    found, expected = load(tmp_path / "out" / "direct.exr"), pixels_of(store.find_image(scene, store.DIRECT))
    assert expected.max() > 1 and np.allclose(found, expected, rtol=HALF, atol=1e-7)


def test_objects_lit_at_vertices_are_named(moving, tmp_path, capfd):
    bpy.data.objects["Block"].lightpanes.target = "VERTICES"
    bpy.ops.lightpanes.bake()
    assert write(tmp_path / "out", frame_end=1) == {"FINISHED"}
    assert "Lit at their vertices, which images don't hold: 'Block'." in capfd.readouterr().out
    said = manifest(tmp_path / "out")
    assert said["without_texture"] == ["Block"] and [item["name"] for item in said["objects"]] == ["Room"]
    bpy.data.objects["Room"].lightpanes.target = "VERTICES"
    bpy.ops.lightpanes.bake()
    assert "No object of this bake has a texture ('Block', 'Room' lit at vertices)." in refused(tmp_path / "more")


def test_lamps_that_are_baked_in_and_objects_that_move_are_named(moving, tmp_path):
    block = bpy.data.objects["Block"]
    bpy.data.lights["Lamp"].lightpanes.live = False
    bpy.ops.lightpanes.bake()
    for frame, z in ((2, -0.75), (5, -0.5)):
        block.location.z = z
        block.keyframe_insert("location", frame=frame)
    write(tmp_path, frame_start=2)
    assert manifest(tmp_path)["warnings"] == [
        "This bake has no live lamp, so all frames show the same light.",
        "Lamp 'Lamp' is baked in: that it is another at frame 3 does not show. Switch on Live in its own tab and bake "
        "again.",
        "'Block' is not as it was baked at frame 4; the light around it stays as baked.",
    ]
    first, last = (load(tmp_path / f"irradiance_{frame:04d}.exr") for frame in (2, 5))
    assert np.array_equal(first, last) and first.max() > 0.05


def test_dim_scenes_keep_their_light(baked, tmp_path):
    """Far below what half floats hold: scenes in millimetres, say."""
    action = bpy.data.lights["Lamp"]
    action.animation_data_clear()
    action.energy = 2e-6
    write(tmp_path, frame_start=2, frame_end=2)
    found = load(tmp_path / "irradiance_0002.exr")
    bpy.ops.lightpanes.relight()
    assert np.array_equal(found, shown()) and 0 < found.max() < 1e-6


def animate(*words):
    return commands.main(["animate", *map(str, words)])


@pytest.fixture
def file(baked, tmp_path):
    path = tmp_path / "room_lightpanes.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def test_command(file, tmp_path, capsys):
    original, report = file.read_bytes(), tmp_path / "report.json"
    assert animate(file, "--output", tmp_path / "out", "--start", 2, "--end", "4", "--step", 2, "--json", report) == 0
    assert names(tmp_path / "out") == ["irradiance_0002.exr", "irradiance_0004.exr", "lightpanes_animation.json"]
    said, beside = json.loads(report.read_text("utf-8")), manifest(tmp_path / "out")
    assert {key: said[key] for key in beside} == beside and said["input"] == str(file)
    assert said["file"] == str(tmp_path / "out" / "lightpanes_animation.json")
    assert f"Wrote 2 frames to {tmp_path / 'out'}" in capsys.readouterr().out
    assert file.read_bytes() == original


def test_command_beside_the_file_and_in_blender(file):
    assert commands.main(["animate"], opened=True) == 0
    assert len(manifest(file.parent / "lightpanes_irradiance")["frames"]) == 5
    assert bpy.context.scene.frame_current == 2


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--start", "5", "--end", "2"], "The last frame, 2, is before the first, 5; name them the other way round."),
        (["--step", "0"], "argument --step: '0' is not a whole number from 1 to 1000000"),
        (["--start", "1.5"], "argument --start: '1.5' is not a whole number from -1048574 to 1048574"),
        (["--json", "/none/report.json"], "Can't write the report to '/none/report.json': its folder must exist."),
        pytest.param(
            ["--output", f"{REFUSES}/lightpanes"],
            f"Can't write to folder '{REFUSES}/lightpanes': ",
            marks=needs_a_refusing_folder,
        ),
    ],
)
def test_bad_words(file, capsys, words, message):
    assert animate(file, *words) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith(f"lightpanes: {message}")
    assert names(file.parent) == [file.name]


def test_command_without_a_bake(room, tmp_path, capsys):
    path = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert animate(path) == 2
    assert (
        capsys.readouterr().err
        == "lightpanes: 'room.blend' has no bake in scene 'Scene'. 'python -m lightpanes bake room.blend' makes room_lightpanes.blend, which has one.\n"
    )
    assert names(tmp_path) == ["room.blend"]


def test_interrupted_command(file, capsys, monkeypatch):
    def stop(self, step):
        if step.fraction > 0.5:
            raise KeyboardInterrupt

    monkeypatch.setattr(commands.Bar, "__call__", stop)
    assert animate(file) == 130
    assert capsys.readouterr().err.strip() == "lightpanes: cancelled; nothing was written."
    assert names(file.parent) == [file.name]


@pytest.fixture
def seen(baked, tmp_path):
    """Renders see the block's top in no light but ours: by itself the lamp reaches the camera alone, which has no
    surface. (Lightpanes takes no notice of light linking.) The lamp comes from low beside the block, whose top is a third
    darker then, so that no frame passes for another, though a tiny bake with its few panes errs by a tenth."""
    lamp = bpy.data.objects["Lamp"]
    lamp.location = (-0.5, -0.2, -0.4)
    lamp.keyframe_insert("location", frame=1)
    baked.frame_set(2)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    baked.collection.objects.link(camera)
    linked = bpy.data.collections.new("Lit")
    linked.objects.link(camera)
    lamp.light_linking.receiver_collection = linked
    camera.location, camera.data.type, camera.data.ortho_scale = (0.3, 0.2, 0.5), "ORTHO", 0.4
    render = baked.render
    baked.camera, render.engine, baked.cycles.samples, baked.cycles.use_denoising = camera, "CYCLES", 4, False
    render.resolution_x = render.resolution_y = 24
    render.image_settings.file_format, render.filepath = "OPEN_EXR", str(tmp_path / "frame_")
    baked.lightpanes.cycles = True
    return baked


def top_of_block():
    """Rows and columns of the atlas that the camera sees, the middle four fifths."""
    mesh = bpy.data.objects["Block"].data
    top = next(face for face in mesh.polygons if face.normal.z > 0.9)
    uv = np.array([mesh.uv_layers["Lightpanes"].uv[k].vector for k in top.loop_indices])
    low, high = (np.round(edge * 64).astype(int) for edge in (uv.min(axis=0), uv.max(axis=0)))
    inset = np.maximum((high - low) // 10, 1)
    return tuple(slice(low[k] + inset[k], high[k] - inset[k]) for k in (1, 0))


@pytest.mark.parametrize("kept", [True, False])
def test_rendered_frames_show_their_own_light(seen, tmp_path, kept):
    """Albedo × irradiance / π; twice, for what the first time keeps must not show in the second."""
    seen.render.use_persistent_data = kept
    write(tmp_path)
    place = top_of_block()
    for _ in range(2):
        bpy.ops.render.render(animation=True)
        means = []
        for frame in range(1, 6):
            picture = load(tmp_path / f"frame_{frame:04d}.exr").mean(axis=(0, 1))
            light = load(tmp_path / f"irradiance_{frame:04d}.exr")[place].mean(axis=(0, 1))
            assert np.allclose(picture, light * (0.2, 0.4, 0.7) / np.pi, rtol=0.02)
            means.append(picture.mean())
        assert means[3] == pytest.approx(means[2] / 4, rel=0.01) and abs(means[0] / means[2] - 1) > 0.1
    assert seen.frame_current == 2


@pytest.mark.parametrize("changes", [1, 2, 3, 4])
def test_stills_show_the_last_of_several_changes(seen, tmp_path, changes):
    """However often the light has changed since the last render that kept its data."""
    seen.render.use_persistent_data = True
    lamp = bpy.data.lights["Lamp"]
    lamp.animation_data_clear()
    means = []
    for energy in (20, 10, 5):
        for part in range(changes - 1, -1, -1):
            lamp.energy = energy + part
            bpy.context.view_layer.update()
        seen.render.filepath = str(tmp_path / f"{energy}.exr")
        bpy.ops.render.render(write_still=True)
        means.append(load(seen.render.filepath).mean())
    assert means == pytest.approx([means[0], means[0] / 2, means[0] / 4], rel=1e-2)
