"""Lamps and worlds as Blender holds them: against Cycles' bakes, and what is skipped or warned about."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import lamps  # noqa: E402
from lightpanes.tests.bench import bench_lights as bench  # noqa: E402

from .files import empty  # noqa: E402


@pytest.fixture(autouse=True)
def emptied():
    empty()


def add(kind="POINT", **settings):
    return bench.add_lamp(bench.Case(kind, settings))


def read():
    bpy.context.view_layer.update()
    warnings = []
    return lamps.read_lights(bpy.context.evaluated_depsgraph_get(), warnings), warnings


@pytest.mark.parametrize("name", bench.CASES)
def test_lamps_light_as_in_cycles(name):
    """64² texels: coarse enough for a texel's own sampling to show at hard edges, hence the doubled bar."""
    mean, blocks, _ = bench.compare(name, resolution=64, spp=64)
    sharp = name in bench.SHARP
    assert mean < (0.03 if sharp else 0.01)
    assert sharp or blocks < 0.06


def test_hidden_lamps_do_not_shine():
    names = ["Camera icon", "Not diffuse", "No energy", "Collection", "Excluded", "Portal", "Viewport", "Eye", "Seen"]
    found = {name: add("AREA" if name == "Portal" else "POINT", energy=10.0) for name in names}
    for name, obj in found.items():
        obj.name = name
    found["Camera icon"].hide_render = True
    found["Not diffuse"].visible_diffuse = False
    found["No energy"].data.energy = 0
    found["Portal"].data.cycles.is_portal = True
    scene = bpy.context.scene
    for name in ("Collection", "Excluded"):
        collection = bpy.data.collections.new(name)
        scene.collection.children.link(collection)
        scene.collection.objects.unlink(found[name])
        collection.objects.link(found[name])
    bpy.data.collections["Collection"].hide_render = True
    bpy.context.view_layer.layer_collection.children["Excluded"].exclude = True
    found["Viewport"].hide_viewport = True
    found["Eye"].hide_set(True)
    lights, warnings = read()
    # what only the viewport hides is rendered
    assert sorted(light.name for light in lights) == ["Eye", "Seen", "Viewport"] and not warnings


def test_instanced_lamps_have_their_own_places_and_names():
    obj = add(energy=10.0)
    bench._instance(obj)
    lights, _ = read()
    assert sorted(light.name for light in lights) == ["Empty > Lamp", "Empty.001 > Lamp"]
    assert sorted(light.position[0] for light in lights) == pytest.approx([-0.3, 1.0])
    obj.hide_render = True
    assert read()[0] == ()


def test_vertex_instanced_lamps():
    mesh = bpy.data.meshes.new("Dots")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (2, 0, 0)], [], [])
    parent = bpy.data.objects.new("Dots", mesh)
    parent.instance_type = "VERTS"
    bpy.context.scene.collection.objects.link(parent)
    add(energy=10.0).parent = parent
    lights, _ = read()
    # the lamp itself is only a pattern, in Cycles too
    assert len(lights) == 3 and len({light.name for light in lights}) == 3


def test_warnings_name_the_lamp():
    obj = add("AREA", energy=10.0, size=1.0)
    obj.name = "Key"
    assert read()[1] == []
    obj.light_linking.receiver_collection = bpy.data.collections.new("Lit")
    obj.data.cycles.max_bounces = 2
    _, warnings = read()
    assert len(warnings) == 2 and all("'Key'" in text for text in warnings)
    assert "light linking" in warnings[0] and "bounces" in warnings[1]


def test_textured_lamp_falls_back_to_its_own_colour():
    obj = add(energy=4 * math.pi, color=(1.0, 0.5, 0.25))
    bench._nodes(obj)
    tree = obj.data.node_tree
    emission = next(node for node in tree.nodes if node.type == "EMISSION")
    falloff = tree.nodes.new("ShaderNodeLightFalloff")
    tree.links.new(falloff.outputs[0], emission.inputs["Strength"])
    lights, warnings = read()
    assert lights[0].power == pytest.approx(4 * math.pi * np.array([1, 0.5, 0.25]))
    assert len(warnings) == 1 and "'Lamp'" in warnings[0] and "nodes" in warnings[0]
    value = tree.nodes.new("ShaderNodeValue")
    value.outputs[0].default_value = 2.0
    tree.links.new(value.outputs[0], emission.inputs["Strength"])
    lights, warnings = read()
    assert lights[0].power == pytest.approx(8 * math.pi * np.array([0.5, 0.5, 0.5])) and not warnings
    tree.links.clear()
    assert read()[0] == ()


def test_scale_and_bad_scale():
    obj = add("AREA", energy=10.0, shape="RECTANGLE", size=1.0, size_y=0.5)
    obj.scale = (2.0, -3.0, 5.0)
    (light,), _ = read()
    assert light.size == pytest.approx((2.0, 1.5))
    assert np.abs(np.linalg.norm(light.matrix[:3, :3], axis=0) - 1).max() < 1e-6
    obj.scale = (0.0, 1.0, 1.0)
    assert read()[0] == ()
    obj.scale = (1.0, 1.0, 0.0)
    lights, warnings = read()
    assert lights == () and "'Lamp' is scaled to zero" in warnings[0]
    parent = bpy.data.objects.new("Parent", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.scale, obj.scale, obj.parent = (3.0, 1.0, 1.0), (1.0, 1.0, 1.0), parent
    assert "sheared" in read()[1][0]


# ---- worlds ----


def world(color=(0.0, 0.0, 0.0), strength=1.0):
    made = bpy.data.worlds.new("World")
    if made.node_tree is None:
        made.use_nodes = True
    background = next(node for node in made.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*color, 1.0)
    background.inputs["Strength"].default_value = strength
    bpy.context.scene.world = made
    return made, background


def upward(sky):
    """(3,) irradiance of a sky on a floor, by midpoints."""
    height, width = sky.radiance.shape[:2]
    elevation = ((np.arange(height) + 0.5) / height - 0.5) * np.pi
    weight = np.maximum(np.sin(elevation), 0) * np.cos(elevation) * (np.pi / height) * (2 * np.pi / width)
    return (sky.radiance * weight[:, None, None]).sum(axis=(0, 1))


def cycles_floor():
    """(3,) irradiance of the scene's world on an open floor, by Cycles."""
    room = bench.build_room(8)
    bpy.data.objects.remove(bpy.data.objects["Box"])
    room.data.clear_geometry()
    room.data.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
    layer = room.data.uv_layers[0] if room.data.uv_layers else room.data.uv_layers.new()
    layer.data.foreach_set("uv", [0, 0, 1, 0, 1, 1, 0, 1])
    return bench.bake(room, 8, 512).mean(axis=(0, 1))


def count():
    return [len(getattr(bpy.data, kind)) for kind in ("scenes", "worlds", "meshes", "objects", "materials", "images")]


def test_plain_worlds():
    assert lamps.read_sky(None, []) is None
    assert lamps.read_sky(world()[0], []) is None
    assert lamps.read_sky(world((1, 1, 1), 0.0)[0], []) is None
    made, _ = world((0.2, 0.4, 0.6), 2.0)
    sky = lamps.read_sky(made, [])
    assert sky.radiance.shape == (1, 1, 3) and sky.radiance[0, 0] == pytest.approx([0.4, 0.8, 1.2])
    made.cycles_visibility.diffuse = False
    assert lamps.read_sky(made, []) is None


def test_environment_texture_is_mapped_as_in_cycles():
    made, background = world()
    tree = made.node_tree
    image = bpy.data.images.new("Environment", 64, 32, float_buffer=True)
    pixels = np.random.default_rng(0).random((32, 64, 4)).astype(np.float32)
    pixels[:, :16, 0] += 5
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    texture, mapping, place = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexEnvironment", "Mapping", "TexCoord")
    )
    texture.image = image
    mapping.inputs["Rotation"].default_value = (0.5, 0.2, 1.0)
    tree.links.new(place.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    before, warnings = count(), []
    sky = lamps.read_sky(made, warnings)
    assert count() == before and not warnings and bpy.context.scene.world == made
    assert upward(sky) == pytest.approx(cycles_floor(), rel=0.01)


def test_direction_of_the_map():
    made, background = world()
    tree = made.node_tree
    place, shift = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeVectorMath")
    shift.operation = "MULTIPLY_ADD"
    shift.inputs[1].default_value = shift.inputs[2].default_value = (0.5, 0.5, 0.5)
    tree.links.new(place.outputs["Generated"], shift.inputs[0])
    tree.links.new(shift.outputs[0], background.inputs["Color"])
    from lightpanes.core.lights import sky_radiance

    directions = np.random.default_rng(1).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = sky_radiance(lamps.read_sky(made, []), directions)
    assert np.abs(found - (directions / 2 + 0.5)).max() < 2e-3


def test_light_path_is_a_diffuse_rays():
    """The common trick: one background for the camera, another for light."""
    made, background = world((0.1, 0.1, 0.1))
    tree = made.node_tree
    path, mix, seen = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("LightPath", "MixShader", "Background"))
    seen.inputs["Color"].default_value = (5, 5, 5, 1)
    output = tree.get_output_node("CYCLES")
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    tree.links.new(background.outputs[0], mix.inputs[1])
    tree.links.new(seen.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    sky = lamps.read_sky(made, [])
    assert sky.radiance.min() == pytest.approx(0.1, abs=1e-4) and sky.radiance.max() == pytest.approx(0.1, abs=1e-4)
    assert mix.inputs[0].is_linked


def test_sky_with_a_sun_has_its_energy():
    made, background = world()
    sky = made.node_tree.nodes.new("ShaderNodeTexSky")
    sky.sun_elevation, sky.sun_rotation = math.radians(50), 1.5708
    made.node_tree.links.new(sky.outputs[0], background.inputs["Color"])
    warnings = []
    found = upward(lamps.read_sky(made, warnings))
    assert found == pytest.approx(cycles_floor(), rel=0.03)
    assert len(warnings) == 1 and "'World'" in warnings[0] and "Sun" in warnings[0]
