"""Where on a scene's surface a bake is wrong: the errors of the blocks that were looked at, spread over the atlas."""

from __future__ import annotations

import base64

import numpy as np

from ..memory import slices
from ..panes.regions import features
from ..surface import Texels
from .verdict import Verdict

TILES = 64
"""Tiles of the map a side, at most."""

COLOURS = np.array(
    [[0.0, 0.0, 0.15], [0.0, 0.35, 0.6], [0.1, 0.7, 0.2], [0.95, 0.75, 0.0], [0.9, 0.05, 0.0]], np.float32
)
"""Linear colours from no error, over half the target, the target and twice that, to four times it."""


def error_map(verdict: Verdict, texels: Texels, extent: float, kept: np.ndarray | slice = slice(None)) -> np.ndarray:
    """(n, n) float32 relative error of each tile of the atlas, row 0 at v = 0, −1 where a tile has no texel. kept: rows of
    the texels that count.

    A tile takes after the blocks that are near it in place and normal: its squared error is their mean, weighted by
    distance to the power −6.
    """
    size = texels.resolution
    side = min(TILES, size)
    index, samples = texels.index[kept], texels.samples
    rows = np.arange(len(texels), dtype=np.int32)[kept]
    total, count = np.zeros((side * side, 6)), np.zeros(side * side)
    for s in slices(len(rows), 200):
        tile = (index[s] // size * side // size) * side + index[s] % size * side // size
        own = features(samples.position[rows[s]], samples.flat[rows[s]], extent)
        total += np.stack([np.bincount(tile, column, side * side) for column in own.T], 1)
        count += np.bincount(tile, minlength=side * side)
    names = np.flatnonzero(count)
    middle = total[names] / count[names, None]
    known = features(verdict.places, verdict.normals, extent)
    apart = ((middle[:, None] - known) ** 2).sum(axis=2)
    weight = 1 / np.maximum(apart, 1e-6) ** 3
    result = np.full(side * side, -1, np.float32)
    result[names] = np.sqrt((weight @ verdict.squares) / weight.sum(axis=1))
    return result.reshape(side, side)


def encode(errors: np.ndarray) -> dict:
    """A map as JSON."""
    return {"side": len(errors), "errors": base64.b64encode(errors.astype("<f2").tobytes()).decode()}


def decode(stored: dict) -> np.ndarray:
    """The map that `encode` was given, rounded to half floats. Raises KeyError or ValueError for what is none."""
    errors = np.frombuffer(base64.b64decode(stored["errors"]), "<f2").astype(np.float32)
    return errors.reshape(stored["side"], stored["side"])


def coloured(errors: np.ndarray, target: float) -> np.ndarray:
    """(n, n, 3) float32 linear colours (COLOURS) of a map; tiles without texels are black."""
    stops = target * np.array([0, 0.5, 1, 2, 4])
    result = np.stack([np.interp(errors, stops, column) for column in COLOURS.T], 2).astype(np.float32)
    result[errors < 0] = 0
    return result
