"""The world as a map of radiance: constants are read, everything else is baked by Cycles.

Cycles' ENVIRONMENT bake evaluates the background in the direction of each surface point, so a sphere
unwrapped as an equirectangular map yields it in world space; it leaves the user's render result alone.
"""

from __future__ import annotations

import hashlib

import bpy
import numpy as np

from ..core.scene import Sky
from . import cycles
from .materials import digest_tree
from .pixels import read_pixels
from .trees import heeds_nodes

WIDTH, HEIGHT = 256, 128
FINE = 4
"""Texels baked along each side of a map's texel: a sun's disk is smaller than that."""

SAMPLES = 4
HOT = 20.0
"""A fine texel brighter than this many times the mean is a sun, whose surroundings are baked once more."""

WINDOW = 512
"""Texels along each side of that closer look."""

RAY = {"Is Diffuse Ray": 1.0, "Is Reflection Ray": 1.0, "Ray Depth": 1.0, "Diffuse Depth": 1.0, "Ray Length": 1e6}
"""What Light Path says to a diffuse ray that misses everything; all else is 0."""


def linked_node(socket):
    """The node that feeds a socket, reroutes skipped; None if nothing does."""
    while socket.is_linked and socket.links[0].is_valid:
        node = socket.links[0].from_node
        if node.type != "REROUTE":
            return node
        socket = node.inputs[0]
    return None


def constant(socket) -> np.ndarray | None:
    """(3,) or () float64 of a socket that holds, or is fed by, a constant; None otherwise."""
    node = linked_node(socket)
    if node is None:
        value = socket.default_value
    elif node.type in {"RGB", "VALUE"}:
        value = node.outputs[0].default_value
    else:
        return None
    value = np.array(value, np.float64)
    if socket.type == "VALUE" and value.ndim:
        return None
    return value[:3] if value.ndim else np.broadcast_to(value, 3) if socket.type == "RGBA" else value


def read(world: bpy.types.World, warnings: list[str]) -> Sky | None:
    """The world's radiance, None where it is black."""
    if _has_volume(world):
        warnings.append(f"World '{world.name}' has a volume, which is not honoured: light passes the air freely.")
    color = plain(world)
    if color is not None:
        return _sky(color.astype(np.float32).reshape(1, 1, 3))
    try:
        return _sky(_evaluate(world, warnings))
    except RuntimeError as error:
        warnings.append(f"World '{world.name}' could not be evaluated and gives no light: {error}")
        return None


def lights_surfaces(world: bpy.types.World | None) -> bool:
    """Whether the world is one that diffuse surfaces see at all."""
    # without Cycles there is no setting, and every world is
    rays = getattr(world, "cycles_visibility", None)
    return world is not None and (rays is None or rays.diffuse)


def digest(world: bpy.types.World | None) -> str:
    """Short hash of the light that the world gives, for telling whether a bake is stale."""
    result = hashlib.blake2b(digest_size=8)
    if lights_surfaces(world):
        color = plain(world)
        if color is not None:
            result.update(color.astype(np.float32).tobytes())
        else:
            digest_tree(world.node_tree, result)
    return result.hexdigest()


def _output(world):
    """The node that Cycles shows a world by; None where it has no nodes, or none that counts."""
    return world.node_tree.get_output_node("CYCLES") if heeds_nodes(world) else None


def _has_volume(world) -> bool:
    output = _output(world)
    return output is not None and output.inputs["Volume"].is_linked


def plain(world: bpy.types.World) -> np.ndarray | None:
    """(3,) radiance of a world of one colour, None where it varies."""
    output = _output(world)
    if output is None:
        return np.zeros(3) if heeds_nodes(world) else np.array(world.color, np.float64)
    source = linked_node(output.inputs["Surface"])
    if source is None:
        return np.zeros(3)
    if source.type == "BACKGROUND" and not source.mute:
        color, strength = constant(source.inputs["Color"]), constant(source.inputs["Strength"])
        if strength is not None and strength == 0:
            return np.zeros(3)
        if color is not None and strength is not None:
            return np.asarray(color * strength, np.float64)
    return None


def _sky(radiance) -> Sky | None:
    sky = Sky(np.nan_to_num(radiance, nan=0.0, posinf=0.0, neginf=0.0))
    return None if sky.is_black else sky


def _evaluate(world, warnings) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) float32 mean radiance of each texel as diffuse rays see it."""
    cycles.require(f"World '{world.name}' is not of one colour and needs")
    view = world.copy()
    try:
        _see_as_diffuse_ray(view.node_tree)
        # no map for importance sampling: nothing is lit here
        view.cycles.sampling_method = "NONE"
        fine = _bake(view, (0, 1, 0, 1), WIDTH, HEIGHT, WIDTH * FINE, HEIGHT * FINE)
        radiance = _shrink(fine, FINE)
        if _look_closer(view, fine, radiance):
            warnings.append(
                f"World '{world.name}' contains a sun. As part of the sky it lights with a blurred shadow and more "
                "noise; turn Sun Disc off and use a Sun lamp for a sharp one that can be relit."
            )
        return radiance
    finally:
        bpy.data.worlds.remove(view)


def _shrink(image, factor):
    height, width = image.shape[0] // factor, image.shape[1] // factor
    return image.reshape(height, factor, width, factor, 3).mean(axis=(1, 3))


def _look_closer(world, fine, radiance) -> bool:
    """Bake a small very bright region, the sun, again with many texels: its energy must be right.

    Whether there is one.
    """
    brightness = fine.mean(axis=2)
    rows, columns = np.nonzero(brightness > HOT * max(float(brightness.mean()), 1e-9))
    if not len(rows):
        return False
    peak = np.argmax(brightness[rows, columns])
    # turned so that a sun at the map's seam is in one piece
    shift = columns[peak] // FINE - WIDTH // 2
    column = (columns // FINE - shift) % WIDTH
    left, right = column.min() - 2, column.max() + 3
    low, high = max(rows.min() // FINE - 2, 0), min(rows.max() // FINE + 3, HEIGHT)
    cells = max(right - left, high - low)
    if cells > WINDOW // 8:
        return False
    factor = WINDOW // cells
    window = ((left + shift) / WIDTH, (right + shift) / WIDTH, low / HEIGHT, high / HEIGHT)
    patch = _bake(world, window, right - left, high - low, (right - left) * factor, (high - low) * factor)
    radiance[low:high, np.arange(left + shift, right + shift) % WIDTH] = _shrink(patch, factor)
    return True


def _see_as_diffuse_ray(tree) -> None:
    for node in [n for n in tree.nodes if n.type == "LIGHT_PATH"]:
        for output in node.outputs:
            for link in list(output.links):
                socket = link.to_socket
                if socket.type == "VALUE":
                    tree.links.remove(link)
                    socket.default_value = RAY.get(output.name, 0.0)


def _bake(world, window, columns, rows, width, height) -> np.ndarray:
    """(height, width, 3) float32 radiance over a window (left, right, low, high) of the map, in parts of it.

    columns, rows: faces of the sphere's part.
    """
    scene = bpy.data.scenes.new("Lightpanes Environment")
    mesh = _sphere(window, columns, rows)
    obj = bpy.data.objects.new(mesh.name, mesh)
    image = bpy.data.images.new(mesh.name, width, height, alpha=False, float_buffer=True)
    material = bpy.data.materials.new(mesh.name)
    try:
        image.colorspace_settings.name = "Non-Color"
        if material.node_tree is None:
            material.use_nodes = True
        target = material.node_tree.nodes.new("ShaderNodeTexImage")
        target.image = image
        material.node_tree.nodes.active = target
        mesh.materials.append(material)
        scene.world = world
        scene.render.engine = "CYCLES"
        scene.cycles.samples = SAMPLES
        scene.cycles.use_adaptive_sampling = False
        scene.cycles.use_denoising = False
        scene.cycles.device = "CPU"
        scene.render.bake.use_selected_to_active = False
        scene.collection.objects.link(obj)
        layer = scene.view_layers[0]
        layer.objects.active = obj
        obj.select_set(True, view_layer=layer)
        chosen = {"object": obj, "active_object": obj, "selected_objects": [obj], "selected_editable_objects": [obj]}
        with bpy.context.temp_override(scene=scene, view_layer=layer, **chosen):
            bpy.ops.object.bake(
                type="ENVIRONMENT", target="IMAGE_TEXTURES", save_mode="INTERNAL", use_clear=True, margin=0
            )
        found = read_pixels(image)
    finally:
        bpy.data.scenes.remove(scene)
        bpy.data.objects.remove(obj)
        bpy.data.meshes.remove(mesh)
        bpy.data.materials.remove(material)
        bpy.data.images.remove(image)
    return found[..., :3].copy()


def _sphere(window, columns, rows):
    """A part of the unit sphere whose UVs, 0 to 1 over the window, are Blender's equirectangular map."""
    left, right, low, high = window
    across, up = np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1)
    u, v = np.meshgrid(across, up)
    azimuth, elevation = (0.5 - left - (right - left) * u) * 2 * np.pi, (low + (high - low) * v - 0.5) * np.pi
    flat = np.cos(elevation)
    points = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)
    row, column = np.divmod(np.arange(columns * rows), columns)
    first = row * (columns + 1) + column
    faces = np.stack([first, first + 1, first + columns + 2, first + columns + 1], axis=1).astype(np.int32)
    mesh = bpy.data.meshes.new("Lightpanes Environment")
    mesh.vertices.add(u.size)
    mesh.vertices.foreach_set("co", points.astype(np.float32).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 4, dtype=np.int32))
    mesh.update(calc_edges=True)
    uv = np.stack([u, v], axis=-1).reshape(-1, 2)[faces.ravel()].astype(np.float32)
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", uv.ravel())
    return mesh
