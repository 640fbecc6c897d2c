"""Materials show albedo × irradiance / π and nothing else changes; taking it out gives every tree back."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import nodes, store  # noqa: E402
from lightpanes.core.bake import Bake  # noqa: E402
from lightpanes.core.scene import Material, Scene  # noqa: E402

SIZE = 32
IRRADIANCE = np.array([3.0, 2.0, 1.0], np.float32)
DIRECT = np.array([0.5, 0.0, 0.25], np.float32)
BASE = np.array([0.7, 0.6, 0.5])


def baked_with(*materials):
    """The part of core's Scene that attach reads."""
    return Scene(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]]), materials=materials)


def show(scene, *materials):
    """A bake with one irradiance everywhere, shown by every object of the scene."""
    scene.lightpanes.live = False  # or the lamps' light would take its place
    for item in scene.objects:
        if item.type == "MESH":
            place(item)
    ones = np.ones((SIZE, SIZE, 3), np.float32)
    entries = {"position": np.zeros((4, 3), np.float32)}
    store.store_bake(scene, Bake(SIZE, {}, entries, ones * DIRECT, {}), ones * 0.25)
    store.write_irradiance(scene, np.concatenate([ones * IRRADIANCE, ones[..., :1]], axis=2))
    return nodes.attach(bpy.context, baked_with(*materials or (Material("Other"),)))


def place(item):
    if item.data.uv_layers.get("Lightpanes") is None:
        item.data.uv_layers.new(name="Lightpanes")
    item["lightpanes_scale"], item["lightpanes_offset"], item["lightpanes_baked"] = [1.0, 1.0], [0.0, 0.0], 1.0


def tree_state(tree):
    """All that a user could see change in a node tree."""
    state = [
        (n.name, n.type, n.mute, tuple(n.location), n.select, getattr(n, "is_active_output", None)) for n in tree.nodes
    ]
    links = [(x.from_node.name, x.from_socket.identifier, x.to_node.name, x.to_socket.identifier) for x in tree.links]
    values = [
        tuple(v) if hasattr(v, "__len__") else v
        for n in tree.nodes
        for v in (getattr(s, "default_value", None) for s in n.inputs)
    ]
    return state, sorted(links), values, tree.nodes.active.name if tree.nodes.active else None


def dark(scene):
    """No light but ours."""
    bpy.data.objects.remove(bpy.data.objects["Lamp"])
    scene.world = None


def render(scene, samples=4, size=24, **cycles):
    """(size, size, 3) linear radiance of a Cycles render."""
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.device = samples, False, "CPU"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = bpy.app.tempdir + "lightpanes_test.exr"
    for name, value in cycles.items():
        setattr(scene.cycles, name, value)
    if scene.camera is None:
        camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        scene.collection.objects.link(camera)
        camera.location, camera.rotation_euler = (0, -0.95, 0), (math.pi / 2, 0, 0)
        scene.camera = camera
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    image.colorspace_settings.name = "Non-Color"
    pixels = np.array(image.pixels, np.float32).reshape(size, size, -1)[..., :3]
    bpy.data.images.remove(image)
    return pixels


def test_removing_gives_the_tree_back(room):
    materials = {m: tree_state(m.node_tree) for m in bpy.data.materials}
    groups = len(bpy.data.node_groups)
    show(room)
    room.lightpanes.cycles = True
    assert all(tree_state(m.node_tree) != state for m, state in materials.items())
    nodes.detach(room)
    assert all(tree_state(m.node_tree) == state for m, state in materials.items())
    assert len(bpy.data.node_groups) == groups


def test_attaching_leaves_the_users_nodes_and_links(room):
    material = bpy.data.materials["Room"]
    before = tree_state(material.node_tree)
    show(room)
    tree = material.node_tree
    theirs = [node for node in tree.nodes if "lightpanes" not in node]
    assert [node.name for node in theirs] == [row[0] for row in before[0]]
    kept = [x for x in tree.links if "lightpanes" not in x.from_node and "lightpanes" not in x.to_node]
    assert len(kept) == len(before[1])
    output = tree.get_output_node("EEVEE")
    assert output["lightpanes"] == 1 and output.target == "EEVEE"
    assert output.inputs["Surface"].links[0].from_node.node_tree.name == "Lightpanes"
    assert "lightpanes" not in tree.get_output_node("CYCLES")


def test_attaching_twice_is_attaching_once(room):
    show(room)
    once = tree_state(bpy.data.materials["Room"].node_tree)
    nodes.attach(bpy.context, baked_with(Material("Other")))
    assert tree_state(bpy.data.materials["Room"].node_tree) == once
    assert len([g for g in bpy.data.node_groups if store.TAG in g]) == 1


def test_cycles_is_unchanged_unless_asked(room):
    before = render(room)
    show(room)
    assert np.array_equal(render(room), before)


def test_radiance_in_cycles(room):
    """albedo × E / π on every surface that the camera sees: 0.1 %, no noise where nothing else shines."""
    bpy.data.objects.remove(bpy.data.objects["Block"])
    dark(room)
    show(room)
    room.lightpanes.cycles = True
    image = render(room)
    assert np.allclose(image, BASE * IRRADIANCE / math.pi, rtol=1e-3)


def test_our_light_does_not_bounce_in_cycles(room):
    """Even with Cycles' own bounces forced back on, baked light is seen and does not light anything."""
    bpy.data.objects.remove(bpy.data.objects["Block"])
    dark(room)
    show(room)
    room.lightpanes.cycles = True
    image = render(room, diffuse_bounces=4, samples=16)
    assert np.allclose(image, BASE * IRRADIANCE / math.pi, rtol=1e-3)


def test_mirrors_show_baked_light(room):
    bpy.data.objects.remove(bpy.data.objects["Block"])
    dark(room)
    bpy.ops.mesh.primitive_plane_add(size=1.9, location=(0, 0.9, 0), rotation=(math.pi / 2, 0, 0))
    mirror = bpy.data.materials.new("Mirror")
    if mirror.node_tree is None:
        mirror.use_nodes = True
    tree = mirror.node_tree
    glossy = tree.nodes.new("ShaderNodeBsdfGlossy")
    glossy.inputs["Roughness"].default_value = 0.0
    glossy.inputs["Color"].default_value = (1, 1, 1, 1)
    tree.links.new(glossy.outputs[0], tree.get_output_node("ALL").inputs["Surface"])
    bpy.context.object.data.materials.append(mirror)
    show(room, Material("Mirror", albedo=(0, 0, 0)))
    room.lightpanes.cycles = True
    assert np.allclose(render(room)[8:16, 8:16], BASE * IRRADIANCE / math.pi, rtol=1e-3)


def test_bounces_come_back(room):
    room.cycles.diffuse_bounces = 7
    show(room)
    room.lightpanes.cycles = True
    assert room.cycles.diffuse_bounces == 0
    assert bpy.data.materials["Room"].cycles.emission_sampling == "NONE"
    room.lightpanes.cycles = False
    assert room.cycles.diffuse_bounces == 7
    assert bpy.data.materials["Room"].cycles.emission_sampling == "AUTO"
    room.lightpanes.cycles = True
    nodes.detach(room)
    assert room.cycles.diffuse_bounces == 7
    assert bpy.data.materials["Room"].cycles.emission_sampling == "AUTO"


def test_unbaked_objects_stay_dark(room):
    dark(room)
    show(room)
    room.lightpanes.cycles = True
    for item in room.objects:
        if "lightpanes_baked" in item:
            del item["lightpanes_baked"]
    assert render(room).max() == 0.0


def test_objects_that_share_a_mesh_have_their_own_place(room):
    """Two halves of the atlas, one for each of two planes of one mesh."""
    dark(room)
    for name in ("Room", "Block"):
        bpy.data.objects.remove(bpy.data.objects[name])
    bpy.ops.mesh.primitive_plane_add(size=1, location=(-0.5, 0.5, 0), rotation=(math.pi / 2, 0, 0))
    left = bpy.context.object
    left.data.materials.append(bpy.data.materials["Room"])
    right = bpy.data.objects.new("Right", left.data)
    room.collection.objects.link(right)
    right.location, right.rotation_euler = (0.5, 0.5, 0), left.rotation_euler
    show(room)
    for item, offset in ((left, 0.0), (right, 0.5)):
        item["lightpanes_scale"], item["lightpanes_offset"] = [0.4, 1.0], [offset + 0.05, 0.0]
    pixels = np.zeros((SIZE, SIZE, 4), np.float32)
    pixels[:, : SIZE // 2], pixels[:, SIZE // 2 :] = (1, 0, 0, 1), (0, 0, 1, 1)
    store.write_irradiance(room, pixels)
    room.lightpanes.cycles = True
    image = render(room, size=32)
    assert np.allclose(image[16, 10], [BASE[0] / math.pi, 0, 0], atol=1e-4)
    assert np.allclose(image[16, 22], [0, 0, BASE[2] / math.pi], atol=1e-4)


def surface(tree):
    return tree.get_output_node("EEVEE").inputs["Surface"].links[0].from_node


def test_albedo_of_plain_and_other_trees(room):
    tree = bpy.data.materials["Room"].node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Metallic"].default_value = 0.5
    mixed = bpy.data.materials["Block"].node_tree
    mix = mixed.nodes.new("ShaderNodeMixShader")
    mixed.links.new(mix.outputs[0], mixed.get_output_node("ALL").inputs["Surface"])
    show(room, Material("Room"), Material("Block", albedo=(0.1, 0.2, 0.3), mapped=True))
    plain, mapped = surface(tree), surface(mixed)
    assert np.allclose(plain.inputs["Albedo"].default_value[:3], BASE * 0.5)
    assert plain.inputs["Albedo Map"].default_value == 0.0
    assert mapped.inputs["Albedo Map"].default_value == 1.0


def test_textures_are_shown_at_their_own_resolution(room):
    tree = bpy.data.materials["Room"].node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    texture = tree.nodes.new("ShaderNodeTexChecker")
    tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    shader.inputs["Metallic"].default_value = 0.25
    show(room)
    group = surface(tree)
    assert group.inputs["Albedo"].links[0].from_node == texture
    assert np.allclose(group.inputs["Tint"].default_value[:3], 0.75)
    assert len(shader.inputs["Base Color"].links) == 1


def test_objects_without_material(room):
    bpy.ops.mesh.primitive_cube_add(size=0.2)
    bare = bpy.context.object
    bpy.ops.mesh.primitive_cube_add(size=0.2)
    empty = bpy.context.object
    empty.data.materials.append(None)
    show(room)
    assert bare.material_slots[0].material.name == "Lightpanes Default"
    assert empty.material_slots[0].material.name == "Lightpanes Default"
    nodes.detach(room)
    assert len(bare.material_slots) == 0
    assert len(empty.material_slots) == 1 and empty.material_slots[0].material is None
    assert "Lightpanes Default" not in bpy.data.materials


@pytest.mark.skipif(bpy.app.version >= (5, 0), reason="5.0 made every material use nodes")
def test_materials_without_nodes(room):
    plain = bpy.data.materials.new("Plain")
    plain.use_nodes = False
    plain.diffuse_color = (0.2, 0.4, 0.6, 1)
    bpy.data.objects["Block"].data.materials[0] = plain
    show(room)
    assert np.allclose(surface(plain.node_tree).inputs["Albedo"].default_value[:3], (0.2, 0.4, 0.6))
    nodes.detach(room)
    assert not plain.use_nodes


def test_a_second_output_of_the_user_stays_active(room):
    tree = bpy.data.materials["Room"].node_tree
    second = tree.nodes.new("ShaderNodeOutputMaterial")
    second.is_active_output = True
    before = tree_state(tree)
    show(room)
    nodes.detach(room)
    assert tree_state(tree) == before
    assert tree.get_output_node("EEVEE") == second


@pytest.mark.parametrize(
    "inputs",
    [
        {"Roughness": 0.5},
        {"Roughness": 0.2, "IOR": 1.35},
        {"Roughness": 0.8, "Specular IOR Level": 1.0},
        {"Roughness": 0.6, "Coat Weight": 0.5, "Coat Roughness": 0.1},
    ],
)
def test_gloss_lies_over_baked_light_as_over_cycles_own(blender, inputs):
    """What a white world brings a ball beside its gloss: the ball less a black one; baked light looks alike, at each angle."""
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=128, ring_count=96)
    bpy.context.object.data.polygons.foreach_set("use_smooth", [True] * len(bpy.context.object.data.polygons))
    made = bpy.data.materials.new("Glossy")
    if made.node_tree is None:
        made.use_nodes = True
    shader = next(node for node in made.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for name, value in inputs.items():
        shader.inputs[name].default_value = value
    bpy.context.object.data.materials.append(made)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 2.0, (0, 0, 5)
    scene.collection.objects.link(camera)
    scene.camera, scene.cycles.pixel_filter_type = camera, "BOX"
    world = bpy.data.worlds.new("World")
    if world.node_tree is None:
        world.use_nodes = True
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (1, 1, 1, 1)
    size = 32
    at = (np.arange(size) + 0.5) / size * 2 - 1
    cosine = np.sqrt(np.maximum(1 - at[:, None] ** 2 - at**2, 0))
    seen = []
    for base in (0.8, 0.0):
        scene.world, shader.inputs["Base Color"].default_value = world, (base, base, base, 1)
        seen.append(render(scene, 64, size, max_bounces=1).mean(axis=2) / 0.8)
    truth = seen[0] - seen[1]
    scene.world, shader.inputs["Base Color"].default_value = None, (0.8, 0.8, 0.8, 1)
    show(scene)
    scene.lightpanes.cycles = True
    found = (render(scene, 16, size) * math.pi / (0.8 * IRRADIANCE)).mean(axis=2)
    for low, high in ((0.3, 0.5), (0.5, 0.7), (0.7, 1.01)):
        ring = (cosine > low) & (cosine < high)
        assert truth[ring].mean() < 0.99, "gloss takes its part"
        assert found[ring].mean() == pytest.approx(truth[ring].mean(), abs=0.012)


def test_groups_of_older_files_get_their_inputs(room):
    show(room)
    group = nodes.group_of(room)
    for item in list(group.interface.items_tree):
        if item.name.startswith("Gloss"):
            group.interface.remove(item)
    nodes.rebuild(room)
    assert {"Gloss", "Gloss Edge", "Gloss Power"} <= {item.name for item in group.interface.items_tree}
