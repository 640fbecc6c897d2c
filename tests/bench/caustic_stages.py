"""Scenes for caustics: a floor that fills the atlas, something on it that focuses light, and a lamp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from lightpanes.core.scene import Light, Material, Optics, Scene

from ..core.caustic_scenes import ball, floor, glass, lathe, staged
from ..core.caustic_scenes import lens as make_lens
from ..core.shapes import GREY, lamp

GOLD = Material("Gold", (0, 0, 0), optics=Optics(mirror=(0.9, 0.9, 0.9), mirror_edge=(1, 1, 1)))


@dataclass(frozen=True)
class Stage:
    """A scene and its lamp."""

    scene: Scene
    lamp: Light


def sphere() -> Stage:
    """A glass ball above the floor, its focus a little below it."""
    light = lamp((0.5, 0.2, 2.4))
    return Stage(staged(floor(), ball((0, 0, 0.72), 0.4, 192), materials=(GREY, glass()), lights=[light]), light)


def lens() -> Stage:
    """A plano-convex lens above the floor, which stands before the focus."""
    light = lamp((0.1, 0.05, 2.6))
    part = make_lens(0.8, 0.4, 0.02, 0.7, 256)
    return Stage(staged(floor(), part, materials=(GREY, glass()), lights=[light]), light)


def ring() -> Stage:
    """A band of metal on the floor: its inside makes the cusp of a coffee cup."""
    light = lamp((1.1, 0.3, 0.9))
    section = [(0.5, 0.0), (0.54, 0.02), (0.55, 0.12), (0.54, 0.22), (0.5, 0.24), (0.5, 0.0)]
    # seen from outside the section runs anticlockwise
    part = lathe(_rounded(section), 384, "Ring", smooth=0.5)
    return Stage(staged(floor(), part, materials=(GREY, GOLD), lights=[light]), light)


def _rounded(section):
    """The section with its inner face cut into pieces, so that triangles stay compact."""
    section = np.asarray(section, float)
    pieces = [section[:-1]]
    down = np.linspace(section[-2], section[-1], 9)[1:]
    return np.concatenate([*pieces, down])


def knot(turns: int = 960, sides: int = 80) -> Stage:
    """A torus knot of glass: 154K triangles."""
    light = lamp((0.4, -0.5, 2.3))
    t = np.linspace(0, 2 * np.pi, turns, endpoint=False)
    p, q = 2, 3
    ring_ = 0.36 + 0.15 * np.cos(q * t)
    middle = np.stack([ring_ * np.cos(p * t), ring_ * np.sin(p * t), 0.45 + 0.17 * np.sin(q * t)], 1)
    along = np.roll(middle, -1, axis=0) - np.roll(middle, 1, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross(along, (0, 0, 1.0))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, along)
    turn = np.linspace(0, 2 * np.pi, sides, endpoint=False)[:, None]
    normal = np.cos(turn) * side[:, None] + np.sin(turn) * up[:, None]
    points = middle[:, None] + 0.075 * normal
    index = np.arange(turns * sides).reshape(turns, sides)
    right, above = np.roll(index, -1, axis=0), np.roll(index, -1, axis=1)
    both = np.roll(right, -1, axis=1)
    triangles = np.concatenate(
        [np.stack([index, above, both], -1).reshape(-1, 3), np.stack([index, both, right], -1).reshape(-1, 3)]
    )
    part = "Knot", points.reshape(-1, 3), triangles, None, normal.reshape(-1, 3), 1
    return Stage(staged(floor(), part, materials=(GREY, glass()), lights=[light]), light)


STAGES = {"sphere": sphere, "lens": lens, "ring": ring, "knot": knot}
