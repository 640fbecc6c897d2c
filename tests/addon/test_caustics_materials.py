"""Materials that are glass or metal in part: who casts caustics, and what becomes of the rest of the light."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import extract, materials, optics  # noqa: E402
from lightpanes.core.caustics import casters  # noqa: E402

from .glassware import ball, material  # noqa: E402
from .test_materials import Shader  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


def textured(made, colour):
    """A material whose base colour comes of an image."""
    picture = bpy.data.images.new("Picture", 4, 4)
    picture.colorspace_settings.name = "Non-Color"
    picture.pixels.foreach_set(np.tile(np.float32([*colour, 1]), 16))
    picture.update()
    tree = made.node_tree
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = picture
    tree.links.new(node.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"])
    return made


@pytest.mark.parametrize(
    ("inputs", "colour", "casts"),
    [
        ({"Metallic": 1.0}, (0.7, 0.5, 0.2), True),
        ({"Transmission Weight": 1.0}, (0.7, 0.5, 0.2), True),
        ({"Metallic": 0.6}, (0.7, 0.5, 0.2), True),
        ({"Metallic": 0.4}, (0.7, 0.5, 0.2), False),
    ],
)
def test_textured_metal_casts_in_a_bake_and_afterwards_alike(room, inputs, colour, casts):
    """A bake knows the texture's mean, relighting reads no maps."""
    made = textured(material("Gold", **{key.replace(" ", "_"): value for key, value in inputs.items()}), colour)
    item = ball(room, made=made)
    item.lightpanes.exclude = False
    for albedo in (True, False):
        scene = extract.extract(bpy.context, resolution=32, albedo=albedo)
        found = casters(scene)
        assert (found is not None) == casts, f"albedo {albedo}"
        (gold,) = (each for each in scene.materials if each.name == "Gold")
        if 1.0 in inputs.values():
            assert max(gold.albedo) == 0


def sheet(share=0.15):
    """A window as archviz has it: clear, with a share of mirror."""
    shader = Shader("Window")
    glossy = shader.node("BsdfAnisotropic", Color=(1.0, 1.0, 1.0), Roughness=0.0)
    return shader.show(shader.node("MixShader", Fac=share, _1=shader.node("BsdfTransparent"), _2=glossy))


def tinted():
    shader = Shader("Tinted")
    glossy = shader.node("BsdfAnisotropic", Color=(0.2, 0.2, 0.2), Roughness=0.0)
    return shader.show(shader.node("AddShader", _0=glossy, _1=shader.node("BsdfTransparent", Color=(0.2, 0.4, 0.6))))


@pytest.mark.parametrize(
    ("make", "clear"),
    [
        (sheet, (0.85, 0.85, 0.85)),
        (tinted, (0.2, 0.4, 0.6)),
        (lambda: material("Metal", Metallic=1.0, Alpha=0.25), (0.75, 0.75, 0.75)),
        (lambda: material("Glass", Transmission_Weight=1.0, Alpha=0.25), (0.75, 0.75, 0.75)),
        (lambda: material("Half", Metallic=0.5, Transmission_Weight=1.0), (0.0, 0.0, 0.0)),
    ],
)
def test_what_passes_straight_on_beside_mirror_and_glass(blender, make, clear):
    made = make()
    found = optics.read_optics(made, [])
    assert found.clear == pytest.approx(clear, abs=1e-6)
    passes = materials.look(made, []).transmission
    if max(found.glass) > 0:
        # shadow rays of a bake without caustics take glass for clear, too
        assert (passes > np.array(clear)).all()
    else:
        assert passes == pytest.approx(clear, abs=1e-6)


def test_clear_alone_is_no_optics(blender):
    shader = Shader("Veil")
    assert optics.read_optics(shader.show(shader.node("BsdfTransparent")), []) is None
    assert optics.read_optics(material("Ghost", Alpha=0.3), []) is None
