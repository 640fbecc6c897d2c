"""A picture of the stored points through the scene's camera, so that a person sees where they are dense.

Each point is a small disc on its surface. The surfaces behind are dim; a side of a surface that holds no points (the
outside of a room that light does not reach) is not drawn and hides nothing, so that one sees into closed rooms.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ..core.point_cache.grid import DiscGrid
from ..core.rays import Bvh, chunks
from ..core.scene import Scene
from ..core.threads import in_threads
from . import colours, extract, points

LONGER = 1280
"""Width or height of the picture, whichever is longer, px."""

FINER = 2
"""Samples a pixel, each way."""

DISC = 0.3
"""Radius of a drawn disc over the point's own: discs of neighbours never touch."""

SMALLEST, LARGEST = 1.6, 14.0
"""Radius of a drawn disc, samples: fewer are not seen, more say nothing."""

LAYERS = 12
"""Unlit sides that a ray passes, at most."""

DIM = (0.05, 0.2)
"""Grey of surfaces, seen at a grazing angle and from straight above."""


@dataclass(frozen=True)
class View:
    """matrix: (4, 4) float64 from the world to clip space. width, height: samples."""

    matrix: np.ndarray
    width: int
    height: int

    def project(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where (n, 3) places lie, (n, 2) in samples, and whether in front of the camera and in view, (n,) bool."""
        clip = np.concatenate([places, np.ones((len(places), 1))], 1) @ self.matrix.T
        ahead = (np.abs(clip[:, :3]) <= clip[:, 3:]).all(axis=1)
        shown = clip[:, :2] / np.where(np.abs(clip[:, 3:]) > 1e-12, clip[:, 3:], 1e-12)
        return (shown + 1) / 2 * (self.width, self.height), ahead

    def rays(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins on the near plane and unit directions, (n, 3) float32, through (n, 2) places in samples."""
        back = np.linalg.inv(self.matrix)
        ends = []
        for depth in (-1.0, 1.0):
            clip = np.concatenate([2 * at / (self.width, self.height) - 1, np.full((len(at), 1), depth)], 1)
            world = np.concatenate([clip, np.ones((len(at), 1))], 1) @ back.T
            ends.append(world[:, :3] / world[:, 3:])
        along = ends[1] - ends[0]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        return ends[0].astype(np.float32), along.astype(np.float32)


def draw(context: bpy.types.Context, kind: str) -> np.ndarray:
    """(H, W, 3) float32 sRGB, the first row at the bottom. Raises SceneError where there are no points."""
    scene = context.scene
    values, scale = colours.read(scene, kind)
    position, normal, radius = (points.read(scene, name) for name in ("position", "normal", "radius"))
    surfaces = extract.extract(context, resolution=16, looks=False)
    view = view_of(context, position)
    lit = Lit(surfaces, position, normal, radius)
    picture, depth = _surfaces(view, lit)
    _discs(picture, depth, view, lit, position, normal, radius, scale.colours(values))
    height, width = view.height // FINER, view.width // FINER
    picture = picture.reshape(height, FINER, width, FINER, 3).mean(axis=(1, 3))
    return np.concatenate([colours.legend(scale, kind, len(values), width), picture])


class Lit:
    """The sides of surfaces that hold points: all that is seen, and all that hides."""

    def __init__(self, surfaces: Scene, position, normal, radius):
        corners = surfaces.positions[surfaces.triangles]
        self.bvh = Bvh(corners)
        self.cross = surfaces.triangle_cross()
        self.step = np.float32(max(1e-5 * surfaces.extent, 4e-7 * float(np.abs(surfaces.positions).max())))
        # (T, 2): front and back of each triangle
        self.side = np.zeros((len(corners), 2), bool)
        lift = np.minimum(0.1 * radius, 100 * self.step)[:, None].astype(np.float32)
        below = self.bvh.closest(np.ascontiguousarray(position + lift * normal), np.ascontiguousarray(-normal))
        held = below >= 0
        facing = np.einsum("nd,nd->n", self.cross[below[held]], normal[held]) > 0
        self.side[below[held], np.where(facing, 0, 1)] = True
        # triangles too small for a point of their own
        grid = DiscGrid(position, normal, 2 * radius)
        middle = corners.mean(axis=1)
        for piece in chunks(len(corners), 16_384):
            triangle, point = grid.pairs(middle[piece])
            triangle = triangle + piece.start
            apart = position[point] - middle[triangle]
            rise = np.abs(np.einsum("nd,nd->n", apart, normal[point]))
            near = (np.linalg.norm(apart, axis=1) < 2 * radius[point]) & (rise < 0.3 * radius[point])
            facing = np.einsum("nd,nd->n", self.cross[triangle], normal[point])
            size = np.linalg.norm(self.cross[triangle], axis=1)
            near &= np.abs(facing) > 0.5 * size
            self.side[triangle[near], np.where(facing[near] > 0, 0, 1)] = True

    def hits(self, origins, directions) -> tuple[np.ndarray, np.ndarray]:
        """First triangle (n,) whose lit side rays meet, −1 for none, and its distance (n,)."""

        def part(s):
            triangle, distance = np.full(s.stop - s.start, -1, np.int32), np.full(s.stop - s.start, np.inf, np.float32)
            alive, start = np.arange(s.stop - s.start), origins[s].copy()
            gone = np.zeros(s.stop - s.start, np.float32)
            for _ in range(LAYERS):
                along = np.ascontiguousarray(directions[s][alive])
                found = self.bvh.hits(np.ascontiguousarray(start[alive]), along)
                hit = found.triangle >= 0
                alive, along, which, far = alive[hit], along[hit], found.triangle[hit], found.distance[hit]
                back = np.einsum("nd,nd->n", self.cross[which], along) > 0
                seen = self.side[which, back.astype(np.int8)]
                triangle[alive[seen]], distance[alive[seen]] = which[seen], gone[alive[seen]] + far[seen]
                alive, along, far = alive[~seen], along[~seen], far[~seen] + self.step
                gone[alive] += far
                start[alive] += along * far[:, None]
                if not len(alive):
                    break
            return triangle, distance

        parts = in_threads(part, chunks(len(origins), 65_536))
        return tuple(np.concatenate([p[k] for p in parts]) for k in (0, 1))


def view_of(context, position) -> View:
    scene = context.scene
    render = scene.render
    camera = scene.camera
    if camera is None:
        return _fitted(position)
    wide, high = render.resolution_x * render.pixel_aspect_x, render.resolution_y * render.pixel_aspect_y
    factor = LONGER / max(wide, high)
    width, height = (FINER * max(1, round(side * factor)) for side in (wide, high))
    camera = camera.evaluated_get(context.evaluated_depsgraph_get())
    lens = camera.calc_matrix_camera(context.evaluated_depsgraph_get(), x=width, y=height)
    place = camera.matrix_world.normalized().inverted()
    return View(np.array(lens, np.float64) @ np.array(place, np.float64), width, height)


def _fitted(position) -> View:
    """From above one corner, all points in view."""
    low, high = position.min(axis=0).astype(np.float64), position.max(axis=0).astype(np.float64)
    middle, size = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-6)
    back = np.array([0.5, -0.75, 0.55]) / np.linalg.norm([0.5, -0.75, 0.55])
    right = np.cross([0, 0, 1], back)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(back, right), back])
    slope = np.tan(np.radians(35) / 2)
    away = size / np.sin(np.radians(35) / 2)
    near, far = max(away - 1.2 * size, 0.01 * size), away + 1.2 * size
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = turn, -turn @ (middle + away * back)
    width, height = FINER * LONGER, FINER * LONGER * 3 // 4
    lens = np.zeros((4, 4))
    lens[0, 0], lens[1, 1] = height / width / slope, 1 / slope
    lens[2, 2:] = (far + near) / (near - far), 2 * far * near / (near - far)
    lens[3, 2] = -1
    return View(lens @ place, width, height)


def _surfaces(view, lit) -> tuple[np.ndarray, np.ndarray]:
    """The lit sides in grey, (H, W, 3), and their distance along each sample's ray, (H, W)."""
    # one ray a pixel is enough for what is dim
    wide, high = view.width // FINER, view.height // FINER
    column, row = np.meshgrid(np.arange(wide), np.arange(high))
    origins, directions = view.rays(np.stack([column.ravel() + 0.5, row.ravel() + 0.5], 1) * FINER)
    triangle, distance = lit.hits(origins, directions)
    shade = np.zeros(len(triangle), np.float32)
    hit = triangle >= 0
    cross = lit.cross[triangle[hit]]
    facing = np.abs(np.einsum("nd,nd->n", cross, directions[hit])) / np.linalg.norm(cross, axis=1)
    shade[hit] = DIM[0] + (DIM[1] - DIM[0]) * facing
    grow = lambda a: np.repeat(np.repeat(a.reshape(high, wide), FINER, axis=0), FINER, axis=1)  # noqa: E731
    return np.repeat(grow(shade)[..., None], 3, axis=2) + np.float32(0.02), grow(distance)


def seen(view: View, lit: Lit, position, normal, radius) -> tuple[np.ndarray, np.ndarray]:
    """The points that the camera sees, rows (m,), and how far away each is, (m,)."""
    at, ahead = view.project(position.astype(np.float64))
    rows = np.flatnonzero(ahead)
    origins, directions = view.rays(at[rows])
    far = np.linalg.norm(position[rows] - origins, axis=1)
    facing = np.einsum("nd,nd->n", normal[rows], directions) < 0
    rows, origins, directions, far = rows[facing], origins[facing], directions[facing], far[facing]
    # its own surface must not hide a point, whichever way rounding goes
    slack = np.maximum(2 * lit.step, 0.05 * radius[rows])
    _, before = lit.hits(origins, directions)
    free = before > far - slack
    return rows[free], far[free]


def _discs(picture, depth, view, lit, position, normal, radius, colour) -> None:
    """Draw the points that the camera sees."""
    rows, far = seen(view, lit, position, normal, radius)
    at, _ = view.project(position[rows].astype(np.float64))
    size = radius[rows] * np.float32(DISC)
    # the ellipse that a disc makes: where the ends of two of its radii are seen
    first = np.cross(normal[rows], np.where(np.abs(normal[rows, :1]) < 0.6, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normal[rows], first)
    tiny = 1e-3 * size[:, None]
    axes = [(view.project(position[rows] + tiny * axis)[0] - at) * 1e3 for axis in (first, second)]
    shape = np.stack(axes, 2)
    # as large as can be seen and no larger, keeping their shape
    longest = np.maximum(np.linalg.norm(shape, axis=(1, 2)), 1e-9)
    larger = np.clip(longest, SMALLEST * 1.4, LARGEST * 1.4) / longest
    shape *= larger[:, None, None]
    slack = np.maximum(2 * radius[rows], 4 * size * larger)
    reach = np.ceil(np.linalg.norm(shape, axis=2).max(axis=1) + 1).astype(np.int64)
    # a disc seen edge-on is still as thick as a sample
    spread = shape @ shape.transpose(0, 2, 1) + 0.35 * np.eye(2)
    inverse = np.linalg.inv(spread)
    whole = np.floor(at).astype(np.int64)
    for width in np.unique(reach):
        group = np.flatnonzero(reach == width)
        for dy in range(-width, width + 1):
            for dx in range(-width, width + 1):
                pixel = whole[group] + (dx, dy)
                off = pixel + 0.5 - at[group]
                inside = np.einsum("na,nab,nb->n", off, inverse[group], off) <= 1
                inside &= ((pixel >= 0) & (pixel < (view.width, view.height))).all(axis=1)
                one, (x, y) = group[inside], pixel[inside].T
                # not over the edge of its own surface, or of what stands before
                free = np.abs(depth[y, x] - far[one]) < slack[one]
                picture[y[free], x[free]] = colour[rows[one[free]]]
