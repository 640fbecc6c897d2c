"""Scenes whose bakes are judged by Cycles, with lamps of the kind that a bake judges itself by (panes/held_out.py).

The samples, and four scenes that nothing in Lightpanes was tuned on: an office, a bent corridor, things on an open floor,
an attic. The lamps are other ones than the bake's own judges: drawn by another seed, from entries of another size.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import bpy
import lightpanes
import numpy as np
from lightpanes.addon import lamps
from lightpanes.addon.atlas import make_atlas
from lightpanes.addon.extract import extract
from lightpanes.core import metrics
from lightpanes.core.bake.live import DIM, grey
from lightpanes.core.caustics import casters
from lightpanes.core.panes import Relighter
from lightpanes.core.panes.entry_light import EntryLight, EntrySurface
from lightpanes.core.panes.held_out import held_out_lamps
from lightpanes.core.rays import Bvh, Tracer
from lightpanes.core.scene import Light, Scene
from lightpanes.core.surface import make_patches, make_texels
from lightpanes.core.transfer import find_entries, make_gatherer, make_transport
from mathutils import Matrix, Vector

from . import cycles, scenes

RESOLUTION = 128
FINER = {"atrium": 512}
"""Texels a side of scenes whose charts need more."""

LAMPS = 12

SPP, MOST_SPP = 128, 1024
"""Samples a texel of each half: those that tell how noisy a reference is, and the most that it gets."""

NOISE = 0.02
ROUGH = {"atrium": 0.2}
"""Relative RMSE on blocks that a reference's own noise may make, which is subtracted: about half of what it is to measure."""

SEED = 9000
POOL = 48
"""Lamps of which those in the air stand in for others that light hardly anything."""

FINE = 2048
"""Texels a side of the atlas that tells which texels are buried in part."""

MEETING = 64
"""Rays of an entry that tell how much of what leaves it another one gets."""


@dataclass(frozen=True)
class Truth:
    """What shines, and the light that Cycles makes of it."""

    lights: tuple[Light, ...]
    reference: cycles.Reference


def resolution(name: str) -> int:
    """Texels a side of a scene's atlas."""
    return FINER.get(name, RESOLUTION)


def open_scene(name: str) -> Scene:
    """Open a sample or build one of BUILT, without sky and glow, whose light never changes; with an atlas, extracted."""
    lightpanes.register()
    if name in BUILT:
        bpy.ops.wm.read_homefile(use_empty=True)
        BUILT[name]()
    else:
        bpy.ops.wm.open_mainfile(filepath=str(scenes.FOLDER / f"{name}.blend"))
    context = bpy.context
    context.scene.world = None
    make_atlas(context, [item for item in context.scene.objects if item.type == "MESH"], resolution(name))
    return extract(context, resolution=resolution(name))


def truths(name: str, scene: Scene) -> list[Truth]:
    """Cycles' light of the open scene under each judging lamp alone, at texels no part of which is buried; kept in
    out/bench/cache."""
    script = inspect.getsource(BUILT[name]) + inspect.getsource(_Builder) if name in BUILT else ""
    own = {item.name: item for item in bpy.context.scene.objects if item.type == "LIGHT"}
    for item in own.values():
        item.hide_render = True
        item.animation_data_clear()
    if casters(scene) is not None:
        # what glass focuses is no part of panes, and Cycles' paths find it from lamps with a size only
        for item in own.values():
            _shrink(item.data)
    whole = ~half_buried(scene, resolution(name))
    data = bpy.data.lights.new("Judge", "POINT")
    data.energy, data.shadow_soft_size = 100.0, 0.0
    judge = bpy.data.objects.new("Judge", data)
    bpy.context.scene.collection.objects.link(judge)
    found = []
    for light in judging_lamps(scene):
        item = own.get(light.name, judge)
        item.matrix_world = Matrix(light.matrix.tolist())
        judge.hide_render, item.hide_render = True, False
        bpy.context.view_layer.update()
        lights = lamps.read_lights(bpy.context.evaluated_depsgraph_get(), [])
        reference = _reference(name, script)
        found.append(Truth(lights, replace(reference, mask=reference.mask & whole)))
        item.hide_render = True
    return found


def _reference(name, script):
    """Light of the scene as it stands, from as many samples as its noise asks for."""
    found = cycles.reference_indirect(bpy.context, resolution(name), SPP, script=script)
    asked = found.samples_for(ROUGH.get(name, NOISE))
    if asked <= SPP:
        return found
    # by powers of two, so that a little more noise makes no other reference
    spp = min(SPP << int(np.ceil(np.log2(asked / SPP))), MOST_SPP)
    return cycles.reference_indirect(bpy.context, resolution(name), spp, script=script)


def _shrink(data: bpy.types.Light) -> None:
    """Make a lamp a point, a sun one without width; area lamps stay."""
    if data.type == "SUN":
        data.angle = 0.0
    elif data.type != "AREA":
        data.shadow_soft_size = 0.0


def judging_lamps(scene: Scene, count: int = LAMPS) -> list[Light]:
    """The lamps, the same whatever bake they judge. Those in the air that light hardly anything, outside or in a crack, give
    way to others, as where a bake chooses its own."""
    tracer = Tracer(scene)
    patches, bvh, entries, _ = _entries(scene, tracer)
    gatherer = make_gatherer(scene, patches, entries, bvh, tracer.offset)
    lamps, own = held_out_lamps(scene, entries.places, gatherer, count, SEED)
    others, theirs = held_out_lamps(scene, entries.places, gatherer, POOL, SEED + 1)
    others = [lamp for lamp, is_own in zip(others, theirs, strict=True) if not is_own]
    surface = EntrySurface.of(entries, patches, entries.places, tracer.offset)
    eyes = EntryLight(surface, tracer, SEED, few=1)
    direct = np.stack([grey(eyes.unit(lamp)) for lamp in lamps + others], 1)
    passed_on = make_transport(entries, gatherer, MEETING, SEED).arriving(
        entries.albedo.mean(axis=1, keepdims=True) * direct
    )
    light = entries.area @ passed_on
    least = DIM * np.median(light[len(lamps) :])
    bright = iter(lamp for lamp, gives in zip(others, light[len(lamps) :], strict=True) if gives >= least)
    return [lamp if own[k] or light[k] >= least else next(bright) for k, lamp in enumerate(lamps)]


def _entries(scene, tracer):
    """Patches, their hierarchy, entries, and what tells whether places are buried, the same whatever bake is judged."""
    patches = make_patches(scene, 1000, SEED, tracer)
    bvh = Bvh(patches.corners)
    exits = make_texels(scene, RESOLUTION).samples
    entries, _, is_buried = find_entries(scene, patches, bvh, exits, tracer.offset, SEED)
    return patches, bvh, entries, is_buried


def judge(scene: Scene, result, known: list[Truth]) -> list[metrics.Comparison]:
    """A bake's light against each truth."""
    focusing = casters(scene)
    # as in Cycles, what focuses a lamp's light casts a shadow of it
    relighter = Relighter(result.panes(), Tracer(scene, solid=None if focusing is None else focusing.triangles))
    steady = relighter.relight(())[..., :3].copy()
    found = []
    for truth in known:
        ours = relighter.relight(truth.lights)[..., :3] - steady
        found.append(truth.reference.compare(ours, result.own))
    return found


def half_buried(scene: Scene, resolution: int) -> np.ndarray:
    """(H, W) bool: texels of which a part lies inside a thing, be it the foot of a box that ends 1 cm below the floor. Cycles
    averages over all of a texel, the dark part as well; what is seen of it is the other part, and that is what a bake holds."""
    times = max(FINE // resolution, 1)
    texels = make_texels(scene, times * resolution)
    is_buried = _entries(scene, Tracer(scene))[3]
    row, column = np.divmod(texels.index[is_buried(texels.samples)], times * resolution)
    found = np.zeros((resolution, resolution), bool)
    found[row // times, column // times] = True
    return found


class _Builder:
    """Boxes, walls and lamps."""

    def __init__(self):
        self.materials: dict[tuple, bpy.types.Material] = {}

    def paint(self, item: bpy.types.Object, colour: tuple[float, float, float]) -> bpy.types.Object:
        if colour not in self.materials:
            material = bpy.data.materials.new("Paint")
            material.use_nodes = True
            tree = material.node_tree
            tree.nodes.clear()
            shader, output = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
            shader.inputs["Color"].default_value = (*colour, 1)
            tree.links.new(shader.outputs[0], output.inputs[0])
            self.materials[colour] = material
        item.data.materials.clear()
        item.data.materials.append(self.materials[colour])
        return item

    def box(self, low, high, colour, turn: float = 0.0) -> None:
        middle, size = (np.add(high, low) / 2).tolist(), np.subtract(high, low).tolist()
        bpy.ops.mesh.primitive_cube_add(size=1, location=middle, rotation=(0, 0, turn))
        bpy.context.object.scale = size
        self.paint(bpy.context.object, colour)

    def quad(self, corner, along, across, colour) -> None:
        """A rectangle that faces along × across."""
        corner, along, across = map(np.array, (corner, along, across))
        mesh = bpy.data.meshes.new("Wall")
        points = [corner, corner + along, corner + along + across, corner + across]
        mesh.from_pydata([p.tolist() for p in points], [], [(0, 1, 2, 3)])
        item = bpy.data.objects.new("Wall", mesh)
        bpy.context.scene.collection.objects.link(item)
        self.paint(item, colour)

    def lamp(self, kind: str, place, power: float, aim=None, **values) -> None:
        data = bpy.data.lights.new(kind.title(), kind)
        data.energy = power
        for name, value in values.items():
            setattr(data, name, value)
        item = bpy.data.objects.new(kind.title(), data)
        item.location = place
        if aim is not None:
            item.rotation_euler = (Vector(aim) - Vector(place)).to_track_quat("-Z", "Y").to_euler()
        bpy.context.scene.collection.objects.link(item)


def office() -> None:
    """A room with a window niche, desks, shelves, and a panel at its ceiling."""
    make = _Builder()
    white, grey, wood, blue = (0.8, 0.8, 0.78), (0.35, 0.35, 0.38), (0.45, 0.28, 0.14), (0.15, 0.25, 0.5)
    make.quad((0, 0, 0), (5, 0, 0), (0, 4, 0), grey)
    make.quad((0, 4, 2.8), (5, 0, 0), (0, -4, 0), white)
    make.quad((0, 4, 0), (5, 0, 0), (0, 0, 2.8), white)
    make.quad((5, 0, 0), (-5, 0, 0), (0, 0, 2.8), white)
    make.quad((0, 0, 0), (0, 4, 0), (0, 0, 2.8), blue)
    make.quad((5, 4, 0), (0, -4, 0), (0, 0, 2.8), white)
    for x in (0.8, 2.9):
        make.box((x, 1.2, 0.7), (x + 1.4, 2.0, 0.75), wood)
        for a in (x + 0.02, x + 1.3):
            make.box((a, 1.25, 0.001), (a + 0.06, 1.95, 0.7), grey)
        make.box((x + 0.5, 1.7, 0.751), (x + 0.95, 1.75, 1.1), (0.05, 0.05, 0.06), turn=0.1)
    for z in (0.4, 0.9, 1.4, 1.9):
        make.box((3.2, 3.6, z), (4.8, 3.995, z + 0.03), wood)
        make.box((3.4, 3.7, z + 0.031), (3.9, 3.95, z + 0.3), (0.6, 0.12, 0.1))
    make.lamp("AREA", (2.5, 2.0, 2.7), 120, aim=(2.5, 2.0, 0), size=0.8)
    make.lamp("POINT", (1.2, 1.5, 1.2), 30, shadow_soft_size=0.03)


def corridor() -> None:
    """A corridor that bends twice; a spot shines down its first leg."""
    make = _Builder()
    wall, floor, red = (0.7, 0.68, 0.6), (0.3, 0.22, 0.18), (0.6, 0.1, 0.08)
    make.quad((0, 0, 0), (8, 0, 0), (0, 6, 0), floor)
    make.quad((0, 6, 2.4), (8, 0, 0), (0, -6, 0), wall)
    make.quad((0, 0, 0), (0, 6, 0), (0, 0, 2.4), wall)
    make.quad((8, 6, 0), (0, -6, 0), (0, 0, 2.4), red)
    make.quad((8, 0, 0), (-8, 0, 0), (0, 0, 2.4), wall)
    make.quad((0, 6, 0), (8, 0, 0), (0, 0, 2.4), wall)
    make.box((1.5, -0.01, -0.01), (3.5, 4.4, 2.41), wall)
    make.box((5.2, 1.6, -0.01), (6.4, 6.01, 2.41), wall)
    make.box((4.1, 2.6, 0.001), (4.6, 3.1, 1.0), red, turn=0.4)
    make.lamp("SPOT", (0.7, 0.6, 2.1), 200, aim=(0.8, 5.5, 0.5), spot_size=math.radians(60), shadow_soft_size=0.04)


def open_floor() -> None:
    """Things on a floor under nothing; most light leaves."""
    make = _Builder()
    make.quad((-4, -4, 0), (8, 0, 0), (0, 8, 0), (0.55, 0.55, 0.5))
    for k in range(7):
        angle = 0.9 * k
        place = (2.1 * math.cos(angle), 2.1 * math.sin(angle), 0.45)
        bpy.ops.mesh.primitive_uv_sphere_add(segments=24, ring_count=12, radius=0.44, location=place)
        bpy.ops.object.shade_smooth()
        make.paint(bpy.context.object, ((0.7, 0.2, 0.1), (0.2, 0.6, 0.2), (0.8, 0.75, 0.6))[k % 3])
    bpy.ops.mesh.primitive_torus_add(major_radius=0.8, minor_radius=0.22, location=(0, 0, 0.9), rotation=(0.9, 0.3, 0))
    make.paint(bpy.context.object, (0.75, 0.6, 0.2))
    make.quad((-3, 3.2, 0.001), (6, 0, 0), (0, 0, 2.2), (0.3, 0.4, 0.7))
    make.lamp("POINT", (0.6, -1.2, 2.0), 150, shadow_soft_size=0.1)


def attic() -> None:
    """Under a pitched roof, with beams and boxes; two lamps."""
    make = _Builder()
    wood, dark, plaster = (0.5, 0.33, 0.18), (0.2, 0.12, 0.07), (0.78, 0.72, 0.62)
    make.quad((0, 0, 0), (6, 0, 0), (0, 5, 0), wood)
    make.quad((0, 0, 0.6), (0, 2.5, 2.2), (6, 0, 0), plaster)
    make.quad((6, 5, 0.6), (0, -2.5, 2.2), (-6, 0, 0), plaster)
    make.quad((6, 0, 0), (-6, 0, 0), (0, 0, 0.6), plaster)
    make.quad((0, 5, 0), (6, 0, 0), (0, 0, 0.6), plaster)
    for x, side in ((0, 1), (6, -1)):
        mesh = bpy.data.meshes.new("Gable")
        points = [(x, 0, 0), (x, 5, 0), (x, 5, 0.6), (x, 2.5, 2.8), (x, 0, 0.6)]
        mesh.from_pydata(points, [], [tuple(range(5))[::side]])
        item = bpy.data.objects.new("Gable", mesh)
        bpy.context.scene.collection.objects.link(item)
        make.paint(item, plaster)
    for x in (1.5, 3.0, 4.5):
        make.box((x - 0.08, 0.9, 1.2), (x + 0.08, 4.1, 1.4), dark)
        make.box((x - 0.08, 2.42, 1.401), (x + 0.08, 2.58, 2.7), dark)
    make.box((0.4, 0.5, 0.001), (1.3, 1.3, 0.7), (0.6, 0.5, 0.35), turn=0.2)
    make.box((0.5, 0.6, 0.75), (1.1, 1.1, 1.1), (0.5, 0.45, 0.3), turn=0.5)
    make.box((4.6, 3.3, 0.001), (5.7, 4.4, 0.9), (0.25, 0.35, 0.3), turn=-0.1)
    make.lamp("POINT", (2.2, 2.6, 1.9), 60, shadow_soft_size=0.05)
    make.lamp("POINT", (5.0, 2.0, 0.8), 40, shadow_soft_size=0.05)


BUILT: dict[str, Callable[[], None]] = {
    "office": office,
    "corridor": corridor,
    "open_floor": open_floor,
    "attic": attic,
}
"""Not among the samples, and not looked at while the estimate was made."""

NAMES = (*scenes.NAMES, "glass", *BUILT, "atrium")
