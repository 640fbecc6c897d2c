"""Cycles' references (addon/reference.py), kept on disk so that no benchmark path traces the same thing twice."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import bpy
import numpy as np
from lightpanes.addon.atlas import LAYER
from lightpanes.addon.reference import Reference, cycles_bake, halves, place

__all__ = ["Reference", "cycles_bake", "reference_direct", "reference_indirect"]

CACHE = Path(__file__).resolve().parents[2] / "out" / "bench" / "cache"


def reference_indirect(
    context, resolution: int = 256, spp: int = 64, seed: int = 0, bounces: int = 32, script: str = ""
) -> Reference:
    """Indirect irradiance of the scene as it stands: lamps, sky and emission after at least one bounce.

    The scene's baked objects (`lightpanes_baked`) need their `Lightpanes` UVs. Cached in out/bench/cache by
    the file's content, the UVs, every lamp and the settings; the scene itself is left as it was. script: what built the
    scene, where no file holds it.
    """
    return _reference(context, {"INDIRECT"}, resolution, spp, seed, bounces, script)


def reference_direct(context, resolution: int = 256, spp: int = 64, seed: int = 0) -> Reference:
    """Direct irradiance of the scene as it stands: lamps, sky and emissive faces; otherwise as above."""
    return _reference(context, {"DIRECT"}, resolution, spp, seed, 0)


def _reference(context, passes, resolution, spp, seed, bounces, script=""):
    settings = {"passes": sorted(passes), "resolution": resolution, "spp": spp, "seed": seed, "bounces": bounces}
    if script:
        settings["script"] = script
    path = CACHE / f"{_fingerprint(context, settings)}.npz"
    # without a file or a script nothing says which materials these are
    keep = bool(bpy.data.filepath or script)
    if keep and path.exists():
        with np.load(path, allow_pickle=False) as stored:
            return Reference(stored["halves"], stored["mask"], spp, float(stored["seconds"]))
    result = halves(context, passes, resolution, spp, seed, bounces)
    if not keep:
        return result
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part.npz")
    np.savez_compressed(part, halves=result.halves, mask=result.mask, seconds=result.seconds)
    part.replace(path)
    return result


def _fingerprint(context, settings):
    """Of all that the reference depends on; materials count through the bytes of the file that was opened."""
    digest = hashlib.sha256(json.dumps([settings, bpy.app.version_string], sort_keys=True).encode())
    if bpy.data.filepath:
        digest.update(Path(bpy.data.filepath).read_bytes())
    graph = context.evaluated_depsgraph_get()
    for obj in sorted(context.scene.objects, key=lambda o: o.name):
        if obj.hide_render:
            continue
        digest.update(obj.name.encode() + np.array(obj.matrix_world, np.float32).tobytes())
        if obj.type == "MESH":
            mesh = obj.evaluated_get(graph).data
            points = np.empty(len(mesh.vertices) * 3, np.float32)
            mesh.vertices.foreach_get("co", points)
            digest.update(points.tobytes())
            layer = mesh.uv_layers.get(LAYER)
            if layer is not None:
                uv = np.empty(len(layer.uv) * 2, np.float32)
                layer.uv.foreach_get("vector", uv)
                digest.update(uv.tobytes() + repr(place(obj)).encode())
        elif obj.type == "LIGHT":
            digest.update(repr(_values(obj.data)).encode())
    for node in _nodes(context.scene.world):
        digest.update(
            repr([(s.name, _plain(s.default_value)) for s in node.inputs if hasattr(s, "default_value")]).encode()
        )
    return digest.hexdigest()[:32]


def _values(data):
    kinds = {"FLOAT", "INT", "BOOLEAN", "ENUM"}
    return [
        (p.identifier, _plain(getattr(data, p.identifier)))
        for p in data.bl_rna.properties
        if p.type in kinds and not p.is_readonly and not (p.type == "ENUM" and p.is_enum_flag)
    ]


def _plain(value):
    return tuple(value) if hasattr(value, "__len__") and not isinstance(value, str) else value


def _nodes(owner):
    return owner.node_tree.nodes if owner is not None and owner.node_tree is not None else []
