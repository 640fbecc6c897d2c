"""Build the sample scenes: python sample_blends/build.py [cornell] [pillars] [two_rooms] [stairs] [atrium] [glass].

Build them with bpy 4.5, so that every supported Blender reads them.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import bpy
import lightpanes
import numpy as np
from atrium import atrium
from kit import Shape, animate, camera, diffuse, lamp, principled, save, start
from mathutils import Matrix, Vector
from tabletop import glass

HERE = Path(__file__).resolve().parent


def cornell() -> None:
    """A room of 3 m, open in front, with a monkey and a block; a point lamp tours it."""
    start(exposure=0.6)
    white = diffuse("White", (0.75, 0.73, 0.70))
    red = diffuse("Red", (0.63, 0.06, 0.045))
    green = diffuse("Green", (0.12, 0.42, 0.08))
    block = diffuse("Block", (0.70, 0.68, 0.64))
    fur = principled("Fur", (0.62, 0.36, 0.16), roughness=0.6)

    room = Shape()
    room.box((-1.5, -1.5, 0), (1.5, 1.5, 3), inward=True, skip="-x +x -y")
    room.build("Room", white)
    for name, x, material in (("Red Wall", -1.5, red), ("Green Wall", 1.5, green)):
        wall = Shape()
        if x < 0:
            wall.wall((x, -1.5, 0), (0, 3, 0), (0, 0, 3))
        else:
            wall.wall((x, 1.5, 0), (0, -3, 0), (0, 0, 3))
        wall.build(name, material)

    tall = Shape()
    tall.box((-0.42, -0.42, 0), (0.42, 0.42, 1.7), skip="-z")
    tall.build("Block", block, place=Matrix.Translation((-0.55, 0.6, 0)) @ Matrix.Rotation(math.radians(18), 4, "Z"))

    bpy.ops.mesh.primitive_monkey_add()
    monkey = bpy.context.object
    monkey.name = monkey.data.name = "Monkey"
    monkey.data.materials.append(fur)
    monkey.data.polygons.foreach_set("use_smooth", [True] * len(monkey.data.polygons))
    subdivision = monkey.modifiers.new("Subdivision", "SUBSURF")
    subdivision.levels = subdivision.render_levels = 2
    monkey.scale = (0.62, 0.62, 0.62)
    monkey.rotation_euler = (math.radians(-35), 0, math.radians(-20))
    monkey.location = (0.6, -0.45, 1.0)
    _rest(monkey, 0.0)

    bulb = lamp("Lamp", "POINT", (0, -0.3, 2.55), 80, (1.0, 0.88, 0.72), shadow_soft_size=0.04)
    animate(
        bulb,
        {
            1: (0.0, -0.3, 2.55),
            20: (-1.15, -0.55, 2.0),
            35: (-1.2, -0.75, 0.25),
            50: (-0.3, -1.0, 0.6),
            62: (1.2, -1.15, 1.3),
            74: (1.3, 0.85, 1.3),
            84: (0.75, 0.95, 0.45),
            92: (0.6, 0.7, 1.9),
            100: (0.0, -0.3, 2.55),
        },
    )
    camera((0, -8.0, 1.5), (0, 0, 1.5), lens=73, size=(800, 760))


def _rest(obj: bpy.types.Object, height: float, gap: float = 0.002) -> None:
    """Lower the object until its lowest point is a gap above that height."""
    bpy.context.view_layer.update()
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    lowest = min((evaluated.matrix_world @ v.co).z for v in evaluated.data.vertices)
    obj.location.z += height + gap - lowest


def pillars() -> None:
    """A vaulted marble chamber of 5 by 8 m and some 3,300 triangles, like the paper's."""
    start(exposure=0.5)
    marble = diffuse("Marble", (0.78, 0.74, 0.67))
    plaster = diffuse("Plaster", (0.72, 0.62, 0.48))
    light_tile = diffuse("Light Tile", (0.66, 0.60, 0.52))
    dark_tile = diffuse("Dark Tile", (0.21, 0.10, 0.065))
    green_marble = principled("Green Marble", (0.10, 0.24, 0.17), roughness=0.5)
    bronze = diffuse("Bronze", (0.36, 0.20, 0.085))

    floor = Shape()
    for i in range(10):
        for j in range(16):
            x, y = -2.5 + 0.5 * i, -4 + 0.5 * j
            floor.face([(x, y, 0), (x + 0.5, y, 0), (x + 0.5, y + 0.5, 0), (x, y + 0.5, 0)], (i + j) % 2)
    floor.build("Floor", light_tile, dark_tile)

    walls = Shape()
    walls.wall((-2.5, -4, 0), (0, 8, 0), (0, 0, 3.2))
    walls.wall((2.5, 4, 0), (0, -8, 0), (0, 0, 3.2))
    arc = [(2.5 * math.cos(math.pi * k / 16), 3.2 + 2.0 * math.sin(math.pi * k / 16)) for k in range(17)]
    walls.face([(-2.5, 4, 0), (2.5, 4, 0), *((x, 4, z) for x, z in arc)])
    walls.face([(2.5, -4, 0), (-2.5, -4, 0), *((x, -4, z) for x, z in reversed(arc))])
    walls.build("Walls", plaster)
    vault = Shape()
    vault.points = [Vector((x, y, z)) for y in (-4, 4) for x, z in arc]
    vault.faces = [(k, k + 1, k + 18, k + 17) for k in range(16)]
    vault.slots = [0] * 16
    vault.build("Vault", marble, smooth=True)

    profile = [(0.25, 0.32), (0.27, 0.36), (0.25, 0.41), (0.205, 0.44), (0.2, 1.2), (0.19, 1.9), (0.17, 2.6)]
    profile += [(0.2, 2.63), (0.2, 2.67), (0.175, 2.70), (0.26, 2.82)]
    for k, (x, y) in enumerate((x, y) for y in (-2.0, 0.25, 2.5) for x in (-1.55, 1.55)):
        column = Shape()
        column.lathe(profile, 16, (x, y, 0))
        column.build(f"Column {k + 1}", marble, smooth=True)
    plinths = Shape()
    for y in (-2.0, 0.25, 2.5):
        for x in (-1.55, 1.55):
            plinths.box((x - 0.3, y - 0.3, 0), (x + 0.3, y + 0.3, 0.32), skip="-z")
            plinths.box((x - 0.28, y - 0.28, 2.82), (x + 0.28, y + 0.28, 2.94), skip="+z")
    plinths.build("Plinths", green_marble)
    beams = Shape()
    for x in (-1.55, 1.55):
        beams.box((x - 0.22, -4, 2.94), (x + 0.22, 4, 3.2), skip="-y +y")
    beams.build("Beams", marble)

    steps = Shape()
    side = [(4.0, 0.0), (4.0, 0.42), (2.8, 0.42), (2.8, 0.28), (2.5, 0.28), (2.5, 0.14), (2.2, 0.14), (2.2, 0.0)]
    steps.prism(side, -1.15, 1.15, skip=(0, 7))
    steps.build("Steps", light_tile)
    pedestal = Shape()
    pedestal.box((-0.28, 3.02, 0.42), (0.28, 3.58, 1.05), skip="-z")
    pedestal.build("Pedestal", green_marble)
    vase = Shape()
    turned = [(0.15, 1.05), (0.12, 1.1), (0.2, 1.22), (0.3, 1.45), (0.31, 1.6), (0.22, 1.78)]
    turned += [(0.12, 1.88), (0.17, 1.97)]
    vase.lathe(turned, 32, (0, 3.3, 0))
    vase.build("Vase", bronze, smooth=True)

    for name, x, y0, y1 in (("Left Screen", -1.55, -1.65, -0.1), ("Right Screen", 1.55, 0.6, 2.15)):
        screen = Shape()
        for k in range(21):
            y = y0 + (y1 - y0) * k / 20
            screen.box((x - 0.006, y - 0.02, 0.26), (x + 0.006, y + 0.02, 1.6), skip="-z +z")
        for z in (0.0, 0.22, 1.6):
            screen.box((x - 0.02, y0 - 0.03, z), (x + 0.02, y1 + 0.03, z + 0.04), skip="" if z else "-z")
        screen.build(name, bronze)

    lamp(
        "Spot",
        "SPOT",
        (0, -0.6, 4.7),
        420,
        (0.80, 0.88, 1.0),
        aim=(0, 3.2, 0.9),
        spot_size=math.radians(48),
        spot_blend=0.35,
        shadow_soft_size=0.06,
    )
    torch = lamp("Torch", "POINT", (0, 0, 1.5), 85, (1.0, 0.68, 0.38), shadow_soft_size=0.05)
    animate(
        torch,
        {
            1: (-2.1, -0.9, 1.3),
            20: (-2.15, 1.2, 0.4),
            35: (-0.75, 1.6, 1.1),
            50: (0.65, 1.3, 1.9),
            62: (2.1, 1.35, 1.5),
            75: (2.15, -0.8, 0.25),
            88: (0.3, -1.2, 2.6),
            100: (-2.1, -0.9, 1.3),
        },
    )
    camera((0.4, -3.85, 1.6), (-0.08, 1.5, 1.85), lens=20)


def two_rooms() -> None:
    """Two rooms with 2 cm of wall between them: sun and sky in one, a lamp in the other."""
    start(sky=(0.42, 0.66, 1.0), strength=2.2, exposure=0.6)
    wall_paint = diffuse("Wall Paint", (0.76, 0.72, 0.65))
    blue_paint = diffuse("Blue Paint", (0.28, 0.42, 0.55))
    ceiling_paint = diffuse("Ceiling Paint", (0.82, 0.81, 0.79))
    frame_paint = diffuse("Frame Paint", (0.80, 0.79, 0.76))
    wood = principled("Wood", (0.33, 0.17, 0.075), roughness=0.55)
    cloth = diffuse("Cloth", (0.60, 0.17, 0.09))
    cushion = diffuse("Cushion", (0.72, 0.55, 0.18))
    glaze = diffuse("Glaze", (0.70, 0.66, 0.58))
    leaves = diffuse("Leaves", (0.10, 0.28, 0.07))

    left, right, front, back, top = -4.0, 3.2, -1.9, 1.9, 2.6
    window = (1.0, 2.9, 0.85, 2.15)
    floor = Shape()
    floor.face([(left, front, 0), (right, front, 0), (right, back, 0), (left, back, 0)])
    floor_object = floor.build("Floor", _planks())
    layer = floor_object.data.uv_layers.new(name="UVMap")
    for corner, point in zip(layer.data, floor.points, strict=True):
        corner.uv = (point.x / 1.6, point.y / 1.6)

    shell = Shape()
    shell.face([(left, back, top), (0, back, top), (0, front, top), (left, front, top)], 1)
    shell.wall((left, front, 0), (0, back - front, 0), (0, 0, top))
    shell.wall((0, front, 0), (left, 0, 0), (0, 0, top))
    shell.wall((left, back, 0), (-left, 0, 0), (0, 0, top), [window])
    shell.build("Sunny Room", wall_paint, ceiling_paint)
    shell = Shape()
    shell.face([(0, back, top), (right, back, top), (right, front, top), (0, front, top)], 1)
    shell.wall((right, back, 0), (0, front - back, 0), (0, 0, top))
    shell.wall((right, front, 0), (-right, 0, 0), (0, 0, top))
    shell.wall((0, back, 0), (right, 0, 0), (0, 0, top))
    shell.build("Blue Room", blue_paint, ceiling_paint)

    door0, door1, door_top = 0.15, 1.1, 2.05
    partition = Shape()
    partition.wall(
        (0.01, front, 0), (0, back - front, 0), (0, 0, top), [(door0 - front, door1 - front, 0, door_top)], 1
    )
    partition.wall((-0.01, back, 0), (0, front - back, 0), (0, 0, top), [(back - door1, back - door0, 0, door_top)], 0)
    partition.box((-0.01, door0, 0), (0.01, door1, door_top), inward=True, skip="-x +x -z", slot=2)
    partition.build("Thin Wall", wall_paint, blue_paint, frame_paint)

    x0, x1, z0, z1 = left + window[0], left + window[1], window[2], window[3]
    frame = Shape()
    frame.box((x0, back, z0), (x1, back + 0.18, z1), inward=True, skip="-y +y")
    middle = (x0 + x1) / 2
    frame.box((middle - 0.025, back + 0.09, z0), (middle + 0.025, back + 0.13, z1), skip="-z +z")
    frame.box((x0 - 0.06, back - 0.16, z0 - 0.05), (x1 + 0.06, back, z0 - 0.01), skip="+y")
    frame.build("Window", frame_paint)

    table = Shape()
    table.box((-2.95, -0.75, 0.70), (-1.55, 0.05, 0.74))
    for x in (-2.85, -1.71):
        for y in (-0.67, -0.09):
            table.box((x, y, 0), (x + 0.06, y + 0.06, 0.7), skip="-z +z")
    table.build("Table", wood)
    bowl = Shape()
    bowl.lathe(
        [(0.07, 0.74), (0.16, 0.80), (0.2, 0.88), (0.19, 0.88), (0.14, 0.81), (0.0, 0.77)],
        24,
        (-2.4, -0.35, 0),
    )
    bowl.build("Bowl", glaze, smooth=True)
    plant = Shape()
    plant.lathe([(0.15, 0.0), (0.2, 0.36), (0.18, 0.36), (0.0, 0.32)], 20, (-0.42, -1.2, 0), 0)
    for k in range(11):
        turn = (
            Matrix.Translation((-0.42, -1.2, 0.32))
            @ Matrix.Rotation(2.4 * k, 4, "Z")
            @ Matrix.Rotation(0.25 + 0.04 * k, 4, "X")
        )
        blade = [(0, 0, 0), (0.055, 0.02, 0.3), (0.0, 0.1, 0.78), (-0.055, 0.02, 0.3)]
        plant.face([turn @ Vector(p) for p in (blade[0], blade[1], blade[3])], 1)
        plant.face([turn @ Vector(p) for p in (blade[1], blade[2], blade[3])], 1)
    plant.build("Plant", glaze, leaves)

    sofa = Shape()
    side = [(0.85, 0.0), (1.7, 0.0), (1.7, 0.86), (1.45, 0.86), (1.45, 0.42), (0.85, 0.42)]
    sofa.prism(side, 0.95, 2.75, skip=(0,))
    for x in (0.72, 2.7):
        sofa.box((x, 0.82, 0), (x + 0.28, 1.68, 0.6), skip="-z")
    sofa.build("Sofa", cloth)
    pillow = Shape()
    tilt = (
        Matrix.Translation((1.3, 1.28, 0.66))
        @ Matrix.Rotation(math.radians(-18), 4, "X")
        @ Matrix.Rotation(math.radians(8), 4, "Y")
    )
    pillow.box((-0.21, -0.05, -0.21), (0.21, 0.05, 0.21), place=tilt)
    pillow.build("Pillow", cushion)
    rug = Shape()
    rug.box((0.8, -1.1, 0), (2.7, 0.45, 0.012), skip="-z")
    rug.build("Rug", cushion)
    stool = Shape()
    stool.lathe(
        [(0.14, 0.012), (0.05, 0.05), (0.045, 0.34), (0.24, 0.37), (0.25, 0.41), (0.0, 0.415)],
        24,
        (1.75, -0.3, 0),
    )
    stool.build("Stool", wood, smooth=True)
    picture = Shape()
    picture.box((1.25, back - 0.03, 1.25), (2.45, back, 1.95), skip="+y")
    picture.build("Picture", frame_paint)

    lamp("Sun", "SUN", (-4.3, 10.5, 6.2), 30.0, (1.0, 0.84, 0.62), aim=(-1.4, -0.5, 0.0), angle=math.radians(0.6))
    bulb = lamp("Lamp", "POINT", (1.9, -0.2, 2.1), 30, (1.0, 0.74, 0.46), shadow_soft_size=0.05)
    animate(
        bulb,
        {
            1: (1.8, -0.2, 2.05),
            25: (2.75, 0.4, 1.3),
            45: (2.2, -1.3, 0.35),
            65: (0.45, -0.9, 0.9),
            85: (0.3, 0.7, 1.6),
            100: (1.8, -0.2, 2.05),
        },
    )
    camera((-1.5, -8.6, 1.3), (-1.5, 0, 1.3), lens=33.8, clip_start=6.72, shift=(0.153, 0), size=(1200, 460))


def _planks() -> bpy.types.Material:
    """Oak boards from a small packed image."""
    rng = np.random.default_rng(7)
    size, boards = 128, 8
    pixels = np.ones((size, size, 4), np.float32)
    height = size // boards
    along = np.arange(size) / size
    for board in range(boards):
        rows = slice(board * height, (board + 1) * height)
        shift, tone = rng.uniform(size=2)
        grain = 0.06 * np.sin(
            math.tau * (3 * np.arange(height)[:, None] / height + 0.7 * np.sin(math.tau * (along + shift)) + shift)
        )
        value = 0.78 + 0.3 * tone + grain + rng.normal(0, 0.025, (height, size))
        joint = int(shift * size)
        value[:, joint : joint + 2] = 0.35
        value[:1] = 0.35
        pixels[rows, :, :3] = value[..., None] * np.array([0.52, 0.36, 0.22])
    image = bpy.data.images.new("Planks", size, size)
    image.pixels.foreach_set(np.clip(pixels, 0, 1).ravel())
    image.pack()
    material = diffuse("Planks", (0.27, 0.13, 0.05))
    tree = material.node_tree
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = image
    texture.location = (-320, 0)
    tree.links.new(texture.outputs["Color"], tree.nodes["Diffuse BSDF"].inputs["Color"])
    return material


def stairs() -> None:
    """Stairs that agree on no direction as up, after Escher's Relativity, in a room of 6 m."""
    start(exposure=0.4)
    paper = diffuse("Paper", (0.74, 0.70, 0.62))
    ochre = diffuse("Ochre", (0.66, 0.42, 0.17))
    blue = diffuse("Blue", (0.20, 0.33, 0.48))
    stone = diffuse("Stone", (0.62, 0.59, 0.54))
    rust = diffuse("Rust", (0.52, 0.15, 0.08))
    peg = principled("Peg", (0.72, 0.62, 0.40), roughness=0.6)

    room = Shape()
    room.box((-3, -3, 0), (3, 3, 6), inward=True, skip="-x +x")
    room.build("Room", paper)
    sides = Shape()
    sides.wall((-3, -3, 0), (0, 6, 0), (0, 0, 6), slot=0)
    sides.wall((3, 3, 0), (0, -6, 0), (0, 0, 6), slot=1)
    sides.build("Side Walls", ochre, blue)

    # four ways up: from the floor, the blue wall, the ceiling and the ochre wall
    upright = Matrix()
    sideways = Matrix.Translation((3, 0, 3)) @ Matrix.Rotation(math.radians(-90), 4, "Y")
    inverted = Matrix.Translation((0, 0, 6)) @ Matrix.Rotation(math.pi, 4, "Y")
    outward = Matrix.Translation((-3, 0, 3)) @ Matrix.Rotation(math.radians(90), 4, "Y")
    turn = Matrix.Rotation(math.radians(-90), 4, "Z")

    _flight("Flight Left", stone, 10, 0.27, 0.19, 1.1, upright @ Matrix.Translation((-2.25, -1.9, 0)))
    _slab("Landing", stone, upright, (-3, 0.8, 1.74), (-0.2, 2.6, 1.9), "-x")
    _flight("Flight Back", stone, 8, 0.27, 0.19, 1.0, upright @ Matrix.Translation((-0.2, 2.0, 1.9)) @ turn, hangs=True)

    _slab("Back Landing", stone, upright, (1.96, 1.4, 3.26), (3, 2.6, 3.42), "+x")

    _flight("Flight Side", stone, 9, 0.27, 0.19, 1.0, sideways @ Matrix.Translation((-2.1, -2.2, 0)))
    _slab("Side Landing", stone, sideways, (-2.7, 0.23, 1.55), (-0.9, 1.3, 1.71))
    _flight("Flight Ceiling", stone, 8, 0.27, 0.19, 1.1, inverted @ Matrix.Translation((-1.7, -1.6, 0)))
    _slab("Ceiling Landing", stone, inverted, (-2.6, 0.56, 1.36), (-0.8, 2.4, 1.52))
    _flight("Flight Ochre", stone, 7, 0.27, 0.19, 1.0, outward @ Matrix.Translation((-1.7, -1.4, 0)))
    _slab("Ochre Landing", stone, outward, (-2.4, 0.49, 1.17), (-0.9, 1.9, 1.33))

    doors = Shape()
    for frame, x, y, z in ((upright, -1.0, 2.45, 1.9), (sideways, -2.0, 1.1, 1.71), (outward, -1.65, 1.7, 1.33)):
        _arch(doors, frame @ Matrix.Translation((x, y, z)))
    doors.build("Arches", rust)

    walkers = (
        (upright, -2.3, -1.25, 0.57),
        (upright, -1.2, 1.5, 1.9),
        (sideways, -2.0, 0.75, 1.71),
        (inverted, -1.7, -0.12, 1.14),
        (upright, 0.9, -1.0, 0.0),
        (outward, -1.7, -0.18, 0.95),
    )
    for k, (frame, x, y, z) in enumerate(walkers):
        walker = Shape()
        outline = [(0.15, 0.0), (0.155, 0.05), (0.09, 0.2), (0.06, 0.46), (0.09, 0.5), (0.05, 0.52)]
        outline += [(0.095, 0.58), (0.1, 0.63), (0.07, 0.7), (0.0, 0.73)]
        walker.lathe(outline, 20)
        walker.build(
            f"Walker {k + 1}", peg if k % 2 else rust, smooth=True, place=frame @ Matrix.Translation((x, y, z))
        )

    panel = lamp(
        "Panel", "AREA", (0, 0, 4), 260, (1.0, 0.90, 0.76), aim=(0, 0, 0), shape="RECTANGLE", size=1.2, size_y=0.7
    )
    animate(
        panel,
        {
            1: (0.5, -2.4, 5.2),
            30: (-1.9, -2.3, 4.2),
            55: (-0.9, -1.9, 0.9),
            80: (1.2, -2.4, 2.4),
            100: (0.5, -2.4, 5.2),
        },
        {1: (-0.6, 1.0, 1.6), 30: (0.6, 1.2, 2.2), 55: (0.3, 1.5, 4.0), 80: (-1.2, 1.5, 3.4), 100: (-0.6, 1.0, 1.6)},
    )
    camera((0, -11.4, 3), (0, 0, 3), lens=48.5, clip_start=8.42, size=(800, 780))


def _slab(name, material, frame, low, high, skip=""):
    shape = Shape()
    shape.box(low, high, skip=skip, place=frame)
    shape.build(name, material)


def _arch(shape, frame):
    """A door frame with a round head, 0.9 m wide, its foot in the middle of the frame's floor."""
    head = [(math.cos(math.pi * k / 10), math.sin(math.pi * k / 10)) for k in range(11)]
    outer = [(0.45, 0.0), *((0.45 * y, 1.25 + 0.45 * z) for y, z in head), (-0.45, 0.0)]
    inner = [(0.35, 0.0), *((0.35 * y, 1.25 + 0.35 * z) for y, z in head), (-0.35, 0.0)]
    outline = [*outer, *reversed(inner)]
    feet = (len(outer) - 1, len(outline) - 1)
    shape.prism(outline, -0.06, 0.06, skip=feet, place=frame @ Matrix.Rotation(math.radians(90), 4, "Z"))


def _flight(name, material, count, run, rise, width, place, thickness=0.16, hangs=False):
    """Steps that climb along the local +y from the origin, centred on x, with a sloping underside.

    They end at a landing, so that end is open; so is the foot of the first step, unless it hangs in the air.
    """
    top = []
    for k in range(count):
        top += [(k * run, k * rise), (k * run, (k + 1) * rise)]
    top.append((count * run, count * rise))
    outline = [(run, 0.0), (count * run, count * rise - thickness), *reversed(top)]
    shape = Shape()
    shape.prism(outline, -width / 2, width / 2, skip=(1,) if hangs else (1, len(outline) - 1))
    return shape.build(name, material, place=place)


SAMPLES = {
    "cornell": cornell,
    "pillars": pillars,
    "two_rooms": two_rooms,
    "stairs": stairs,
    "atrium": atrium,
    "glass": glass,
}


def main(names: list[str]) -> None:
    unknown = set(names) - set(SAMPLES)
    if unknown:
        sys.exit(f"Unknown sample: {', '.join(sorted(unknown))}. There are {', '.join(SAMPLES)}.")
    # some samples have settings of its own
    lightpanes.register()
    for name in names or SAMPLES:
        SAMPLES[name]()
        path = HERE / f"{name}.blend"
        save(path)
        print(f"{path.name}: {path.stat().st_size / 1024:.0f} kB, {_triangles():,} triangles")


def _triangles() -> int:
    """How many triangles all modifiers make of the scene."""
    graph = bpy.context.evaluated_depsgraph_get()
    meshes = [obj.evaluated_get(graph).data for obj in bpy.context.scene.objects if obj.type == "MESH"]
    return sum(len(polygon.vertices) - 2 for mesh in meshes for polygon in mesh.polygons)


if __name__ == "__main__":
    main(sys.argv[1:])
