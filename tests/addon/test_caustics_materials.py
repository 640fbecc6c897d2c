"""Materials that are glass or metal in part: who casts caustics, and what becomes of the rest of the light."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import extract  # noqa: E402
from lightpanes.core.caustics import casters  # noqa: E402

from .glassware import ball, material  # noqa: E402

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
