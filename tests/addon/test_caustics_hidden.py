"""Glass that is hidden with its collection, and glass that is a part of its mesh alone."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import caustics, extract, relight, store  # noqa: E402

from .glassware import ball, image, material  # noqa: E402
from .soft import EEVEE  # noqa: E402
from .test_relight import update  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def shelf(room):
    """The room, baked, with a glass ball in a collection of its own; returns that."""
    room.render.engine, room.lightpanes.photons = EEVEE, 5000
    item, made = ball(room), bpy.data.collections.new("Glassware")
    for former in list(item.users_collection):
        former.objects.unlink(item)
    made.objects.link(item)
    room.collection.children.link(made)
    update()
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    return made


@pytest.mark.parametrize("way", ["render", "exclude", "unlink"])
def test_hidden_with_its_collection(shelf, way):
    room = bpy.context.scene
    before, bounced = image(), image(store.IRRADIANCE)
    assert before.max() > 1

    def hide(yes):
        if way == "render":
            shelf.hide_render = yes
        elif way == "exclude":
            bpy.context.view_layer.layer_collection.children["Glassware"].exclude = yes
        elif yes:
            room.collection.children.unlink(shelf)
        else:
            room.collection.children.link(shelf)
        update()

    hide(True)
    assert store.find_image(room, store.CAUSTICS) is None and caustics.report(room) is None
    assert any("'Ball'" in sentence for sentence in relight.check_stale(bpy.context)), "bounces are of what was baked"
    hide(False)
    assert not list(relight.check_stale(bpy.context))
    assert np.allclose(image(), before, rtol=1e-3, atol=1e-3)
    assert np.allclose(image(store.IRRADIANCE), bounced, rtol=1e-2, atol=1e-3)


def test_a_window_of_glass_in_a_wooden_frame(room):
    """Two materials in one mesh: the pane casts caustics, the frame a full shadow, and only the frame shows light."""
    room.render.engine, room.lightpanes.photons = EEVEE, 20_000
    bpy.data.objects.remove(bpy.data.objects["Block"])
    mesh = bpy.data.meshes.new("Window")
    outer, inner = 0.45, 0.25
    square = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    points = [(x * r, y * r, z) for z in (-0.01, 0.01) for r in (outer, inner) for x, y in square]
    faces, slots = [], []
    for k in range(4):
        n = (k + 1) % 4
        faces += [(k, 4 + k, 4 + n, n), (8 + k, 8 + n, 12 + n, 12 + k), (k, n, 8 + n, 8 + k)]
        slots += [0, 0, 0]
    faces += [(7, 6, 5, 4), (12, 13, 14, 15)]
    slots += [1, 1]
    mesh.from_pydata(points, [], faces)
    mesh.polygons.foreach_set("material_index", slots)
    wood = material("Wood", Base_Color=(0.4, 0.3, 0.2), Roughness=0.5)
    glass = material("Pane", Base_Color=(1.0, 1.0, 1.0), Transmission_Weight=1.0, IOR=1.5)
    for made in (wood, glass):
        mesh.materials.append(made)
    window = bpy.data.objects.new("Window", mesh)
    window.location = (-0.3, -0.2, -0.3)
    room.collection.objects.link(window)
    update()
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert caustics.held(room).casters == ("Window",)
    surfaces = extract.extract(bpy.context, resolution=room.lightpanes.resolution)
    owner = [surfaces.materials[k].name for k in surfaces.triangle_material]
    solid = caustics.casters(surfaces).triangles
    assert {name for name, yes in zip(owner, solid, strict=True) if yes} == {"Pane"}
    from lightpanes.core.surface import make_texels

    texels = make_texels(surfaces, room.lightpanes.resolution)
    place, names = texels.samples.position, np.array(owner)[texels.samples.triangle]
    light = image().reshape(-1, 3)[texels.index].mean(axis=1)
    bare = image(store.IRRADIANCE).reshape(-1, 3)[texels.index].mean(axis=1)
    # the lamp, 0.7 m above the pane, casts frame and pane twice as large on the floor
    across = np.abs(place[:, :2] - (-0.3, -0.2)).max(axis=1)
    floor = (place[:, 2] < -0.999) & (texels.samples.normal[:, 2] > 0.9)
    through, shaded = floor & (across < 0.35), floor & (across > 0.6) & (across < 0.68)
    expected = 20 / (4 * np.pi * 1.4**2)
    assert through.any() and shaded.any()
    assert light[through & (across < 0.15)].mean() == pytest.approx(0.92 * expected, rel=0.05)
    assert light[shaded].mean() < 0.1 * light[through].mean()
    assert bare[names == "Wood"].mean() > 0
