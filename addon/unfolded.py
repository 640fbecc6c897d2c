"""Where a planned atlas lies on objects as they render, modifiers included, before any mesh of the scene has it.

A modifier carries our UV layer along only while the mesh has it. So it gets the layer for the moment that reading takes,
and Blender, which the user may use between two steps of a bake, never meets a scene that is half a bake.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

import bpy
import numpy as np

from ..core.scene import SceneError
from . import visibility
from .meshes import LAYER, loop_triangles, read_attribute
from .snapshot import Snapshot, read_layer, remove_layer, write_layer

DOUBLING = {"MIRROR", "ARRAY", "SOLIDIFY", "SCREW", "NODES", "BOOLEAN", "SKIN", "BUILD"}
READS = 64
"""Turns in which the objects are read, about, between which the user may cancel."""

CHANGED = "The scene changed while it was read: bake again."


def together(objects: Sequence[bpy.types.Object]) -> Iterator[list[bpy.types.Object]]:
    """The objects a few at a time, in order: each read costs Blender a look at all that there is, so there are no more
    reads in a large scene than in a small one."""
    count = max(len(objects) // READS, 1)
    corners = sum(len(item.data.loops) for item in objects) / READS
    some, held = [], 0
    for item in objects:
        some.append(item)
        held += len(item.data.loops)
        if len(some) >= count or held >= corners:
            yield some
            some, held = [], 0
    if some:
        yield some


class Unfolded:
    """A planned atlas; `read` all objects, a few `together`, then look at `place` and `uv` inside of `laid`."""

    def __init__(self, planned: Snapshot):
        self.planned = planned
        self._evaluated: dict[int, np.ndarray | None] = {}
        self._rest: set[int] = set()

    def place(self, item: bpy.types.Object) -> dict:
        """What the object will have of `snapshot.PLACE`."""
        return self.planned.places.get(item.session_uid, {})

    def layer(self, item: bpy.types.Object) -> np.ndarray | None:
        """(L, 2) float32 coordinates on the object's own mesh, None where it has none."""
        return self.planned.layer(item.data)

    def read(self, context: bpy.types.Context, *items: bpy.types.Object) -> list[str]:
        """Find where modifiers leave the layer; returns warnings. Their meshes are afterwards as they were."""
        shaped = [item for item in items if item.modifiers and "lightpanes_scale" in self.place(item)]
        if not shaped:
            return []
        # as others render; they are made so all at once
        self._rest.update(item.session_uid for item in shaped if _refers(item))
        warnings: list[str] = []
        with self._laid(shaped), visibility.as_rendered(context, shaped) as depsgraph:
            for item in shaped:
                mesh = item.evaluated_get(depsgraph).data
                self._evaluated[item.session_uid] = read_layer(mesh)
                warnings += _overlaps(item, mesh)
        return warnings

    @contextmanager
    def laid(self, objects: Iterable[bpy.types.Object]) -> Iterator[None]:
        """While the scene is read: those of the objects that can't be read one by one have their layer."""
        rest = [item for item in objects if item.session_uid in self._rest]
        with self._laid(rest):
            yield

    def uv(
        self, item: bpy.types.Object, found: np.ndarray | None, loops: np.ndarray, corners: int
    ) -> np.ndarray | None:
        """(T, 3, 2) float32 coordinates of an evaluated mesh's triangles, None where a modifier lost them.

        found: what the mesh itself has. loops: (T, 3) of it, of so many corners in all. Raises SceneError where they are
        no longer those that `read` saw.
        """
        if item.session_uid in self._rest:
            return found
        uv = self._evaluated[item.session_uid] if item.session_uid in self._evaluated else self.layer(item)
        if uv is None and item.session_uid in self._evaluated:
            return None
        if uv is None or len(uv) != corners:
            raise SceneError(CHANGED)
        return uv[loops]

    @contextmanager
    def _laid(self, objects):
        """Their meshes with the layer, and afterwards with that which they had."""
        before = {}
        try:
            for data in {item.data for item in objects}:
                uv = self.planned.layer(data)
                if uv is None:
                    raise SceneError(CHANGED)
                before[data] = read_layer(data)
                write_layer(data, uv)
            yield
        finally:
            for data, uv in before.items():
                if uv is None:
                    remove_layer(data)
                else:
                    write_layer(data, uv)


def _refers(item) -> bool:
    """Whether what the object's modifiers make of it may depend on how others render."""
    for modifier in item.modifiers:
        if modifier.type == "NODES":
            return True
        for each in modifier.bl_rna.properties:
            if each.type == "POINTER" and isinstance(
                getattr(modifier, each.identifier), (bpy.types.Object, bpy.types.Collection)
            ):
                return True
    return False


def _overlaps(item, evaluated) -> list[str]:
    """Modifiers that copy faces copy their UVs: more UV area than the mesh has means shared texels."""
    suspects = [modifier for modifier in item.modifiers if modifier.type in DOUBLING and modifier.show_render]
    if not suspects or LAYER not in evaluated.uv_layers or _uv_area(evaluated) <= 1.05 * _uv_area(item.data):
        return []
    return [
        f"'{item.name}': the modifier '{suspects[0].name}' puts several faces on the same texels, so they share their "
        "light: apply it."
    ]


def _uv_area(data) -> float:
    if not len(data.polygons):
        return 0.0
    uv = read_attribute(data, LAYER, len(data.loops), 2, "vector", np.float32)[loop_triangles(data)].astype(np.float64)
    e, f = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    return float(np.abs(e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]).sum() / 2)
