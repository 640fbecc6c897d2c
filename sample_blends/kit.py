"""What the sample scenes are made of: a mesh builder, materials, lamps, cameras."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import bpy
from mathutils import Matrix, Vector

Point = Sequence[float]


class Shape:
    """A mesh under construction: polygons with a material slot each, in the object's own space."""

    def __init__(self):
        self.points: list[Vector] = []
        self.faces: list[tuple[int, ...]] = []
        self.slots: list[int] = []

    def face(self, points: Iterable[Point], slot: int = 0) -> None:
        """One polygon, counter-clockwise seen from the side its normal points to."""
        start = len(self.points)
        self.points += [Vector(p) for p in points]
        self.faces.append(tuple(range(start, len(self.points))))
        self.slots.append(slot)

    def box(
        self, low: Point, high: Point, slot: int = 0, skip: str = "", inward: bool = False, place: Matrix | None = None
    ) -> None:
        """A box from corner to corner. skip: sides left out, as in "-z +x"; inward: seen from inside."""
        left_out = skip.split()
        place = place or Matrix()
        for axis, name in enumerate("xyz"):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            for side, sign in ((low, "-"), (high, "+")):
                if sign + name in left_out:
                    continue
                ring = []
                for a, b in ((low[u], low[v]), (high[u], low[v]), (high[u], high[v]), (low[u], high[v])):
                    point = Vector((0.0, 0.0, 0.0))
                    point[axis], point[u], point[v] = side[axis], a, b
                    ring.append(place @ point)
                self.face(ring if (sign == "+") != inward else ring[::-1], slot)

    def wall(
        self, corner: Point, u: Point, v: Point, holes: Sequence[tuple[float, float, float, float]] = (), slot: int = 0
    ) -> None:
        """A rectangle spanned by u and v, its normal along u × v, with holes (u0, u1, v0, v1) in metres.

        The holes must not overlap along u.
        """
        corner, u, v = Vector(corner), Vector(u), Vector(v)
        width, height = u.length, v.length
        u, v = u.normalized(), v.normalized()

        def rectangle(u0, u1, v0, v1):
            if u1 > u0 and v1 > v0:
                self.face([corner + u * a + v * b for a, b in ((u0, v0), (u1, v0), (u1, v1), (u0, v1))], slot)

        reached = 0.0
        for u0, u1, v0, v1 in sorted(holes):
            rectangle(reached, u0, 0.0, height)
            rectangle(u0, u1, 0.0, v0)
            rectangle(u0, u1, v1, height)
            reached = u1
        rectangle(reached, width, 0.0, height)

    def lathe(
        self, profile: Sequence[tuple[float, float]], segments: int, centre: Point = (0, 0, 0), slot: int = 0
    ) -> None:
        """Turn a profile of (radius, height), listed upwards, about the vertical; radius 0 closes it."""
        rings = []
        for radius, height in profile:
            if radius == 0.0:
                rings.append([len(self.points)] * segments)
                self.points.append(Vector(centre) + Vector((0, 0, height)))
                continue
            rings.append(list(range(len(self.points), len(self.points) + segments)))
            for i in range(segments):
                angle = math.tau * i / segments
                self.points.append(
                    Vector(centre) + Vector((radius * math.cos(angle), radius * math.sin(angle), height))
                )
        for below, above in itertools.pairwise(rings):
            for i in range(segments):
                j = (i + 1) % segments
                ring = list(dict.fromkeys((below[i], below[j], above[j], above[i])))
                self.faces.append(tuple(ring))
                self.slots.append(slot)

    def prism(
        self,
        outline: Sequence[tuple[float, float]],
        low: float,
        high: float,
        slot: int = 0,
        skip: Sequence[int] = (),
        place: Matrix | None = None,
    ) -> None:
        """Extrude an outline of (y, z), counter-clockwise seen from +x, along x from low to high.

        skip: numbers of the outline's edges that get no face; edge k starts at point k.
        """
        place = place or Matrix()
        count = len(outline)
        self.face([place @ Vector((high, y, z)) for y, z in outline], slot)
        self.face([place @ Vector((low, y, z)) for y, z in reversed(outline)], slot)
        for i in range(count):
            if i in skip:
                continue
            (y0, z0), (y1, z1) = outline[i], outline[(i + 1) % count]
            corners = ((low, y0, z0), (low, y1, z1), (high, y1, z1), (high, y0, z0))
            self.face([place @ Vector(p) for p in corners], slot)

    def build(
        self, name: str, *materials: bpy.types.Material, smooth: bool = False, place: Matrix | None = None
    ) -> bpy.types.Object:
        """Make it an object of the scene. smooth: shade edges below 40 degrees smooth."""
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata([tuple(p) for p in self.points], [], self.faces)
        for material in materials:
            mesh.materials.append(material)
        mesh.polygons.foreach_set("material_index", self.slots)
        mesh.polygons.foreach_set("use_smooth", [smooth] * len(self.faces))
        if smooth:
            mesh.set_sharp_from_angle(angle=math.radians(40))
        mesh.validate()
        mesh.update()
        obj = bpy.data.objects.new(name, mesh)
        if place is not None:
            obj.matrix_world = place
        bpy.context.scene.collection.objects.link(obj)
        return obj


def diffuse(name: str, colour: Point) -> bpy.types.Material:
    """A purely diffuse material of that linear colour."""
    material = _with_nodes(name, colour)
    tree = material.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (*colour, 1.0)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    output.location = (220, 0)
    tree.links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    return material


def principled(name: str, colour: Point, roughness: float = 0.5, specular: float = 0.5) -> bpy.types.Material:
    """Blender's usual material, with that linear base colour."""
    material = _with_nodes(name, colour)
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*colour, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Specular IOR Level"].default_value = specular
    return material


def _with_nodes(name, colour):
    material = bpy.data.materials.new(name)
    if not material.node_tree:
        material.use_nodes = True
    material.diffuse_color = (*colour, 1.0)
    return material


def lamp(
    name: str, kind: str, place: Point, energy: float, colour: Point = (1, 1, 1), aim: Point | None = None, **settings
) -> bpy.types.Object:
    """A lamp; with `aim` its beam points there. settings: any attribute of the light data."""
    data = bpy.data.lights.new(name, kind)
    data.energy, data.color = energy, colour
    for key, value in settings.items():
        setattr(data, key, value)
    obj = bpy.data.objects.new(name, data)
    obj.location = place
    if aim is not None:
        obj.rotation_euler = (Vector(aim) - Vector(place)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(obj)
    return obj


def animate(obj: bpy.types.Object, keys: dict[int, Point], aim: dict[int, Point] | None = None) -> None:
    """Keyframe the object's place and, with `aim`, where its -Z axis looks."""
    for frame, place in keys.items():
        obj.location = place
        obj.keyframe_insert("location", frame=frame)
        if aim is not None:
            turn = (Vector(aim[frame]) - Vector(place)).to_track_quat("-Z", "Y").to_euler("XYZ", obj.rotation_euler)
            obj.rotation_euler = turn
            obj.keyframe_insert("rotation_euler", frame=frame)


def camera(
    place: Point,
    aim: Point,
    lens: float,
    clip_start: float = 0.05,
    shift: Point = (0, 0),
    size: tuple[int, int] = (960, 600),
) -> None:
    """The scene's camera. A large clip_start cuts the room open where the camera stands outside."""
    data = bpy.data.cameras.new("Camera")
    data.lens, data.clip_start, data.shift_x, data.shift_y = lens, clip_start, *shift
    obj = bpy.data.objects.new("Camera", data)
    obj.location = place
    obj.rotation_euler = (Vector(aim) - Vector(place)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.scene.camera = obj
    bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y = size


def start(sky: Point = (0, 0, 0), strength: float = 1.0, exposure: float = 0.0) -> None:
    """An empty file with the settings that all samples share."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.filepaths.save_version = 0
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.filepath = "//"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 256
    scene.cycles.use_denoising = False
    scene.cycles.diffuse_bounces = scene.cycles.max_bounces = 12
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"
    scene.view_settings.exposure = exposure
    scene.frame_start, scene.frame_end = 1, 100
    scene.world = bpy.data.worlds.new("World")
    if not scene.world.node_tree:
        scene.world.use_nodes = True
    background = scene.world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (*sky, 1.0)
    background.inputs["Strength"].default_value = strength


def save(path: Path) -> None:
    """Write the file, compressed, at its first frame."""
    bpy.context.scene.frame_set(1)
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True, check_existing=False)
