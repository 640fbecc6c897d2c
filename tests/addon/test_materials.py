"""Materials as constants and maps, against Cycles and against the pictures they come from."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import atlas, extract, maps, materials  # noqa: E402

from .files import empty  # noqa: E402

COLOUR = (0.2, 0.5, 0.8)
RESOLUTION = 64


def add(kind, **options):
    getattr(bpy.ops.mesh, f"primitive_{kind}_add")(**options)
    return bpy.context.object


class Shader:
    """A new material with a node tree to write."""

    def __init__(self, name="Paint"):
        self.material = bpy.data.materials.new(name)
        if bpy.app.version < (5, 0):
            self.material.use_nodes = True
        self.tree = self.material.node_tree
        self.tree.nodes.clear()
        self.output = self.tree.nodes.new("ShaderNodeOutputMaterial")

    def node(self, kind, **inputs):
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        for name, value in inputs.items():
            socket = node.inputs[int(name[1:])] if name[0] == "_" else node.inputs[name.replace("_", " ")]
            if isinstance(value, bpy.types.Node):
                self.tree.links.new(value.outputs[0], socket)
            elif isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, socket)
            elif isinstance(value, tuple) and socket.type == "RGBA":
                socket.default_value = (*value, 1)
            else:
                socket.default_value = value
        return node

    def show(self, node):
        self.tree.links.new(node.outputs[0], self.output.inputs["Surface"])
        return self.material

    def picture(self, pixels, **options):
        """An image texture of a (H, W, 3) array of linear colours."""
        image = bpy.data.images.new("Picture", pixels.shape[1], pixels.shape[0], float_buffer=True)
        image.colorspace_settings.name = "Non-Color"
        image.pixels.foreach_set(np.dstack([pixels, np.ones(pixels.shape[:2])]).astype(np.float32).ravel())
        node = self.node("TexImage")
        node.image, node.interpolation = image, "Closest"
        for name, value in options.items():
            setattr(node, name, value)
        return node


def look(material):
    return materials.look(material, [])


def close(value, expected):
    np.testing.assert_allclose(value, np.broadcast_to(expected, 3), atol=1e-5)


PRINCIPLED = {
    "metal": ({"Metallic": 1.0}, 0, 0, 0),
    "half metal": ({"Metallic": 0.5, "Specular_IOR_Level": 0.0}, np.array(COLOUR) / 2, 0, 0),
    "no gloss": ({"Specular_IOR_Level": 0.0}, COLOUR, 0, 0),
    "ghost": ({"Alpha": 0.25, "Specular_IOR_Level": 0.0}, np.array(COLOUR) / 4, 0, 0.75),
    "glass": ({"Transmission_Weight": 1.0, "Specular_IOR_Level": 0.0}, 0, 0, np.sqrt(COLOUR)),
    "lamp": ({"Emission_Color": (1.0, 0.5, 0.0), "Emission_Strength": 4.0, "Metallic": 1.0}, 0, (4, 2, 0), 0),
}


@pytest.mark.parametrize("name", PRINCIPLED)
def test_principled_constants(blender, name):
    inputs, albedo, emission, transmission = PRINCIPLED[name]
    shader = Shader()
    found = look(shader.show(shader.node("BsdfPrincipled", Base_Color=COLOUR, **inputs)))
    close(found.albedo, albedo)
    close(found.emission, emission)
    close(found.transmission, transmission)


def test_other_shaders_as_constants(blender):
    shader = Shader()
    diffuse = shader.node("BsdfDiffuse", Color=COLOUR)
    glow = shader.node("Emission", Color=(1.0, 0.0, 0.0), Strength=2.0)
    clear = shader.node("BsdfTransparent", Color=(0.5, 0.5, 1.0))
    close(look(shader.show(diffuse)).albedo, COLOUR)
    close(look(shader.show(glow)).emission, (2, 0, 0))
    close(look(shader.show(clear)).transmission, (0.5, 0.5, 1))
    mixed = look(shader.show(shader.node("MixShader", _0=0.25, _1=diffuse, _2=clear)))
    close(mixed.albedo, 0.75 * np.array(COLOUR))
    close(mixed.transmission, (0.125, 0.125, 0.25))
    both = look(shader.show(shader.node("AddShader", _0=diffuse, _1=glow)))
    close(both.albedo, COLOUR)
    close(both.emission, (2, 0, 0))
    close(look(shader.show(shader.node("BsdfGlossy"))).albedo, 0)
    window = look(shader.show(shader.node("BsdfGlass", Color=(0.9, 1.0, 0.9), IOR=1.0)))
    close(window.albedo, 0)
    close(window.transmission, (0.9, 1, 0.9))
    value = shader.node("RGB")
    value.outputs[0].default_value = (*COLOUR, 1)
    close(look(shader.show(shader.node("BsdfDiffuse", Color=value))).albedo, COLOUR)


def test_what_is_not_a_node_tree(blender):
    close(look(None).albedo, 0.8)
    if bpy.app.version < (5, 0):
        material = bpy.data.materials.new("Plain")
        material.diffuse_color = (*COLOUR, 1)
        close(look(material).albedo, COLOUR)
    shader = Shader()
    close(look(shader.material).albedo, 0)
    shader.tree.nodes.clear()
    close(look(shader.material).albedo, 0)


def test_mute_and_reroute(blender):
    shader = Shader()
    diffuse = shader.node("BsdfDiffuse", Color=COLOUR)
    reroute = shader.tree.nodes.new("NodeReroute")
    shader.tree.links.new(diffuse.outputs[0], reroute.inputs[0])
    mix = shader.node("MixShader", _0=1.0, _1=reroute, _2=shader.node("Emission"))
    mix.mute = True
    close(look(shader.show(mix)).albedo, COLOUR)


def test_textures_vary(blender):
    shader = Shader()
    texture = shader.node("TexNoise")
    found = look(shader.show(shader.node("BsdfPrincipled", Base_Color=texture)))
    assert found.albedo is None and found.emission is not None and found.transmission is not None
    found = look(shader.show(shader.node("BsdfPrincipled", Alpha=texture)))
    assert found.albedo is None and found.transmission is None
    found = look(shader.show(shader.node("Emission", Color=texture)))
    assert found.emission is None and found.albedo is not None


def test_our_own_nodes_are_not_the_material(blender):
    """What shows baked light in EEVEE and Cycles must not be baked again."""
    shader = Shader()
    shader.show(shader.node("BsdfDiffuse", Color=COLOUR))
    for target in ("EEVEE", "CYCLES"):
        ours = shader.tree.nodes.new("ShaderNodeOutputMaterial")
        glow = shader.node("Emission", Strength=10.0)
        shader.tree.links.new(glow.outputs[0], ours.inputs["Surface"])
        ours.target = target
        ours["lightpanes"] = glow["lightpanes"] = 1
        ours["lightpanes_former"] = shader.output.name
        ours.is_active_output = True
    found = look(shader.material)
    close(found.albedo, COLOUR)
    close(found.emission, 0)


def indirect(shader_of, samples):
    """(3,) indirect irradiance over direct in a closed box of the material, on a small matt patch; by Cycles."""
    empty()
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    settings = scene.cycles
    settings.samples, settings.use_adaptive_sampling, settings.use_denoising = samples, False, False
    settings.sample_clamp_indirect, settings.blur_glossy, settings.seed = 0.0, 0.0, 7
    settings.max_bounces = settings.diffuse_bounces = settings.glossy_bounces = 64
    box = add("cube", size=2)
    box.data.flip_normals()
    shader = Shader("Walls")
    box.data.materials.append(shader.show(shader_of(shader)))
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.data.energy, lamp.data.shadow_soft_size = 10.0, 0.05
    scene.collection.objects.link(lamp)
    patch = add("plane", size=0.3, location=(0, 0, -0.99))
    matt = Shader("Patch")
    patch.data.materials.append(matt.show(matt.node("BsdfDiffuse", Color=(0.5, 0.5, 0.5))))
    image = bpy.data.images.new("Result", 8, 8, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    target = matt.tree.nodes.new("ShaderNodeTexImage")
    target.image = image
    matt.tree.nodes.active = target
    light = []
    for pass_filter in ({"DIRECT"}, {"INDIRECT"}):
        bpy.ops.object.bake(type="DIFFUSE", pass_filter=pass_filter, margin=0)
        light.append(np.array(image.pixels[:]).reshape(-1, 4)[:, :3].mean(axis=0))
    return light[1] / light[0]


@pytest.mark.parametrize("roughness,ior", [(0.5, 1.5), (0.2, 1.45), (1.0, 1.5)])
def test_albedo_of_principled_reflects_as_cycles_does(blender, roughness, ior):
    """A box of Principled and a box of matt paint of the albedo we read: equal indirect light, to 2 %.

    Base colour alone is 6 to 14 % too dark in the darkest channel.
    """
    inputs = {"Base_Color": COLOUR, "Roughness": roughness, "IOR": ior}
    shader = Shader()
    albedo = tuple(look(shader.show(shader.node("BsdfPrincipled", **inputs))).albedo)
    truth = indirect(lambda s: s.node("BsdfPrincipled", **inputs), 256)
    ours = indirect(lambda s: s.node("BsdfDiffuse", Color=albedo), 256)
    np.testing.assert_allclose(ours, truth, rtol=0.02)


def state():
    """All that a bake of maps must leave alone."""
    scene = bpy.context.scene
    trees = {
        material.name: (
            sorted((node.name, node.type, tuple(node.location)) for node in material.node_tree.nodes),
            sorted((link.from_node.name, link.from_socket.name, link.to_node.name, link.to_socket.name) for link in material.node_tree.links),
            material.node_tree.nodes.active and material.node_tree.nodes.active.name,
        )
        for material in bpy.data.materials
    }  # fmt: skip
    blocks = {name: sorted(block.name for block in getattr(bpy.data, name)) for name in ("objects", "meshes", "materials", "images", "scenes", "node_groups", "collections", "actions")}  # fmt: skip
    render = {p.identifier: getattr(scene.render.bake, p.identifier) for p in scene.render.bake.bl_rna.properties if p.type in {"ENUM", "INT", "FLOAT", "BOOLEAN"} and not getattr(p, "is_array", False)}  # fmt: skip
    return trees, blocks, render, scene.render.engine, [obj.name for obj in bpy.context.selected_objects]


def textured(kind="BsdfPrincipled", **where):
    """A room with a textured floor; where: input names → the picture's role."""
    rng = np.random.default_rng(1)
    pixels = rng.random((8, 8, 3)) * 0.9
    floor = add("plane", size=2)
    shader = Shader("Floor")
    picture = shader.picture(pixels)
    inputs = {name: (picture if value == "picture" else value) for name, value in where.items()}
    floor.data.materials.append(shader.show(shader.node(kind, **inputs)))
    box = add("cube", size=0.5)
    atlas.make_atlas(bpy.context, bpy.context.scene.objects, RESOLUTION)
    return floor, box, pixels


def sample(scene, image, material, pixels, floor):
    """(T, 3) the map and the picture at points of the material's triangles; the picture by the artist's UV layer."""
    index = [each.name for each in scene.materials].index(material)
    rows = np.flatnonzero(scene.triangle_material == index)
    rng = np.random.default_rng(2)
    weights = rng.dirichlet((1, 1, 1), (len(rows), 400))
    uv = np.einsum("tpc,tcd->tpd", weights, scene.atlas_uv[rows]).reshape(-1, 2)
    points = np.einsum("tpc,tcd->tpd", weights, scene.positions[scene.triangles[rows]]).reshape(-1, 3)
    artist = (points[:, :2] + 1) / 2  # a plane's own UVs
    inside = np.abs(artist * 8 - np.round(artist * 8)).min(axis=1) > 0.2  # away from the picture's texel borders
    x, y = (artist[inside] * 8).astype(int).T
    column, row = (uv[inside] * image.shape[0]).astype(int).T
    return image[row, column], pixels[y, x]


def test_textured_albedo_is_the_picture(blender):
    floor, _, pixels = textured(Base_Color="picture", Specular_IOR_Level=0.0)
    before = state()
    scene = extract.extract(bpy.context, resolution=RESOLUTION)
    assert state() == before
    assert scene.albedo_map.shape == (RESOLUTION, RESOLUTION, 3) and scene.albedo_map.dtype == np.float32
    assert scene.emission_map is None and scene.transmission_map is None
    found, expected = sample(scene, scene.albedo_map, "Floor", pixels, floor)
    np.testing.assert_allclose(found, expected, atol=2e-3)
    material = next(each for each in scene.materials if each.name == "Floor")
    assert material.mapped
    np.testing.assert_allclose(material.albedo, pixels.mean((0, 1)), atol=0.03)


def test_textured_albedo_counts_the_gloss(blender):
    floor, _, pixels = textured(Base_Color="picture")
    scene = extract.extract(bpy.context, resolution=RESOLUTION)
    found, expected = sample(scene, scene.albedo_map, "Floor", pixels, floor)
    gloss = materials.gloss_albedo(0.5, 1.5)
    np.testing.assert_allclose(found, expected + gloss * (1 - expected), atol=3e-3)


def test_textured_emission(blender):
    floor, _, pixels = textured("Emission", Color="picture", Strength=5.0)
    before = state()
    scene = extract.extract(bpy.context, resolution=RESOLUTION)
    assert state() == before
    found, expected = sample(scene, scene.emission_map, "Floor", pixels, floor)
    np.testing.assert_allclose(found, 5 * expected, rtol=2e-3)


def test_textured_alpha_lets_light_through(blender):
    floor, _, pixels = textured(Alpha="picture", Base_Color=COLOUR, Specular_IOR_Level=0.0)
    before = state()
    scene = extract.extract(bpy.context, resolution=RESOLUTION)
    assert state() == before
    found, expected = sample(scene, scene.transmission_map, "Floor", pixels, floor)
    alpha = expected @ (0.2126, 0.7152, 0.0722)
    np.testing.assert_allclose(found, np.repeat(1 - alpha[:, None], 3, axis=1), atol=3e-3)
    found, _ = sample(scene, scene.albedo_map, "Floor", pixels, floor)
    np.testing.assert_allclose(found, alpha[:, None] * COLOUR, atol=3e-3)
    again = extract.extract(bpy.context, resolution=RESOLUTION, albedo=False)
    np.testing.assert_array_equal(again.transmission_map, scene.transmission_map)
    assert again.albedo_map is None


def test_mixed_shader_by_a_picture(blender):
    floor = add("plane", size=2)
    shader = Shader("Floor")
    mask = np.zeros((8, 8, 3))
    mask[:4] = 1
    mix = shader.node(
        "MixShader",
        _0=shader.picture(mask),
        _1=shader.node("BsdfDiffuse", Color=COLOUR),
        _2=shader.node("BsdfTransparent"),
    )
    floor.data.materials.append(shader.show(mix))
    atlas.make_atlas(bpy.context, [floor], RESOLUTION)
    scene = extract.extract(bpy.context, resolution=RESOLUTION)
    found, expected = sample(scene, scene.transmission_map, "Floor", mask, floor)
    np.testing.assert_allclose(found, expected, atol=1e-3)
    found, expected = sample(scene, scene.albedo_map, "Floor", (1 - mask) * COLOUR, floor)
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_objects_that_share_a_mesh_have_their_own_texels(blender):
    """Generated by the object's place: the same UVs, two colours."""
    shader = Shader("By place")
    geometry = shader.node("NewGeometry")
    first = add("plane", size=1)
    first.data.materials.append(shader.show(shader.node("BsdfDiffuse", Color=geometry.outputs["Position"])))
    second = first.copy()
    second.location = (0, 0, 0.5)
    bpy.context.scene.collection.objects.link(second)
    bpy.context.view_layer.update()
    atlas.make_atlas(bpy.context, [first, second], RESOLUTION)
    scene = extract.extract(bpy.context, resolution=RESOLUTION)
    for index, obj in enumerate(scene.objects):
        centre = scene.atlas_uv[scene.triangle_object == index].mean((0, 1))
        column, row = (centre * RESOLUTION).astype(int)
        assert scene.albedo_map[row, column, 2] == pytest.approx(0.5 if obj.name == second.name else 0.0, abs=1e-3)


def test_texture_on_what_has_no_texels_is_its_mean(blender):
    _, _, pixels = textured(Base_Color="picture", Specular_IOR_Level=0.0)
    for obj in bpy.context.scene.objects:
        del obj["lightpanes_baked"]
    before = state()
    scene = extract.extract(bpy.context, resolution=RESOLUTION)
    assert state() == before
    material = next(each for each in scene.materials if each.name == "Floor")
    np.testing.assert_allclose(material.albedo, pixels.mean((0, 1)), atol=5e-3)
    assert any("'Plane' has no texels" in warning and "'Floor'" in warning for warning in scene.warnings)


def test_failure_leaves_nothing_behind(blender, monkeypatch):
    textured(Alpha="picture", Base_Color="picture")
    before = state()

    def fail(self, *_):
        raise KeyboardInterrupt

    monkeypatch.setattr(maps._Studio, "_run", fail)
    with pytest.raises(KeyboardInterrupt):
        extract.extract(bpy.context, resolution=RESOLUTION)
    assert state() == before


def test_white_is_warned_of(blender):
    floor = add("plane")
    shader = Shader("Snow")
    floor.data.materials.append(shader.show(shader.node("BsdfDiffuse", Color=(1.0, 1.0, 1.0))))
    scene = extract.extract(bpy.context, resolution=RESOLUTION)
    assert any("'Snow' reflects all light" in warning for warning in scene.warnings)


def test_what_is_not_honoured_is_named(blender):
    shader = Shader("Fog")
    shader.tree.links.new(shader.node("VolumePrincipled").outputs[0], shader.output.inputs["Volume"])
    warnings = []
    close(materials.look(shader.material, warnings).transmission, 1)
    assert any("'Fog' has a volume" in warning for warning in warnings)


def test_digest_sees_nodes_links_and_values(blender):
    shader = Shader()
    node = shader.node("BsdfDiffuse", Color=COLOUR)
    seen = {materials.digest(shader.material)}
    shader.show(node)
    seen.add(materials.digest(shader.material))
    node.inputs["Color"].default_value = (1, 1, 1, 1)
    seen.add(materials.digest(shader.material))
    assert len(seen) == 3
    extra = shader.node("Emission")
    extra["lightpanes"] = 1
    assert materials.digest(shader.material) in seen
