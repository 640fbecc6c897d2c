"""Baked objects in other files and in other scenes: the light survives, or the panel says why not."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import nodes, panel, preflight, relight, sessions, store  # noqa: E402
from lightpanes.addon.meshes import BAKE  # noqa: E402

from .conftest import furnish  # noqa: E402
from .drawing import draw, texts  # noqa: E402
from .files import baked_once, empty, reopen  # noqa: E402
from .mending import found, mend  # noqa: E402
from .test_operators import everything  # noqa: E402
from .test_sequences import ours, trees  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def baked(room, saved):
    return baked_once(room, saved)


@pytest.fixture
def library(baked, tmp_path):
    """The baked room in a file, and then another one that is empty; returns the file."""
    path = tmp_path / "library.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    empty()
    return path


def bring(path, *names, link=False):
    """Append or link objects into the scene; returns them."""
    with bpy.data.libraries.load(str(path), link=link) as (_, here):
        here.objects = list(names)
    for item in here.objects:
        bpy.context.scene.collection.objects.link(item)
    bpy.context.view_layer.update()
    return here.objects


def image(scene):
    return np.array(store.find_image(scene, store.IRRADIANCE).pixels)


def shown_image(material):
    """The image that a material shows as baked light."""
    group = next(node.node_tree for node in material.node_tree.nodes if nodes.NODE_TAG in node and node.type == "GROUP")
    return next(node.image for node in group.nodes if node.type == "TEX_IMAGE")


def test_an_appended_object_shows_its_light_as_it_was(library):
    (block,) = bring(library, "Block")
    shown = shown_image(block.data.materials[0])
    light = np.array(shown.pixels).reshape(64, 64, 4)
    assert light.max() > 0.1
    assert "lightpanes_scale" in block and "Lightpanes" in block.data.uv_layers
    (told,) = found("FOREIGN_LIGHT")
    assert told.sentence == (
        "'Block' shows the light of a bake that is not in this file, as it was last shown. Bake to replace it."
    )
    # and so it is in a file of its own
    path = bpy.app.tempdir + "other.blend"
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    shown = shown_image(bpy.data.objects["Block"].data.materials[0])
    assert np.array_equal(np.array(shown.pixels).reshape(64, 64, 4), light)


def test_clear_takes_an_appended_objects_light_off(library):
    (block,) = bring(library, "Block")
    assert "lightpanes.clear" in texts(draw(panel.LIGHTPANES_PT_render), "operator")
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert not [key for key in block.keys() if key.startswith("lightpanes_")]
    assert "Lightpanes" not in block.data.uv_layers
    assert not ours() and not [n for n in block.data.materials[0].node_tree.nodes if nodes.NODE_TAG in n]
    assert not found("FOREIGN_LIGHT")


def test_its_button_takes_the_light_off(library):
    bring(library, "Block", "Room")
    assert mend("FOREIGN_LIGHT").button == "Remove That Light"
    assert not ours()


def test_baking_replaces_an_appended_objects_light(library):
    scene = furnish()
    (block,) = bring(library, "Block")
    assert block.name == "Block.001"
    block.location.x = -0.4
    bpy.context.view_layer.update()
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert block[BAKE] == store.bake_key(scene)
    assert shown_image(block.data.materials[0]) == store.find_image(scene, store.IRRADIANCE)
    assert not found("FOREIGN_LIGHT")
    assert len([g for g in bpy.data.node_groups if store.TAG in g]) == 1
    assert len([i for i in bpy.data.images if i.get(store.TAG) == store.IRRADIANCE]) == 1
    bpy.ops.lightpanes.clear()
    assert not ours()


def test_an_appended_object_beside_a_bake_keeps_its_own_light(library):
    scene = furnish()
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    (block,) = bring(library, "Block")
    theirs = shown_image(block.data.materials[0])
    assert theirs != store.find_image(scene, store.IRRADIANCE)
    before = np.array(theirs.pixels)
    bpy.data.objects["Lamp"].location.x += 0.3
    bpy.context.view_layer.update()
    assert np.array_equal(np.array(theirs.pixels), before)
    (told,) = found("FOREIGN_LIGHT")
    assert told.names == ("Block.001",) and not told.button
    bpy.ops.lightpanes.relight()
    assert sessions.of(scene).stale == ("'Block.001' was added since the bake; bake again.",)
    bpy.ops.lightpanes.clear()
    assert not ours() and not found("FOREIGN_LIGHT")


def test_light_at_vertices_is_not_overwritten_by_another_bake(room, tmp_path):
    bpy.data.objects["Block"].lightpanes.target = "VERTICES"
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    path = tmp_path / "library.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    empty()
    furnish().lightpanes.seed = 3
    bpy.data.objects["Block"].lightpanes.target = "VERTICES"
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    (block,) = bring(path, "Block")

    def light(item):
        return np.array([v for d in item.data.attributes["lightpanes_irradiance"].data for v in d.color])

    theirs, mine = light(block), light(bpy.data.objects["Block"])
    assert theirs.any()
    bpy.data.objects["Lamp"].data.energy *= 3
    bpy.context.view_layer.update()
    bpy.ops.lightpanes.relight()
    assert np.array_equal(light(block), theirs)
    assert light(bpy.data.objects["Block"]).sum() > 1.5 * mine.sum()
    bpy.ops.lightpanes.clear()
    assert "lightpanes_irradiance" not in block.data.attributes


def test_a_linked_object_shows_its_light_and_is_left_alone(library):
    (block,) = bring(library, "Block", link=True)
    before = everything(), trees()
    (told,) = found("FOREIGN_LIGHT")
    assert told.sentence == "'Block' shows the light of a bake in 'library.blend', as it was when that was saved."
    assert not told.button
    assert "lightpanes.clear" not in texts(draw(panel.LIGHTPANES_PT_render), "operator")
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert (everything(), trees()) == before
    assert shown_image(block.data.materials[0]).library is not None
    furnish()
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert shown_image(block.data.materials[0]).library is not None
    bpy.ops.lightpanes.clear()
    assert shown_image(block.data.materials[0]).library is not None and block["lightpanes_baked"] == 1.0


def test_an_instance_of_a_linked_collection_is_told(baked, tmp_path):
    collection = bpy.data.collections.new("House")
    baked.collection.children.link(collection)
    for name in ("Room", "Block"):
        collection.objects.link(bpy.data.objects[name])
    path = tmp_path / "library.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    empty()
    with bpy.data.libraries.load(str(path), link=True) as (_, here):
        here.collections = ["House"]
    house = bpy.data.objects.new("House", None)
    house.instance_type, house.instance_collection = "COLLECTION", here.collections[0]
    bpy.context.scene.collection.objects.link(house)
    bpy.context.view_layer.update()
    (told,) = found("FOREIGN_LIGHT")
    assert told.names == ("Block", "Room")
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert shown_image(bpy.data.materials["Block"]).library is not None


@pytest.mark.parametrize("exits", ["TEXELS", "POINTS"])
def test_a_bake_that_is_appended_with_its_objects_can_be_used(room, tmp_path, exits):
    room.lightpanes.exits = exits
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    light = image(room)
    path = tmp_path / "library.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    empty()
    scene = bpy.context.scene
    bring(path, "Room", "Block", "Lamp", store.ENTRIES)
    assert store.find_entries(scene) is None
    assert mend("FOREIGN_LIGHT").button == "Use That Bake"
    assert np.allclose(image(scene), light, rtol=1e-3, atol=1e-4)
    bpy.data.objects["Lamp"].data.energy *= 2
    bpy.context.view_layer.update()
    assert np.allclose(image(scene)[..., :3].max(), light[..., :3].max() * 2, rtol=0.02)
    assert not relight.check_stale(bpy.context)
    bpy.ops.lightpanes.clear()
    assert not ours()


def test_a_bake_that_is_appended_and_not_used_goes_with_clear(library):
    bring(library, "Block", store.ENTRIES)
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert not ours()


def test_an_appended_scene_relights(baked, tmp_path):
    path = tmp_path / "library.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    empty()
    with bpy.data.libraries.load(str(path), link=False) as (_, here):
        here.scenes = ["Scene"]
    bpy.context.window.scene = here.scenes[0]
    before = image(here.scenes[0])
    bpy.data.objects["Lamp"].data.energy *= 2
    bpy.context.view_layer.update()
    assert np.allclose(image(here.scenes[0])[0::4], 2 * before[0::4], rtol=0.02, atol=1e-3)
    assert not found("FOREIGN_LIGHT")


@pytest.mark.parametrize("kind", ["FULL_COPY", "LINK_COPY"])
def test_copies_of_a_scene_each_show_their_own_lamps(baked, kind):
    bpy.ops.scene.new(type=kind)
    copy = bpy.context.scene
    assert not found("FOREIGN_LIGHT")
    first = image(baked)
    lamp = next(item for item in copy.objects if item.type == "LIGHT")
    for energy in (40.0, 80.0):
        lamp.data.energy = energy
        bpy.context.view_layer.update()
        there = image(copy)
        assert np.allclose(there[0::4], energy / 20 * first[0::4], rtol=0.02, atol=1e-3)
        bpy.context.window.scene = baked
        bpy.context.view_layer.update()
        assert np.allclose(image(baked), first if kind == "FULL_COPY" else there, rtol=1e-3, atol=1e-4)
        bpy.context.window.scene = copy
        bpy.context.view_layer.update()
        assert np.allclose(image(copy), there, rtol=1e-3, atol=1e-4)


def test_copies_of_a_scene_after_reopening(baked, tmp_path):
    bpy.ops.scene.new(type="FULL_COPY")
    lamp = next(item for item in bpy.context.scene.objects if item.type == "LIGHT")
    first = image(baked)
    lamp.data.energy = 40.0
    bpy.context.view_layer.update()
    copy = reopen(tmp_path)
    there = image(copy)
    relight.relight(bpy.context)
    assert np.allclose(image(copy), there, rtol=1e-3, atol=1e-4) and there.max() > 1.5 * first.max()
    bpy.context.window.scene = bpy.data.scenes["Scene"]
    bpy.context.view_layer.update()
    assert np.allclose(image(bpy.context.scene), first, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("kind", ["FULL_COPY", "LINK_COPY"])
def test_clear_in_the_original_leaves_its_copy(baked, kind):
    bpy.ops.scene.new(type=kind)
    copy = bpy.context.scene
    bpy.context.window.scene = baked
    bpy.ops.lightpanes.clear()
    bpy.context.window.scene = copy
    block = next(item for item in copy.objects if item.name.startswith("Block"))
    assert "lightpanes_scale" in block and shown_image(block.data.materials[0]) is not None
    before = image(copy)
    for lamp in copy.objects:
        if lamp.type == "LIGHT":
            lamp.data.energy *= 2
    bpy.context.view_layer.update()
    assert np.allclose(image(copy)[0::4], 2 * before[0::4], rtol=0.02, atol=1e-3)
    bpy.ops.lightpanes.clear()
    assert not ours()


def test_a_copy_with_materials_of_its_own_is_cleared_by_itself(baked):
    bpy.ops.scene.new(type="FULL_COPY")
    copy = bpy.context.scene
    block = next(item for item in copy.objects if item.name.startswith("Block"))
    own = block.data.materials[0] = block.data.materials[0].copy()
    bpy.ops.lightpanes.clear()
    assert not [node for node in own.node_tree.nodes if nodes.NODE_TAG in node]
    assert shown_image(bpy.data.objects["Block"].data.materials[0]) == store.find_image(baked, store.IRRADIANCE)


def test_objects_in_two_scenes_show_the_last_bake_and_the_other_says_so(baked):
    bpy.ops.scene.new(type="LINK_COPY")
    copy = bpy.context.scene
    copy.name = "Night"
    copy.lightpanes.seed = 5
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert not found("FOREIGN_LIGHT")
    bpy.context.window.scene = baked
    preflight.forget()
    (told,) = found("FOREIGN_LIGHT")
    assert (
        told.sentence
        == "'Block' and 'Room' show the light of scene 'Night', as its lamps are. Bake here to replace it."
    )


def test_renaming_everything(baked, tmp_path):
    for kind in ("images", "node_groups", "materials", "meshes", "lights", "objects", "collections", "scenes"):
        for item in getattr(bpy.data, kind):
            item.name = f"Thing {item.name[-3:]}"
    scene = reopen(tmp_path)
    before = image(scene)
    lamp = next(item for item in scene.objects if item.type == "LIGHT")
    lamp.data.energy *= 2
    bpy.context.view_layer.update()
    assert np.allclose(image(scene)[0::4], 2 * before[0::4], rtol=0.02, atol=1e-3)
    material = next(
        item for item in scene.objects if item.type == "MESH" and "lightpanes_baked" in item
    ).data.materials[0]
    assert shown_image(material) == store.find_image(scene, store.IRRADIANCE)
    assert not found("FOREIGN_LIGHT")
    bpy.ops.lightpanes.clear()
    assert not ours()


@pytest.mark.parametrize("method", ["USE_LOCAL", "WRITE_LOCAL"])
def test_unpacking_and_packing_all(baked, tmp_path, method):
    bake = {name: array.tobytes() for name, array in store.load_bake(baked).images.items()}
    before = image(baked)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    bpy.ops.file.unpack_all(method=method)
    assert (tmp_path / "textures").is_dir()
    for packed in (False, True):
        scene = reopen(tmp_path)
        assert {name: array.tobytes() for name, array in store.load_bake(scene).images.items()} == bake
        assert np.array_equal(image(scene), before)
        lamp = bpy.data.objects["Lamp"]
        lamp.data.energy = 40.0
        bpy.context.view_layer.update()
        assert np.allclose(image(scene)[0::4], 2 * before[0::4], rtol=0.02, atol=1e-3)
        # nothing is lost when it is saved like this
        there = image(scene)
        scene = reopen(tmp_path)
        assert np.array_equal(image(scene), there)
        bpy.data.objects["Lamp"].data.energy = 20.0
        bpy.context.view_layer.update()
        assert np.allclose(image(scene), before, rtol=1e-3, atol=1e-4)
        before = image(scene)
        if not packed:
            bpy.ops.file.pack_all()
            for file in (tmp_path / "textures").iterdir():
                file.unlink()
    bpy.ops.lightpanes.clear()
    assert not ours()
