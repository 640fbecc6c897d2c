"""Lamps by group: light is linear, so that each group's share of it is known by itself."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import bpy
import numpy as np

from ..core.panes import Relighter
from ..core.scene import Light
from . import claims

REST, STEADY = "Rest", "Steady"


def in_scene(scene: bpy.types.Scene, static: Iterable[str] = ()) -> list[str]:
    """Names of the groups of the scene's lamps, instanced ones included, in order; last "", where a lamp has none.

    static: names of lamps that are baked in and belong to no group.
    """
    lamps = [item for item in claims.members(scene) if item.type == "LIGHT" and item.name not in set(static)]
    found = {group_of(item.data) for item in lamps}
    return sorted(found - {""}) + ([""] if "" in found or not found else [])


def group_of(lamp: bpy.types.Light) -> str:
    """The group's name, "" for none; without the add-on registered no lamp has one."""
    mine = getattr(lamp, "lightpanes", None)
    return mine.group.strip() if mine is not None else ""


def file_parts(groups: Iterable[str]) -> dict[str, str]:
    """What file names call the groups, "" included: safe on all systems, and different even where letters' case is not
    told apart. None of them is called STEADY, and no other than "" REST."""
    taken, parts = {STEADY.lower(), REST.lower()}, {}
    for group in groups:
        plain = re.sub(r"[^\w\- ]+", "_", group).strip() or "_"
        name, number = plain, 1
        while name.lower() in taken and group:
            number += 1
            name = f"{plain} {number}"
        taken.add(name.lower())
        parts[group] = name if group else REST
    return parts


def shares(relighter: Relighter, lights: Sequence[Light], groups: Sequence[str]) -> tuple[list[np.ndarray], np.ndarray]:
    """The (H, W, 3) float32 irradiance that each group's lamps make, and that which no live lamp does.

    groups: names of all groups of these lamps. Their sum is what all lamps make together. Noise may leave a group a
    little below nothing.
    """
    return relighter.shares([[light for light in lights if light.group == group] for group in groups])
