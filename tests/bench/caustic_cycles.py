"""Caustics against Cycles: the same light of a soft lamp in the same atlas, and the time that each takes to the same error.

Cycles' paths find a lamp's caustics only by chance, and those of a lamp without size never; so the lamp has a size here,
that of a bulb. What is compared is light that came by glass or metal alone: the bake's indirect light, the floor hidden
from rays that went there. Both are measured against one reference, point photons from places all over the lamp, and
Cycles' mean over many samples is held against it too.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import bpy
import numpy as np
from lightpanes.core import metrics
from lightpanes.core.caustics import PHOTONS, CausticAtlas
from lightpanes.core.scene import Light, Optics, Scene

from . import caustic_references, harness
from .caustic_stages import STAGES

RESOLUTION = 256
RADIUS = 0.03
"""m, of the lamp: a bulb."""

BAR = 1 / 1000
SAMPLES = 32, 128
"""Of Cycles' two bakes, the longer one of which tells its error; the time of a sample is what their difference took."""

REFERENCE = 2e7
LAMP_POINTS = 1024
REPEATS = 5
BOUNCES = 16


@dataclass
class Judge:
    """An atlas' reference, (2, blocks) halves of W/m² on 4 × 4 texels, and its texels on the floor."""

    mask: np.ndarray
    halves: list[np.ndarray]
    weight: np.ndarray

    @property
    def expected(self) -> np.ndarray:
        return (self.halves[0] + self.halves[1]) / 2

    @property
    def level(self) -> float:
        return float((self.weight * self.expected**2).sum())

    @property
    def noise(self) -> float:
        """Squared, of the reference."""
        return float((self.weight * (self.halves[0] - self.halves[1]) ** 2).sum()) / 4

    def blocks(self, image: np.ndarray) -> np.ndarray:
        return metrics.block_average(image, self.mask)[0][..., 0]

    def error(self, image: np.ndarray) -> float:
        """Relative to the reference's root mean square, its noise subtracted."""
        squared = float((self.weight * (self.blocks(image) - self.expected) ** 2).sum())
        return float(np.sqrt(max(squared - self.noise, 0.0) / self.level))

    def balance(self, image: np.ndarray) -> float:
        """All light over the reference's."""
        return float((self.weight * self.blocks(image)).sum() / (self.weight * self.expected).sum())


def rows():
    """One for each scene, and one for how far Cycles' mean and the reference agree."""
    for name in STAGES:
        yield from _rows(name)


def judge(name: str, atlas: CausticAtlas, light: Light) -> Judge:
    receivers = atlas._receivers
    power = caustic_references.reference(name, atlas._surfaces, receivers, light, REFERENCE, LAMP_POINTS)
    mask = np.zeros(RESOLUTION**2, bool)
    mask[receivers.texels.index[receivers.texels.centred]] = True
    mask = mask.reshape(RESOLUTION, RESOLUTION)
    images = [receivers.irradiance(half * light.power[0]).reshape(RESOLUTION, RESOLUTION, -1) for half in power]
    blocks, texels = metrics.block_average(images[0], mask)
    return Judge(mask, [blocks[..., 0], metrics.block_average(images[1], mask)[0][..., 0]], texels / texels.sum())


def _rows(name: str):
    stage = STAGES[name]()
    light = replace(stage.lamp, radius=RADIUS)
    atlas = CausticAtlas(stage.scene, RESOLUTION)
    judged = judge(name, atlas, light)
    ours = {}
    for photons in (PHOTONS, 4 * PHOTONS):
        seconds = []
        for _ in range(REPEATS if photons == PHOTONS else 2):
            atlas._lamps = {}
            began = time.perf_counter()
            image = atlas.image([light], photons)
            seconds.append(time.perf_counter() - began)
        ours[photons] = min(seconds), judged.error(image[..., :1])
    floor = build(stage.scene, light)
    baked = [bake(floor, RESOLUTION, samples, seed) for seed, samples in enumerate((*SAMPLES, SAMPLES[1]))]
    short, long = baked[0][1], min(spent for _, spent in baked[1:])
    each = (long - short) / (SAMPLES[1] - SAMPLES[0])
    squared = np.mean([judged.error(image) ** 2 for image, _ in baked[1:]])
    ratios = {}
    for photons, (seconds, error) in ours.items():
        needed = SAMPLES[1] * squared / error**2
        ratios[photons] = seconds / (needed * each)
    seconds, error = ours[PHOTONS]
    detail = (
        f"ours {seconds:.2f} s, error {error:.4f}; Cycles {SAMPLES[1]} samples in {each * SAMPLES[1]:.1f} s, error "
        f"{np.sqrt(squared):.2f}; 1/{1 / ratios[PHOTONS]:.0f}; with 160K photons ours {ours[4 * PHOTONS][0]:.2f} s, "
        f"{ours[4 * PHOTONS][1]:.4f}, 1/{1 / ratios[4 * PHOTONS]:.0f}; reference's noise {np.sqrt(judged.noise / judged.level):.4f}"
    )
    yield harness.row(f"caustics, {name}: time over Cycles' for equal error", ratios[PHOTONS], BAR, detail=detail)
    # two bakes with seeds of their own: what they have in common is no noise
    first, second = (judged.blocks(image) - judged.expected for image, _ in baked[1:])
    common = float((judged.weight * first * second).sum() - judged.noise) / judged.level
    mean = sum(judged.balance(image) for image, _ in baked[1:]) / 2
    detail = f"light in all over the reference's {mean:.4f}; squared bias {common:+.4f} of the reference's mean square"
    yield harness.row(f"caustics, {name}: Cycles over the reference", mean, detail=detail)


def build(scene: Scene, light: Light) -> bpy.types.Object:
    """The scene's two objects, floor and caster, and its lamp, in a new file. Returns the floor."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    objects = []
    for number, material in enumerate((_diffuse(), _sharp(scene.materials[1].optics))):
        rows = np.flatnonzero(scene.triangle_object == number)
        used, triangles = np.unique(scene.triangles[rows], return_inverse=True)
        triangles = triangles.reshape(-1, 3)
        mesh = bpy.data.meshes.new(f"Object {number}")
        mesh.from_pydata(scene.positions[used].tolist(), [], triangles.tolist())
        if number == 0:
            mesh.uv_layers.new(name="Atlas").uv.foreach_set("vector", scene.atlas_uv[rows].ravel())
        else:
            mesh.shade_smooth()
            mesh.normals_split_custom_set(scene.corner_normals[rows].reshape(-1, 3).tolist())
        mesh.materials.append(material)
        objects.append(bpy.data.objects.new(mesh.name, mesh))
        bpy.context.collection.objects.link(objects[-1])
    floor = objects[0]
    # light that came to the floor, was scattered and came again is none of this
    floor.visible_diffuse = floor.visible_glossy = floor.visible_transmission = False
    data = bpy.data.lights.new("Lamp", "POINT")
    data.energy, data.shadow_soft_size = float(light.power[0]), light.radius
    lamp = bpy.data.objects.new("Lamp", data)
    lamp.location = light.position
    bpy.context.collection.objects.link(lamp)
    return floor


def bake(floor: bpy.types.Object, resolution: int, samples: int, seed: int) -> tuple[np.ndarray, float]:
    """(resolution, resolution, 1) irradiance by way of glass or metal, W/m², and seconds."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.samples, cycles.seed, cycles.use_adaptive_sampling = samples, seed, False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = cycles.transmission_bounces = BOUNCES
    # no roulette before a path has gone through the glass and out again
    cycles.min_light_bounces = 4
    image = bpy.data.images.new("Baked", resolution, resolution, float_buffer=True)
    nodes = floor.data.materials[0].node_tree.nodes
    node = nodes.new("ShaderNodeTexImage")
    node.image = image
    nodes.active = node
    bpy.ops.object.select_all(action="DESELECT")
    floor.select_set(True)
    bpy.context.view_layer.objects.active = floor
    began = time.perf_counter()
    bpy.ops.object.bake(type="DIFFUSE", pass_filter={"INDIRECT"}, margin=0)
    spent = time.perf_counter() - began
    pixels = np.empty(resolution * resolution * 4, np.float32)
    image.pixels.foreach_get(pixels)
    nodes.remove(node)
    bpy.data.images.remove(image)
    # a bake without colour is radiance of a white surface
    return pixels.reshape(resolution, resolution, 4)[..., :1] * np.pi, spent


def _diffuse():
    material, shader = _material("Grey", "ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (1, 1, 1, 1)
    return material


def _sharp(optics: Optics):
    """Clear glass, or metal."""
    if max(optics.glass) > 0:
        material, shader = _material("Glass", "ShaderNodeBsdfGlass")
        shader.inputs["Roughness"].default_value, shader.inputs["IOR"].default_value = 0.0, optics.ior
        shader.inputs["Color"].default_value = (1, 1, 1, 1)
        return material
    material, shader = _material("Metal", "ShaderNodeBsdfPrincipled")
    shader.inputs["Metallic"].default_value, shader.inputs["Roughness"].default_value = 1.0, 0.0
    shader.inputs["Base Color"].default_value = (*optics.mirror, 1)
    shader.inputs["Specular Tint"].default_value = (*optics.mirror_edge, 1)
    return material


def _material(name: str, kind: str):
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    shader, output = nodes.new(kind), nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(shader.outputs[0], output.inputs[0])
    return material, shader
