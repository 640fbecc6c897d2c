"""The extracted scene against what Blender itself says."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import atlas, extract  # noqa: E402
from lightpanes.core.scene import SceneError  # noqa: E402
from mathutils import Matrix  # noqa: E402


def add(kind, name=None, **options):
    getattr(bpy.ops.mesh, f"primitive_{kind}_add")(**options)
    if name:
        bpy.context.object.name = name
    return bpy.context.object


def read(**options):
    return extract.extract(bpy.context, resolution=64, **{"albedo": False, **options})


def part(scene, name):
    """Rows of the triangles of the object or instance."""
    index = [obj.name for obj in scene.objects].index(name)
    return np.flatnonzero(scene.triangle_object == index)


def names(scene):
    return sorted(obj.name for obj in scene.objects)


def outward(scene, rows):
    """Smallest cosine between geometric normals and the way out of a convex part, and of shading normals."""
    points = scene.positions[scene.triangles[rows]].astype(float)
    away = points.mean(axis=1) - points.reshape(-1, 3).mean(axis=0)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    cross = scene.triangle_cross()[rows]
    cross = cross / np.linalg.norm(cross, axis=1, keepdims=True)
    return (cross * away).sum(axis=1).min(), (scene.corner_normals[rows] * cross[:, None]).sum(axis=2).min()


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (2, -0.5, 1), (-1, -2, -3), (0.01, 0.02, 0.03)])
def test_normals_point_outside_whatever_the_scale(blender, scale):
    obj = add("ico_sphere", subdivisions=3)
    bpy.ops.object.shade_smooth()
    obj.rotation_euler, obj.scale, obj.location = (0.3, 0.5, 0.7), scale, (4, 5, 6)
    bpy.context.view_layer.update()
    scene = read()
    geometric, shading = outward(scene, part(scene, obj.name))
    assert geometric > 0 and shading > 0.8
    # the exact normal of an ellipsoid: inverse transpose times the point on the unit sphere
    matrix = np.array(obj.matrix_world)
    local = (scene.positions - matrix[:3, 3]) @ np.linalg.inv(matrix[:3, :3]).T
    expected = local[scene.triangles] @ np.linalg.inv(matrix[:3, :3])
    expected /= np.linalg.norm(expected, axis=2, keepdims=True)
    assert (expected * scene.corner_normals).sum(axis=2).min() > 0.995


def test_flat_faces_have_flat_normals(blender):
    add("uv_sphere", segments=8, ring_count=6)
    scene = read()
    cross = scene.triangle_cross()
    cross /= np.linalg.norm(cross, axis=1, keepdims=True)
    np.testing.assert_allclose(scene.corner_normals, np.repeat(cross[:, None], 3, axis=1), atol=1e-5)


def test_flattened_object_keeps_its_normals(blender):
    obj = add("plane")
    obj.scale = (1, 1, 0)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(read().corner_normals, np.broadcast_to([0, 0, 1], (2, 3, 3)), atol=1e-6)


def test_positions_are_blenders(blender):
    obj = add("monkey", rotation=(1, 2, 3), location=(1, 2, 3))
    obj.modifiers.new("Subdivision", "SUBSURF").render_levels = 1
    bpy.context.view_layer.update()
    obj.modifiers[0].levels = 1
    bpy.context.view_layer.update()
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    expected = np.array([obj.matrix_world @ vertex.co for vertex in mesh.vertices])
    np.testing.assert_allclose(read().positions, expected, atol=2e-6)
    evaluated.to_mesh_clear()


def test_modifiers_are_evaluated_as_for_rendering_and_put_back(blender):
    obj = add("cube")
    modifier = obj.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels, modifier.render_levels = 0, 2
    hidden = obj.modifiers.new("Array", "ARRAY")
    hidden.show_render = False
    assert len(read().triangles) == 6 * 16 * 2
    assert (modifier.levels, modifier.render_levels, hidden.show_viewport) == (0, 2, True)


def test_curves_text_and_metaballs_are_read_once(blender):
    bpy.ops.curve.primitive_bezier_circle_add()
    bpy.context.object.data.bevel_depth = 0.1
    bpy.ops.object.text_add(location=(3, 0, 0))
    bpy.context.object.data.extrude = 0.1
    bpy.ops.object.metaball_add(location=(0, 3, 0))
    bpy.ops.surface.primitive_nurbs_surface_sphere_add(location=(0, 0, 3))
    scene = read()
    assert len(scene.objects) == 4
    for obj in bpy.context.scene.objects:
        mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
        mesh.calc_loop_triangles()
        rows = (scene.triangle_object == next(i for i, o in enumerate(scene.objects) if obj.name in o.name)).sum()
        assert abs(rows - len(mesh.loop_triangles)) <= 0.04 * rows  # triangles without area are dropped
        assert any(obj.name in warning and "Convert" in warning for warning in scene.warnings)
    assert np.isnan(scene.atlas_uv).all()


def test_linked_duplicates_and_collection_instances(blender):
    cube = add("cube", "Cube")
    twin = cube.copy()
    twin.name, twin.location = "Twin", (3, 0, 0)
    bpy.context.scene.collection.objects.link(twin)
    collection = bpy.data.collections.new("Parts")
    ball = add("ico_sphere", "Ball")
    hidden = add("cone", "Hidden")
    hidden.hide_render = True
    for obj in (ball, hidden):
        bpy.context.scene.collection.objects.unlink(obj)
        collection.objects.link(obj)
    for k in range(2):
        empty = bpy.data.objects.new(f"Empty {k}", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
        empty.location = (0, 3 + 3 * k, 0)
        bpy.context.scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    atlas.make_atlas(bpy.context, bpy.context.scene.objects, 64)
    scene = read()
    assert names(scene) == ["Cube", "Empty 0: Ball", "Empty 1: Ball", "Twin"]
    assert [obj.receives for obj in sorted(scene.objects, key=lambda obj: obj.name)] == [True, False, False, True]
    assert sum("Make Instances Real" in warning for warning in scene.warnings) == 2
    centre = scene.positions[scene.triangles[part(scene, "Empty 1: Ball")]].reshape(-1, 3).mean(axis=0)
    np.testing.assert_allclose(centre, (0, 6, 0), atol=1e-5)
    first, second = scene.atlas_uv[part(scene, "Cube")], scene.atlas_uv[part(scene, "Twin")]
    assert first.min() > 0 and second.max() < 1
    apart = (first.max((0, 1)) < second.min((0, 1))) | (second.max((0, 1)) < first.min((0, 1)))
    assert apart.any()


def scatter(points, instance):
    """Geometry nodes that put the object on the points' object, by reference."""
    tree = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    enter, leave = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    put, info = tree.nodes.new("GeometryNodeInstanceOnPoints"), tree.nodes.new("GeometryNodeObjectInfo")
    info.inputs["Object"].default_value = instance
    info.inputs["As Instance"].default_value = True
    tree.links.new(enter.outputs[0], put.inputs["Points"])
    tree.links.new(info.outputs["Geometry"], put.inputs["Instance"])
    tree.links.new(put.outputs[0], leave.inputs[0])
    points.modifiers.new("Scatter", "NODES").node_group = tree


def test_geometry_node_instances_of_a_hidden_object(blender):
    ball = add("ico_sphere", "Ball", subdivisions=1)
    material = bpy.data.materials.new("Red")
    ball.data.materials.append(material)
    ball.hide_render = True
    scatter(add("plane", "Ground", size=10), ball)
    scene = read()
    assert names(scene) == ["Ground: Ball"] * 4
    assert [each.name for each in scene.materials] == ["Red"]
    assert np.ptp(scene.positions, axis=0) == pytest.approx([12, 12, 2], abs=0.3)


def test_render_visibility_counts_not_the_viewports(blender):
    shown = {"Eye", "Monitor", "Layer eye", "Plain"}
    for name in (*shown, "Camera", "Collection camera", "Excluded"):
        add("cube", name)
    data, layer = bpy.data, bpy.context.view_layer

    def move(name):
        collection = data.collections.new(name)
        bpy.context.scene.collection.children.link(collection)
        collection.objects.link(data.objects[name])
        bpy.context.scene.collection.objects.unlink(data.objects[name])
        return collection, layer.layer_collection.children[name]

    data.objects["Eye"].hide_set(True)
    data.objects["Monitor"].hide_viewport = True
    data.objects["Camera"].hide_render = True
    move("Layer eye")[1].hide_viewport = True
    move("Collection camera")[0].hide_render = True
    move("Excluded")[1].exclude = True
    assert set(names(read())) == shown
    assert data.objects["Eye"].hide_get() and data.objects["Monitor"].hide_viewport
    assert layer.layer_collection.children["Layer eye"].hide_viewport


def test_visibility_flags_and_light_linking(blender):
    obj = add("cube", "Ghost")
    obj.visible_diffuse = obj.visible_shadow = False
    other = add("cube", "Linked")
    other.light_linking.receiver_collection = bpy.data.collections.new("Receivers")
    scene = read()
    flags = {each.name: (each.reflects, each.casts_shadow) for each in scene.objects}
    assert flags == {"Ghost": (False, False), "Linked": (True, True)}
    assert any("'Linked' uses light linking" in warning for warning in scene.warnings)


def test_material_of_each_triangle(blender):
    obj = add("cube")
    for name in ("A", "B"):
        obj.data.materials.append(bpy.data.materials.new(name))
    obj.data.materials.append(None)
    for k, face in enumerate(obj.data.polygons):
        face.material_index = k % 3
    obj.material_slots[1].link = "OBJECT"
    obj.material_slots[1].material = bpy.data.materials.new("Own")
    scene = read()
    counts = np.bincount(scene.triangle_material)
    found = {material.name: int(count) for material, count in zip(scene.materials, counts, strict=True)}
    assert found == {"A": 4, "Own": 4, "No material": 4}


def test_atlas_places_follow_into_modified_meshes(blender):
    obj = add("cube")
    obj.modifiers.new("Subdivision", "SUBSURF").render_levels = 3
    atlas.make_atlas(bpy.context, [obj], 64)
    scene = read()
    assert np.isfinite(scene.atlas_uv).all() and scene.atlas_uv.min() > 0 and scene.atlas_uv.max() < 1
    obj["lightpanes_scale"], obj["lightpanes_offset"] = (0.5, 0.25), (0.1, 0.2)
    moved = read().atlas_uv
    np.testing.assert_allclose(moved, scene.atlas_uv * [0.5, 0.25] + [0.1, 0.2], atol=1e-6)


def test_mirrored_object_keeps_uv_with_its_corners(blender):
    obj = add("monkey")
    atlas.make_atlas(bpy.context, [obj], 64)
    before = read()
    obj.matrix_world = Matrix.Diagonal((-1, 1, 1, 1))
    bpy.context.view_layer.update()
    after = read()

    def corners(scene):
        points = scene.positions[scene.triangles] * np.sign([[[scene is before or -1, 1, 1]]])
        rows = np.concatenate([points, scene.atlas_uv], axis=2).reshape(-1, 5).round(5)
        return rows[np.lexsort(rows.T)]

    np.testing.assert_allclose(corners(before), corners(after), atol=2e-5)


def test_excluded_object_receives_nothing(blender):
    obj = add("cube")
    atlas.make_atlas(bpy.context, [obj], 64)
    obj.lightpanes.exclude = True
    scene = read()
    assert not scene.objects[0].receives and np.isnan(scene.atlas_uv).all()


def test_layer_lost_in_a_modifier(blender):
    obj = add("cube")
    atlas.make_atlas(bpy.context, [obj], 64)
    obj.modifiers.new("Remesh", "REMESH").voxel_size = 0.5
    scene = read()
    assert not scene.objects[0].receives
    assert any("'Cube' loses its UV layer" in warning for warning in scene.warnings)


def test_object_in_edit_mode_is_read_as_it_is(blender):
    add("cube")
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.translate(value=(0, 0, 5))
    scene = read()
    bpy.ops.object.mode_set(mode="OBJECT")
    assert len(scene.triangles) == 12
    np.testing.assert_allclose(scene.positions.mean(axis=0), (0, 0, 5), atol=1e-6)


def refused():
    with pytest.raises(SceneError) as error:
        read()
    return str(error.value)


def test_no_meshes(blender):
    assert "no mesh" in refused()


def test_everything_hidden(blender):
    add("cube").hide_render = True
    message = refused()
    assert "hidden from renders" in message and "'Cube'" in message and "camera" in message


def test_mesh_without_faces(blender):
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Bare", bpy.data.meshes.new("Bare")))
    assert "'Bare'" in refused()
    add("cube")
    scene = read()
    assert names(scene) == ["Cube"] and any("'Bare' has no faces" in warning for warning in scene.warnings)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_vertices_that_are_not_numbers(blender, value):
    add("cube", "Fine")
    add("cube", "Broken").data.vertices[3].co.y = value
    message = refused()
    assert "'Broken'" in message and "not numbers" in message


def test_what_is_not_traced_is_named(blender):
    add("cube")
    volume = bpy.data.objects.new("Fog", bpy.data.volumes.new("Fog"))
    bpy.context.scene.collection.objects.link(volume)
    assert any("'Fog' is a volume" in warning for warning in read().warnings)


def test_fingerprint_names_what_changed(blender):
    cube, ball, other = add("cube", "Cube"), add("ico_sphere", "Ball"), add("cone", "Other")
    ball.data.materials.append(bpy.data.materials.new("Paint"))
    ball.hide_set(False)

    def take():
        bpy.context.view_layer.update()
        return extract.fingerprint(bpy.context)

    start = take()
    assert set(start) == {"Cube", "Ball", "Other"} and take() == start
    steps = {}

    def step(name, action):
        before = take()
        action()
        steps[name] = extract.changed_objects(before, take())

    step("move", lambda: setattr(cube, "location", (1, 0, 0)))
    step("edit", lambda: setattr(ball.data.vertices[0].co, "x", 3.0))
    step("modify", lambda: other.modifiers.new("Bevel", "BEVEL"))
    step("assign", lambda: ball.data.materials.clear())
    step("hide from render", lambda: setattr(other, "hide_render", True))
    step("hide in viewport", lambda: cube.hide_set(True))
    step("delete", lambda: bpy.data.objects.remove(ball))
    step("atlas", lambda: atlas.make_atlas(bpy.context, [cube], 64))
    assert steps == {
        "move": ["Cube"], "edit": ["Ball"], "modify": ["Other"], "assign": ["Ball"], "hide from render": ["Other"],
        "hide in viewport": [], "delete": ["Ball"], "atlas": [],
    }  # fmt: skip


def test_fingerprint_sees_materials_and_instances(blender):
    ball = add("ico_sphere", "Ball", subdivisions=1)
    material = bpy.data.materials.new("Paint")
    material.diffuse_color = (1, 0, 0, 1)
    ball.data.materials.append(material)
    ground = add("plane", "Ground")
    before = extract.fingerprint(bpy.context)
    material.diffuse_color = (0, 1, 0, 1)
    bpy.context.view_layer.update()
    middle = extract.fingerprint(bpy.context)
    assert extract.changed_objects(before, middle) == ["Ball"]
    scatter(ground, ball)
    bpy.context.view_layer.update()
    assert extract.changed_objects(middle, extract.fingerprint(bpy.context)) == ["Ground"]
