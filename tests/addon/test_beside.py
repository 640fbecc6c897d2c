"""The bake's images as files beside the .blend: written with it, found with it, gone with it."""

import os
import shutil

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import beside, commands, panel, sessions, store  # noqa: E402

from .drawing import draw, texts  # noqa: E402
from .files import empty  # noqa: E402
from .kept import baked_beside, contents, files, follows, image, in_files, move_lamp, open_file, save  # noqa: E402
from .mending import found  # noqa: E402
from .test_sequences import ours  # noqa: E402
from .test_store import assert_same, make_bake  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def baked(room, saved):
    return baked_beside(room, saved)


@pytest.mark.parametrize("exits", ["TEXELS", "POINTS", "ATLAS"])
def test_nothing_is_lost_by_a_bit(room, tmp_path, exits):
    room.lightpanes.exits, room.lightpanes.storage = exits, "BESIDE"
    room.world = bpy.data.worlds.new("Sky")
    room.world.color = (0.1, 0.2, 0.3)
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    count, before = len(store.images_of(room)), contents(room)
    assert in_files(room) == (0, count)
    blend = tmp_path / "room.blend"
    save(blend)
    assert in_files(room) == (count, 0) and contents(room) == before
    key = store.bake_key(room)[:8]
    assert files(blend) == sorted(f"{i[store.TAG]} {key}.exr" for i in store.images_of(room))
    scene = open_file(blend)
    assert contents(scene) == before and in_files(scene) == (count, 0)
    assert follows(scene)


def test_odd_values(room, tmp_path):
    """Infinities, denormals, values that are not numbers."""
    bake = make_bake()
    bake.images["Lightpanes Panes"][0, 1] = np.array([0x7FC00123, 0x7F800001, 0xFFC12345, 1], np.uint32).view(
        np.float32
    )
    room.lightpanes.live = False
    room.lightpanes.storage = "BESIDE"
    store.store_bake(room, bake)
    save(tmp_path / "odd.blend")
    assert_same(bake, store.load_bake(open_file(tmp_path / "odd.blend")))


def test_packed_is_the_default(room, tmp_path):
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    save(tmp_path / "room.blend")
    assert files(tmp_path / "room.blend") is None


def test_each_save_writes_what_changed(baked, tmp_path):
    blend = tmp_path / "room.blend"
    save(blend)
    panes = next(path for path in beside.folder_of(blend).iterdir() if "Panes" in path.name)
    stamp = panes.stat().st_mtime_ns
    move_lamp(baked)
    shown = image(baked)
    bpy.ops.wm.save_mainfile()
    assert not store.find_image(baked, store.IRRADIANCE).is_dirty
    assert np.array_equal(image(baked), shown) and panes.stat().st_mtime_ns == stamp
    scene = open_file(blend)
    assert np.array_equal(image(scene), shown)
    # it shows what the lamps are, so that opening costs nothing
    assert sessions.of(scene).shown and sessions.of(scene).relighter is None
    bpy.context.view_layer.update()
    assert sessions.of(scene).relighter is None


def test_the_blend_is_small(baked, tmp_path):
    save(tmp_path / "beside.blend", compress=False)
    baked.lightpanes.storage = "PACKED"
    save(tmp_path / "packed.blend", compress=False)
    bytes_in = sum(path.stat().st_size for path in beside.folder_of(tmp_path / "beside.blend").iterdir())
    sizes = [(tmp_path / name).stat().st_size for name in ("beside.blend", "packed.blend")]
    assert sizes[0] < sizes[1] - 0.8 * bytes_in


def test_saving_under_another_name(baked, tmp_path):
    first, second = tmp_path / "a" / "room.blend", tmp_path / "b" / "c" / "hall.blend"
    save(first)
    before = contents(baked)
    second.parent.mkdir(parents=True)
    save(second)
    assert files(first) and len(files(second)) == len(files(first))
    assert contents(baked) == before
    assert all(store.path_of(i).parent == beside.folder_of(second) for i in store.images_of(baked))
    # each stands alone, wherever it is moved
    shutil.rmtree(first.parent)
    moved = tmp_path / "elsewhere"
    os.rename(second.parent, moved)
    scene = open_file(moved / "hall.blend")
    assert contents(scene) == before and follows(scene)


def test_saving_without_remapping_in_the_same_folder(baked, tmp_path):
    save(tmp_path / "room.blend", relative_remap=False)
    save(tmp_path / "hall.blend", relative_remap=False)
    shutil.rmtree(beside.folder_of(tmp_path / "room.blend"))
    assert follows(open_file(tmp_path / "hall.blend"))


def test_saving_a_copy_leaves_the_file_as_it_was(baked, tmp_path):
    blend, copy = tmp_path / "a" / "room.blend", tmp_path / "b" / "copy.blend"
    save(copy, copy=True)
    assert in_files(baked)[0] == 0
    unsaved = contents(baked)
    save(blend)
    move_lamp(baked)
    before = contents(baked)
    paths = [store.path_of(i) for i in store.images_of(baked)]
    save(copy, copy=True)
    assert contents(baked) == before
    left = [store.path_of(i) for i in store.images_of(baked)]
    # the irradiance was not saved with the file, and is not there by a save of a copy
    assert [p for p in left if p is not None] == [p for p in paths if "Irradiance" not in p.name]
    bpy.ops.wm.save_mainfile()
    assert [store.path_of(i) for i in store.images_of(baked)] == paths
    assert contents(open_file(blend)) == before
    shutil.rmtree(blend.parent)
    scene = open_file(copy)
    assert contents(scene) == before != unsaved and follows(scene)


def test_a_second_bake_takes_the_files_of_the_first_away(baked, tmp_path):
    blend = tmp_path / "room.blend"
    save(blend)
    mine = beside.folder_of(blend) / "Lightpanes Irradiance.exr"
    mine.write_text("saved by the user")
    first = files(blend)
    baked.lightpanes.seed = 4
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    # closed now without saving, the file still has its light
    assert files(blend) == first
    bpy.ops.wm.save_mainfile()
    before = contents(baked)
    assert contents(open_file(blend)) == before
    assert not set(files(blend)) & set(first) - {mine.name} and mine.read_text() == "saved by the user"


def test_clear_takes_its_files_away_once_the_file_is_saved_and_closed(baked, tmp_path):
    blend = tmp_path / "room.blend"
    save(blend)
    first = files(blend)
    mine = beside.folder_of(blend) / "notes.txt"
    mine.write_text("mine")
    bpy.ops.lightpanes.clear()
    assert not ours() and set(files(blend)) == {*first, "notes.txt"}
    open_file(blend)
    assert len(ours()) > 3 and set(files(blend)) == {*first, "notes.txt"}
    bpy.ops.lightpanes.clear()
    bpy.ops.wm.save_mainfile()
    # undo might bring them back
    assert set(files(blend)) == {*first, "notes.txt"}
    open_file(blend)
    assert files(blend) == ["notes.txt"]


def test_clear_takes_the_folder_away(baked, tmp_path):
    save(tmp_path / "room.blend")
    bpy.ops.lightpanes.clear()
    bpy.ops.wm.save_mainfile()
    open_file(tmp_path / "room.blend")
    assert files(tmp_path / "room.blend") is None


def test_undo_after_clearing_and_saving(baked, tmp_path):
    bpy.ops.ed.undo_push(message="Baked")
    save(tmp_path / "room.blend")
    before = contents(baked)
    bpy.ops.ed.undo_push(message="Saved")
    bpy.ops.lightpanes.clear()
    bpy.ops.ed.undo_push(message="Cleared")
    bpy.ops.wm.save_mainfile()
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert contents(scene)[0] == before[0] and follows(scene)
    bpy.ops.wm.save_mainfile()
    assert contents(open_file(tmp_path / "room.blend"))[0] == before[0]


def test_switching_after_a_bake(baked, tmp_path):
    blend = tmp_path / "room.blend"
    save(blend)
    count, before = in_files(baked)[0], contents(baked)
    for storage, expected in (("PACKED", (0, count)), ("BESIDE", (count, 0)), ("PACKED", (0, count))):
        baked.lightpanes.storage = storage
        bpy.ops.wm.save_mainfile()
        assert in_files(baked) == expected
        baked = open_file(blend)
        assert (files(blend) is None) == (storage == "PACKED")
        assert in_files(baked) == expected and contents(baked) == before
    assert follows(baked)


def test_unsaved_files_keep_their_images_packed(baked):
    assert in_files(baked)[0] == 0 and follows(baked)


@pytest.mark.parametrize("same", [True, False])
def test_two_scenes(baked, tmp_path, same):
    """Two bakes that differ by nothing, too, have an image each for their own lamps."""
    bpy.ops.scene.new(type="FULL_COPY")
    copy = bpy.context.scene
    copy.lightpanes.seed = 0 if same else 5
    for item in [item for item in copy.objects if item.type == "MESH"]:
        item.name = item.name.removesuffix(".001")
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    move_lamp(copy)
    blend = tmp_path / "room.blend"
    names = baked.name, copy.name
    before = [contents(scene) for scene in (baked, copy)]
    save(blend)
    assert before == [contents(scene) for scene in (baked, copy)]
    bpy.ops.wm.save_mainfile()
    open_file(blend)
    assert [contents(bpy.data.scenes[name]) for name in names] == before
    assert before[0][1] != before[1][1]
    # one of them packed, the other not
    bpy.data.scenes[names[1]].lightpanes.storage = "PACKED"
    bpy.ops.wm.save_mainfile()
    open_file(blend)
    assert [contents(bpy.data.scenes[name]) for name in names] == before
    assert in_files(bpy.data.scenes[names[0]])[1] == 0 and in_files(bpy.data.scenes[names[1]])[0] == 0


def test_copies_of_a_scene_share_files(baked, tmp_path):
    bpy.ops.scene.new(type="LINK_COPY")
    blend = tmp_path / "room.blend"
    save(blend)
    assert len(files(blend)) == len(store.images_of(baked))
    assert follows(open_file(blend))


def test_packing_and_unpacking_by_the_user(baked, tmp_path):
    blend = tmp_path / "room.blend"
    save(blend)
    count, before = in_files(baked)[0], contents(baked)
    bpy.ops.file.pack_all()
    assert in_files(baked) == (0, count) and contents(baked) == before
    bpy.ops.wm.save_mainfile()
    assert in_files(baked) == (count, 0) and contents(baked) == before
    bpy.ops.file.pack_all()
    bpy.ops.file.unpack_all(method="WRITE_LOCAL")
    bpy.ops.wm.save_mainfile()
    scene = open_file(blend)
    assert contents(scene) == before and follows(scene)


def test_undo_after_saving(baked, tmp_path):
    bpy.ops.ed.undo_push(message="Baked")
    before = contents(baked)
    save(tmp_path / "room.blend")
    bpy.data.objects["Block"].name = "Crate"
    bpy.ops.ed.undo_push(message="Renamed")
    bpy.ops.ed.undo()
    assert contents(bpy.context.scene)[0] == before[0]
    bpy.ops.wm.save_mainfile()
    assert contents(open_file(tmp_path / "room.blend"))[0] == before[0]


def test_an_appended_object_reads_the_library_s_files(baked, tmp_path):
    save(tmp_path / "library" / "room.blend")
    before = image(baked)
    empty()
    with bpy.data.libraries.load(str(tmp_path / "library" / "room.blend")) as (_, here):
        here.objects = ["Block"]
    bpy.context.scene.collection.objects.link(here.objects[0])
    save(tmp_path / "other.blend")
    open_file(tmp_path / "other.blend")
    shown = next(i for i in bpy.data.images if i.get(store.TAG) == store.IRRADIANCE)
    assert np.array_equal(np.array(shown.pixels, np.float32), before)


def test_the_command(room, tmp_path, capsys):
    save(tmp_path / "room.blend")
    arguments = ["bake", str(tmp_path / "room.blend"), "--resolution", "64", "--storage", "beside"]
    assert commands.main(arguments) == 0
    blend = tmp_path / "room_lightpanes.blend"
    assert sorted(path.name for path in tmp_path.iterdir() if not path.name.endswith("1")) == [
        "room.blend",
        "room_lightpanes.blend",
        "room_lightpanes_lightpanes",
    ]
    scene = open_file(blend)
    assert in_files(scene)[1] == 0 and not found("MISSING_FILE")
    before = contents(scene)[0]
    assert commands.main(["relight", str(blend), "--output", str(tmp_path / "out")]) == 0
    shutil.rmtree(beside.folder_of(blend))
    scene = open_file(tmp_path / "out" / "room_lightpanes_relit.blend")
    assert contents(scene)[0] == before and follows(scene)


def test_the_setting_is_in_the_panel(baked):
    assert "storage" in texts(draw(panel.LIGHTPANES_PT_output), "prop")
