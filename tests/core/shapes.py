"""Small scenes made in code, and what tests do with them."""

from functools import cache

import numpy as np
from lightpanes.core.bake import Bake, Settings, bake
from lightpanes.core.panes import Relighter
from lightpanes.core.rays import Tracer
from lightpanes.core.scene import Light, Material, Scene, SceneObject


def globe(rings: int = 48, radius: float = 1.0, inward: bool = True, uv: bool = True):
    """Sphere: positions (V, 3), triangles (T, 3), atlas_uv (T, 3, 2)."""
    polar, around = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, 2 * rings + 1), indexing="ij"
    )
    points = radius * np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1)
    flat = np.stack([around / (2 * np.pi), polar / np.pi], -1) * 0.96 + 0.02
    index = np.arange(polar.size).reshape(polar.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    triangles = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    if inward:
        triangles = triangles[:, ::-1]
    return points.reshape(-1, 3), triangles, flat.reshape(-1, 2)[triangles]


def box(low, high, inward: bool = False):
    """Box: positions (8, 3), triangles (12, 3), atlas_uv (12, 3, 2) with the faces in a 3 × 2 grid."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    points = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    faces = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * 0.9 + 0.05
    cell = np.array([[k % 3, k // 3] for k in range(6)])
    flat = (corners[None] + cell[:, None]) / np.array([3, 2])
    triangles = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    uv = np.concatenate([flat[:, [0, 1, 2]], flat[:, [0, 2, 3]]])
    if inward:
        triangles, uv = triangles[:, ::-1], uv[:, ::-1]
    return points, triangles, uv


GREY = Material("Grey", (0.5, 0.5, 0.5))


def scene(*parts, materials=(GREY,), lights=(), names=None, **more) -> Scene:
    """Scene of (positions, triangles, atlas_uv, material) parts, each an object with its share of the atlas."""
    side = int(np.ceil(np.sqrt(len(parts))))
    points, triangles, uvs, material, owner, count = [], [], [], [], [], 0
    for k, (p, t, uv, m) in enumerate(parts):
        points.append(p)
        triangles.append(t + count)
        uvs.append((uv + np.array([k % side, k // side])) / side)
        material.append(np.full(len(t), m))
        owner.append(np.full(len(t), k))
        count += len(p)
    names = names or [f"Object {k}" for k in range(len(parts))]
    return Scene(
        np.concatenate(points),
        np.concatenate(triangles),
        atlas_uv=np.concatenate(uvs),
        triangle_material=np.concatenate(material),
        triangle_object=np.concatenate(owner),
        materials=materials,
        objects=[SceneObject(n) for n in names],
        lights=lights,
        **more,
    )


def lamp(place, power=100.0, kind="POINT", **more) -> Light:
    """A lamp at `place`, shining down."""
    matrix = np.eye(4)
    matrix[:3, 3] = place
    return Light("Lamp", kind, matrix, np.broadcast_to(power, 3), **more)


def quad(corner, along, across):
    """Parallelogram that faces along × across: positions (4, 3), triangles (2, 3), atlas_uv (2, 3, 2)."""
    corner, along, across = (np.asarray(v, float) for v in (corner, along, across))
    points = np.array([corner, corner + along, corner + along + across, corner + across])
    flat = np.array([[0.05, 0.05], [0.95, 0.05], [0.95, 0.95], [0.05, 0.95]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    return points, triangles, flat[triangles]


def grid(corner, along, across, cells):
    """Parallelogram of cells × cells quads, each vertex its own: as `quad`, for shapes with many triangles."""
    step = np.linspace(0, 1, cells + 1)
    u, v = np.meshgrid(step, step, indexing="ij")
    corner, along, across = (np.asarray(v, float) for v in (corner, along, across))
    points = corner + u[..., None] * along + v[..., None] * across
    index = np.arange(u.size).reshape(u.shape)
    a, b, c, d = (i.ravel() for i in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    flat = np.stack([u, v], -1).reshape(-1, 2) * 0.9 + 0.05
    return points.reshape(-1, 3), triangles, flat[triangles]


def room_parts(size=(4.0, 3.0, 2.5)):
    """A room, its faces inwards, with a block on the floor."""
    block = (np.array(size) * [0.25, 0.33, 0], np.array(size) * [0.45, 0.66, 0.4])
    return (*box((0, 0, 0), size, True), 0), (*box(*block), 1)


COLOURS = (Material("Walls", (0.7, 0.6, 0.5)), Material("Block", (0.3, 0.5, 0.8)))


def room(**more) -> Scene:
    """4 × 3 × 2.5 m, walls and a block of two colours."""
    return scene(*room_parts(), materials=COLOURS, names=["Room", "Block"], **more)


def quick(**more) -> Settings:
    """Budgets for a bake within a second."""
    given = {"resolution": 48, "entries": 500, "lamps": 200, "regions": 24, "entry_rays": 256, "exit_rays": 128}
    return Settings(**(given | more))


@cache
def baked_room() -> tuple[Scene, Bake]:
    """One bake of `room()` for all tests that only read it."""
    made = room(lights=[lamp((3, 1.5, 2))])
    return made, bake(made, quick())


def relighter(made: Scene, baked: Bake) -> Relighter:
    return Relighter(baked.panes(), Tracer(made))


def moved(made: Scene, turn=None, shift=(0, 0, 0)) -> Scene:
    """The scene with its vertices, shading normals and lamps turned (or scaled) by (3, 3) `turn`, then shifted.

    A mirroring turn leaves the triangles' winding as it is, as Blender's negative scale does before extraction.
    """
    turn = np.eye(3) if turn is None else np.asarray(turn, float)
    return Scene(
        made.positions.astype(float) @ turn.T + np.asarray(shift, float),
        made.triangles,
        atlas_uv=made.atlas_uv,
        triangle_material=made.triangle_material,
        triangle_object=made.triangle_object,
        materials=made.materials,
        objects=made.objects,
        lights=[lamp(turn @ light.position + shift, light.power) for light in made.lights],
    )


def bilinear(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(n, C) values of an (H, W, C) image at (n, 2) coordinates in [0, 1], as a renderer filters it."""
    height, width = image.shape[:2]
    x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    result = 0
    for dy in (0, 1):
        for dx in (0, 1):
            weight = np.abs(1 - dx - (x - column)) * np.abs(1 - dy - (y - row))
            texel = image[np.clip(row + dy, 0, height - 1), np.clip(column + dx, 0, width - 1)]
            result = result + weight[:, None] * texel
    return result
