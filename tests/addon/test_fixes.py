"""Fixes that meet what they can't mend, and objects that share a name."""

import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import baking  # noqa: E402

from .mending import add, found, press  # noqa: E402


def ribbon(scene, name, collection=None):
    curve = bpy.data.curves.new(name, "CURVE")
    curve.extrude = 0.1
    spline = curve.splines.new("BEZIER")
    spline.bezier_points.add(2)
    spline.use_cyclic_u = True
    return add(scene, name, curve, collection)


@pytest.fixture
def hidden(room):
    """A collection that the viewport does not show."""
    collection = bpy.data.collections.new("Hidden")
    room.collection.children.link(collection)
    collection.hide_viewport = True
    return collection


def test_what_can_be_converted_is(room, hidden):
    first, second, third = ribbon(room, "A"), ribbon(room, "B", hidden), ribbon(room, "C")
    (obstacle,) = found("CONVERT")
    assert press(obstacle) == {"FINISHED"}
    assert [item.type for item in (first, second, third)] == ["MESH", "CURVE", "MESH"]
    assert [obstacle.names for obstacle in found("CONVERT")] == [("B",)]


def test_what_was_converted_can_be_undone(room, hidden):
    ribbon(room, "A"), ribbon(room, "B", hidden)
    bpy.ops.ed.undo_push(message="Before")
    press(found("CONVERT")[0])
    bpy.ops.ed.undo_push(message="After")
    bpy.ops.ed.undo()
    assert bpy.data.objects["A"].type == "CURVE"


def test_where_nothing_can_be_converted_nothing_is_said_to_be(room, hidden):
    ribbon(room, "B", hidden)
    with pytest.raises(RuntimeError, match="'B' is hidden in the viewport by its collection: show that first"):
        press(found("CONVERT")[0])


@pytest.fixture
def library(room, tmp_path):
    """A file that holds the room's block, alone and in a collection."""
    collection = bpy.data.collections.new("Set")
    crate = bpy.data.objects.new("Crate", bpy.data.objects["Block"].data.copy())
    collection.objects.link(crate)
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {collection, bpy.data.objects["Block"]})
    bpy.data.objects.remove(crate)
    bpy.data.collections.remove(collection)
    return path


def link(path, kind, name, scene):
    with bpy.data.libraries.load(path, link=True) as (_, into):
        setattr(into, kind, [name])
    (item,) = getattr(into, kind)
    (scene.collection.objects if kind == "objects" else scene.collection.children).link(item)
    bpy.context.view_layer.update()
    return item


def test_what_can_be_made_local_is(room, library):
    link(library, "collections", "Set", room)
    link(library, "objects", "Block", room)
    (obstacle,) = found("LINKED")
    assert set(obstacle.names) == {"Crate", "Block"}
    assert press(obstacle) == {"FINISHED"}
    assert len(found("LINKED")) == 1 and found("LINKED")[0].names == ("Crate",)
    with pytest.raises(RuntimeError, match="'Crate' is in a linked collection"):
        press(found("LINKED")[0])


def test_a_linked_and_a_local_object_of_one_name(room, library):
    linked = link(library, "objects", "Block", room)
    local = bpy.data.objects["Block", None]
    assert linked.name == local.name
    local.data.attributes.new("Lightpanes", "FLOAT", "POINT")
    (obstacle,) = found("ATTRIBUTE")
    assert press(obstacle) == {"FINISHED"}
    assert "Lightpanes.001" in local.data.attributes and not found("ATTRIBUTE")


def test_the_panel_and_the_bake_say_it_in_one_wording(room, library, quick):
    link(library, "collections", "Set", room)
    link(library, "objects", "Block", room)
    room.objects["Room"].lightpanes.target = "VERTICES"
    twin = add(room, "Twin", bpy.data.objects["Room"].data)
    twin.scale = (1.2, 1.2, 1.2)
    part = bpy.data.collections.new("Part")
    part.objects.link(bpy.data.objects["Block", None])
    instancer = add(room, "Instancer", None)
    instancer.instance_type, instancer.instance_collection = "COLLECTION", part
    bpy.context.view_layer.update()
    foreseen = {obstacle.sentence for kind in ("LINKED", "SHARED_MESH", "INSTANCES") for obstacle in found(kind)}
    assert len(foreseen) == 3
    told = baking.bake_scene(bpy.context)["warnings"]
    assert foreseen <= set(told) and len(told) == len(foreseen)
