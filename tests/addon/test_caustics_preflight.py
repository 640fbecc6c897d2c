"""What the panel says of glass before a bake: holes in it, more objects than photons are for, too many faces."""

import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import caustics, extract, glassware  # noqa: E402

from .glassware import ball, material  # noqa: E402
from .mending import found, mend, without_fix  # noqa: E402


def told():
    return [said for said in extract.extract(bpy.context, resolution=64, albedo=False).warnings if "open edges" in said]


def halve(item):
    """Leave the lower half of a ball."""
    import bmesh

    cut = bmesh.new()
    cut.from_mesh(item.data)
    bmesh.ops.delete(cut, geom=[face for face in cut.faces if face.calc_center_median().z > 0], context="FACES")
    cut.to_mesh(item.data)
    cut.free()


def test_a_bowl_without_thickness(room):
    item = ball(room)
    assert not found("OPEN_GLASS") and not told()
    halve(item)
    (sentence,) = told()
    assert sentence.startswith("'Ball' is glass with open edges, which light enters and does not leave again")
    assert mend("OPEN_GLASS").sentence == sentence
    bpy.context.view_layer.update()
    assert item.modifiers[0].type == "SOLIDIFY" and item.modifiers[0].thickness == pytest.approx(0.005, rel=0.02)
    assert not told()


def test_metal_and_a_pane_in_its_frame_are_closed(room):
    halve(ball(room, made=material("Metal", Metallic=1.0)))
    bpy.ops.mesh.primitive_cube_add(size=0.3, location=(-0.5, 0.5, 0))
    pane = bpy.context.object.data
    for made in (material("Wood", Roughness=0.5), material("Glass", Transmission_Weight=1.0)):
        pane.materials.append(made)
    for face in pane.polygons:
        face.material_index = int(abs(face.normal.z) > 0.5)
    bpy.context.view_layer.update()
    assert not found("OPEN_GLASS") and not told()
    assert caustics.is_made_of(bpy.data.materials["Glass"])


def test_many_objects_share_the_photons(room):
    room.lightpanes.photons = 5000
    first = ball(room)
    for k in range(30):
        other = bpy.data.objects.new(f"Ball {k}", first.data)
        room.collection.objects.link(other)
    bpy.context.view_layer.update()
    obstacle = mend("MANY_CASTERS")
    assert obstacle.sentence.startswith(
        "31 objects share the 5,000 photons of each lamp that Photons asks for, too few"
    )
    assert obstacle.button == "Photons: 7,750" and room.lightpanes.photons == 7750
    room.lightpanes.photons = 5000
    assert found("MANY_CASTERS")
    room.lightpanes.caustics = False
    assert not found("MANY_CASTERS")


def test_huge_ones(room, monkeypatch):
    ball(room)
    assert not found("HUGE_CASTER")
    monkeypatch.setattr(glassware, "FACES", 1000)
    assert without_fix("HUGE_CASTER").sentence.startswith("'Ball' focuses light with 0.0 million faces")
