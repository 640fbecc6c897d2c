"""The largest sample: an atrium in the manner of Sponza, two storeys of galleries about an open court.

Each of its four sides is built along x about the line of its columns, the court at -y, and then turned into
place. Opposite sides share their meshes. No modifier copies faces: copies would share their texels.
"""

from __future__ import annotations

import itertools
import math

import bmesh
import bpy
from kit import Shape, animate, camera, lamp, principled, start
from mathutils import Matrix, Vector

BAY = 2.4  # from column to column, and the depth of the galleries
FIRST, LAST = 0.22, BAY + 0.02  # where vaults end, inside the arcade and behind the outer wall
SPRING = 3.0
UPPER_SPRING = 7.15
FLOOR, CEILING = 4.6, 8.4
LONG, SHORT = 8, 3  # bays
WALL = 0.05  # by how much floors and ceilings run under the walls


def atrium() -> None:
    """A court of 24 by 12 m under the sun, with vaulted galleries and cloths; a lantern walks one of them."""
    start(sky=(0.45, 0.68, 1.0), strength=0.5, exposure=0.9)
    paint = _paints()
    half_x, half_y = LONG * BAY / 2, SHORT * BAY / 2
    sides = (
        (LONG, half_y, {"North": 0, "South": 180}),
        (SHORT, half_x, {"East": -90, "West": 90}),
    )
    for bays, distance, turns in sides:
        places = {
            name: Matrix.Rotation(math.radians(turn), 4, "Z") @ Matrix.Translation((0, distance, 0))
            for name, turn in turns.items()
        }
        _lower_storey(bays, places, paint)
        _upper_storey(bays, places, paint)
        _columns(bays, places, paint)
        _blocks(bays, places, paint)
    _piers(half_x, half_y, paint)
    _floors(half_x, half_y, paint)
    _ceilings(half_x, half_y, paint)
    _props(half_y, paint)
    _lamps()
    camera((-8.5, -1.9, 1.75), (4.0, 0.9, 3.1), lens=19)


def _paints():
    colours = {
        "Stone": (0.62, 0.52, 0.39),
        "Column Stone": (0.70, 0.63, 0.52),
        "Plaster": (0.66, 0.48, 0.30),
        "Vault Plaster": (0.70, 0.64, 0.54),
        "Dark Tile": (0.13, 0.10, 0.085),
        "Light Tile": (0.34, 0.29, 0.24),
        "Terracotta": (0.30, 0.13, 0.075),
        "Wood": (0.20, 0.105, 0.05),
        "Red Cloth": (0.55, 0.035, 0.025),
        "Green Cloth": (0.06, 0.30, 0.06),
        "Blue Cloth": (0.035, 0.09, 0.42),
        "Glaze": (0.10, 0.26, 0.30),
        "Bronze": (0.30, 0.21, 0.10),
    }
    return {name: principled(name, colour, roughness=1.0, specular=0.0) for name, colour in colours.items()}


def _place(shape, name, places, *materials, smooth=True, bevel=0.0, subdivide=0):
    """Make the shape one mesh without double points, and an object of it at each of the places."""
    mesh = None
    for suffix, place in places.items():
        title = f"{name} {suffix}".strip()
        if mesh is None:
            obj = shape.build(title, *materials, smooth=smooth, place=place)
            mesh = obj.data
            mesh.name = name
            _weld(mesh, smooth)
        else:
            obj = bpy.data.objects.new(title, mesh)
            obj.matrix_world = place
            bpy.context.scene.collection.objects.link(obj)
        if bevel:
            modifier = obj.modifiers.new("Bevel", "BEVEL")
            modifier.width, modifier.limit_method = bevel, "ANGLE"
        if subdivide:
            modifier = obj.modifiers.new("Subdivision", "SUBSURF")
            modifier.levels = modifier.render_levels = subdivide


def _weld(mesh, smooth):
    """Join the faces, so that a wall is one chart of the atlas and a bevel finds its edges."""
    cells = bmesh.new()
    cells.from_mesh(mesh)
    bmesh.ops.remove_doubles(cells, verts=cells.verts, dist=1e-4)
    cells.to_mesh(mesh)
    cells.free()
    if smooth:
        mesh.set_sharp_from_angle(angle=math.radians(40))
    mesh.update()


def _arc(middle, radius, spring, segments):
    """Points (x, z) of a semicircle from left to right."""
    angles = [math.pi * (1 - k / segments) for k in range(segments + 1)]
    return [(middle + radius * math.cos(a), spring + radius * math.sin(a)) for a in angles]


def _sheet(shape, y, below, above, slot=0, back=False):
    """Faces in the plane y between two rows of (x, z), listed to the right; seen from -y, or else from the back."""
    for (a, b), (c, d) in zip(itertools.pairwise(below), itertools.pairwise(above), strict=True):
        ring = [(p[0], y, p[1]) for p in (a, b, d, c)]
        shape.face(ring[::-1] if back else ring, slot)


def _soffit(shape, row, y0, y1, slot=0, above=False):
    """The underside of a row of (x, z) from y0 to y1, or else its upper side."""
    for (xa, za), (xb, zb) in itertools.pairwise(row):
        ring = [(xa, y0, za), (xa, y1, za), (xb, y1, zb), (xb, y0, zb)]
        shape.face(ring[::-1] if above else ring, slot)


def _arcade(shape, middles, half, radius, spring, tops, thickness, trim, segments):
    """A wall on arches: trim (width, depth) runs about each arch in front; tops: heights of front and back.

    It has no face between the arches' feet, where it stands on its columns.
    """
    front, back = -thickness / 2, thickness / 2
    width, depth = trim
    for middle in middles:
        inner = _arc(middle, radius, spring, segments)
        outer = _arc(middle, radius + width, spring, segments)
        left, right = (middle - half, spring), (middle + half, spring)
        row = [left, *outer, right]
        _sheet(shape, front, row, [(x, tops[0]) for x, _ in row])
        _sheet(shape, front - depth, inner, outer)
        _soffit(shape, outer, front - depth, front, above=True)
        _soffit(shape, inner, front - depth, back)
        row = [left, *inner, right]
        _sheet(shape, back, row, [(x, tops[1]) for x, _ in row], back=True)


def _moulding(shape, profile, half):
    """Sweep a profile of (y, z), listed up the court's side and down the back, from corner to corner, mitred."""
    for (y0, z0), (y1, z1) in itertools.pairwise(profile):
        ends = ((-half - y0, y0, z0), (half + y0, y0, z0), (half + y1, y1, z1), (-half - y1, y1, z1))
        shape.face(ends)


def _lower_storey(bays, places, paint):
    half = bays * BAY / 2
    middles = [BAY * (k + 0.5) - half for k in range(bays)]
    arcade = Shape()
    _arcade(arcade, middles, BAY / 2, 0.92, SPRING, (4.5, 4.58), 0.5, (0.16, 0.04), 24)
    _place(arcade, "Arcade", places, paint["Stone"])

    vault = Shape()
    for middle in middles:
        _groin(vault, middle - BAY / 2, middle + BAY / 2)
    if bays == LONG:
        _groin(vault, -half - LAST, -half)
        _groin(vault, half, half + LAST)
    for k in range(bays + 1):
        _rib(vault, BAY * k - half, 0.28 if k in (0, bays) else 0.15)
    _place(vault, "Vault", places, paint["Vault Plaster"])

    kinds = "n.dn.nd.n." if bays == LONG else "n.d.n"
    wall = Shape()
    _outer_wall(wall, half, kinds, (0.0, 1.0, 2.0, 4.45), 0.45)
    _place(wall, "Outer Wall", places, paint["Plaster"], paint["Wood"])


def _groin(shape, x0, x1, segments=14):
    """A vault over a bay: two elliptic barrels that meet along the diagonals."""
    steps = [(1 - math.cos(math.pi * k / segments)) / 2 for k in range(segments + 1)]
    rise = [math.sin(math.pi * k / segments) for k in range(segments + 1)]

    def point(i, j):
        height = SPRING + 1.15 * max(rise[i], rise[j])
        return (x0 + (x1 - x0) * steps[i], FIRST + (LAST - FIRST) * steps[j], height)

    for i in range(segments):
        for j in range(segments):
            # counter-clockwise seen from below; the groins must be edges
            ring = [point(i, j), point(i, j + 1), point(i + 1, j + 1), point(i + 1, j)]
            if i == j:
                shape.face([ring[0], ring[1], ring[2]])
                shape.face([ring[0], ring[2], ring[3]])
            elif i + j == segments - 1:
                shape.face([ring[0], ring[1], ring[3]])
                shape.face([ring[1], ring[2], ring[3]])
            else:
                shape.face(ring)


def _rib(shape, x, half, segments=16):
    """An arch across the gallery between two bays, its top just above the vaults."""
    turn = Matrix.Translation((x, 0, 0)) @ Matrix.Rotation(math.radians(90), 4, "Z")
    arc = [(FIRST, SPRING), *_arc(1.28, 1.0, SPRING, segments), (LAST, SPRING)]
    top = [(y, SPRING + 1.2 * max(0.7, math.sqrt(max(0.0, 1 - ((y - 1.32) / 1.1) ** 2)))) for y, _ in arc]
    part = Shape()
    _sheet(part, -half, arc, top)
    _sheet(part, half, arc, top, back=True)
    _soffit(part, arc[1:-1], -half, half)
    for face in part.faces:
        shape.face([turn @ part.points[k] for k in face])


def _outer_wall(shape, half, kinds, levels, depth):
    """The wall behind a gallery, bay by bay: n a niche, d a door, or plain; levels: foot, sill, spring, top."""
    foot, sill, spring, top = levels
    radius = 0.55
    for k, kind in enumerate(kinds):
        left, right = BAY * (k - 1) - half, BAY * k - half
        middle = (left + right) / 2
        if k == 0:
            left -= WALL
        if k == len(kinds) - 1:
            right += WALL
        if kind == ".":
            for z0, z1 in itertools.pairwise(levels):
                _sheet(shape, BAY, [(left, z0), (right, z0)], [(left, z1), (right, z1)])
            continue
        arc = _arc(middle, radius, spring, 16)
        for a, b in ((left, middle - radius), (middle + radius, right)):
            for z0, z1 in itertools.pairwise(levels[:3]):
                _sheet(shape, BAY, [(a, z0), (b, z0)], [(a, z1), (b, z1)])
        row = [(left, spring), *arc, (right, spring)]
        _sheet(shape, BAY, row, [(x, top) for x, _ in row])
        door = kind == "d"
        low = foot + 0.12 if door else sill
        _recess(shape, arc, low, spring, depth * (0.5 if door else 1.0), int(door))
        ends = (middle - radius, middle + radius)
        _sheet(shape, BAY, [(x, foot) for x in ends], [(x, low) for x in ends])


def _recess(shape, arc, low, spring, depth, slot):
    """A niche behind the arc, open in front; slot: of its back."""
    x0, x1, back = arc[0][0], arc[-1][0], BAY + depth
    shape.face([(x0, BAY, low), (x0, back, low), (x0, back, spring), (x0, BAY, spring)])
    shape.face([(x1, back, low), (x1, BAY, low), (x1, BAY, spring), (x1, back, spring)])
    _soffit(shape, arc, BAY, back)
    _sheet(shape, back, [(x, low) for x, _ in arc], arc, slot)
    shape.face([(x0, BAY, low), (x1, BAY, low), (x1, back, low), (x0, back, low)])


def _upper_storey(bays, places, paint):
    half = bays * BAY / 2
    middles = [BAY / 2 * (k + 0.5) - half for k in range(2 * bays)]
    arcade = Shape()
    _arcade(arcade, middles, BAY / 4, 0.47, UPPER_SPRING, (8.3, 8.45), 0.26, (0.09, 0.03), 16)
    profile = [(-0.12, 8.22), (-0.2, 8.25), (-0.23, 8.34), (-0.34, 8.42), (-0.4, 8.52), (-0.4, 8.62), (0.2, 8.7)]
    _moulding(arcade, profile, half)
    _place(arcade, "Upper Arcade", places, paint["Stone"])

    parapet = Shape()
    for y, low, back in ((-0.15, 4.7, False), (0.15, 4.58, True)):
        _sheet(parapet, y, [(-half, low), (half, low)], [(-half, 5.41), (half, 5.41)], back=back)
    ledge = [(-0.24, 4.4), (-0.3, 4.44), (-0.31, 4.5), (-0.38, 4.55), (-0.38, 4.66), (-0.35, 4.7), (-0.14, 4.74)]
    _moulding(parapet, ledge, half)
    coping = [(-0.14, 5.38), (-0.2, 5.41), (-0.2, 5.48), (-0.18, 5.5)]
    _moulding(parapet, [*coping, *((-y, z) for y, z in reversed(coping))], half)
    _place(parapet, "Parapet", places, paint["Stone"])

    kinds = ".n.d..d.n." if bays == LONG else ".ndn."
    wall = Shape()
    _outer_wall(wall, half, kinds, (FLOOR, 5.5, 6.6, 8.45), 0.3)
    _place(wall, "Upper Wall", places, paint["Plaster"], paint["Wood"])


def _columns(bays, places, paint):
    """Stout columns below and slim ones above, turned, their ends inside plinths and capitals."""
    half = bays * BAY / 2
    stout = [(0.325, 0.17), (0.325, 0.27), (0.285, 0.33), (0.275, 0.36), (0.29, 0.4), (0.25, 0.47), (0.25, 1.2)]
    stout += [(0.235, 2.0), (0.215, 2.46), (0.24, 2.5), (0.24, 2.53), (0.215, 2.57), (0.23, 2.66), (0.285, 2.76)]
    stout += [(0.29, 2.83)]
    slim = [(0.14, 5.47), (0.14, 5.54), (0.11, 5.59), (0.115, 5.62), (0.09, 5.67), (0.088, 6.2), (0.078, 6.82)]
    slim += [(0.085, 6.88), (0.125, 6.97), (0.125, 7.05)]
    columns = Shape()
    for k in range(1, bays):
        columns.lathe(stout, 16, (BAY * k - half, 0, 0))
    for k in range(1, 2 * bays):
        columns.lathe(slim, 8, (BAY / 2 * k - half, 0, 0))
    _place(columns, "Columns", places, paint["Column Stone"], subdivide=1)


def _blocks(bays, places, paint):
    """The square stones above and below the columns, and pilasters that carry the vaults at the wall."""
    half = bays * BAY / 2
    blocks = Shape()

    def block(x, reach, low, high, skip=""):
        blocks.box((x - reach, -reach, low), (x + reach, reach, high), skip=skip)

    for k in range(1, bays):
        x = BAY * k - half
        block(x, 0.36, 0.0, 0.2, "-z")
        block(x, 0.31, 2.8, SPRING + 0.02)
    for k in range(1, 2 * bays):
        x = BAY / 2 * k - half
        block(x, 0.145, 7.0, UPPER_SPRING + 0.02, "+z")
    for k in range(bays + 1):
        x, reach = BAY * k - half, 0.32 if k in (0, bays) else 0.22
        blocks.box((x - reach, BAY - 0.15, 0), (x + reach, LAST, SPRING + 0.02), skip="-z +y")
        for low, high in ((0.0, 0.3), (2.8, SPRING - 0.02)):
            blocks.box(
                (x - reach - 0.05, BAY - 0.2, low), (x + reach + 0.05, LAST, high), skip="+y" if low else "-z +y"
            )
    _place(blocks, "Blocks", places, paint["Column Stone"], smooth=False, bevel=0.015)


def _piers(half_x, half_y, paint):
    """The square piers in the court's corners, through both storeys."""
    piers = Shape()
    for x, y in itertools.product((-half_x, half_x), (-half_y, half_y)):
        stones = ((0.3, 0.0, 4.57), (0.37, 0.0, 0.35), (0.35, 2.8, 3.03), (0.24, 4.5, 8.43), (0.28, 6.99, 7.18))
        for reach, low, high in stones:
            skip = "-z" if low == 0.0 else ""
            piers.box((x - reach, y - reach, low), (x + reach, y + reach, high), skip=skip)
    _place(piers, "Piers", {"": Matrix()}, paint["Column Stone"], smooth=False, bevel=0.02)


def _floors(half_x, half_y, paint):
    columns, rows = 2 * LONG + 4, 2 * SHORT + 4
    step = BAY / 2
    floor = Shape()

    def edge(k, count):
        return (k - count / 2) * step + (-WALL if k == 0 else WALL if k == count else 0.0)

    for i, j in itertools.product(range(columns), range(rows)):
        x0, x1, y0, y1 = edge(i, columns), edge(i + 1, columns), edge(j, rows), edge(j + 1, rows)
        inside = 2 <= i < columns - 2 and 2 <= j < rows - 2
        slot = (i + j) % 2 if inside else 2
        floor.face([(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)], slot)
    _place(floor, "Floor", {"": Matrix()}, paint["Dark Tile"], paint["Light Tile"], paint["Terracotta"], smooth=False)
    upper = Shape()
    _ring(upper, FLOOR, half_x, half_y, 0.1)
    _place(upper, "Gallery Floor", {"": Matrix()}, paint["Terracotta"], smooth=False)


def _ring(shape, height, half_x, half_y, start, below=False):
    """What covers the galleries at that height, from `start` behind the columns' line to under the walls."""
    xs = (-half_x - BAY - WALL, -half_x - start, half_x + start, half_x + BAY + WALL)
    ys = (-half_y - BAY - WALL, -half_y - start, half_y + start, half_y + BAY + WALL)
    for (i, (x0, x1)), (j, (y0, y1)) in itertools.product(
        enumerate(itertools.pairwise(xs)), enumerate(itertools.pairwise(ys))
    ):
        if i == j == 1:
            continue
        ring = [(x0, y0, height), (x1, y0, height), (x1, y1, height), (x0, y1, height)]
        shape.face(ring[::-1] if below else ring)


def _ceilings(half_x, half_y, paint):
    ceiling = Shape()
    _ring(ceiling, CEILING, half_x, half_y, 0.0, below=True)
    _place(ceiling, "Ceiling", {"": Matrix()}, paint["Vault Plaster"], smooth=False)
    beams = Shape()
    low, high = CEILING - 0.2, CEILING + 0.02
    for sign in (-1, 1):
        for k in range(1, LONG):
            x = BAY * k - half_x
            y0, y1 = sorted((sign * (half_y + 0.1), sign * (half_y + LAST)))
            beams.box((x - 0.1, y0, low), (x + 0.1, y1, high), skip="+z -y +y")
        for k in range(1, SHORT):
            y = BAY * k - half_y
            x0, x1 = sorted((sign * (half_x + 0.1), sign * (half_x + LAST)))
            beams.box((x0, y - 0.1, low), (x1, y + 0.1, high), skip="+z -x +x")
    # rods of the curtains, from capital to capital
    for x, y in ((1.2, -half_y), (-6.0, half_y)):
        beams.box((x - 1.05, y - 0.02, 2.74), (x + 1.05, y + 0.02, 2.78), skip="-x +x")
    _place(beams, "Beams", {"": Matrix()}, paint["Wood"], smooth=False)


def _props(half_y, paint):
    hung = [(0.14, 5.515), (-0.06, 5.515), (-0.22, 5.515), (-0.35, 5.44), (-0.44, 5.2), (-0.47, 4.8), (-0.48, 4.4)]
    hung += [(-0.48, 4.0), (-0.48, 3.6), (-0.48, 3.2), (-0.48, 2.9)]
    north = Matrix.Translation((0, half_y, 0))
    south = Matrix.Rotation(math.pi, 4, "Z") @ north
    for name, frame, x in (("Red", north, 1.8), ("Green", south, 0.6), ("Blue", north, -3.0)):
        _cloth(f"{name} Banner", paint[f"{name} Cloth"], hung, 0.8, frame @ Matrix.Translation((x, 0, 0)))
    curtain = [(0.0, 2.75), (0.0, 2.6), (0.01, 2.3), (0.02, 1.9), (0.03, 1.5), (0.03, 1.1), (0.02, 0.7), (0.0, 0.3)]
    for name, frame, x in (("Red", south, -1.2), ("Green", north, -6.0)):
        _cloth(f"{name} Curtain", paint[f"{name} Cloth"], curtain, 1.3, frame @ Matrix.Translation((x, 0, 0)))

    vase = Shape()
    turned = [(0.26, 0.0), (0.28, 0.05), (0.2, 0.12), (0.17, 0.2), (0.34, 0.45), (0.42, 0.75), (0.38, 1.0)]
    turned += [(0.22, 1.18), (0.2, 1.28), (0.3, 1.4), (0.28, 1.41), (0.17, 1.28), (0.19, 1.16), (0.3, 0.9), (0.0, 0.8)]
    vase.lathe(turned, 16)
    spots = {"Left": Matrix.Translation((-3.6, 2.1, 0)), "Right": Matrix.Translation((4.8, -2.1, 0))}
    _place(vase, "Vase", spots, paint["Glaze"], subdivide=1)

    plinth = Shape()
    for reach, low, high in ((0.75, 0.0, 0.25), (0.5, 0.23, 1.25), (0.6, 1.23, 1.4)):
        plinth.box((6.6 - reach, -reach, low), (6.6 + reach, reach, high), skip="" if low else "-z")
    _place(plinth, "Plinth", {"": Matrix()}, paint["Stone"], smooth=False, bevel=0.03)
    bpy.ops.mesh.primitive_monkey_add()
    statue = bpy.context.object
    statue.name = statue.data.name = "Statue"
    statue.data.materials.append(paint["Bronze"])
    statue.data.polygons.foreach_set("use_smooth", [True] * len(statue.data.polygons))
    modifier = statue.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels = modifier.render_levels = 1
    statue.scale = (0.75, 0.75, 0.75)
    statue.rotation_euler = (math.radians(-25), 0, math.radians(-90))
    statue.location = (6.6, 0.0, 1.4)
    bpy.context.view_layer.update()
    evaluated = statue.evaluated_get(bpy.context.evaluated_depsgraph_get())
    lowest = min((evaluated.matrix_world @ v.co).z for v in evaluated.data.vertices)
    statue.location.z += 1.4 + 0.002 - lowest


def _cloth(name, material, path, width, place, across=12):
    """A cloth 2 cm thick, both sides real, that falls along a path of (y, z) in folds."""
    points = [Vector((0, y, z)) for y, z in path]
    rows = []
    for k, point in enumerate(points):
        along = points[min(k + 1, len(points) - 1)] - points[max(k - 1, 0)]
        normal = along.normalized().cross(Vector((1, 0, 0)))
        fold = 0.055 * min(1.0, max(0.0, (path[0][1] - 0.05 - point.z) / 0.5))
        row = []
        for i in range(across + 1):
            u = i / across - 0.5
            centre = point + Vector((width * u, fold * math.sin(3 * math.tau * u), 0))
            row.append((centre - normal * 0.01, centre + normal * 0.01))
        rows.append(row)
    cloth = Shape()
    for above, below in itertools.pairwise(rows):
        for i in range(across):
            for side in (0, 1):
                ring = [above[i][side], below[i][side], below[i + 1][side], above[i + 1][side]]
                cloth.face(ring if side == 1 else ring[::-1])
        for i, sign in ((0, 1), (across, -1)):
            ring = [above[i][0], below[i][0], below[i][1], above[i][1]]
            cloth.face(ring[::sign])
    for row, sign in ((rows[0], 1), (rows[-1], -1)):
        for a, b in itertools.pairwise(row):
            cloth.face([a[0], a[1], b[1], b[0]][::sign])
    _place(cloth, name, {"": place}, material, subdivide=1)


def _lamps():
    lamp("Sun", "SUN", (-6.0, -5.0, 15.0), 6.0, (1.0, 0.90, 0.74), aim=(0.0, 0.0, 0.0), angle=math.radians(1.0))
    lantern = lamp("Lantern", "POINT", (0, 0, 2), 150, (1.0, 0.70, 0.40), shadow_soft_size=0.06)
    animate(
        lantern,
        {
            1: (-10.6, 4.8, 1.9),
            20: (-6.4, 4.9, 2.2),
            35: (-4.75, 4.06, 1.3),
            50: (-1.2, 4.9, 0.5),
            65: (2.3, 4.12, 2.3),
            80: (6.0, 5.2, 1.5),
            100: (10.8, 4.9, 2.0),
        },
    )
    panel = lamp(
        "Panel", "AREA", (0, 0, 2), 160, (0.72, 0.84, 1.0), aim=(0, 0, 0), shape="RECTANGLE", size=0.9, size_y=0.5
    )
    animate(
        panel,
        {1: (-7.2, -5.0, 2.9), 50: (1.2, -5.2, 2.4), 100: (8.0, -4.9, 2.9)},
        {1: (-5.2, -4.2, 0.0), 50: (0.6, -2.6, 0.3), 100: (6.4, -3.4, 0.0)},
    )
