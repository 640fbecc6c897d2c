"""The truth: irradiance in the shared atlas, path traced by Cycles, as two independent halves.

Cycles' DIFFUSE bake without the receiver's colour, times π, is irradiance in W/m². Nothing that
biases it is left on: no clamping, no filtered glossy, no light threshold, no adaptive sampling, no
fast approximation; 32 bounces (what lies beyond is below 0.1 % at the samples' albedos). The light
tree only chooses which lamp a path looks at, which is unbiased.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import time
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

CACHE = Path(__file__).resolve().parents[2] / "out" / "bench" / "cache"
UV_LAYER = "Lightpanes"
UNBIASED = {
    "use_adaptive_sampling": False,
    "sample_clamp_direct": 0.0,
    "sample_clamp_indirect": 0.0,
    "light_sampling_threshold": 0.0,
    "blur_glossy": 0.0,
    "use_fast_gi": False,
    "use_guiding": False,
    "use_denoising": False,
    "caustics_reflective": True,
    "caustics_refractive": True,
    "sampling_pattern": "TABULATED_SOBOL",
    "device": "CPU",
}
BOUNCES = ("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces", "transparent_max_bounces")


@dataclass(frozen=True)
class Reference:
    """Two independent estimates of irradiance over the atlas, W/m²; row 0 is v = 0.

    halves: (2, H, W, 3) float32. mask: (H, W) bool, the texels that Cycles wrote.
    spp: samples a texel of each half. seconds: what both took when they were made.
    """

    halves: np.ndarray
    mask: np.ndarray
    spp: int
    seconds: float

    @property
    def image(self) -> np.ndarray:
        """(H, W, 3) float32: the mean of the halves."""
        return self.halves.mean(axis=0)


def reference_indirect(context, resolution: int = 256, spp: int = 64, seed: int = 0, bounces: int = 32) -> Reference:
    """Indirect irradiance of the scene as it stands: lamps, sky and emission after at least one bounce.

    The scene's baked objects (`lightpanes_baked`) need their `Lightpanes` UVs. Cached in out/bench/cache by
    the file's content, the UVs, every lamp and the settings; the scene itself is left as it was.
    """
    return _reference(context, {"INDIRECT"}, resolution, spp, seed, bounces)


def reference_direct(context, resolution: int = 256, spp: int = 64, seed: int = 0) -> Reference:
    """Direct irradiance of the scene as it stands: lamps, sky and emissive faces; otherwise as above."""
    return _reference(context, {"DIRECT"}, resolution, spp, seed, 0)


def cycles_bake(
    context, passes: set[str], resolution: int, spp: int, seed: int = 0, bounces: int = 32
) -> tuple[np.ndarray, np.ndarray, float]:
    """One bake: (H, W, 3) float32 irradiance in W/m², (H, W) bool mask of written texels, seconds it took."""
    scene = context.scene
    objects = [o for o in scene.objects if o.get("lightpanes_baked") and not o.hide_render]
    if not objects:
        raise ValueError("No object of the scene has a place in the atlas; run addon.atlas.make_atlas first.")
    wrong = [o.name for o in objects if o.type != "MESH"]
    if wrong:
        raise ValueError(f"The reference bakes meshes only, not {', '.join(wrong)}.")
    image = bpy.data.images.new("Lightpanes Reference", resolution, resolution, alpha=True, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    try:
        with _settings(scene, spp, seed, bounces), _placed(objects), _targets(objects, image):
            context.view_layer.update()
            started = time.perf_counter()
            with context.temp_override(
                active_object=objects[0],
                object=objects[0],
                selected_objects=objects,
                selected_editable_objects=objects,
            ):
                bpy.ops.object.bake(
                    type="DIFFUSE",
                    pass_filter=passes,
                    target="IMAGE_TEXTURES",
                    save_mode="INTERNAL",
                    uv_layer=UV_LAYER,
                    use_clear=True,
                    margin=0,
                )
            seconds = time.perf_counter() - started
        pixels = np.empty(resolution * resolution * 4, np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    pixels = pixels.reshape(resolution, resolution, 4)
    return pixels[..., :3] * np.float32(np.pi), pixels[..., 3] > 0, seconds


def _reference(context, passes, resolution, spp, seed, bounces):
    settings = {"passes": sorted(passes), "resolution": resolution, "spp": spp, "seed": seed, "bounces": bounces}
    path = CACHE / f"{_fingerprint(context, settings)}.npz"
    # without a file nothing says which materials these are
    keep = bool(bpy.data.filepath)
    if keep and path.exists():
        with np.load(path, allow_pickle=False) as stored:
            return Reference(stored["halves"], stored["mask"], spp, float(stored["seconds"]))
    halves = [cycles_bake(context, passes, resolution, spp, 2 * seed + k + 1, bounces) for k in range(2)]
    images = np.stack([half[0] for half in halves])
    result = Reference(images, halves[0][1], spp, sum(half[2] for half in halves))
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
            layer = mesh.uv_layers.get(UV_LAYER)
            if layer is not None:
                uv = np.empty(len(layer.uv) * 2, np.float32)
                layer.uv.foreach_get("vector", uv)
                digest.update(uv.tobytes() + repr(_place(obj)).encode())
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


def _place(obj):
    return [
        tuple(obj.get(key, default))
        for key, default in (("lightpanes_scale", (1.0, 1.0)), ("lightpanes_offset", (0.0, 0.0)))
    ]


@contextlib.contextmanager
def _settings(scene, spp, seed, bounces):
    """Cycles, unbiased; everything is put back afterwards."""
    values = {
        **UNBIASED,
        "samples": spp,
        "seed": seed,
        **dict.fromkeys(BOUNCES, bounces),
        "transparent_max_bounces": 64,
    }
    before = {key: getattr(scene.cycles, key) for key in values if hasattr(scene.cycles, key)}
    engine, bake_type = scene.render.engine, scene.cycles.bake_type
    scene.render.engine = "CYCLES"
    for key in before:
        setattr(scene.cycles, key, values[key])
    try:
        yield
    finally:
        for key, value in before.items():
            setattr(scene.cycles, key, value)
        scene.cycles.bake_type = bake_type
        scene.render.engine = engine


@contextlib.contextmanager
def _placed(objects):
    """Give every object its own mesh whose UVs stand where the atlas has them, so that one bake does all."""
    before = []
    try:
        for obj in objects:
            mesh = obj.data.copy()
            before.append((obj, obj.data, mesh))
            obj.data = mesh
            layer = mesh.uv_layers.get(UV_LAYER)
            if layer is None:
                raise ValueError(f"'{obj.name}' has no UV layer {UV_LAYER}.")
            scale, offset = _place(obj)
            uv = np.empty(len(layer.uv) * 2, np.float32)
            layer.uv.foreach_get("vector", uv)
            uv = uv.reshape(-1, 2) * np.array(scale, np.float32) + np.array(offset, np.float32)
            layer.uv.foreach_set("vector", uv.ravel())
            if not mesh.materials:
                mesh.materials.append(None)
        yield
    finally:
        for obj, original, mesh in before:
            obj.data = original
            bpy.data.meshes.remove(mesh)


@contextlib.contextmanager
def _targets(objects, image):
    """Make the image the active texture of every material; a plain one stands in where there is none."""
    added, stand_in, empty = [], None, []
    try:
        for slot in (slot for obj in objects for slot in obj.material_slots):
            if slot.material is None:
                if stand_in is None:
                    stand_in = bpy.data.materials.new("Lightpanes Reference")
                slot.material = stand_in
                empty.append(slot)
            material = slot.material
            if material.node_tree is None:
                material.use_nodes = True
            tree = material.node_tree
            if any(known == tree for known, _, _ in added):
                continue
            node = tree.nodes.new("ShaderNodeTexImage")
            added.append((tree, node, tree.nodes.active))
            node.image = image
            tree.nodes.active = node
        yield
    finally:
        for tree, node, active in added:
            tree.nodes.remove(node)
            if active is not None:
                tree.nodes.active = active
        for slot in empty:
            slot.material = None
        if stand_in is not None:
            bpy.data.materials.remove(stand_in)
