"""Direct irradiance of every lamp type alone against Cycles' bake: the lamp goes through Blender both ways.

An open room, 4 m wide and 3 m high, with a box in it: floor, two walls and ceiling each have a quarter of
the map. Mean error over the map, and RMSE on blocks of 4×4 texels over the mean.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import bpy
import numpy as np
from lightpanes.addon import lamps
from lightpanes.core.lights import irradiance
from lightpanes.core.rays import Tracer
from lightpanes.core.scene import Light, Scene

from . import harness

MEAN, BLOCKS = 0.01, 0.05
SAMPLES = 16
SUBTEXELS = 2
"""Points along each side of a texel: Cycles averages over texels."""

BORDER = 2
"""Texels left out around each face: Cycles' filter reaches past them in 5.x."""

ROOM = np.array(
    [
        [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)],
        [(-2, 2, 0), (2, 2, 0), (2, 2, 3), (-2, 2, 3)],
        [(-2, -2, 0), (-2, 2, 0), (-2, 2, 3), (-2, -2, 3)],
        [(-2, -2, 3), (-2, 2, 3), (2, 2, 3), (2, -2, 3)],
    ],
    np.float32,
)
"""(faces, corners, 3): floor, far wall, left wall, ceiling, all seen from inside."""

BOX = ((-0.3, -0.2, 0.0), (0.5, 0.4, 0.8))


@dataclass(frozen=True)
class Case:
    """A lamp: Blender's type, settings of its data, its place; `change` does what settings can't."""

    kind: str
    data: dict
    place: tuple[float, float, float] = (0.4, -0.3, 2.2)
    turn: tuple[float, float, float] = (0.3, -0.4, 0.5)
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    change: Callable[[bpy.types.Object], None] | None = None


def _nodes(obj):
    obj.data.use_nodes = True
    emission = next(node for node in obj.data.node_tree.nodes if node.type == "EMISSION")
    emission.inputs["Color"].default_value = (0.5, 1.0, 2.0, 1.0)
    emission.inputs["Strength"].default_value = 1.7


def _parent(obj):
    """A parent that turns, moves and scales."""
    parent = bpy.data.objects.new("Parent", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.location, parent.rotation_euler, parent.scale = (0.2, 0.3, 0.4), (0, 0, 0.7), (1.5, 1.5, 0.8)
    obj.parent = parent


def _instance(obj):
    """The lamp only as a member of a collection that two empties show."""
    collection = bpy.data.collections.new("Lamps")
    bpy.context.scene.collection.objects.unlink(obj)
    collection.objects.link(obj)
    for x in (-0.7, 0.6):
        empty = bpy.data.objects.new("Empty", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
        empty.location = (x, 0.1, 0.1)
        bpy.context.scene.collection.objects.link(empty)


W = {"energy": 100.0}
AREA = {**W, "shape": "RECTANGLE", "size": 1.2, "size_y": 0.5}
CASES = {
    "point": Case("POINT", {**W, "shadow_soft_size": 0.0}),
    "point, soft": Case("POINT", {**W, "shadow_soft_size": 0.25, "use_soft_falloff": False}),
    "point, soft falloff": Case("POINT", {**W, "shadow_soft_size": 0.25}),
    "point near a wall": Case("POINT", {**W, "shadow_soft_size": 0.15}, place=(0.5, 1.7, 1.2)),
    "spot": Case("SPOT", {**W, "shadow_soft_size": 0.0, "spot_size": 1.6, "spot_blend": 0.4}),
    "spot, soft": Case("SPOT", {**W, "shadow_soft_size": 0.2, "spot_size": 1.6, "use_soft_falloff": False}),
    "spot, soft falloff": Case("SPOT", {**W, "shadow_soft_size": 0.2, "spot_size": 1.2, "spot_blend": 1.0}),
    "spot, no blend": Case("SPOT", {**W, "shadow_soft_size": 0.1, "spot_size": 2.2, "spot_blend": 0.0}),
    "spot, half space": Case("SPOT", {**W, "shadow_soft_size": 0.1, "spot_size": math.pi, "spot_blend": 0.5}),
    "spot, uneven scale": Case("SPOT", {**W, "shadow_soft_size": 0.1, "spot_size": 1.2}, scale=(1.0, 2.0, 0.8)),
    "sun": Case("SUN", {"energy": 3.0, "angle": 0.0}, turn=(0.5, 0.3, 0)),
    "sun, wide": Case("SUN", {"energy": 3.0, "angle": 0.6}, turn=(0.8, 0.3, 0.4)),
    "area, square": Case("AREA", {**W, "size": 0.8}),
    "area, rectangle": Case("AREA", AREA),
    "area, disk": Case("AREA", {**W, "shape": "DISK", "size": 0.9}),
    "area, ellipse": Case("AREA", {**AREA, "shape": "ELLIPSE"}),
    "area, spread": Case("AREA", {**AREA, "spread": 1.8}),
    "area, narrow spread": Case("AREA", {**AREA, "spread": 0.5}),
    "area, ellipse, spread": Case("AREA", {**AREA, "shape": "ELLIPSE", "spread": 1.8}),
    "area, beam": Case("AREA", {**W, "size": 2.0, "spread": 0.0}, turn=(0.2, -0.1, 0.5)),
    "area, scaled": Case("AREA", AREA, scale=(0.5, 2.0, 3.0)),
    "area, large, near a wall": Case("AREA", {**W, "size": 2.5}, place=(0.3, 1.2, 1.5), turn=(1.2, 0.1, 0.2)),
    "emission node": Case("POINT", {**W, "shadow_soft_size": 0.1}, change=_nodes),
    "temperature, exposure": Case("POINT", {**W, "use_temperature": True, "temperature": 3000.0, "exposure": 0.7}),
    "not normalised, point": Case("POINT", {**W, "normalize": False, "shadow_soft_size": 0.2}),
    "not normalised, area": Case("AREA", {**AREA, "normalize": False, "shape": "ELLIPSE"}),
    "not normalised, sun": Case("SUN", {**W, "normalize": False, "angle": 0.5}),
    "parented": Case("AREA", AREA, place=(0.1, -0.3, 2.1), turn=(0, 0, 0.0), change=_parent),
    "instanced": Case("POINT", {**W, "shadow_soft_size": 0.1}, change=_instance),
    "no shadow": Case("SPOT", {**W, "use_shadow": False, "spot_size": 1.5}),
}

SHARP = ("point", "spot", "sun", "area, beam", "area, narrow spread", "no shadow", "temperature, exposure")
"""Lamps whose light ends at a line or within a few texels."""


def rows() -> Iterator[dict]:
    for name in CASES:
        mean, blocks, detail = compare(name, resolution=96, spp=128)
        yield harness.row(f"direct irradiance, {name}, against Cycles: mean error", mean, MEAN, detail=detail)
        # where light ends at a line, the two Blenders differ by this much too: they sample texels in their own ways
        bar = None if name in SHARP else BLOCKS
        yield harness.row(f"direct irradiance, {name}, against Cycles: 4×4 blocks", blocks, bar)
    yield speed()


def speed() -> dict:
    """Time of irradiance() beside that of its shadow rays: 6,000 points, four samples, a point lamp."""
    random = np.random.default_rng(0)
    tracer = Tracer(trace_scene())
    points, normals, _ = texel_points(40)
    rows = random.permutation(len(points))[:6000]
    points, normals = points[rows] + normals[rows] * tracer.offset, normals[rows]
    matrix = np.eye(4)
    matrix[:3, 3] = (0.4, -0.3, 2.2)
    light = Light("Point", "POINT", matrix, 1.0, radius=0.1)
    rays = []
    irradiance(light, points, normals, lambda o, v: rays.append((o, v)) or np.ones(len(o), np.float32), 4)
    whole, alone = harness.interleaved(
        lambda: irradiance(light, points, normals, tracer.visibility, 4),
        lambda: [tracer.visibility(*r) for r in rays],
        repeats=15,
    )
    detail = f"{1e3 * whole:.2f} ms whole, {1e3 * alone:.2f} ms rays"
    name = "one lamp at 6,000 points × 4 samples: time outside the rays"
    return harness.row(name, 1e3 * (whole - alone), unit="ms", detail=detail)


def compare(name: str, resolution: int, spp: int) -> tuple[float, float, str]:
    """Relative error of the mean, and of 4×4 blocks, of one lamp of CASES; empties Blender first."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    room = build_room(resolution)
    add_lamp(CASES[name])
    bpy.context.view_layer.update()
    warnings: list[str] = []
    lights = lamps.read_lights(bpy.context.evaluated_depsgraph_get(), warnings)
    if warnings or not lights:
        raise AssertionError(f"{name}: {len(lights)} lamps, {warnings}")
    expected = bake(room, resolution, spp)
    found = sum(ours(light, resolution) * light.power.astype(np.float32) for light in lights)
    return *errors(found, expected, resolution), f"mean {expected.mean():.4g} W/m²"


def errors(found, expected, resolution) -> tuple[float, float]:
    quarter = np.zeros((resolution // 2,) * 2, bool)
    quarter[BORDER:-BORDER, BORDER:-BORDER] = True
    inside = np.tile(quarter, (2, 2))[..., None]
    found, expected = np.where(inside, found, 0), np.where(inside, expected, 0)
    cells = resolution // 4
    gap = (found - expected).reshape(cells, 4, cells, 4, 3).mean(axis=(1, 3))
    return abs(found.mean() / expected.mean() - 1), math.sqrt((gap**2).mean()) / expected.mean()


def ours(light: Light, resolution: int) -> np.ndarray:
    """(resolution, resolution, 3) float32 irradiance of the lamp at unit power."""
    tracer = Tracer(trace_scene())
    points, normals, texels = texel_points(resolution // 2 * SUBTEXELS)
    points = points + normals * tracer.offset
    value = irradiance(light, points, normals, tracer.visibility, SAMPLES)
    image = np.zeros((resolution * SUBTEXELS) ** 2, np.float32)
    image[texels] = value
    image = image.reshape(resolution, SUBTEXELS, resolution, SUBTEXELS).mean(axis=(1, 3))
    return np.repeat(image[..., None], 3, axis=2)


def texel_points(side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points and normals, (n, 3) float32, of side² texels on each face, and their places in the map, row by row."""
    centre = (np.arange(side) + 0.5) / side
    v, u = (g.reshape(-1, 1) for g in np.meshgrid(centre, centre, indexing="ij"))
    row, column = np.divmod(np.arange(side * side), side)
    points, normals, places = [], [], []
    for face, (a, b, c, d) in enumerate(ROOM):
        points.append(((1 - u) * a + u * b) * (1 - v) + ((1 - u) * d + u * c) * v)
        normal = np.cross(b - a, d - a)
        normals.append(np.broadcast_to(normal / np.linalg.norm(normal), (side * side, 3)))
        places.append((row + side * (face // 2)) * 2 * side + column + side * (face % 2))
    return np.concatenate(points).astype(np.float32), np.concatenate(normals).astype(np.float32), np.concatenate(places)


def trace_scene() -> Scene:
    """Room and box as triangles."""
    low, high = BOX
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * np.subtract(high, low) + low
    quads = np.array(box_faces()) + 16
    quads = np.concatenate([np.arange(16).reshape(4, 4), quads])
    positions = np.concatenate([ROOM.reshape(-1, 3), corners])
    return Scene(positions, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


def box_faces() -> list[tuple[int, int, int, int]]:
    return [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def build_room(resolution: int) -> bpy.types.Object:
    """The room with its image, and the box, in the current scene."""
    mesh = bpy.data.meshes.new("Room")
    mesh.from_pydata(ROOM.reshape(-1, 3).tolist(), [], np.arange(16).reshape(4, 4).tolist())
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    uv = np.concatenate([np.add(square, divmod(face, 2)[::-1]) / 2 for face in range(4)])
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", uv.astype(np.float32).ravel())
    image = bpy.data.images.new("Room", resolution, resolution, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    material = bpy.data.materials.new("Room")
    if material.node_tree is None:
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(diffuse.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    target = tree.nodes.new("ShaderNodeTexImage")
    target.image = image
    tree.nodes.active = target
    mesh.materials.append(material)
    low, high = BOX
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * np.subtract(high, low) + low
    block = bpy.data.meshes.new("Box")
    block.from_pydata(corners.tolist(), [], box_faces())
    room = bpy.data.objects.new("Room", mesh)
    for obj in (room, bpy.data.objects.new("Box", block)):
        bpy.context.scene.collection.objects.link(obj)
    return room


def add_lamp(case: Case) -> bpy.types.Object:
    obj = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", case.kind))
    bpy.context.scene.collection.objects.link(obj)
    obj.location, obj.rotation_euler, obj.scale = case.place, case.turn, case.scale
    for key, value in case.data.items():
        setattr(obj.data, key, value)
    if case.change:
        case.change(obj)
    return obj


def bake(room: bpy.types.Object, resolution: int, spp: int) -> np.ndarray:
    """(resolution, resolution, 3) float32: Cycles' direct irradiance of the room, W/m²."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = spp
    for name, value in {
        "use_adaptive_sampling": False,
        "use_denoising": False,
        "sample_clamp_direct": 0.0,
        "sample_clamp_indirect": 0.0,
        "light_sampling_threshold": 0.0,
        "device": "CPU",
    }.items():
        setattr(scene.cycles, name, value)
    for obj in scene.objects:
        obj.select_set(obj == room)
    bpy.context.view_layer.objects.active = room
    bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT"}, margin=0, use_clear=True)
    pixels = np.empty(resolution * resolution * 4, np.float32)
    image = room.data.materials[0].node_tree.nodes.active.image
    image.pixels.foreach_get(pixels)
    return pixels.reshape(resolution, resolution, 4)[..., :3] * np.float32(np.pi)
