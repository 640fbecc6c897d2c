"""The render engine in the background: against Blender's projection and Cycles' light, and where things are missing."""

import bpy
import numpy as np
import pytest
from lightpanes.addon import render, view
from mathutils import Matrix

SIZE = (48, 32)


@pytest.fixture
def scene(blender, tmp_path):
    """A floor, a wall and a box under a lamp, and a camera; the engine is ours."""
    made = bpy.context.scene
    made.render.engine = render.ENGINE
    made.render.resolution_x, made.render.resolution_y = SIZE
    made.render.resolution_percentage = 100
    made.lightpanes.samples = 16
    made.view_settings.view_transform = "Standard"
    made.world = bpy.data.worlds.new("World")
    shine(made, (0.0, 0.0, 0.0))
    quad("Floor", [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], (0.7, 0.6, 0.5))
    quad("Wall", [(-2, 2, 0), (2, 2, 0), (2, 2, 3), (-2, 2, 3)], (0.2, 0.5, 0.7))
    quad("Step", [(-0.5, 0, 0.5), (0.5, 0, 0.5), (0.5, 1, 0.5), (-0.5, 1, 0.5)], (0.8, 0.2, 0.2))
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.data.energy, lamp.data.shadow_soft_size, lamp.location = 100.0, 0.2, (1.0, -0.5, 2.0)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.matrix_world = Matrix.Translation((0, -4, 2)) @ Matrix.Rotation(1.2, 4, "X")
    for item in (lamp, camera):
        made.collection.objects.link(item)
    made.camera = camera
    made.render.filepath = str(tmp_path / "image.exr")
    made.render.image_settings.file_format = "OPEN_EXR"
    made.render.image_settings.color_depth = "32"
    return made


def shine(scene, colour):
    """An even sky."""
    if scene.world.node_tree is None:
        scene.world.use_nodes = True
    background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*colour, 1)


def quad(name, corners, colour):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader, output = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["Color"].default_value = (*colour, 1)
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    mesh.materials.append(material)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, mesh))
    return mesh


def rendered(scene):
    """(H, W, 4) of the scene as it renders, row 0 at the bottom."""
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    try:
        width, height = image.size
        pixels = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(pixels)
        return pixels.reshape(height, width, 4)
    finally:
        bpy.data.images.remove(image)


def by_cycles(scene, samples=128):
    scene.render.engine = "CYCLES"
    for name, value in {"samples": samples, "use_adaptive_sampling": False, "use_denoising": False}.items():
        setattr(scene.cycles, name, value)
    try:
        return rendered(scene)
    finally:
        scene.render.engine = render.ENGINE


def test_the_camera_projects_as_blenders(scene):
    for kind in ("PERSP", "ORTHO"):
        for fit in ("AUTO", "HORIZONTAL", "VERTICAL"):
            for size in ((90, 60), (60, 90)):
                projects_as_blenders(scene, kind, fit, size)


def projects_as_blenders(scene, kind, fit, size):
    camera, drawn = scene.camera, scene.render
    data = camera.data
    data.type, data.sensor_fit, data.lens, data.ortho_scale = kind, fit, 31.0, 4.5
    data.shift_x, data.shift_y, data.clip_start, data.clip_end = 0.13, -0.07, 0.3, 50.0
    drawn.pixel_aspect_x, drawn.pixel_aspect_y = 1.0, 1.5
    camera.matrix_world = Matrix.LocRotScale((1, -3, 2), Matrix.Rotation(0.7, 3, (1, 2, 3)), (2, 2, 2))
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    ours = view.through_camera(camera.evaluated_get(graph), drawn, *size, [])
    theirs = camera.calc_matrix_camera(graph, x=size[0], y=size[1], scale_x=1.0, scale_y=1.5)
    assert ours.projection == pytest.approx(np.array(theirs), rel=1e-5, abs=1e-5)
    assert ours.view == pytest.approx(np.array(camera.matrix_world.normalized().inverted()), abs=1e-5)
    origins, directions, _ = ours.rays()
    # a place on a pixel's ray is projected onto that pixel
    at = origins[37] + 2.5 * directions[37]
    clip = ours.projection @ ours.view @ np.append(at, 1)
    assert (clip[:2] / clip[3] + 1) / 2 * size == pytest.approx((37 % size[0] + 0.5, 37 // size[0] + 0.5), abs=1e-2)


def test_a_render_is_cycles_render(scene):
    ours, theirs = rendered(scene), by_cycles(scene)
    assert ours.shape == theirs.shape == (SIZE[1], SIZE[0], 4)
    assert ours[..., :3].mean((0, 1)) == pytest.approx(theirs[..., :3].mean((0, 1)), rel=0.03)
    error = np.sqrt(((ours - theirs)[..., :3] ** 2).mean()) / theirs[..., :3].mean()
    assert error < 0.12


def test_sky_texture_and_transparent_film(scene):
    shine(scene, (0.3, 0.4, 0.6))
    scene.render.film_transparent = True
    checker = bpy.data.images.new("Checker", 2, 2)
    checker.pixels[:] = [1, 0, 0, 1, 0, 1, 0, 1, 0, 0, 1, 1, 1, 1, 1, 1]
    material = bpy.data.materials["Floor"]
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image, node.interpolation = checker, "Closest"
    shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_DIFFUSE")
    material.node_tree.links.new(node.outputs[0], shader.inputs["Color"])
    uv = bpy.data.meshes["Floor"].uv_layers.new(name="Tiles")
    uv.data.foreach_set("uv", [-1.0, -1.0, 2.0, -1.0, 2.0, 2.0, -1.0, 2.0])
    ours, theirs = rendered(scene), by_cycles(scene)
    assert ours.mean((0, 1)) == pytest.approx(theirs.mean((0, 1)), rel=0.03)
    assert ours[-1, 0, 3] < 0.1
    # each tile has its colour
    error = np.sqrt(((ours - theirs)[..., :3] ** 2).mean()) / theirs[..., :3].mean()
    assert error < 0.15


def test_border_percentage_and_frames(scene):
    whole = rendered(scene)
    scene.render.use_border = True
    scene.render.border_min_x, scene.render.border_max_x = 0.25, 0.75
    scene.render.border_min_y, scene.render.border_max_y = 0.5, 1.0
    part = rendered(scene)
    assert part.shape == whole.shape and not part[:16].any()
    assert part[16:, 12:36, :3] == pytest.approx(whole[16:, 12:36, :3], rel=0.5, abs=0.05)
    scene.render.use_crop_to_border = True
    assert rendered(scene).shape == (16, 24, 4)
    scene.render.use_border = False
    scene.render.resolution_percentage = 50
    assert rendered(scene).shape == (16, 24, 4)


def test_passes_reach_the_file(scene):
    layer = bpy.context.view_layer
    for flag, *_ in render.PASSES.values():
        setattr(layer, flag, True)
    seen = {}
    write = render._write

    def note(result, name, image):
        seen[name] = result.layers[0].passes.get(name) is not None
        write(result, name, image)

    render._write = note
    try:
        rendered(scene)
    finally:
        render._write = write
    assert set(seen) == {"Combined", *render.passes_of(layer).values()} and all(seen.values())


def test_cancelled_before_the_first_sample(scene, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(render, "cancelled", lambda _: True)
        assert not rendered(scene)[..., :3].any()
    assert rendered(scene)[..., :3].any()


def test_no_lamps_and_no_meshes(scene):
    bpy.data.objects.remove(bpy.data.objects["Lamp"])
    assert not rendered(scene)[..., :3].any()
    for item in [item for item in bpy.data.objects if item.type == "MESH"]:
        bpy.data.objects.remove(item)
    shine(scene, (0.25, 0.5, 1.0))
    assert rendered(scene)[..., :3] == pytest.approx(np.broadcast_to([0.25, 0.5, 1.0], (32, 48, 3)), abs=1e-3)


def test_a_missing_image_is_magenta(scene):
    material = bpy.data.materials["Floor"]
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = bpy.data.images.new("Lost", 4, 4)
    node.image.source, node.image.filepath = "FILE", "//lost.png"
    shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_DIFFUSE")
    material.node_tree.links.new(node.outputs[0], shader.inputs["Color"])
    bpy.data.meshes["Floor"].uv_layers.new(name="UVMap")
    red, green, blue = rendered(scene)[2, 24, :3]
    assert green < 0.1 * red and blue > 0.5 * red


def test_errors_name_what_is_wrong(scene):
    scene.camera = None
    with pytest.raises(RuntimeError, match="camera"):
        bpy.ops.render.render()


def test_vertices_that_are_not_numbers(scene):
    bpy.data.meshes["Step"].vertices[0].co.x = float("nan")
    with pytest.raises(RuntimeError, match="'Step'"):
        bpy.ops.render.render()


def test_blenders_panels_stay_and_go_with_the_engine(scene):
    from lightpanes.addon import render_panel

    def taken():
        return {
            panel.__name__
            for panel in render_panel._subclasses(bpy.types.Panel)
            if render.ENGINE in (getattr(panel, "COMPAT_ENGINES", None) or ())
        }

    assert {"EEVEE_MATERIAL_PT_surface", "EEVEE_MATERIAL_PT_context_material", "RENDER_PT_output"} & taken()
    render_panel.unregister()
    assert not {name for name in taken() if "LIGHTPANES" not in name}
    render_panel.register()


def layer_of_step(scene):
    """A second view layer, in which the step is not seen; returns it."""
    apart = bpy.data.collections.new("Apart")
    scene.collection.children.link(apart)
    step = bpy.data.objects["Step"]
    scene.collection.objects.unlink(step)
    apart.objects.link(step)
    layer = scene.view_layers.new("Bare")
    layer.layer_collection.children["Apart"].exclude = True
    return layer


def test_view_layers_each_show_what_is_theirs(scene, monkeypatch):
    bare = layer_of_step(scene)
    bare.use_pass_z = True
    scene.lightpanes.samples = 4
    written = {}

    def note(result, name, image):
        written[result.layers[0].name, name] = image

    monkeypatch.setattr(render, "_write", note)
    bpy.ops.render.render()
    first = next(layer.name for layer in scene.view_layers if layer.name != "Bare")
    assert set(written) == {(first, "Combined"), ("Bare", "Combined"), ("Bare", "Depth")}
    # the step is in the middle of the one, and not of the other
    middle = (slice(8, 24), slice(16, 32))
    with_step, without = (written[name, "Combined"][middle] for name in (first, "Bare"))
    redness = [image[..., 0].max() / image[..., 2].max() for image in (with_step, without)]
    assert redness[0] > 1.5 * redness[1]


def test_every_frame_of_an_animation_is_a_render_of_its_own(scene, tmp_path):
    step = bpy.data.objects["Step"]
    scene.frame_start, scene.frame_end, scene.lightpanes.samples = 1, 3, 4
    for frame, x in ((1, 0.0), (2, 0.6), (3, 3.0)):
        step.location.x = x
        step.keyframe_insert("location", index=0, frame=frame)
    scene.render.filepath = str(tmp_path / "frame_####")
    bpy.ops.render.render(animation=True)
    frames = []
    for path in sorted(tmp_path.glob("frame_*.exr")):
        image = bpy.data.images.load(str(path))
        pixels = np.empty(SIZE[0] * SIZE[1] * 4, np.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
        frames.append(pixels.reshape(SIZE[1], SIZE[0], 4))
    assert len(frames) == 3

    def redness(image, columns):
        part = image[8:26, columns]
        return (part[..., 0] - part[..., 2]).max()

    left, right = slice(12, 24), slice(28, 40)
    assert redness(frames[0], left) > redness(frames[1], left)
    assert redness(frames[1], right) > 0.02
    # each is what a render of that frame alone gives
    scene.frame_set(2)
    scene.render.filepath = str(tmp_path / "alone.exr")
    assert rendered(scene) == pytest.approx(frames[1], abs=1e-4)
