"""While a scene is read for a bake it stays as it is, whatever modifiers its objects have."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import atlas, baking, extract, job, unfolded  # noqa: E402
from lightpanes.addon.snapshot import PLACE, Snapshot  # noqa: E402
from lightpanes.addon.work import Work, run  # noqa: E402
from lightpanes.core.scene import SceneError  # noqa: E402

from .test_job import drive, ended, stage  # noqa: E402, F401
from .test_operators import bake_state, everything  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def shaped(room):
    """The room and objects whose faces come from modifiers, of all kinds that matter for UVs."""
    kinds = {"Smooth": "SUBSURF", "Row": "ARRAY", "Cut": "BOOLEAN", "Ring": "MIRROR", "Lost": "REMESH", "Edge": "BEVEL"}
    for number, (name, kind) in enumerate(kinds.items()):
        bpy.ops.mesh.primitive_cube_add(size=0.2, location=(0.25 * number - 0.6, -0.5, -0.3))
        item = bpy.context.object
        item.name, item.rotation_euler.z = name, 0.1 * number
        modifier = item.modifiers.new(name, kind)
        if kind == "SUBSURF":
            # the viewport shows less than a render
            modifier.levels, modifier.render_levels = 1, 2
        elif kind == "BOOLEAN":
            modifier.object = bpy.data.objects["Smooth"]
        elif kind == "MIRROR":
            modifier.mirror_object = bpy.data.objects["Block"]
        elif kind == "REMESH":
            modifier.voxel_size = 0.05
    twin = bpy.data.objects.new("Twin", bpy.data.objects["Edge"].data)
    twin.location = (0.5, 0.6, 0.2)
    room.collection.objects.link(twin)
    bpy.data.objects["Edge"].lightpanes.weight = 3
    bpy.context.view_layer.update()
    room.lightpanes.resolution = 128
    return room


def meshes():
    return [item for item in bpy.context.scene.objects if item.type == "MESH"]


def differing(one, other):
    """Names of the arrays in which two scenes differ by more than the order in which Blender's threads add up."""
    names = ("positions", "triangles", "corner_normals", "atlas_uv", "triangle_material", "triangle_object")
    pairs = [(name, getattr(one, name), getattr(other, name)) for name in names]
    return [name for name, a, b in pairs if a.shape != b.shape or not np.allclose(a, b, atol=1e-5, equal_nan=True)]


def test_it_is_read_as_if_it_had_the_atlas(shaped):
    planned, _ = run(atlas.atlas_steps(bpy.context, meshes(), 128))
    found = unfolded.Unfolded(planned)
    before = everything()
    warnings = [text for item in meshes() for text in found.read(bpy.context, item)]
    with found.laid(meshes()):
        read = extract.extract(bpy.context, resolution=128, atlas=found)
    assert everything() == before
    told = atlas.make_atlas(bpy.context, meshes(), 128)
    truth = extract.extract(bpy.context, resolution=128)
    assert differing(read, truth) == [] and read.warnings == truth.warnings
    assert [item.receives for item in read.objects] == [item.receives for item in truth.objects]
    assert [text for text in told if "same texels" in text] == warnings and "'Row'" in warnings[0]
    receives = {item.name: item.receives for item in read.objects}
    assert not receives.pop("Lost") and all(receives.values())


@pytest.mark.parametrize("again", [False, True])
def test_no_step_leaves_anything_of_ours(shaped, again):
    if again:
        baking.bake_scene(bpy.context)
        state = bake_state(shaped)
    before, answer = everything(), None
    bpy.data.objects["Block"].lightpanes.weight = 4
    steps, seen = baking.bake_steps(bpy.context), set()
    while True:
        step = steps.send(answer)
        answer = None
        assert everything() == before
        if again:
            assert bake_state(shaped) == state
        if isinstance(step, Work):
            if step.alone:
                break
            answer = step.run(lambda _: None)
        else:
            seen.add(step.stage)
    steps.close()
    assert seen == {"Atlas", "Reading the scene"} and everything() == before


def test_materials_that_vary_get_their_maps(shaped):
    """On copies, which have the atlas that is planned."""
    material = bpy.data.objects["Block"].data.materials[0]
    tree = material.node_tree
    noise = tree.nodes.new("ShaderNodeTexChecker")
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    tree.links.new(noise.outputs["Color"], shader.inputs["Base Color"])
    planned, _ = run(atlas.atlas_steps(bpy.context, meshes(), 64))
    found = unfolded.Unfolded(planned)
    for item in meshes():
        found.read(bpy.context, item)
    with found.laid(meshes()):
        read = extract.extract(bpy.context, resolution=64, atlas=found)
    planned.restore()
    truth = extract.extract(bpy.context, resolution=64)
    assert np.array_equal(read.albedo_map, truth.albedo_map) and np.ptp(read.albedo_map) > 0.1


def test_undone_while_the_scene_is_read(shaped, monkeypatch):
    """An undo step from that time holds nothing of a bake."""
    monkeypatch.setattr(job, "SLICE", 0.0)
    bpy.ops.ed.undo_push(message="Before")
    running = drive(stage("Reading the scene"))
    bpy.data.objects["Lamp"].location.x += 0.1
    bpy.ops.ed.undo_push(message="Moved")
    running.cancel()
    bpy.data.objects["Lamp"].location.x += 0.1
    bpy.ops.ed.undo_push(message="Moved again")
    bpy.ops.ed.undo()
    found = everything()
    assert not [layer for layer in found["layers"] if layer[1] == "Lightpanes"]
    assert not [key for _, key in found["properties"] if key in PLACE]


def test_the_scene_deleted_while_it_is_read(shaped, monkeypatch):
    monkeypatch.setattr(job, "SLICE", 0.0)
    running = drive(stage("Reading the scene"))
    bpy.data.scenes.new("Other")
    bpy.data.scenes.remove(shaped)
    drive(running=running)
    assert running.error == "The scene was deleted while it was baked." and running.steps.gi_frame is None
    found = everything()
    assert not [layer for layer in found["layers"] if layer[1] == "Lightpanes"]


@pytest.mark.parametrize("change", ["faces", "modifier"])
def test_a_mesh_edited_while_it_is_read(shaped, change):
    planned, _ = run(atlas.atlas_steps(bpy.context, meshes(), 128))
    found = unfolded.Unfolded(planned)
    item = bpy.data.objects["Row" if change == "faces" else "Block"]
    if change == "faces":
        item.data.clear_geometry()
        item.data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    else:
        item.modifiers.new("Late", "SUBSURF").render_levels = 2
    before = everything()
    with pytest.raises(SceneError, match="The scene changed while it was read: bake again"), found.laid(meshes()):
        if change == "faces":
            found.read(bpy.context, item)
        extract.extract(bpy.context, resolution=128, atlas=found)
    assert everything() == before


def test_a_snapshot_leaves_linked_objects_alone(room, tmp_path):
    bpy.data.objects["Block"]["lightpanes_baked"] = 1.0
    bpy.data.libraries.write(str(tmp_path / "library.blend"), {bpy.data.objects["Block"]})
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, into):
        into.objects = ["Block"]
    room.collection.objects.link(into.objects[0])
    Snapshot.of(room, meshes()).restore()
    assert into.objects[0]["lightpanes_baked"] == 1.0
