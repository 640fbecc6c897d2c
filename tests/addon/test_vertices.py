"""Objects without a texture take their light at their vertices: the same light, in an attribute that is ours alone."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import nodes, store, vertices  # noqa: E402

from .files import baked_once, empty  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")

LIGHT, UV = "lightpanes_irradiance", "Lightpanes"


@pytest.fixture
def asking(room):
    """The room, whose block asks for light at its vertices; a finer block, so that vertices see what texels see."""
    block = bpy.data.objects["Block"]
    finer(block)
    block.lightpanes.target = "VERTICES"
    return room


@pytest.fixture
def baked(asking, saved):
    return baked_once(asking, saved)


def finer(item, cuts=3):
    """Cut the faces into smaller ones."""
    with bpy.context.temp_override(object=item, active_object=item, selected_objects=[item]):
        modifier = item.modifiers.new("Finer", "SUBSURF")
        modifier.subdivision_type, modifier.levels, modifier.render_levels = "SIMPLE", cuts, cuts
        bpy.context.view_layer.objects.active = item
        bpy.ops.object.modifier_apply(modifier=modifier.name)
    bpy.context.view_layer.update()


def light(name="Block"):
    """(n, 3) what the attribute holds."""
    attribute = bpy.data.objects[name].data.attributes[LIGHT]
    values = np.empty(4 * len(attribute.data), np.float32)
    attribute.data.foreach_get("color", values)
    values = values.reshape(-1, 4)
    assert (values[:, 3] == 1).all()
    return values[:, :3].copy()


def normals(name="Block"):
    """(n, 3) of each corner."""
    mesh = bpy.data.objects[name].data
    values = np.empty(3 * len(mesh.loops), np.float32)
    mesh.corner_normals.foreach_get("vector", values)
    return values.reshape(-1, 3)


def update():
    bpy.context.view_layer.update()


def state():
    """All that a user could see change on meshes, objects and materials."""
    found = []
    for mesh in sorted(bpy.data.meshes, key=lambda mesh: mesh.name):
        colors = mesh.color_attributes
        found.append(
            (
                mesh.name,
                sorted((a.name, a.domain, a.data_type) for a in mesh.attributes),
                sorted(mesh.keys()),
                (colors.active_color_name, colors.default_color_name),
                [layer.name for layer in mesh.uv_layers],
            )
        )
    for item in sorted(bpy.data.objects, key=lambda item: item.name):
        found.append((item.name, sorted(key for key in item.keys() if key != "lightpanes")))
    for material in sorted(bpy.data.materials, key=lambda material: material.name):
        found.append((material.name, [(node.name, node.type) for node in material.node_tree.nodes]))
    return found


def warnings(scene):
    return store.read_meta(scene)["report"]["warnings"]


def test_no_uv_layer_and_no_place_in_the_atlas(baked):
    block, room = bpy.data.objects["Block"], bpy.data.objects["Room"]
    assert UV not in block.data.uv_layers and UV in room.data.uv_layers
    assert block["lightpanes_baked"] == block["lightpanes_vertices"] == 1.0
    assert "lightpanes_scale" not in block and "lightpanes_vertices" not in room
    assert LIGHT not in room.data.attributes
    assert store.read_meta(baked)["report"]["exits"] == "points"


def test_flat_faces_are_lit_at_corners_and_smooth_ones_at_vertices(baked):
    block = bpy.data.objects["Block"]
    assert block.data.attributes[LIGHT].domain == "CORNER"
    assert len(light()) == len(block.data.loops) and light().max() > 0.05
    block.data.shade_smooth()
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert block.data.attributes[LIGHT].domain == "POINT"
    assert len(light()) == len(block.data.vertices) and light().max() > 0.05


def test_agrees_with_the_texture_of_the_same_scene(baked):
    """Top and sides of the block, by vertices and by texels. Smooth light: their means differ by noise alone."""
    mine = light()
    up = normals()
    means = [mine[up[:, axis] * sign > 0.9].mean(axis=0) for axis in range(3) for sign in (1, -1)]
    bpy.data.objects["Block"].lightpanes.target = "TEXTURE"
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    mesh = bpy.data.objects["Block"].data
    assert LIGHT not in mesh.attributes and UV in mesh.uv_layers
    image = store.find_image(baked, store.IRRADIANCE)
    pixels = np.array(image.pixels, np.float32).reshape(64, 64, 4)[..., :3]
    uv = np.empty(2 * len(mesh.loops), np.float32)
    mesh.uv_layers["Lightpanes"].uv.foreach_get("vector", uv)
    column, row = np.clip((uv.reshape(-1, 2) * 64).astype(int), 0, 63).T
    theirs = pixels[row, column]
    truth = [theirs[up[:, axis] * sign > 0.9].mean(axis=0) for axis in range(3) for sign in (1, -1)]
    # the block stands on the floor, and nothing is lit below it
    assert np.allclose(np.delete(means, 5, 0), np.delete(truth, 5, 0), rtol=0.12)
    assert np.mean(np.delete(means, 5, 0)) == pytest.approx(np.mean(np.delete(truth, 5, 0)), rel=0.04)


def test_follows_the_lamps(baked):
    before = light()
    lamp = bpy.data.objects["Lamp"]
    lamp.data.energy *= 0.5
    update()
    assert np.allclose(light(), before / 2, rtol=1e-3, atol=1e-5)
    lamp.location.x = 0.5
    update()
    assert np.abs(2 * light() - before).max() > 0.05 * before.max()


def test_relights_after_reopening(baked, tmp_path):
    bpy.data.objects["Lamp"].location.x = 0.45
    update()
    expected = light()
    bpy.data.objects["Lamp"].location.x = -0.3
    update()
    before = light()
    path = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    empty()
    bpy.ops.wm.open_mainfile(filepath=path)
    assert np.array_equal(light(), before)
    bpy.data.objects["Lamp"].location.x = 0.45
    update()
    assert np.allclose(light(), expected, rtol=1e-3, atol=1e-4 * expected.max())


def test_each_corner_has_its_own_light(baked):
    """Light from above falls on the top alone, whichever order the mesh has its faces in."""
    baked.lightpanes.live = True
    up = normals()
    top, bottom = light()[up[:, 2] > 0.9], light()[up[:, 2] < -0.9]
    assert top.mean() > 5 * bottom.mean()


def test_mirrored_objects_and_faces_without_area(asking):
    """Both change the order in which corners meet their places."""
    block = bpy.data.objects["Block"]
    block.scale.x = -1
    mesh = block.data
    corners = [tuple(v.co) for v in mesh.vertices]
    faces = [tuple(face.vertices) for face in mesh.polygons]
    mesh.clear_geometry()
    mesh.from_pydata([*corners, (0, 0, 0), (0, 0, 0.1), (0, 0, 0.2)], [], [(96 + 2, 98 + 1, 98 + 2), *faces])
    update()
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    up = normals()[3:]
    mine = light()[3:]
    assert mine[up[:, 2] > 0.9].mean() > 5 * mine[up[:, 2] < -0.9].mean()


def test_everything_at_vertices(asking):
    for name in ("Room", "Block"):
        bpy.data.objects[name].lightpanes.target = "VERTICES"
    finer(bpy.data.objects["Room"])
    before = state()
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert light("Room").mean() > 0.1
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert state() == before


def test_clear_gives_everything_back(asking):
    mesh = bpy.data.objects["Block"].data
    mesh.attributes.new("Painted", "BYTE_COLOR", "CORNER")
    mesh.attributes.new("Own", "FLOAT", "POINT")
    before = state()
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert mesh.color_attributes.active_color_name == "Painted"
    assert state() != before
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert state() == before


def test_a_cancelled_bake_changes_nothing(asking):
    from lightpanes.addon import baking

    def stop(progress):
        if progress.fraction > 0.5:
            raise KeyboardInterrupt

    before = state()
    with pytest.raises(KeyboardInterrupt):
        baking.bake_scene(bpy.context, stop)
    assert state() == before


def test_from_vertices_to_texture_and_back(baked):
    block = bpy.data.objects["Block"]
    for target in ("TEXTURE", "VERTICES"):
        block.lightpanes.target = target
        assert bpy.ops.lightpanes.bake() == {"FINISHED"}
        assert (UV in block.data.uv_layers) == (target == "TEXTURE")
        assert (LIGHT in block.data.attributes) == (target == "VERTICES")
        assert ("lightpanes_scale" in block) == (target == "TEXTURE")


def refused(scene, reason):
    """The block takes a texture instead, and the user reads why."""
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    told = [sentence for sentence in warnings(scene) if sentence.startswith("'Block' can't be lit at its vertices")]
    assert len(told) == 1 and reason in told[0]
    block = bpy.data.objects["Block"]
    assert UV in block.data.uv_layers and "lightpanes_vertices" not in block and vertices.OURS not in block.data


def test_modifiers_that_change_the_vertices(asking):
    modifier = bpy.data.objects["Block"].modifiers.new("Bevel", "BEVEL")
    modifier.show_viewport = False  # a render shows it
    refused(asking, "modifiers that change its vertices")
    modifier.show_render = False
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert not warnings(asking) and LIGHT in bpy.data.objects["Block"].data.attributes


def test_modifiers_that_bend(asking):
    modifier = bpy.data.objects["Block"].modifiers.new("Wave", "SIMPLE_DEFORM")
    modifier.deform_method, modifier.angle = "TWIST", 0.5
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert light().max() > 0.05


def test_a_mesh_with_two_users(asking):
    block = bpy.data.objects["Block"]
    other = bpy.data.objects.new("Twin", block.data)
    other.location = (-0.5, 0.4, -0.7)
    asking.collection.objects.link(other)
    update()
    refused(asking, "shares its mesh with 'Twin'")


def test_an_attribute_of_the_users_own(asking):
    mesh = bpy.data.objects["Block"].data
    own = mesh.attributes.new(LIGHT, "FLOAT", "POINT")
    own.data.foreach_set("value", np.full(len(mesh.vertices), 7.0, np.float32))
    refused(asking, f"has an attribute '{LIGHT}' of its own")
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert mesh.attributes[LIGHT].data[0].value == 7.0


def test_a_deleted_attribute_is_named(baked):
    mesh = bpy.data.objects["Block"].data
    mesh.attributes.remove(mesh.attributes[LIGHT])
    bpy.data.lights["Lamp"].energy = 5
    update()
    with pytest.raises(RuntimeError, match=f"The attribute '{LIGHT}' of 'Block' has been deleted"):
        bpy.ops.lightpanes.relight()
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert vertices.OURS not in mesh


def test_two_scenes(baked):
    before = light()
    bpy.ops.scene.new(type="FULL_COPY")
    copy = bpy.context.scene
    for item in copy.objects:
        if item.type == "LIGHT":
            item.data.energy = 0.0
    update()
    twin = next(item for item in copy.objects if item.name.startswith("Block"))
    assert light(twin.name).max() == 0
    assert np.array_equal(light(), before)
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert LIGHT not in twin.data.attributes
    assert np.array_equal(light(), before)


def test_undo(baked):
    bpy.ops.ed.undo_push(message="Baked")
    before = light()
    bpy.data.lights["Lamp"].energy = 5.0
    update()
    bpy.ops.ed.undo_push(message="Dimmed")
    bpy.ops.ed.undo()
    assert np.allclose(light(), before, rtol=1e-4, atol=1e-6)


def camera(scene):
    """Look at the block's top alone."""
    made = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(made)
    made.location, made.data.type, made.data.ortho_scale = (0.3, 0.2, 0.5), "ORTHO", 0.4
    scene.camera, scene.render.engine, scene.cycles.samples = made, "CYCLES", 4
    scene.cycles.use_denoising = False
    scene.render.resolution_x = scene.render.resolution_y = 24


def pixels(path):
    """(24, 24, 3) of a rendered file."""
    return np.array(bpy.data.images.load(str(path)).pixels, np.float32).reshape(24, 24, -1)[..., :3]


def picture(scene, tmp_path):
    """(24, 24, 3) of the block's top in the light that the bake gives and no other."""
    camera(scene)
    scene.lightpanes.cycles = True
    scene.render.image_settings.file_format, scene.render.filepath = "OPEN_EXR", str(tmp_path / "picture.exr")
    scene.lightpanes.live = False
    bpy.data.lights["Lamp"].energy = 0.0
    bpy.ops.render.render(write_still=True)
    return pixels(scene.render.filepath)


def test_materials_show_it(baked, tmp_path):
    """Albedo × irradiance / π, on the block's top."""
    shown = picture(baked, tmp_path)
    expected = light()[normals()[:, 2] > 0.9].mean(axis=0) * (0.2, 0.4, 0.7) / np.pi
    assert np.allclose(shown.mean(axis=(0, 1)), expected, rtol=0.1)


def test_each_frame_of_a_render_shows_its_own_light(baked, tmp_path):
    """No light but ours, from a lamp that Cycles does not see, in a render that keeps its data between frames."""
    lamp = bpy.data.objects["Lamp"]
    for frame, energy in ((1, 20.0), (2, 5.0)):
        lamp.data.energy = energy
        lamp.data.keyframe_insert("energy", frame=frame)
    lamp.data.cycles.max_bounces = 0
    camera(baked)
    baked.lightpanes.cycles = baked.render.use_persistent_data = True
    baked.frame_start, baked.frame_end = 1, 2
    baked.render.image_settings.file_format, baked.render.filepath = "OPEN_EXR", str(tmp_path / "frame_")
    bpy.ops.render.render(animation=True)
    means = [pixels(tmp_path / f"frame_{frame:04d}.exr").mean() for frame in (1, 2)]
    assert means[1] == pytest.approx(means[0] / 4, rel=0.02)


def test_materials_without_a_plain_albedo_show_their_mean(asking, tmp_path):
    """There is no place in the atlas from which such an albedo could be read."""
    tree = bpy.data.materials["Block"].node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    mix, dark = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfDiffuse")
    dark.inputs["Color"].default_value = (0, 0, 0, 1)
    output = tree.get_output_node("ALL")
    tree.links.new(shader.outputs[0], mix.inputs[1])
    tree.links.new(dark.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    shown = picture(asking, tmp_path)
    expected = light()[normals()[:, 2] > 0.9].mean(axis=0) * (0.1, 0.2, 0.35) / np.pi
    assert np.allclose(shown.mean(axis=(0, 1)), expected, rtol=0.1)


def test_scenes_without_such_objects_keep_the_plain_group(room):
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    group = next(g for g in bpy.data.node_groups if g.get(store.TAG) == nodes.GROUP)
    names = {node.attribute_name for node in group.nodes if node.type == "ATTRIBUTE"}
    assert names == {"lightpanes_scale", "lightpanes_offset", "lightpanes_baked"}
