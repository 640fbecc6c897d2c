"""The display images as OpenEXR files."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import store  # noqa: E402


def read(path):
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    pixels = np.array(image.pixels, np.float32)
    bpy.data.images.remove(image)
    return pixels


@pytest.fixture
def baked(room, quick):
    world = room.world = bpy.data.worlds.new("Sky")
    if world.node_tree is None:
        world.use_nodes = True
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    return room


def test_saving_images(baked, tmp_path):
    names = {"Lightpanes Irradiance.exr": store.IRRADIANCE, "Lightpanes Direct.exr": store.DIRECT}
    (tmp_path / "Lightpanes Direct.exr").write_text("an older one")
    before = {role: (i.filepath, i.source, i.packed_file is not None) for role, i in images(baked).items()}
    assert bpy.ops.lightpanes.save_images(directory=str(tmp_path)) == {"FINISHED"}
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)
    for name, role in names.items():
        there = read(tmp_path / name).reshape(-1, 4)[:, :3]
        assert np.array_equal(there, np.array(store.find_image(baked, role).pixels, np.float32).reshape(-1, 4)[:, :3])
    assert before == {role: (i.filepath, i.source, i.packed_file is not None) for role, i in images(baked).items()}


def images(scene):
    found = {role: store.find_image(scene, role) for role in (store.IRRADIANCE, store.DIRECT, store.ALBEDO)}
    return {role: image for role, image in found.items() if image is not None}


def test_saving_images_beside_the_file(baked, tmp_path):
    with pytest.raises(RuntimeError, match="The file has not been saved yet: save it, or choose a folder"):
        bpy.ops.lightpanes.save_images()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    assert bpy.ops.lightpanes.save_images() == {"FINISHED"}
    assert (tmp_path / "Lightpanes Irradiance.exr").exists()


def test_saving_images_where_none_can_be(baked, tmp_path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(
        RuntimeError, match=r"Can't write '.*Lightpanes Irradiance\.exr': Not a directory. Choose another folder"
    ):
        bpy.ops.lightpanes.save_images(directory=str(tmp_path / "file"))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_saving_images_without_a_bake(room):
    assert not bpy.ops.lightpanes.save_images.poll()
