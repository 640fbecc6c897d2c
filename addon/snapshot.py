"""The atlas as it is, to be put back: UV layers and the objects' places in it.

Objects and meshes are named by the numbers that they keep in a session, since undo and deletion make references to them
invalid.
"""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np

from .atlas import PLACE, remove_layer, write_layer
from .meshes import LAYER, read_attribute


class Snapshot:
    """Our UV layers of the objects' meshes, and the places of all objects of the scene."""

    def __init__(self, scene: bpy.types.Scene, objects: Iterable[bpy.types.Object]):
        self.places = {
            item.session_uid: {n: (list(v) if hasattr(v := item[n], "to_list") else v) for n in PLACE if n in item}
            for item in scene.objects
        }
        self.layers = {}
        for data in {item.data for item in objects}:
            uv = None
            if LAYER in data.uv_layers:
                uv = read_attribute(data, LAYER, len(data.loops), 2, "vector", np.float32)
            self.layers[data.session_uid] = uv, len(data.loops)

    def edited(self) -> list[str]:
        """Names of meshes that have other corners than when this was taken."""
        return [
            data.name
            for data in bpy.data.meshes
            if data.session_uid in self.layers and len(data.loops) != self.layers[data.session_uid][1]
        ]

    def restore(self) -> None:
        """Put back what is still there."""
        for data in bpy.data.meshes:
            uv, loops = self.layers.get(data.session_uid, (None, -1))
            if uv is not None and loops == len(data.loops):
                write_layer(data, uv)
            elif uv is None and loops >= 0 and LAYER in data.uv_layers:
                remove_layer(data)
        for item in bpy.data.objects:
            values = self.places.get(item.session_uid)
            if values is None:
                continue
            for name in PLACE:
                if name in values:
                    item[name] = values[name]
                elif name in item:
                    del item[name]
