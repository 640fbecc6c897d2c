"""Arrays as attributes of a mesh's points, and back, to the last bit."""

from __future__ import annotations

import bpy
import numpy as np

from ..core.scene import SceneError

_TYPES = {(): "FLOAT", (2,): "FLOAT2", (3,): "FLOAT_VECTOR", (4,): "FLOAT_COLOR"}
_FIELDS = {
    "FLOAT": "value",
    "INT": "value",
    "FLOAT2": "vector",
    "FLOAT_VECTOR": "vector",
    "FLOAT_COLOR": "color",
}


def write(mesh: bpy.types.Mesh, name: str, array: np.ndarray) -> list:
    """[dtype, shape] of what was written, from which `read` restores the array exactly. Raises SceneError for what
    Blender has no attribute for."""
    array = np.asarray(array)
    count = len(mesh.vertices)
    if len(array) != count:
        raise SceneError(f"The bake's '{name}' has {len(array)} rows for {count} entries.")
    if array.dtype.kind in "iub" and np.array_equal(array, array.astype(np.int32)):
        columns, kind = array.astype(np.int32), "INT"
    elif array.dtype.kind == "f" and array.dtype.itemsize <= 4:
        columns, kind = array.astype(np.float32), None
    else:
        raise SceneError(f"The bake's '{name}' is {array.dtype}; 32-bit floats and integers can be stored.")
    trailing = array.shape[1:]
    if kind is None and trailing in _TYPES:
        if name == "position" and trailing == (3,):
            mesh.attributes["position"].data.foreach_set("vector", columns.reshape(-1))
        else:
            fill(mesh, name, _TYPES[trailing], columns)
    elif trailing == ():
        fill(mesh, name, kind, columns)
    else:
        for k, column in enumerate(columns.reshape(count, -1).T):
            fill(mesh, f"{name}.{k}", kind or "FLOAT", column)
    return [array.dtype.str, list(array.shape)]


def fill(mesh: bpy.types.Mesh, name: str, kind: str, values: np.ndarray) -> None:
    """A new attribute of the points, of Blender's type `kind`."""
    attribute = mesh.attributes.new(name, kind, "POINT")
    if attribute.name != name:
        raise SceneError(f"The bake's '{name}' has a name that Blender keeps for itself.")
    attribute.data.foreach_set(_FIELDS[kind], np.ascontiguousarray(values).reshape(-1))


def read(mesh: bpy.types.Mesh, name: str, dtype: str, shape: list) -> np.ndarray:
    """The array that `write` wrote. Raises ValueError or KeyError where it is not there any more."""
    if name in mesh.attributes:
        return _read_data(mesh.attributes[name], shape).astype(dtype).reshape(shape)
    width = int(np.prod(shape[1:]))
    columns = [_read_data(mesh.attributes[f"{name}.{k}"], shape[:1]) for k in range(width)]
    empty = np.empty((shape[0], 0), dtype)
    return (np.stack(columns, axis=1) if columns else empty).astype(dtype).reshape(shape)


def _read_data(attribute, shape) -> np.ndarray:
    if len(attribute.data) != shape[0]:
        raise ValueError(f"{attribute.name} has {len(attribute.data)} values for {shape[0]} entries")
    values = np.empty(int(np.prod(shape)), np.int32 if attribute.data_type == "INT" else np.float32)
    attribute.data.foreach_get(_FIELDS[attribute.data_type], values)
    return values
