"""The truth: irradiance in the shared atlas, path traced by Cycles, as two independent halves.

Cycles' DIFFUSE bake without the receiver's colour, times π, is irradiance in W/m². Nothing that
biases it is left on: no clamping, no filtered glossy, no light threshold, no adaptive sampling, no
fast approximation; 32 bounces (what lies beyond is below 0.1 % at the samples' albedos). The light
tree only chooses which lamp a path looks at, which is unbiased.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np

from ..core import metrics
from ..core.scene import SceneError
from . import linking
from .atlas import LAYER
from .pixels import read_pixels

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

    def compare(self, image: np.ndarray, valid: np.ndarray | None = None) -> metrics.Comparison:
        """How far (H, W, 3) irradiance is from this, its own noise subtracted, at texels that are valid, (H, W) bool, too."""
        mask = self.mask if valid is None else self.mask & valid
        return metrics.compare(image, self.image, mask, reference_halves=tuple(self.halves))

    @property
    def noise(self) -> float:
        """Relative RMSE on blocks that noise alone makes of `image`."""
        return self.compare(self.image).noise

    def samples_for(self, noise: float) -> int:
        """Samples a texel that each half of a reference as noisy as that takes: noise falls with their root."""
        return int(np.ceil(self.spp * (self.noise / noise) ** 2))


def indirect(
    context,
    resolution: int = 256,
    spp: int = 64,
    seed: int = 0,
    bounces: int = 32,
    progress: Callable[[], None] = lambda: None,
) -> Reference:
    """Indirect irradiance of the scene as it stands: lamps, sky and emission after at least one bounce.

    The scene's baked objects (`lightpanes_baked`) need their `Lightpanes` UVs; the scene itself is left as it
    was. progress is called before each half. Raises SceneError where nothing can be baked.
    """
    return halves(context, {"INDIRECT"}, resolution, spp, seed, bounces, progress)


def halves(
    context,
    passes: set[str],
    resolution: int,
    spp: int,
    seed: int = 0,
    bounces: int = 32,
    progress: Callable[[], None] = lambda: None,
) -> Reference:
    """Two bakes of other seeds. passes: {"DIRECT"}, {"INDIRECT"} or both."""
    made = []
    for k in range(2):
        progress()
        made.append(cycles_bake(context, passes, resolution, spp, 2 * seed + k + 1, bounces))
    return Reference(np.stack([half[0] for half in made]), made[0][1], spp, sum(half[2] for half in made))


def cycles_bake(
    context, passes: set[str], resolution: int, spp: int, seed: int = 0, bounces: int = 32
) -> tuple[np.ndarray, np.ndarray, float]:
    """One bake: (H, W, 3) float32 irradiance in W/m², (H, W) bool mask of written texels, seconds it took."""
    scene = context.scene
    objects = [o for o in scene.objects if o.get("lightpanes_baked") and not o.hide_render]
    if not objects:
        raise SceneError("No object of the scene has a place in the atlas; bake the scene first.")
    wrong = [o.name for o in objects if o.type != "MESH"]
    if wrong:
        raise SceneError(f"The reference bakes meshes only, not {', '.join(wrong)}.")
    image = bpy.data.images.new("Lightpanes Reference", resolution, resolution, alpha=True, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    try:
        with linking.suspended(scene), _settings(scene, spp, seed, bounces), _placed(objects), _targets(objects, image):
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
                    uv_layer=LAYER,
                    use_clear=True,
                    margin=0,
                )
            seconds = time.perf_counter() - started
        found = read_pixels(image)
    finally:
        bpy.data.images.remove(image)
    return found[..., :3] * np.float32(np.pi), found[..., 3] > 0, seconds


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
            layer = mesh.uv_layers.get(LAYER)
            if layer is None:
                raise SceneError(f"'{obj.name}' has no UV layer {LAYER}.")
            scale, offset = place(obj)
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


def place(obj: bpy.types.Object) -> list[tuple[float, float]]:
    """Scale and offset of the object's UVs in the atlas."""
    return [
        tuple(obj.get(key, default))
        for key, default in (("lightpanes_scale", (1.0, 1.0)), ("lightpanes_offset", (0.0, 0.0)))
    ]
