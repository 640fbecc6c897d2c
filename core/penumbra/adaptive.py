"""Fewer receivers where light is even: a grid is cast coarsely, and finer only where neighbouring masks differ.

Laine and Aila's adaptive antialiasing (2005, extensions), for texels: what lies between four receivers of one surface
that see the lamp alike is taken to see it alike too. So shadows narrower than the grid's step can be missed, and nothing
else.
"""

from __future__ import annotations

import numpy as np

from .cast import cast
from .lamp import LampSamples
from .masks import LIT, Masks, Statistics, words_of
from .occluders import Occluders
from .receivers import Receivers

ASKED = -4
"""Index of a receiver that is still open."""


def cast_adaptively(
    receivers: Receivers,
    grid: np.ndarray,
    surface: np.ndarray,
    lamp: LampSamples,
    occluders: Occluders,
    step: int = 4,
    threads: int | None = None,
) -> tuple[Masks, np.ndarray]:
    """Masks of all receivers, and (R,) bool, which of them were cast.

    grid: (H, W) int rows of the receivers in their raster, −1 where there is none; each receiver in one place. surface:
    (R,) int, receivers are compared with others of the same surface only. step: a power of two, receivers between the
    first ones. Receivers beside a border of their surface are always cast.
    """
    index = np.full(len(receivers), ASKED, np.int32)
    words = [np.zeros((0, words_of(lamp.count)), np.uint64)]
    kept, was_cast, done = 0, np.zeros(len(receivers), bool), Statistics()

    def ask(rows):
        nonlocal kept
        rows = np.unique(rows)
        rows = rows[index[rows] == ASKED]
        if not len(rows):
            return
        masks = cast(receivers.take(rows), lamp, occluders, threads)
        index[rows] = np.where(masks.index >= 0, masks.index + kept, masks.index)
        words.append(masks.words)
        kept += len(masks.words)
        was_cast[rows] = True
        for name in ("relations", "lit", "umbra", "away", "geometry", "rays"):
            setattr(done, name, getattr(done, name) + getattr(masks.statistics, name))

    height, width = grid.shape
    top, left = np.meshgrid(np.arange(0, height, step), np.arange(0, width, step), indexing="ij")
    cells = np.stack([top.ravel(), left.ravel()], axis=1)
    size = step
    while size > 1 and len(cells):
        corners = _places(grid, cells, size, (0, size))
        ask(corners[corners >= 0])
        whole = (corners >= 0).all(axis=1)
        own = np.where(whole[:, None], corners, 0)
        whole &= (surface[own] == surface[own[:, :1]]).all(axis=1)
        state = index[own]
        alike = whole & (state == state[:, :1]).all(axis=1) & (state[:, 0] <= LIT)
        if receivers.normal is not None:
            alike &= (np.einsum("nkd,nd->nk", receivers.normal[own], receivers.normal[own[:, 0]]) > 0.99).all(axis=1)
        for row, column in np.ndindex(size + 1, size + 1):
            inner = _place(grid, cells[alike] + np.array((row, column)))
            use = inner >= 0
            first = own[alike, 0]
            same = use & (surface[np.maximum(inner, 0)] == surface[first])
            filled = inner[same]
            still = index[filled] == ASKED
            index[filled[still]] = index[first[same][still]]
        size //= 2
        offsets = np.array([(0, 0), (0, size), (size, 0), (size, size)])
        cells = (cells[~alike][:, None] + offsets).reshape(-1, 2)
    ask(np.flatnonzero(index == ASKED))
    return Masks(index, np.concatenate(words), lamp.count, done), was_cast


def _places(grid, cells, size, ends):
    """(n, 4) rows of the receivers at the corners of cells, −1 for none."""
    return np.stack([_place(grid, cells + np.array((a, b))) for a in ends for b in ends], axis=1)


def _place(grid, at):
    """(n,) rows of the receivers at places (n, 2) of the raster, −1 for none."""
    inside = ((at >= 0) & (at < grid.shape)).all(axis=1)
    row, column = np.where(inside[:, None], at, 0).T
    return np.where(inside, grid[row, column], -1)
