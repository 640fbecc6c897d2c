"""Which squares of photons a lamp gets: one for each object, family of paths and point of the lamp."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..scene import Light
from .emission import Emitter, emitters
from .families import families, followed
from .softness import Aimed, Cells, aimed, cells, width
from .surfaces import Surfaces

FEWER = 4
"""Points of a soft lamp for one from which weaker families start, where each has a square of its own."""

PER_POINT = 2_500
"""Photons a point of a soft lamp, about, where each has a square of its own."""

MOST = 256
"""The most of those."""

WIDTHS = 0.05, 0.1
"""Of a lamp, in parts of how far the object is, from which it is cut into more parts, where points aim alike: 2 × 2 will do
for a small one, 3 × 3 for a larger one, then 4 × 4."""

EACH = 40_000
"""Photons for which they do; with more photons there are more parts, as the root of them."""

WEAK_CELLS = 4
"""Parts of a lamp for weaker families."""


@dataclass(frozen=True)
class Tree:
    """A square of photons: a point of the lamp towards an object, and the family of paths that they follow.

    unfollowed: see `families.followed`. group: number that trees have in common whose photons aim alike. cell: the part of
    the lamp that it then stands for.
    """

    emitter: Emitter | Aimed
    caster: int
    family: int
    unfollowed: np.ndarray
    group: int
    cell: int = 0


def points_of(photons: int) -> int:
    """Points of a soft lamp, where each has a square of its own."""
    return int(np.clip(photons // PER_POINT, 4, MOST))


def plant(surfaces: Surfaces, light: Light, points: int, photons: int, seed: int) -> tuple[list[Tree], Cells | None]:
    """Trees for so many points of a lamp, and what parts of it they stand for, where they do; one point stands for all.

    photons: of the lamp, which say how many parts there are.
    """
    trees: list[Tree] = []
    objects = {caster: surfaces.bounding(caster, light) for caster in surfaces.casters.tolist()}
    parts, soft = None, False
    if points >= WEAK_CELLS:
        widest = max(width(light, bounds) for bounds in objects.values())
        side = 2 + sum(widest > known for known in WIDTHS)
        parts = _cells(light, min(points, side**2 * max(np.sqrt(photons / EACH), 1)))
    for caster, bounds in objects.items():
        alike = aimed(light, bounds, parts.point, surfaces.extent) if parts else None
        group = trees[-1].group + 1 if trees else 0
        if alike:
            trees += _alike(surfaces, alike, caster, seed, group)
            soft = True
            continue
        squares = emitters(light, bounds, points, seed, surfaces.extent)
        if squares:
            trees += _apart(surfaces, squares, caster, seed, group)
    return trees, parts if soft else None


def _cells(light, count):
    """Parts of a lamp: four for weaker families, then those for the strongest."""
    round_ = light.kind != "AREA" or light.shape in ("DISK", "ELLIPSE")
    weak, strong = cells(WEAK_CELLS, round_), cells(count, round_)
    return Cells(*(np.concatenate(pair) for pair in zip(weak, strong, strict=True)))


def _alike(surfaces, squares, caster, seed, group):
    """Trees whose photons aim alike."""
    chosen = families(surfaces, squares[0].middle, caster, seed)
    unfollowed = followed(chosen)
    trees = []
    for k, family in enumerate(chosen.tolist()):
        some = range(WEAK_CELLS) if family else range(WEAK_CELLS, len(squares))
        for cell in some:
            emitter = replace(squares[cell], share=1 / len(some))
            trees.append(Tree(emitter, caster, family, unfollowed[k], group + k, cell))
    return trees


def _apart(surfaces, squares, caster, seed, group):
    """Trees that have squares of their own."""
    if len(squares) > 1:
        # grids of different points must not fall onto one another, or their coarseness shows
        squares = [square.shifted(k, seed) for k, square in enumerate(squares)]
    chosen = families(surfaces, squares[len(squares) // 2], caster, seed)
    unfollowed = followed(chosen)
    trees = []
    for k, family in enumerate(chosen.tolist()):
        # the weaker ways from a quarter of the points, each of which gets as many photons more
        step = FEWER if family and len(squares) >= 4 * FEWER else 1
        some = squares[step // 2 :: step]
        part = len(squares) / len(some)
        for square in some:
            emitter = replace(square, share=square.share * part)
            trees.append(Tree(emitter, caster, family, unfollowed[k], group + len(trees)))
    return trees
