"""The buttons, and what a user reads when something can't be baked."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import lightpanes  # noqa: E402
from lightpanes.addon import baking, operators, store  # noqa: E402
from lightpanes.addon.snapshot import PLACE  # noqa: E402
from lightpanes.core.scene import SceneError  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


def bake():
    return bpy.ops.lightpanes.bake()


def failing_bake():
    """What the user reads when the bake fails; nothing of ours may be left behind."""
    before = everything()
    with pytest.raises(RuntimeError) as caught:
        bake()
    assert everything() == before
    return str(caught.value).strip()


def everything():
    """Names of all data-blocks, UV layers and custom properties (4.5 lists the PropertyGroup among them), by kind."""
    kinds = ("images", "meshes", "objects", "collections", "node_groups", "materials", "texts", "lights", "worlds")
    found = {kind: sorted(item.name for item in getattr(bpy.data, kind)) for kind in kinds}
    found["layers"] = sorted((mesh.name, layer.name) for mesh in bpy.data.meshes for layer in mesh.uv_layers)
    found["active"] = sorted((m.name, m.uv_layers.active.name if m.uv_layers.active else "") for m in bpy.data.meshes)
    found["properties"] = sorted(
        (item.name, key) for item in bpy.data.objects for key in item.keys() if key != "lightpanes"
    )
    found["nodes"] = sorted((m.name, n.name) for m in bpy.data.materials if m.node_tree for n in m.node_tree.nodes)
    found["slots"] = sorted((o.name, [s.name for s in o.material_slots]) for o in bpy.data.objects)
    return found


def bake_state(scene):
    """All of a bake that a failed one must not touch."""
    found = store.load_bake(scene)
    arrays = [*found.images.values(), *found.entries.values()]
    layers = []
    for item in sorted(scene.objects, key=lambda item: item.name):
        if item.type == "MESH" and item.data.uv_layers.get("Lightpanes") is not None:
            uv = np.empty(2 * len(item.data.loops), np.float32)
            item.data.uv_layers["Lightpanes"].uv.foreach_get("vector", uv)
            layers.append((item.name, uv.tobytes(), *(list(item[key]) for key in PLACE[:2])))
    irradiance = store.find_image(scene, store.IRRADIANCE)
    return [a.tobytes() for a in arrays], layers, np.array(irradiance.pixels, np.float32).tobytes(), found.meta


def test_bake_and_clear_give_the_scene_back(room):
    before = everything()
    assert bake() == {"FINISHED"}
    assert everything() != before
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert everything() == before
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}


def test_an_unsaved_file_bakes(room):
    assert not bpy.data.filepath
    assert bake() == {"FINISHED"}


def test_a_second_bake_on_top_of_the_first(room):
    bake()
    names, state = everything(), bake_state(room)
    bake()
    assert everything() == names
    again = bake_state(room)
    assert again[0] == state[0], "the same seed gives the same bake"


def test_no_objects(blender):
    assert failing_bake() == "Error: There is nothing to bake: scene 'Scene' has no mesh. Add one."


def test_only_a_lamp(room):
    for name in ("Room", "Block"):
        bpy.data.objects.remove(bpy.data.objects[name])
    assert failing_bake() == "Error: There is nothing to bake: scene 'Scene' has no mesh. Add one."


def test_everything_hidden(room):
    for name in ("Room", "Block"):
        bpy.data.objects[name].hide_render = True
    assert failing_bake() == (
        "Error: There is nothing to bake: every mesh in scene 'Scene' is hidden from renders. "
        "Turn on its camera icon in the Outliner, or that of its collection."
    )


def test_hidden_by_its_collection(room):
    collection = bpy.data.collections.new("Set")
    room.collection.children.link(collection)
    for name in ("Room", "Block"):
        item = bpy.data.objects[name]
        room.collection.objects.unlink(item)
        collection.objects.link(item)
    collection.hide_render = True
    assert "hidden from renders" in failing_bake()


def test_everything_excluded(room):
    for name in ("Room", "Block"):
        bpy.data.objects[name].lightpanes.exclude = True
    message = "Error: There is nothing to bake: every mesh in scene 'Scene' is excluded from Lightpanes."
    assert failing_bake() == message


def test_no_lamps(room, capfd):
    bpy.data.objects.remove(bpy.data.objects["Lamp"])
    assert bake() == {"FINISHED"}
    assert (
        "Scene 'Scene' has no visible lamp; the light follows as soon as you add or show one." in capfd.readouterr().out
    )
    assert store.read_meta(room)["report"]["warnings"]


def only(room, mesh):
    for name in ("Room", "Block"):
        bpy.data.objects.remove(bpy.data.objects[name])
    item = bpy.data.objects.new("Bad", mesh)
    room.collection.objects.link(item)
    return item


def test_a_mesh_without_polygons(room):
    mesh = bpy.data.meshes.new("Bad")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0)], [(0, 1)], [])
    only(room, mesh)
    assert failing_bake() == "Error: There is nothing to bake: 'Bad' has no faces. Add some."


def test_zero_area_faces_alone(room):
    mesh = bpy.data.meshes.new("Bad")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (2, 0, 0)], [], [(0, 1, 2)])
    only(room, mesh)
    assert "area" in failing_bake()


def test_zero_area_faces_among_others(room):
    mesh = bpy.data.objects["Block"].data
    corners = [tuple(v.co) for v in mesh.vertices]
    mesh.clear_geometry()
    mesh.from_pydata([*corners, (0, 0, 0), (0, 0, 0.1), (0, 0, 0.2)], [], [(0, 1, 3, 2), (8, 9, 10)])
    assert bake() == {"FINISHED"}


def test_nan_vertices(room):
    bpy.data.objects["Block"].data.vertices[0].co.x = float("nan")
    message = failing_bake()
    assert message.startswith("Error: 'Block' has vertices that are not numbers")


def test_an_atlas_too_small_for_its_charts(room):
    room.lightpanes.resolution = 16
    mesh = bpy.data.objects["Block"].data
    corners, faces = [], []
    for k in range(400):  # charts that touch nothing
        corners += [(k, 0, 0), (k + 0.5, 0, 0), (k, 0.5, 0.1 * (k % 7))]
        faces.append((3 * k, 3 * k + 1, 3 * k + 2))
    mesh.clear_geometry()
    mesh.from_pydata(corners, [], faces)
    assert "resolution" in failing_bake().lower()


def test_a_failed_bake_leaves_the_previous(room):
    bake()
    state = bake_state(room)
    bpy.data.objects["Block"].data.vertices[0].co.x = float("inf")
    failing_bake()
    assert bake_state(room) == state


class Stop(Exception):
    pass


@pytest.mark.parametrize("at", [0.01, 0.2, 0.6, 0.9])
def test_an_interrupted_bake_leaves_the_previous(room, at):
    bake()
    state, names = bake_state(room), everything()
    room.lightpanes.seed = 5
    bpy.ops.mesh.primitive_cube_add(size=0.3, location=(-0.5, 0.5, 0))
    bpy.context.object.name = "New"

    def stop(progress):
        if progress.fraction >= at:
            raise Stop

    with pytest.raises(Stop):
        baking.bake_scene(bpy.context, stop)
    assert bake_state(room) == state
    bpy.data.meshes.remove(bpy.data.objects["New"].data)
    assert everything() == names


def test_an_interrupted_first_bake_leaves_nothing(room):
    before = everything()

    def stop(progress):
        if progress.fraction > 0.5:
            raise Stop

    with pytest.raises(Stop):
        baking.bake_scene(bpy.context, stop)
    assert everything() == before


def test_undo_after_a_bake(room):
    bpy.ops.ed.undo_push(message="Before")
    before = everything()
    bake()
    bpy.ops.ed.undo_push(message="Baked")
    baked = everything()
    bpy.ops.ed.undo()
    assert everything() == before
    assert store.load_bake(bpy.context.scene) is None
    bpy.ops.ed.redo()
    assert everything() == baked
    assert store.load_bake(bpy.context.scene) is not None
    assert np.array(store.find_image(bpy.context.scene, store.IRRADIANCE).pixels).reshape(-1, 4)[:, :3].max() > 0


def test_clear_in_one_scene_leaves_the_other(room):
    bake()
    bpy.ops.scene.new(type="FULL_COPY")
    copy = bpy.context.scene
    assert bake() == {"FINISHED"}
    state = bake_state(room)
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert store.load_bake(copy) is None
    assert bake_state(room) == state


def test_relighting_without_a_bake(room):
    with pytest.raises(RuntimeError, match=r"Scene 'Scene' has no bake; press Bake first\."):
        bpy.ops.lightpanes.relight()


def test_not_in_edit_mode(room):
    bpy.context.view_layer.objects.active = bpy.data.objects["Block"]
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        assert not bpy.ops.lightpanes.bake.poll()
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")


def test_registering_twice_and_again(room):
    lightpanes.register()
    lightpanes.unregister()
    assert not hasattr(bpy.types.Scene, "lightpanes")
    lightpanes.unregister()
    lightpanes.register()
    assert bpy.context.scene.lightpanes.error_target == pytest.approx(0.05)


def test_one_line_about_a_bake():
    assert operators.summary({"total_seconds": 4.21, "error": 0.031, "relight_ms": 3.2}) == (
        "Baked in 4.2 s, error 3.1 %, relights in 3.2 ms"
    )


def test_progress_goes_up_and_ends(room):
    room.lightpanes.error_target = 0.5
    seen = []
    baking.bake_scene(bpy.context, lambda progress: seen.append(progress.fraction))
    assert seen == sorted(seen) and seen[0] == 0 and seen[-1] == 1


def test_preflight_counts_instances(room):
    for name in ("Room", "Block"):
        bpy.data.objects.remove(bpy.data.objects[name])
    with pytest.raises(SceneError):
        baking.preflight(bpy.context)
    empty = bpy.data.objects.new("Instance", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", bpy.data.collections.new("Set")
    room.collection.objects.link(empty)
    assert baking.preflight(bpy.context) == []
