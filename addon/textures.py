"""Materials as the preview engine shows them, read at once and without Cycles: constants, and image textures as albedo.

What is neither is shown by the atlas' albedo of a bake, by a mean that `prepared` has from Cycles, or in grey.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy
import numpy as np

from ..core.preview import Texture
from ..core.scene import Material, Scene
from . import materials, prepared
from .optics import read_optics

EXTENSIONS = {"REPEAT": "REPEAT", "EXTEND": "EXTEND", "CLIP": "CLIP", "MIRROR": "REPEAT"}
LARGEST = 4096
"""Texels a side of an image that is read in full; of larger ones every second, third … is taken."""


@dataclass(frozen=True)
class _Found:
    """An image texture behind a shader's colour: albedo = offset + scale · texel. layer: of UVs, "" the one that renders."""

    node: bpy.types.Node
    layer: str
    transform: np.ndarray | None
    scale: float
    offset: float


@dataclass
class Textures:
    """The materials of one reading of the scene. warnings: more are added."""

    warnings: list[str]
    _found: dict[bpy.types.Material | None, _Found | None] = field(default_factory=dict)

    def layer_of(self, material: bpy.types.Material | None) -> str | None:
        """Name of the UV layer that the material's texture reads, None without one."""
        if material not in self._found:
            self._found[material] = _texture(material)
        found = self._found[material]
        return None if found is None else found.layer

    def read(self, scene: Scene, used: list[bpy.types.Material | None], has_albedo: bool) -> dict[int, Texture]:
        """Fill `scene.materials`; returns the textures of those that have one. has_albedo: the scene has an albedo map,
        which mapped materials show."""
        textures: dict[int, Texture] = {}
        made = []
        placed = np.isfinite(scene.atlas_uv).all((1, 2))
        for number, material in enumerate(used):
            look = materials.look(material, self.warnings)
            name = material.name if material is not None else materials.EMPTY_SLOT.name
            values = {"albedo": look.albedo, "emission": look.emission, "transmission": look.transmission}
            mapped = False
            if look.albedo is None:
                found = self._found.get(material)
                texture = _read_texture(found, name, self.warnings) if found is not None else None
                own = scene.triangle_material == number
                if texture is not None:
                    textures[number] = texture
                    values["albedo"] = texture.mean
                elif has_albedo and placed[own].any():
                    mapped = True
            for kind, default in (
                ("albedo", materials.GREY),
                ("emission", materials.BLACK),
                ("transmission", materials.BLACK),
            ):
                if values[kind] is not None:
                    continue
                mean = prepared.mean(material, kind)
                values[kind] = default if mean is None else mean
                if not mapped or kind != "albedo":
                    shown = (
                        "in grey"
                        if mean is None and kind == "albedo"
                        else "as nothing"
                        if mean is None
                        else "as its mean"
                    )
                    self.warnings.append(
                        f"Material '{name}': its {kind} varies in a way that the preview shows {shown}."
                    )
            colours = {kind: tuple(float(v) for v in np.broadcast_to(value, 3)) for kind, value in values.items()}
            made.append(Material(name, mapped=mapped, optics=read_optics(material, []), **colours))
        scene.materials = tuple(made)
        return textures


def has_texture(material: bpy.types.Material | None) -> bool:
    """Whether its albedo is an image that can be read directly."""
    return _texture(material) is not None


def _texture(material) -> _Found | None:
    """The image behind a Principled or Diffuse shader's colour, if nothing but a mapping is in between."""
    if material is None or material.node_tree is None:
        return None
    output = materials.surface_output(material.node_tree)
    shader = materials.source(output.inputs["Surface"]) if output is not None else None
    if shader is None or shader.type not in {"BSDF_PRINCIPLED", "BSDF_DIFFUSE"}:
        return None
    principled = shader.type == "BSDF_PRINCIPLED"
    node = materials.source(shader.inputs["Base Color" if principled else "Color"])
    if node is None or node.type != "TEX_IMAGE" or node.image is None or node.projection != "FLAT":
        return None
    layer, transform = _coordinates(node)
    if layer is None:
        return None
    scale, offset = 1.0, 0.0
    if principled:
        shares = [materials.constant(shader.inputs[name]) for name in ("Alpha", "Metallic", "Transmission Weight")]
        if shares[1] is None or shares[2] is None:
            return None
        # an alpha that varies is a cut-out, whose albedo counts where it is opaque
        alpha, metallic, glass = (1.0 if share is None else float(np.clip(share, 0, 1)) for share in shares)
        gloss = materials.principled_gloss(shader)
        whole = alpha * (1 - metallic) * (1 - glass)
        scale, offset = whole * (1 - gloss), whole * gloss
    return _Found(node, layer, transform, scale, offset)


def _coordinates(node) -> tuple[str | None, np.ndarray | None]:
    """The UV layer that an image node reads and what is done to it, (2, 3) or None; None where it reads no layer."""
    before = materials.source(node.inputs["Vector"])
    transform = None
    if before is not None and before.type == "MAPPING":
        transform = _mapping(before)
        if transform is None:
            return None, None
        before = materials.source(before.inputs["Vector"])
        if before is None:
            return None, None
    if before is None:
        return "", transform
    if before.type == "UVMAP" and not before.from_instancer:
        return before.uv_map, transform
    if before.type == "TEX_COORD" and not before.from_instancer and _comes_from(node, "UV"):
        return "", transform
    return None, None


def _comes_from(node, output: str) -> bool:
    socket = node.inputs["Vector"]
    while socket.is_linked:
        link = socket.links[0]
        if link.from_node.type in {"MAPPING", "REROUTE"}:
            socket = link.from_node.inputs["Vector" if link.from_node.type == "MAPPING" else 0]
            continue
        return link.from_socket.name == output
    return False


def _mapping(node) -> np.ndarray | None:
    """(2, 3) of a Mapping node of constants that stays in the plane."""
    if node.vector_type not in {"POINT", "TEXTURE"} or any(
        node.inputs[name].is_linked for name in ("Location", "Rotation", "Scale") if name in node.inputs
    ):
        return None
    scale, turn = np.array(node.inputs["Scale"].default_value), np.array(node.inputs["Rotation"].default_value)
    place = np.array(node.inputs["Location"].default_value) if "Location" in node.inputs else np.zeros(3)
    if abs(turn[0]) > 1e-6 or abs(turn[1]) > 1e-6:
        return None
    c, s = np.cos(turn[2]), np.sin(turn[2])
    linear = np.array([[c, -s], [s, c]]) @ np.diag(scale[:2])
    if node.vector_type == "POINT":
        return np.column_stack([linear, place[:2]])
    if abs(np.linalg.det(linear)) < 1e-20:
        return None
    back = np.linalg.inv(linear)
    return np.column_stack([back, -back @ place[:2]])


def _read_texture(found: _Found, name: str, warnings: list[str]) -> Texture | None:
    pixels = _pixels(found.node.image)
    # bytes come in the image's own space, floats are linear already
    encoded = not found.node.image.is_float and found.node.image.colorspace_settings.name == "sRGB"
    if pixels is None:
        warnings.append(
            f"Material '{name}': the image '{found.node.image.name}' cannot be read, so it is shown in magenta. "
            "Find it by File > External Data > Find Missing Files."
        )
        # as Cycles shows what is missing
        pixels = np.array([[[1.0, 0.0, 1.0]]], np.float32)
    return Texture(
        pixels,
        np.full(3, found.scale, np.float32),
        np.full(3, found.offset, np.float32),
        EXTENSIONS[found.node.extension],
        found.node.interpolation != "Closest",
        found.transform,
        encoded,
    )


_images: dict[int, tuple[tuple, np.ndarray]] = {}


def _pixels(image) -> np.ndarray | None:
    """(H, W, 3) float32, as Blender has them; None where the image has none. Kept until the image changes."""
    key = (image.size[:], image.filepath_raw, image.colorspace_settings.name, image.source, image.is_dirty)
    held = _images.get(image.session_uid)
    if held is not None and held[0] == key and not image.is_dirty:
        return held[1]
    if not image.has_data and len(image.pixels):
        image.pixels[0]  # reads the file
    width, height = image.size
    if not image.has_data or width * height == 0 or image.channels < 1:
        return None
    pixels = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height, width, image.channels)
    step = -(-max(width, height) // LARGEST)
    pixels = pixels[::step, ::step]
    pixels = np.repeat(pixels[..., :1], 3, axis=2) if image.channels < 3 else pixels[..., :3]
    pixels = np.nan_to_num(pixels, nan=0.0, posinf=0.0, neginf=0.0)
    pixels = np.ascontiguousarray(pixels, np.float32)
    _images[image.session_uid] = key, pixels
    return pixels


def forget() -> None:
    """Drop all images."""
    _images.clear()
