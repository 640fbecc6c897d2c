"""The stored points of a bake, in Blender: the mesh `Lightpanes Points` shows their light and follows their surfaces."""

from __future__ import annotations

import bpy
import numpy as np

from ..core.bake import Bake
from ..core.scene import Scene
from ..core.surface import sample_triangles
from . import store

LIGHT = "irradiance"
BACK = "back"
# On the points' mesh once surfaces have moved: where the bake found the points, and their normals there.
REST = {"position": store.REST.format("position"), "normal": store.REST.format("normal")}
# In the bake's meta: how many triangles each object has.
TRIANGLES = "triangles"

_FIELDS = {
    "INT": ("value", 1, np.int32),
    "FLOAT": ("value", 1, np.float32),
    "FLOAT_VECTOR": ("vector", 3, np.float32),
    "FLOAT_COLOR": ("color", 4, np.float32),
}


def show(scene: bpy.types.Scene, values: np.ndarray) -> None:
    """Write the points' irradiance, (n, 3) float32 in the mesh's order."""
    mesh = mesh_of(scene)
    light = mesh.attributes.get(LIGHT) if mesh is not None else None
    if light is None or len(light.data) != len(values):
        return  # deleted or edited by the user: reading the bake again will say so
    colors = np.ones((len(values), 4), np.float32)
    # their noise may dip below nothing
    np.maximum(values, 0, out=colors[:, :3])
    light.data.foreach_set("color", colors.reshape(-1))


def mesh_of(scene: bpy.types.Scene) -> bpy.types.Mesh | None:
    """The mesh whose vertices are the points of the scene's bake."""
    found = store.find_points(scene)
    return found.data if found is not None and found.type == "MESH" else None


def read(scene: bpy.types.Scene, name: str) -> np.ndarray | None:
    """An attribute of the points as they are now, (n,), (n, 3) or (n, 4); None without points."""
    mesh = mesh_of(scene)
    attribute = mesh.attributes.get(name) if mesh is not None else None
    if attribute is None:
        return None
    field, width, kind = _FIELDS[attribute.data_type]
    values = np.empty(width * len(attribute.data), kind)
    attribute.data.foreach_get(field, values)
    return values.reshape(-1, width) if width > 1 else values


def remember(bake: Bake, surfaces: Scene) -> None:
    """Add to a bake whose exits are points what `follow` needs: the side of its triangle that each point is on, and
    how many triangles each object has."""
    if not bake.points:
        return
    fresh = _samples(bake.points, bake.points["triangle"], surfaces)
    turned = np.einsum("nd,nd->n", fresh.normal, bake.points["normal"]) < 0
    bake.points[BACK] = (turned ^ fresh.behind(surfaces)).astype(np.int32)
    bake.meta[TRIANGLES] = np.bincount(surfaces.triangle_object, minlength=len(surfaces.objects)).tolist()


def follow(scene: bpy.types.Scene, meta: dict, surfaces: Scene | None) -> tuple[str, ...]:
    """Move the points' mesh along with its surfaces; returns sentences that say how stale the transport is.

    surfaces: the scene as it is now, None where it is as it was baked. Each point stays at its place on its triangle;
    points of objects that are gone, or that have other triangles than before, stay where they are.
    """
    mesh = mesh_of(scene)
    if mesh is None or TRIANGLES not in meta or (surfaces is None and REST["position"] not in mesh.attributes):
        return ()
    held = {name: read(scene, name) for name in ("triangle", "weights", BACK, *REST)}
    rest = {name: read(scene, kept) for name, kept in REST.items()}
    if any(values is None for values in held.values()):
        return ()
    rest = {name: held[name] if rest[name] is None else rest[name] for name in REST}
    now = {name: values.copy() for name, values in rest.items()}
    here = np.ones(len(held["triangle"]), bool)
    if surfaces is not None:
        triangle = _triangles_now(meta, surfaces)[held["triangle"]]
        here = triangle >= 0
        part = {name: values[here] for name, values in held.items()}
        samples = _samples(part, triangle[here], surfaces).on_side(surfaces, part[BACK].astype(bool))
        now["position"][here], now["normal"][here] = samples.position, samples.normal
    for name, kept in REST.items():
        _write(mesh, name, now[name])
        if surfaces is None:
            mesh.attributes.remove(mesh.attributes[kept])
        elif kept not in mesh.attributes:
            _write(mesh, kept, rest[name])
    mesh.update()
    return _stale(now, rest, here, surfaces)


def _stale(now, rest, here, surfaces) -> tuple[str, ...]:
    if surfaces is None:
        return ()
    way = np.linalg.norm(now["position"] - rest["position"], axis=1)
    # beyond what rounding does
    moved = way > 1e-5 * surfaces.extent + 1e-6 * float(np.abs(now["position"]).max(initial=0.0))
    told = []
    if moved.any():
        told.append(
            f"{_share(moved)} of the points have moved with their surfaces since the bake, by up to "
            f"{_length(float(way.max()))}; they bring along the light of the places where they were."
        )
    if not here.all():
        told.append(f"{_share(~here)} of the points are on objects that are gone or have other faces since the bake.")
    return tuple(told)


def _share(chosen) -> str:
    percent = 100 * float(chosen.mean())
    return f"{percent:.0f} %" if percent >= 1 else "Less than 1 %"


def _length(metres) -> str:
    return f"{metres:.2g} m" if metres < 100 else f"{metres:.0f} m"


def _triangles_now(meta, surfaces) -> np.ndarray:
    """Number that each of the bake's triangles has in the scene now, −1 where its object is gone or has others."""
    ends = np.cumsum(np.bincount(surfaces.triangle_object, minlength=len(surfaces.objects)))
    parts = {
        key: range(*run) for key, run in zip(_numbered([o.name for o in surfaces.objects]), _runs(ends), strict=True)
    }
    result = []
    for key, count in zip(_numbered(meta["report"]["objects"]), meta[TRIANGLES], strict=True):
        part = parts.get(key, ())
        result.append(np.array(part, np.int32) if len(part) == count else np.full(count, -1, np.int32))
    return np.concatenate(result)


def _runs(ends) -> list[tuple[int, int]]:
    return list(zip([0, *ends[:-1].tolist()], ends.tolist(), strict=True))


def _numbered(names) -> list[tuple[str, int]]:
    """Names with how often each came before: instances share theirs."""
    seen: dict[str, int] = {}
    result = []
    for name in names:
        result.append((name, seen.get(name, 0)))
        seen[name] = seen.get(name, 0) + 1
    return result


def _samples(held, triangle, surfaces):
    return sample_triangles(surfaces, triangle, held["weights"])


def _write(mesh, name, values) -> None:
    attribute = mesh.attributes.get(name) or mesh.attributes.new(name, "FLOAT_VECTOR", "POINT")
    attribute.data.foreach_set("vector", np.ascontiguousarray(values, np.float32).reshape(-1))
