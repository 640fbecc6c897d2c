"""What stands in the way of a bake: said in the panel, mended by one click, gone afterwards."""

import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import fixes, preflight  # noqa: E402
from lightpanes.addon.obstacles import ERROR, named  # noqa: E402
from lightpanes.core.scene import SceneError  # noqa: E402

from .mending import add, bakes, found, mend, press, without_fix  # noqa: E402


def walls():
    return bpy.data.objects["Room"]


def block():
    return bpy.data.objects["Block"]


def lamp():
    return bpy.data.objects["Lamp"]


def test_a_good_scene_has_none(room):
    seen = preflight.examine(bpy.context)
    assert seen.obstacles == () and preflight.check(bpy.context) == []
    assert (seen.objects, seen.at_vertices, seen.excluded, seen.blockers) == (2, 0, 0, 0)
    assert (seen.live, seen.static, seen.lamps) == (1, 0, ("Lamp",))


def test_no_mesh(blender):
    obstacle = without_fix("NO_MESH")
    assert obstacle.severity == ERROR and preflight.examine(bpy.context).forecast is None
    with pytest.raises(SceneError, match=r"There is nothing to bake: scene 'Scene' has no mesh\. Add one\."):
        preflight.check(bpy.context)


def test_everything_hidden_from_renders(room, quick):
    inner = bpy.data.collections.new("Inner")
    outer = bpy.data.collections.new("Outer")
    room.collection.children.link(outer)
    outer.children.link(inner)
    room.collection.objects.unlink(block())
    inner.objects.link(block())
    outer.hide_render = True
    bpy.context.view_layer.layer_collection.children["Outer"].children["Inner"].exclude = True
    walls().hide_render = True
    mend("ALL_HIDDEN")
    assert preflight.examine(bpy.context).objects == 2
    assert bakes()


def test_showing_leaves_other_collections_hidden(room):
    other = bpy.data.collections.new("Other")
    room.collection.children.link(other)
    other.hide_render = True
    walls().hide_render = block().hide_render = True
    mend("ALL_HIDDEN")
    assert other.hide_render


def test_everything_excluded(room, quick):
    walls().lightpanes.exclude = block().lightpanes.exclude = True
    assert preflight.examine(bpy.context).excluded == 2
    mend("ALL_EXCLUDED")
    assert bakes()


def test_no_faces_at_all(room):
    for item in (walls(), block()):
        item.data.clear_geometry()
    assert without_fix("NO_FACES").severity == ERROR


def test_one_object_without_faces(room):
    block().data.clear_geometry()
    mend("FACELESS")
    assert block().hide_render and not walls().hide_render


def test_nothing_that_can_receive(room):
    for item in (walls(), block()):
        bpy.data.objects.remove(item)
    add(room, "Ball", bpy.data.metaballs.new("Ball"))
    assert without_fix("NO_RECEIVER").severity == ERROR
    with pytest.raises(RuntimeError, match="No object can receive light"):
        bpy.ops.lightpanes.bake()


@pytest.mark.parametrize("mode", ["EDIT", "SCULPT"])
def test_another_mode(room, mode):
    bpy.context.view_layer.objects.active = block()
    bpy.ops.object.mode_set(mode=mode)
    mend("EDIT_MODE" if mode == "EDIT" else "OTHER_MODE")
    assert bpy.context.mode == "OBJECT"


def test_eight_uv_layers(room, quick):
    for number in range(8):
        block().data.uv_layers.new(name=f"UV {number}")
    with pytest.raises(SceneError, match="'Block' has 8 UV layers, the most that Blender allows"):
        preflight.check(bpy.context)
    mend("UV_LAYERS")
    assert len(block().data.uv_layers) == 8 and bakes()


def test_eight_uv_layers_matter_not_at_vertices(room):
    for number in range(8):
        block().data.uv_layers.new(name=f"UV {number}")
    block().lightpanes.target = "VERTICES"
    assert not found("UV_LAYERS")


def test_a_foreign_attribute_of_our_name(room, quick):
    block().data.attributes.new("Lightpanes", "FLOAT", "POINT").data[0].value = 5
    mend("ATTRIBUTE")
    assert block().data.attributes["Lightpanes.001"].data[0].value == 5
    assert bakes() and "Lightpanes" in block().data.uv_layers


def test_an_atlas_for_engines_has_no_place_for_vertices(room):
    room.lightpanes.exits = "ATLAS"
    block().lightpanes.target = "VERTICES"
    mend("EXITS")
    assert room.lightpanes.exits == "AUTO"


def test_no_lamp_at_all(room, quick):
    bpy.data.objects.remove(lamp())
    assert preflight.check(bpy.context) == [
        "Scene 'Scene' has no visible lamp; the light follows as soon as you add or show one."
    ]
    obstacle = mend("NO_LAMP")
    assert obstacle.button == "Add Lamp"
    (new,) = [item for item in room.objects if item.type == "LIGHT"]
    assert all(abs(x) < 1e-6 for x in new.location), "in the middle of the room"
    assert new.data.energy > 0 and bakes()


def test_a_hidden_lamp(room):
    lamp().hide_render = True
    assert mend("NO_LAMP").button == "Show Lamps"
    assert not lamp().hide_render and len(bpy.data.lights) == 1


@pytest.mark.parametrize("kind", ["POINT", "SUN"])
def test_a_lamp_without_power(room, kind):
    lamp().data.type = kind
    lamp().data.energy = 0
    mend("NO_POWER")
    assert lamp().data.energy > 0


def test_a_lamp_that_is_off_among_others_is_none(room):
    other = add(room, "Other", bpy.data.lights.new("Other", "POINT"))
    lamp().data.energy = 0
    assert other.data.energy > 0 and not found("NO_POWER")
    lamp().data.lightpanes.live = False
    assert found("NO_POWER")[0].names == ("Lamp",)


def test_a_lamp_whose_power_is_animated_is_none(room):
    lamp().data.energy = 0
    lamp().data.keyframe_insert("energy", frame=1)
    assert not found("NO_POWER")


def curve(scene, name="Curve", kind="CURVE"):
    data = bpy.data.curves.new(name, kind)
    if kind == "FONT":
        data.body = "Light"
    else:
        data.splines.new("POLY").points.add(3)
        data.bevel_depth = 0.1
    return add(scene, name, data)


@pytest.mark.parametrize("kind", ["CURVE", "FONT"])
def test_curves_and_text(room, quick, kind):
    item = curve(room, "Sign", kind)
    if kind == "CURVE":
        for number, point in enumerate(item.data.splines[0].points):
            point.co = (0.1 * number, 0.02 * number, 0, 1)
    block().select_set(True)
    bpy.context.view_layer.objects.active = block()
    mend("CONVERT")
    assert bpy.data.objects["Sign"].type == "MESH" and preflight.examine(bpy.context).objects == 3
    assert bpy.context.view_layer.objects.active == block() and bpy.context.selected_objects == [block()]
    assert bakes()


def test_a_curve_without_faces_is_none(room):
    curve(room).data.bevel_depth = 0
    assert not found("CONVERT") and not found("NOT_A_MESH")


def test_curves_that_others_use_stay(room):
    item = curve(room)
    add(room, "Copy", item.data)
    add(room, "Ball", bpy.data.metaballs.new("Ball"))
    assert set(without_fix("NOT_A_MESH").names) == {"Ball", "Copy", "Curve"}


def instancer(scene, name="Instances"):
    collection = bpy.data.collections.new("Set")
    mesh = bpy.data.meshes.new("Tile")
    mesh.from_pydata([(0, 0, 0), (0.2, 0, 0), (0, 0.2, 0)], [], [(0, 1, 2)])
    for number in range(3):
        item = bpy.data.objects.new("Tile", mesh)
        item.location.x = 0.3 * number
        collection.objects.link(item)
    item = add(scene, name, None)
    item.instance_type, item.instance_collection = "COLLECTION", collection
    item.location = (0, 0, 0.5)
    bpy.context.view_layer.update()
    return item


def test_instances(room, quick):
    instancer(room, "One")
    instancer(room, "Two")
    assert [obstacle.names for obstacle in found("INSTANCES")] == [("One",), ("Two",)]
    assert press(found("INSTANCES")[1]) == {"FINISHED"}
    assert [obstacle.names for obstacle in found("INSTANCES")] == [("One",)]
    mend("INSTANCES")
    assert preflight.examine(bpy.context).objects == 8
    places = sorted(tuple(item.matrix_world.translation) for item in room.objects if item.name.startswith("Tile"))
    assert len(places) == 6 and places[-1] == pytest.approx((0.6, 0, 0.5))
    assert bakes()


def test_instances_on_faces(room):
    tile = bpy.data.objects["Block"]
    tile.parent = walls()
    walls().instance_type = "FACES"
    mend("INSTANCES")
    assert sum(item.name.startswith("Block") for item in room.objects) == 7


def test_too_many_instances_for_one_click(room):
    mesh = bpy.data.meshes.new("Many")
    mesh.from_pydata([(0.001 * k, 0, 0) for k in range(2000)], [], [(0, 1, 2)])
    owner = add(room, "Many", mesh)
    owner.instance_type = "VERTS"
    block().parent = owner
    without_fix("INSTANCES")


def test_instances_of_lamps_alone_are_none(room):
    item = instancer(room)
    for part in list(item.instance_collection.objects):
        item.instance_collection.objects.unlink(part)
    item.instance_collection.objects.link(lamp())
    assert not found("INSTANCES")


def library(tmp_path):
    """A .blend with an object in a collection."""
    path = tmp_path / "library.blend"
    mesh = bpy.data.meshes.new("Chair")
    mesh.from_pydata([(0, 0, 0), (0.2, 0, 0), (0, 0.2, 0)], [], [(0, 1, 2)])
    collection = bpy.data.collections.new("Chairs")
    collection.objects.link(bpy.data.objects.new("Chair", mesh))
    bpy.data.libraries.write(str(path), {collection})
    bpy.data.objects.remove(bpy.data.objects["Chair"])
    bpy.data.collections.remove(collection)
    bpy.data.meshes.remove(mesh)
    return str(path)


def test_linked_objects(room, quick, tmp_path):
    with bpy.data.libraries.load(library(tmp_path), link=True) as (_, wanted):
        wanted.objects = ["Chair"]
    room.collection.objects.link(bpy.data.objects["Chair"])
    bpy.context.view_layer.update()
    assert preflight.examine(bpy.context).blockers == 1
    mend("LINKED")
    chair = room.objects["Chair"]
    assert chair.library is None and chair.data.library is None
    assert preflight.examine(bpy.context).blockers == 0
    assert bakes()


def test_a_linked_mesh_of_a_local_object(room, tmp_path):
    with bpy.data.libraries.load(library(tmp_path), link=True) as (_, wanted):
        wanted.meshes = ["Chair"]
    item = add(room, "Mine", bpy.data.meshes["Chair"])
    mend("LINKED")
    assert item.data.library is None


def test_a_linked_collection_says_what_to_do(room, tmp_path):
    with bpy.data.libraries.load(library(tmp_path), link=True) as (_, wanted):
        wanted.collections = ["Chairs"]
    room.collection.children.link(bpy.data.collections["Chairs"])
    bpy.context.view_layer.update()
    (obstacle,) = found("LINKED")
    try:
        assert press(obstacle) == {"FINISHED"} and not found("LINKED")
    except RuntimeError as error:
        assert "Library Override" in str(error)


def test_a_mesh_shared_at_vertices(room, quick):
    add(room, "Twin", block().data).location.x = -0.6
    block().lightpanes.target = "VERTICES"
    mend("SHARED_MESH")
    assert preflight.examine(bpy.context).at_vertices == 1
    assert bakes() and "lightpanes_irradiance" in block().data.attributes


def test_a_foreign_attribute_where_light_at_vertices_goes(room):
    block().data.attributes.new("lightpanes_irradiance", "FLOAT", "POINT")
    block().lightpanes.target = "VERTICES"
    mend("LIGHT_ATTRIBUTE")
    assert "lightpanes_irradiance.001" in block().data.attributes


def test_hair_particles_and_volumes(room):
    bpy.context.view_layer.objects.active = block()
    bpy.ops.object.particle_system_add()
    settings = block().particle_systems[0].settings
    settings.render_type = "OBJECT"
    without_fix("PARTICLES")
    settings.type, settings.render_type = "HAIR", "PATH"
    without_fix("HAIR")
    add(room, "Fog", bpy.data.volumes.new("Fog"))
    assert without_fix("UNTRACED").names == ("Fog",)


def test_materials_that_a_bake_does_not_know(room):
    tree = block().data.materials[0].node_tree
    volume = tree.nodes.new("ShaderNodeVolumeAbsorption")
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    tree.links.new(volume.outputs[0], output.inputs["Volume"])
    assert "'Block' has a volume" in without_fix("MATERIAL").sentence


def test_a_fix_that_came_too_late_does_nothing(room):
    lamp().hide_render = True
    (obstacle,) = found("NO_LAMP")
    lamp().hide_render = False
    assert press(obstacle) == {"CANCELLED"}
    assert len(room.objects) == 3


def test_a_fix_can_be_undone(room):
    block().data.attributes.new("Lightpanes", "FLOAT", "POINT")
    bpy.ops.ed.undo_push(message="Before")
    mend("ATTRIBUTE")
    bpy.ops.ed.undo_push(message="Fixed")
    bpy.ops.ed.undo()
    assert found("ATTRIBUTE")


def test_every_fix_has_its_tooltip():
    assert fixes.FIXES.keys() == fixes.HELP.keys()


def test_names_in_sentences(room):
    assert named([block()]) == "'Block'"
    assert named([block(), lamp()]) == "'Block' and 'Lamp'"
    assert named([block(), lamp(), walls()]) == "'Block', 'Lamp' and 'Room'"
    assert named([block(), lamp(), walls(), block(), lamp()]) == "'Block', 'Lamp' and 3 more"


def test_looking_again_costs_nothing_until_something_changes(room, monkeypatch):
    first = preflight.inspect(bpy.context)
    monkeypatch.setattr(preflight, "examine", lambda context: pytest.fail("looked again"))
    assert preflight.inspect(bpy.context) is first
    monkeypatch.undo()
    monkeypatch.setattr(preflight, "REST", 0)
    preflight.forget()
    block().data.attributes.new("Mine", "FLOAT", "POINT")
    for change in (
        lambda: setattr(block(), "hide_render", True),
        lambda: setattr(lamp().data, "energy", 0),
        lambda: setattr(block().lightpanes, "target", "VERTICES"),
        lambda: setattr(room.lightpanes, "resolution", 128),
        lambda: setattr(room.render, "engine", "CYCLES"),
        lambda: setattr(block().data.attributes["Mine"], "name", "Yours"),
        lambda: bpy.data.objects.remove(block()),
    ):
        before = preflight.inspect(bpy.context)
        change()
        bpy.context.view_layer.update()
        assert preflight.inspect(bpy.context) is not before


def test_a_scene_that_keeps_changing_is_looked_at_now_and_then(room, monkeypatch):
    monkeypatch.setattr(preflight, "REST", 1e9)
    monkeypatch.setattr(preflight, "LONGEST_REST", 1e9)
    first = preflight.inspect(bpy.context)
    block().hide_render = True
    bpy.context.view_layer.update()
    assert preflight.inspect(bpy.context) is first
    preflight.forget()
    assert preflight.inspect(bpy.context).objects == 1
