"""Where every chart goes in the atlas: arithmetic on arrays, which needs no Blender and may run on a thread.

Charts of single meshes are packed one by one; a mesh that objects share gets a block of its charts, and each of its
objects a rectangle for that block.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..core.scene import SceneError
from .charts import lay_flat
from .packing import FEW, INSET, MARGIN, Charts, pack

LARGEST_GRID = 1024  # cells; above it a cell is several texels wide
SMALLEST_COVERAGE = 0.2  # of the texels; below it the charts are too many for the atlas
SMALLEST_CHARTED = 0.9  # of the area must be in charts of a texel or more


@dataclass
class Unwrapped:
    """One mesh that is laid out, in the world space of its first user.

    users: names of its objects; ratios: linear size of each, the first one's being 1, weight included. positions
    (V, 3) float64, corners (L,) vertex of each loop, faces (F,) first loop of each polygon, triangles (T, 3) loops,
    uv (L, 2) in [0, 1] with charts apart.
    """

    users: list[str]
    ratios: np.ndarray
    positions: np.ndarray
    corners: np.ndarray
    faces: np.ndarray
    triangles: np.ndarray
    uv: np.ndarray

    @property
    def shared(self) -> bool:
        return len(self.users) > 1


def lay_out(
    meshes: list[Unwrapped], resolution: int, warnings: list[str], tick: Callable[[float], None] | None = None
) -> tuple[list[np.ndarray], dict[str, tuple]]:
    """The layer's UVs (L, 2) per mesh, and each object's (scale, offset) by name.

    tick(part done): called between attempts; an exception that it raises ends the work. Raises SceneError where the
    charts do not fit.
    """
    tick = tick or (lambda part: None)
    layouts = []
    for done, mesh in enumerate(meshes):
        tick(0.3 * done / len(meshes))
        layouts.append(lay_flat(mesh.positions, mesh.corners, mesh.faces, mesh.triangles, mesh.uv))
    grid = min(resolution, LARGEST_GRID)
    total = sum(layout.areas.sum() * (mesh.ratios**2).sum() for mesh, layout in zip(meshes, layouts, strict=True))
    if total <= 0:
        raise SceneError("Every face has zero area; scale the objects up or apply their scale.")
    chart_count = sum(len(layout.areas) * len(mesh.users) for mesh, layout in zip(meshes, layouts, strict=True))
    density = high = _densest(meshes, layouts, total, chart_count, grid)
    smallest = 0.2 * density
    # whether charts fit is not monotonic in their size: few charts can afford to try more sizes
    step = 0.97 if chart_count <= FEW else 0.94
    packed = low = None
    part = 0.3
    while (low is None and density > smallest) or (low is not None and high / low > 1.015):
        part = min(part + 0.05, 0.99)
        tick(part)
        attempt = _attempt(meshes, layouts, density, grid)
        if attempt is None:
            high = density
        else:
            packed, low = attempt, density
        density = np.sqrt(low * high) if low else density * step
    if packed is None:
        raise SceneError(_too_small(meshes, chart_count, resolution))
    density = low * resolution / grid
    _check_sizes(meshes, layouts, density, resolution, total, chart_count, warnings)
    return packed


def _densest(meshes, layouts, total, chart_count, grid) -> float:
    """Cells per metre at which charts and their margins would fill the atlas without a gap; 0 if they can't."""
    border = 0.0
    for mesh, layout in zip(meshes, layouts, strict=True):
        corner = np.zeros((len(layout.areas), 2))
        np.maximum.at(corner, layout.chart, layout.points)
        border += 2 * MARGIN * corner.sum() * mesh.ratios.sum()
    free = grid * grid - (2 * MARGIN) ** 2 * chart_count
    if free <= 0:
        return 0.0
    return float((np.sqrt(border**2 + 4 * total * free) - border) / (2 * total))


def _too_small(meshes, chart_count, resolution) -> str:
    worst = max(meshes, key=lambda mesh: len(mesh.faces) * len(mesh.users)).users[0]
    return (
        f"An atlas of {resolution}×{resolution} texels is too small for its {chart_count} charts: raise Resolution, "
        f"or exclude objects with many small faces ('{worst}' has most)."
    )


def _check_sizes(meshes, layouts, density, resolution, total, chart_count, warnings) -> None:
    covered = total * density**2 / resolution**2
    charted = 0.0
    for mesh, layout in zip(meshes, layouts, strict=True):
        for name, ratio in zip(mesh.users, mesh.ratios, strict=True):
            texels = layout.areas * (ratio * density) ** 2
            seen = layout.areas[texels >= 1].sum() * ratio**2
            charted += seen
            if texels.sum() < 1:
                warnings.append(
                    f"'{name}' is smaller than a texel, so its light is coarse: raise Resolution or the object's weight."
                )
    if covered < SMALLEST_COVERAGE or charted < SMALLEST_CHARTED * total:
        raise SceneError(_too_small(meshes, chart_count, resolution))


def _attempt(meshes, layouts, density, grid):
    """Everything at `density` cells per metre: (UVs per mesh, places per object), or None if it doesn't fit."""
    singles = [i for i, mesh in enumerate(meshes) if not mesh.shared]
    blocks, sizes = {}, []
    areas = [layout.areas.sum() * (mesh.ratios * density) ** 2 for mesh, layout in zip(meshes, layouts, strict=True)]
    used = sum(area.sum() for area in areas)
    for i, mesh in enumerate(meshes):
        if mesh.shared:
            # packed for its smallest user, so that the others' margins are only wider
            least = mesh.ratios.min()
            block = _block(layouts[i], density * least, grid)
            if block is None:
                return None
            blocks[i] = block
            used += (block[1].prod() * (mesh.ratios / least) ** 2 - areas[i]).sum()
            if used > grid**2:
                # the gaps alone are too many, however the rest is packed
                return None
            sizes.extend((i, k, block[1] * (ratio / least)) for k, ratio in enumerate(mesh.ratios))
    charts = _together(
        [layouts[i] for i in singles],
        np.array([np.ceil(size - 1e-6) - 2 * MARGIN - 2 * INSET for _, _, size in sizes]).reshape(-1, 2) / density,
    )
    placed = pack(charts, density, grid, grid)
    if placed is None:
        return None
    uvs, places = [None] * len(meshes), {}
    moved = placed.apply(charts.points * density, charts.chart) / grid
    first = 0
    for i in singles:
        count = len(layouts[i].points)
        uvs[i] = moved[first : first + count]
        first += count
        places[meshes[i].users[0]] = ((1.0, 1.0), (0.0, 0.0))
    turned = charts.count - len(sizes)
    for n, (i, k, size) in enumerate(sizes):
        uvs[i] = blocks[i][0]
        corner = (placed.offset[turned + n] - MARGIN) / grid
        places[meshes[i].users[k]] = (tuple(float(s) for s in size / grid), tuple(float(c) for c in corner))
    return uvs, places


def _block(layout, density, grid):
    """A shared mesh's charts in a box of their own: UVs in [0, 1]² of the box, and its size in cells."""
    charts = layout.charts
    corner = np.zeros((charts.count, 2))
    np.maximum.at(corner, layout.chart, layout.points)
    cells = np.ceil(corner * density) + 2 * MARGIN
    side = np.sqrt(cells.prod(axis=1).sum())
    # a long chart may stand upright: only its shorter side must fit
    narrowest = cells.min(axis=1).max() + 1
    best = None
    for factor in (0.8, 0.9, 1.0, 1.15):
        width = int(np.ceil(max(side * factor, narrowest)))
        placed = pack(charts, density, width) if width <= grid else None
        if placed is None:
            continue
        points = placed.apply(charts.points * density, layout.chart)
        size = np.array([np.ceil(points[:, 0].max() - 1e-6) + MARGIN, placed.height], np.float64)
        if best is None or size.prod() < best[1].prod():
            best = points / size, size
    return best


def _together(layouts, boxes) -> Charts:
    """Charts of many meshes, then a fixed rectangle for each of `boxes` (n, 2), in metres."""
    points, owners, edges = [np.zeros((0, 2))], [np.zeros(0, np.int64)], [np.zeros((0, 2), np.int64)]
    loops = count = 0
    for layout in layouts:
        points.append(layout.points)
        owners.append(layout.chart + count)
        edges.append(layout.edges + loops)
        loops += len(layout.points)
        count += len(layout.areas)
    turnable = np.ones(count + len(boxes), bool)
    turnable[count:] = False
    ring = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    for box in np.maximum(boxes, 1e-9):
        points.append(ring * box)
        owners.append(np.full(4, count))
        edges.append(np.array([[0, 1], [1, 2], [2, 3], [3, 0]]) + loops)
        loops += 4
        count += 1
    return Charts(np.concatenate(points), np.concatenate(owners), np.concatenate(edges), count, turnable)
