"""The sample of caustics: glass and metal on a table of 2.4 by 2 m with walls about it, under a lamp and a spot."""

from __future__ import annotations

import math

import bpy
from kit import Shape, animate, camera, diffuse, lamp, principled, start
from mathutils import Matrix


def glass() -> None:
    """A glass sphere, a lens, a ring and a mirror cylinder; a point lamp circles above, a spot swings through the lens."""
    start(exposure=0.35)
    # Cycles shows caustics where nothing softens or cuts off light
    scene = bpy.context.scene
    scene.cycles.blur_glossy = 0.0
    scene.cycles.sample_clamp_indirect = 0.0
    linen = diffuse("Linen", (0.72, 0.69, 0.63))
    slate = diffuse("Slate", (0.33, 0.40, 0.45))
    clay = diffuse("Clay", (0.58, 0.30, 0.17))
    oak = diffuse("Oak", (0.30, 0.17, 0.08))

    table = Shape()
    table.face([(-1.2, -1, 0), (1.2, -1, 0), (1.2, 1, 0), (-1.2, 1, 0)])
    _large(table.build("Table", linen), 4.0)
    walls = Shape()
    walls.wall((-1.2, 1, 0), (2.4, 0, 0), (0, 0, 1.3))
    walls.build("Back Wall", slate)
    sides = Shape()
    sides.wall((-1.2, -1, 0), (0, 2, 0), (0, 0, 1.3), slot=0)
    sides.wall((1.2, 1, 0), (0, -2, 0), (0, 0, 1.3), slot=1)
    sides.build("Side Walls", clay, slate)
    walls = Shape()
    walls.face([(-1.2, 1, 1.3), (1.2, 1, 1.3), (1.2, -1, 1.3), (-1.2, -1, 1.3)])
    walls.build("Ceiling", linen)

    sphere = Shape()
    radius, rings = 0.2, 48
    turned = [
        (radius * math.sin(math.pi * k / rings), -radius * math.cos(math.pi * k / rings)) for k in range(rings + 1)
    ]
    turned[0], turned[-1] = (0.0, -radius), (0.0, radius)
    sphere.lathe(turned, 96)
    _dark(sphere.build("Sphere", _clear("Glass", (1.0, 1.0, 1.0), 1.5), smooth=True), (-0.62, -0.12, radius + 0.06))
    foot = Shape()
    foot.lathe([(0.11, 0.0), (0.11, 0.03), (0.07, 0.07), (0.07, 0.05), (0.0, 0.05)], 48, (-0.62, -0.12, 0))
    foot.build("Foot", oak)

    lens = Shape()
    lens.lathe(_biconvex(0.2, 0.055, 20), 96)
    _dark(
        lens.build("Lens", _clear("Amber Glass", (1.0, 0.90, 0.72), 1.52), smooth=True),
        (0.56, 0.12, 0.36),
        Matrix.Rotation(math.radians(90), 4, "Y") @ Matrix.Rotation(math.radians(25), 4, "X"),
    )
    stand = Shape()
    stand.box((0.53, -0.05, 0), (0.59, 0.29, 0.03), skip="-z")
    stand.box((0.55, 0.105, 0.03), (0.57, 0.135, 0.155), skip="-z")
    stand.build("Stand", oak)

    ring = Shape()
    inner, outer, height = 0.2, 0.22, 0.1
    ring.lathe([(inner, height), (inner, 0.001), (outer, 0.001), (outer, height), (inner, height)], 128)
    _dark(ring.build("Ring", _metal("Gold", (1.0, 0.72, 0.33)), smooth=True), (0.1, -0.52, 0))
    cylinder = Shape()
    cylinder.lathe([(0.13, 0.0), (0.13, 0.42), (0.0, 0.42)], 128)
    _dark(cylinder.build("Cylinder", _metal("Chrome", (0.92, 0.92, 0.93)), smooth=True), (-0.08, 0.42, 0.001))

    bulb = lamp("Lamp", "POINT", (-0.9, -0.5, 0.95), 26, (1.0, 0.93, 0.82), shadow_soft_size=0.02)
    animate(
        bulb,
        {
            1: (-0.85, -0.55, 0.95),
            20: (-0.35, -0.8, 1.05),
            40: (0.45, -0.75, 0.8),
            60: (0.7, -0.3, 0.95),
            80: (-0.2, 0.1, 1.1),
            100: (-0.85, -0.55, 0.95),
        },
    )
    spot = lamp(
        "Spot",
        "SPOT",
        (-0.2, 0.3, 1.1),
        30,
        (0.80, 0.90, 1.0),
        spot_size=math.radians(30),
        spot_blend=0.3,
        shadow_soft_size=0.01,
    )
    through = (0.56, 0.12, 0.36)
    path = {1: (-0.15, 0.30, 1.05), 34: (-0.25, -0.25, 0.85), 67: (0.15, 0.55, 1.15), 100: (-0.15, 0.30, 1.05)}
    animate(spot, path, {frame: through for frame in path})
    camera((0, -2.6, 1.5), (0.0, 0.02, 0.2), lens=45, size=(960, 600))


def _biconvex(radius: float, bulge: float, steps: int) -> list[tuple[float, float]]:
    """Profile of a lens of two equal caps, each `bulge` high: (radius, height), upwards."""
    curve = (radius**2 + bulge**2) / (2 * bulge)
    cap = []
    for k in range(steps + 1):
        r = radius * math.sin(0.5 * math.pi * k / steps)
        cap.append((r, math.sqrt(curve**2 - r**2) - (curve - bulge)))
    lower = [(r, -height) for r, height in cap[:-1]]
    return [*lower, (radius, 0.0), *reversed(cap[:-1])]


def _clear(name, colour, ior):
    """Smooth glass of that colour."""
    material = principled(name, colour, roughness=0.0)
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Transmission Weight"].default_value = 1.0
    shader.inputs["IOR"].default_value = ior
    return material


def _metal(name, colour):
    material = principled(name, colour, roughness=0.0)
    material.node_tree.nodes["Principled BSDF"].inputs["Metallic"].default_value = 1.0
    return material


def _dark(item, place, turn=None) -> None:
    """Put it there. It scatters no light, so it needs no place in the atlas."""
    item.matrix_world = Matrix.Translation(place) @ (turn or Matrix())
    item.lightpanes.exclude = True


def _large(item, weight) -> None:
    item.lightpanes.weight = weight
