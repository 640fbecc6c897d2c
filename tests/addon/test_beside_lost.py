"""Images beside the .blend that are missing, or that can't be written: told, and nothing else is lost."""

import os
import shutil

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import beside, panel, sessions, store  # noqa: E402
from lightpanes.core.scene import SceneError  # noqa: E402

from .drawing import draw, paragraph  # noqa: E402
from .kept import baked_beside, contents, files, follows, image, in_files, move_lamp, open_file, save  # noqa: E402
from .mending import found  # noqa: E402
from .soft import hang_panel, sky  # noqa: E402
from .test_sequences import ours  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def baked(room, saved):
    return baked_beside(room, saved)


def test_a_missing_file_is_named(baked, tmp_path):
    blend = tmp_path / "room.blend"
    save(blend)
    lost = next(path for path in beside.folder_of(blend).iterdir() if "Panes" in path.name)
    before = contents(baked)
    os.rename(lost, tmp_path / "kept")
    scene = open_file(blend)
    sentence = f"The file '{lost}' of this bake is missing: put it back, or bake again."
    (told,) = found("MISSING_FILE")
    assert told.sentence == sentence
    with pytest.raises(RuntimeError, match="is missing: put it back, or bake again"):
        bpy.ops.lightpanes.relight()
    move_lamp(scene)
    assert sessions.of(scene).error == sentence
    # saving it like this loses nothing more
    bpy.ops.wm.save_mainfile()
    os.rename(tmp_path / "kept", lost)
    # it is enough to relight once it is there again
    assert bpy.ops.lightpanes.relight() == {"FINISHED"}
    there = image(scene)
    scene = open_file(blend)
    bpy.ops.lightpanes.relight()
    assert np.allclose(image(scene), there, rtol=1e-3, atol=1e-4)
    assert not found("MISSING_FILE")
    move_lamp(scene, -0.3)
    assert contents(scene)[0] == before[0]
    assert np.allclose(image(scene), np.frombuffer(before[1], np.float32), rtol=1e-3, atol=1e-4)
    lost.unlink()
    scene = open_file(blend)
    assert bpy.ops.lightpanes.bake() == {"FINISHED"} and follows(scene) and not found("MISSING_FILE")


def test_several_missing_files(baked, tmp_path):
    blend = tmp_path / "room.blend"
    save(blend)
    shutil.rmtree(beside.folder_of(blend))
    open_file(blend)
    (told,) = found("MISSING_FILE")
    assert "more of this bake are missing: put them back, or bake again." in told.sentence
    bpy.ops.lightpanes.clear()
    assert not ours() and not found("MISSING_FILE")


def test_a_missing_irradiance_is_made_anew(baked, tmp_path):
    blend = tmp_path / "room.blend"
    save(blend)
    before = image(baked)
    next(path for path in beside.folder_of(blend).iterdir() if "Irradiance" in path.name).unlink()
    scene = open_file(blend)
    assert not found("MISSING_FILE")
    bpy.context.view_layer.objects.active = bpy.data.objects["Block"]
    bpy.data.objects["Lamp"].update_tag()
    bpy.context.view_layer.update()
    assert np.allclose(image(scene), before, rtol=1e-3, atol=1e-4)
    bpy.ops.wm.save_mainfile()
    assert np.allclose(image(open_file(blend)), before, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("storage", ["BESIDE", "PACKED"])
def test_files_deleted_while_they_are_open(baked, tmp_path, storage):
    blend = tmp_path / "room.blend"
    save(blend)
    before = contents(baked)
    shutil.rmtree(beside.folder_of(blend))
    baked.lightpanes.storage = storage
    bpy.ops.wm.save_mainfile()
    assert contents(open_file(blend)) == before


def test_where_no_folder_can_be_made(baked, tmp_path, capfd):
    blend = tmp_path / "room.blend"
    before = contents(baked)
    beside.folder_of(blend).write_text("a file in its place")
    save(blend)
    assert in_files(baked)[0] == 0 and contents(baked) == before
    assert "the baked images are packed into the .blend instead" in beside.problem()
    assert "the baked images are packed into the .blend instead" in paragraph(draw(panel.LIGHTPANES_PT_output))
    assert contents(open_file(blend)) == before and not beside.problem()
    beside.folder_of(blend).unlink()
    bpy.ops.wm.save_mainfile()
    assert not beside.problem() and in_files(bpy.context.scene)[1] == 0


def test_a_disk_that_fills_midway(baked, tmp_path, monkeypatch, capfd):
    blend, count = tmp_path / "room.blend", 0
    before, replace = contents(baked), os.replace

    def full(*paths):
        nonlocal count
        count += 1
        if count > 2:
            raise OSError(28, "No space left on device", str(paths[1]))
        replace(*paths)

    monkeypatch.setattr(os, "replace", full)
    save(blend)
    monkeypatch.undo()
    assert "No space left on device" in beside.problem() and in_files(baked)[0] == 0
    assert contents(open_file(blend)) == before
    assert files(blend) is None


def test_a_save_that_fails_changes_nothing(baked, tmp_path):
    blend = tmp_path / "room.blend"
    save(blend)
    before, paths = contents(baked), [store.path_of(i) for i in store.images_of(baked)]
    (tmp_path / "other.blend@").mkdir()
    with pytest.raises(RuntimeError):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other.blend"))
    assert [store.path_of(i) for i in store.images_of(baked)] == paths and contents(baked) == before
    # what was written last still needs its files
    bpy.ops.lightpanes.clear()
    (tmp_path / "room.blend@").mkdir()
    with pytest.raises(RuntimeError):
        bpy.ops.wm.save_mainfile()
    assert contents(open_file(blend)) == before


def test_reading_a_missing_file_says_so(baked, tmp_path):
    save(tmp_path / "room.blend")
    shutil.rmtree(beside.folder_of(tmp_path / "room.blend"))
    with pytest.raises(SceneError, match="is missing: put it back, or bake again"):
        store.load_bake(open_file(tmp_path / "room.blend"))


def test_direct_light_whose_file_is_missing_says_so(room, tmp_path, capfd):
    """What the image held before the lamps is gone, so it can't be taken out of it."""
    sky(hang_panel(room))
    room.lightpanes.storage = "BESIDE"
    bpy.data.objects["Room"].hide_render = True
    bpy.ops.mesh.primitive_plane_add(size=2, location=(0, 0, -1))
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    save(tmp_path / "room.blend")
    (steady,) = beside.folder_of(tmp_path / "room.blend").glob(f"{store.STEADY} *.exr")
    open_file(tmp_path / "room.blend")
    steady.unlink()
    scene = open_file(tmp_path / "room.blend")
    scene.lightpanes.direct = "OFF"
    assert f"'{steady}' of this bake is missing" in sessions.of(scene).error
    assert "Traceback" not in capfd.readouterr().err
