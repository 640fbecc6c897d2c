"""Mirrors and glass of materials: what Cycles reflects and lets through at several angles, and what is warned of."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
from lightpanes.addon import extract, optics  # noqa: E402
from lightpanes.core.caustics.casters import is_caster  # noqa: E402
from mathutils import Matrix  # noqa: E402

from .glassware import ball, material  # noqa: E402
from .soft import render  # noqa: E402
from .test_materials import Shader  # noqa: E402

COLOUR = (0.9, 0.6, 0.2)
SMOOTH = {"Roughness": 0.0}
LOOKS = {
    "metal": ("BsdfPrincipled", {"Base_Color": COLOUR, "Metallic": 1.0}, {}),
    "glass": ("BsdfPrincipled", {"Base_Color": COLOUR, "Transmission_Weight": 1.0, "IOR": 1.5}, {}),
    "half": ("BsdfPrincipled", {"Base_Color": COLOUR, "Metallic": 0.5, "Transmission_Weight": 1.0}, {}),
    "Glass": ("BsdfGlass", {"Color": COLOUR, "IOR": 1.45}, {}),
    "Refraction": ("BsdfRefraction", {"Color": COLOUR, "IOR": 1.45}, {}),
    "Glossy": ("BsdfAnisotropic", {"Color": COLOUR}, {}),
    "F82": ("BsdfMetallic", {"Base_Color": COLOUR, "Edge_Tint": (0.8, 0.9, 1.0)}, {}),
    "conductor": ("BsdfMetallic", {}, {"fresnel_type": "PHYSICAL_CONDUCTOR"}),
}


def made(name):
    kind, inputs, settings = LOOKS[name]
    shader = Shader(name)
    node = shader.node(kind, **inputs, **SMOOTH)
    for key, value in settings.items():
        setattr(node, key, value)
    return shader.show(node)


def read(found, told=None):
    return optics.read_optics(found, [] if told is None else told)


def fresnel(cosine, ior):
    """Of a dielectric, seen from outside."""
    inner = math.sqrt(ior**2 - 1 + cosine**2)
    straight = ((inner - cosine) / (inner + cosine)) ** 2
    return straight / 2 * (1 + ((cosine * (inner + cosine) - 1) / (cosine * (inner - cosine) + 1)) ** 2)


def strips(looks):
    """A strip of 1 m for each look over a glowing floor under a bright sky; an orthographic camera."""
    scene = bpy.context.scene
    for index, name in enumerate(looks):
        bpy.ops.mesh.primitive_plane_add(size=1, location=(index - (len(looks) - 1) / 2, 0, 0))
        bpy.context.object.scale = (1, 40, 1)
        bpy.context.object.data.materials.append(made(name))
    bpy.ops.mesh.primitive_plane_add(size=1000, location=(0, 0, -30))
    glow = Shader("Glow")
    bpy.context.object.data.materials.append(glow.show(glow.node("Emission", Strength=1.0)))
    world = scene.world = bpy.data.worlds.new("World")
    if world.node_tree is None:
        world.use_nodes = True
    eye = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    eye.data.type, eye.data.ortho_scale = "ORTHO", len(looks)
    scene.collection.objects.link(eye)
    scene.camera = eye
    scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", 256
    scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
    scene.cycles.blur_glossy = scene.cycles.sample_clamp_indirect = 0.0
    scene.render.resolution_x, scene.render.resolution_y = len(looks), 1
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    return eye, world.node_tree.nodes["Background"], glow.tree.nodes["Emission"]


@pytest.mark.parametrize(("angle", "tolerance"), [(0, 0.012), (60, 0.02)])
def test_lobes_are_as_cycles_has_them(blender, tmp_path, angle, tolerance):
    looks = list(LOOKS)
    eye, sky, glow = strips(looks)
    turn = Matrix.Rotation(math.radians(angle), 4, "X")
    eye.matrix_world = turn @ Matrix.Translation((0, 0, 20))
    found = {}
    for part, (above, below) in {"reflected": (1, 0), "passed": (0, 1)}.items():
        sky.inputs["Color"].default_value = (1, 1, 1, 1)
        sky.inputs["Strength"].default_value, glow.inputs["Strength"].default_value = above, below
        found[part] = render(tmp_path)[0]
    cosine = math.cos(math.radians(angle))
    for index, name in enumerate(looks):
        lobes = read(bpy.data.materials[name])
        rest = (1 - cosine) ** 5
        mirrored = np.array(lobes.mirror) * (1 - rest) + np.array(lobes.mirror_edge) * rest
        lost = fresnel(cosine, lobes.ior)
        # Refraction knows no Fresnel's equations; a tinted edge has another curve than Schlick's
        loose = tolerance + {"Refraction": 0.05, "conductor": 0.02}.get(name, 0.0) * (angle > 0)
        assert np.allclose(mirrored + np.array(lobes.gloss) * lost, found["reflected"][index], atol=loose), name
        assert np.allclose(np.array(lobes.glass) * (1 - lost), found["passed"][index], atol=loose), name


def test_mixed_shaders(blender):
    shader = Shader()
    glass, metal = shader.node("BsdfGlass", Color=COLOUR, IOR=1.4, **SMOOTH), shader.node("BsdfGlossy", Roughness=0.05)
    plain = shader.node("BsdfDiffuse")
    both = read(shader.show(shader.node("MixShader", _0=0.25, _1=glass, _2=metal)))
    assert both.glass == pytest.approx(0.75 * np.array(COLOUR)) and both.ior == pytest.approx(1.4)
    assert both.mirror == pytest.approx((0.2,) * 3) and both.roughness == pytest.approx(0.05)
    added = read(shader.show(shader.node("AddShader", _0=glass, _1=plain)))
    assert added.glass == pytest.approx(COLOUR) and added.mirror == (0, 0, 0)
    assert read(shader.show(plain)) is None
    assert read(shader.show(shader.node("MixShader", _0=1.0, _1=glass, _2=plain))) is None
    clear = shader.node("BsdfTransparent")
    assert read(shader.show(clear)) is None, "cut-out alpha bends nothing"


def test_absorption(blender):
    shader = Shader()
    shader.show(shader.node("BsdfGlass", Roughness=0.0))
    fog = shader.node("VolumeAbsorption", Color=(0.2, 0.5, 1.0), Density=3.0)
    shader.tree.links.new(fog.outputs[0], shader.output.inputs["Volume"])
    assert read(shader.material).absorption == pytest.approx((2.4, 1.5, 0.0))
    told = []
    scatter = shader.node("VolumeScatter")
    shader.tree.links.new(scatter.outputs[0], shader.output.inputs["Volume"])
    assert read(shader.material, told).absorption == (0, 0, 0) and "scatters" in told[0]


def test_light_through_coloured_water_is_as_cycles_has_it(blender, tmp_path):
    """A slab of 1 m with a Volume Absorption, looked through straight on."""
    scene = bpy.context.scene
    strips([])
    eye = scene.camera
    eye.data.ortho_scale, eye.location = 1.0, (0, 0, 20)
    scene.render.resolution_x = 1
    bpy.ops.mesh.primitive_cube_add(size=1)
    bpy.context.object.scale = (40, 40, 1)
    shader = Shader("Water")
    shader.show(shader.node("BsdfRefraction", Roughness=0.0, IOR=1.3))
    fog = shader.node("VolumeAbsorption", Color=(0.2, 0.5, 1.0), Density=1.5)
    shader.tree.links.new(fog.outputs[0], shader.output.inputs["Volume"])
    bpy.context.object.data.materials.append(shader.material)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
    expected = np.exp(-np.array(read(shader.material).absorption))
    assert np.allclose(render(tmp_path)[0, 0], expected, rtol=0.02)


def test_what_is_not_honoured_is_told(blender):
    shader = Shader()
    noise, told = shader.node("TexNoise"), []
    bumped = shader.node("BsdfGlass", Roughness=0.0, Normal=shader.node("Bump").outputs[0])
    assert read(shader.show(bumped), told) is not None and "normal or bump map" in told[-1]
    rough = shader.node("BsdfGlass", Roughness=noise.outputs[0])
    assert read(shader.show(rough), told).roughness == 1 and "roughness that varies" in told[-1]
    frosted = shader.node("BsdfGlass", Roughness=0.4)
    assert read(shader.show(frosted), told).roughness == pytest.approx(0.4) and "rough glass" in told[-1]
    varied = shader.node("MixShader", _0=noise.outputs[0], _1=bumped)
    assert read(shader.show(varied), told) is None and "casts no caustics" in told[-1]
    picture = shader.picture(np.broadcast_to(np.float32(COLOUR), (4, 4, 3)))
    gilded = shader.node("BsdfGlossy", Color=picture.outputs[0], **SMOOTH)
    assert read(shader.show(gilded), told).mirror == pytest.approx(COLOUR, abs=1e-3) and "textured colour" in told[-1]
    silent = []
    for plain in (shader.node("BsdfPrincipled"), shader.node("BsdfGlossy", Roughness=0.4)):
        read(shader.show(plain), silent)
    assert silent == []


def test_coarse_glass_is_told(room):
    """By how far light is bent wrongly: a sphere of 24 rings errs by 2.6 % smooth, by 16 % flat."""
    item = ball(room)
    assert not [said for said in extract.extract(bpy.context, resolution=64).warnings if "coarse" in said]
    item.data.polygons.foreach_set("use_smooth", [False] * len(item.data.polygons))
    item.data.update()
    warnings = extract.extract(bpy.context, resolution=64).warnings
    assert any("'Ball'" in said and "shade it smooth" in said for said in warnings)
    bpy.data.objects.remove(item)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=16, radius=0.25)
    coarse = bpy.context.object
    coarse.data.polygons.foreach_set("use_smooth", [True] * len(coarse.data.polygons))
    coarse.data.materials.append(bpy.data.materials["Glass"])
    warnings = extract.extract(bpy.context, resolution=64).warnings
    assert any(f"'{coarse.name}'" in said and "subdivide it" in said for said in warnings)
    bpy.data.objects.remove(coarse)
    # a pane of flat glass is as it is
    bpy.ops.mesh.primitive_cube_add(size=0.3)
    bpy.context.object.data.materials.append(bpy.data.materials["Glass"])
    assert not [said for said in extract.extract(bpy.context, resolution=64).warnings if "coarse" in said]


def test_who_is_a_caster(room):
    def surfaces():
        return [m for m in extract.extract(bpy.context, resolution=64).materials if is_caster(m)]

    assert surfaces() == []
    item = ball(room)
    assert [m.name for m in surfaces()] == ["Glass"]
    item.data.materials[0] = material("Chrome", Base_Color=(0.9, 0.9, 0.9), Metallic=1.0)
    assert [m.name for m in surfaces()] == ["Chrome"]
    item.data.materials[0] = material("Lacquer", Base_Color=(0.9, 0.1, 0.1), Coat_Weight=1.0)
    assert surfaces() == [], "gloss over an opaque base is too weak"
    item.data.materials[0] = bpy.data.materials["Glass"]
    room.lightpanes.caustics = False
    assert surfaces() == []
