"""What a material does to diffuse light: albedo, emission and straight-through transmission.

Plain node trees are read as constants; `maps` bakes the others.

Glossy lobes return light too, and Cycles counts it in diffuse indirect light. `gloss_albedo` is the
share that a dielectric's lobe adds, fitted to indirect light in closed boxes and spheres by Cycles 4.5 and
5.2 (alike to 0.1 %): Principled of base colour c reflects as a Lambertian of c + E (1 − c), E = 0.03 to 0.037
by default; the base colour alone leaves a box 4 % (c = 0.8) to 13 % (c = 0.2) too dark. Metallic lobes are
left out, as the renderer's diffuse colour leaves them out.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ..core.scene import Material, Scene
from .optics import coarse_glass, open_glass, read_optics, scattered
from .trees import CONSTANT_NODES, constant, source, surface_output, uses_nodes
from .unfolded import Unfolded

PLACEHOLDER = Material("Unread")
EMPTY_SLOT = Material("No material", albedo=(0.8, 0.8, 0.8))
GREY = np.full(3, 0.8)
BLACK = np.zeros(3)
WHITE = np.ones(3)


@dataclass(frozen=True)
class Look:
    """A shader as constants, (3,) each, linear; None where it varies over the surface."""

    albedo: np.ndarray | None
    emission: np.ndarray | None
    transmission: np.ndarray | None

    @property
    def varies(self) -> bool:
        return self.albedo is None or self.emission is None or self.transmission is None


def read_materials(
    context,
    scene: Scene,
    used: list,
    sources: list,
    resolution: int,
    *,
    bake: bool = True,
    atlas: Unfolded | None = None,
) -> None:
    """Fill `scene.materials` and its maps in place.

    used: Blender's material (or None for an empty slot) for each of scene.materials. sources: Blender's
    object for each of scene.objects. bake=False bakes nothing but the transmission that shadow rays need.
    atlas: as for `extract.extract`.
    """
    from . import maps

    looks = [look(material, scene.warnings) for material in used]
    wanted = {kind for each in looks for kind in ("albedo", "emission", "transmission") if getattr(each, kind) is None}
    if not bake:
        wanted &= {"transmission"}
    materials = [_material(material, each) for material, each in zip(used, looks, strict=True)]
    # without the add-on registered there is no setting, and nothing to put caustics in
    if getattr(getattr(context.scene, "lightpanes", None), "caustics", False):
        materials = [
            _with_optics(each, material, seen, scene.warnings)
            for each, material, seen in zip(materials, used, looks, strict=True)
        ]
    scene.materials = tuple(materials)
    scene.warnings += coarse_glass(scene) + open_glass(scene)
    if wanted:
        maps.bake_maps(context, scene, used, sources, looks, wanted, resolution, atlas)
    for material in scene.materials:
        if max(material.albedo) >= 0.99:
            scene.warnings.append(
                f"Material '{material.name}' reflects all light that it gets; its albedo is limited so that light dies out."
            )


def _material(material, each: Look) -> Material:
    if material is None:
        return EMPTY_SLOT
    values = {"albedo": GREY, "emission": BLACK, "transmission": BLACK}
    values = {
        kind: getattr(each, kind) if getattr(each, kind) is not None else default for kind, default in values.items()
    }
    return replace(
        Material(material.name, mapped=each.varies),
        **{kind: tuple(float(v) for v in value) for kind, value in values.items()},
    )


def _with_optics(each: Material, material, seen: Look, warnings) -> Material:
    """With its mirror and glass, and, where the colour beside these varies, its mean as far as that can be read without a
    bake: whoever reads maps and who does not must take the same materials for casters of caustics."""
    optics = read_optics(material, warnings)
    if optics is not None and seen.albedo is None and (mean := scattered(material)) is not None:
        each = replace(each, albedo=tuple(float(v) for v in mean))
    return replace(each, optics=optics)


def look(material: bpy.types.Material | None, warnings: list[str]) -> Look:
    """The material as constants as far as its node tree is plain."""
    if material is None:
        return Look(GREY, BLACK, BLACK)
    tree = material.node_tree
    if not uses_nodes(material):
        return Look(np.array(material.diffuse_color[:3]), BLACK, BLACK)
    output = surface_output(tree)
    if output is None:
        return Look(BLACK, BLACK, BLACK)
    _warn_unsupported(material, output, warnings)
    if not output.inputs["Surface"].is_linked:
        # a volume alone has no surface to stop at
        return Look(BLACK, BLACK, WHITE if output.inputs["Volume"].is_linked else BLACK)
    return _shader(source(output.inputs["Surface"]), material.name, warnings)


def _warn_unsupported(material, output, warnings) -> None:
    if output.inputs["Volume"].is_linked:
        warnings.append(
            f"Material '{material.name}' has a volume, which is not honoured but by caustics: light passes it unchanged."
        )
    if output.inputs["Displacement"].is_linked and getattr(material, "displacement_method", "BUMP") != "BUMP":
        warnings.append(
            f"Material '{material.name}' displaces its surface, which is not honoured: use a Displace modifier."
        )


def gloss_albedo(roughness: float, ior: float, level: float = 0.5) -> float:
    """Share of diffuse light that a dielectric's glossy lobe returns before the base is reached.

    level: Principled's Specular IOR Level, 0.5 being physical. Fitted, see the module's head; ± 0.01 absolute for roughness ≥ 0.2.
    """
    normal = ((ior - 1.0) / (ior + 1.0)) ** 2 * 2.0 * level
    return float(np.clip(normal * (0.95 - 0.6 * roughness**2), 0.0, 1.0))


def principled_gloss(node: bpy.types.Node) -> float:
    """`gloss_albedo` of a Principled node and its coat; varying inputs count as their defaults."""

    def value(name, default):
        found = constant(node.inputs[name])
        return default if found is None else found

    base = gloss_albedo(value("Roughness", 0.5), value("IOR", 1.5), value("Specular IOR Level", 0.5))
    coat = value("Coat Weight", 0.0) * gloss_albedo(value("Coat Roughness", 0.03), value("Coat IOR", 1.5))
    return 1.0 - (1.0 - base) * (1.0 - coat)


def gloss_by_angle(node: bpy.types.Node) -> tuple[float, float, float]:
    """(base, edge, power): base + edge · (1 − c)^power is what a Principled node's gloss and coat return of light along a
    direction, c being its cosine to the normal, before the base is reached.

    Fitted to Cycles 5.2's reflection of a white world, IOR 1.2 to 1.5: ± 0.01 for c > 0.25, roughness ≥ 0.05. Varying
    inputs count as their defaults.
    """

    def value(name, default):
        found = constant(node.inputs[name])
        return default if found is None else found

    def lobe(roughness, ior, level):
        facing = min(((ior - 1) / (ior + 1)) ** 2 * 2 * level, 1.0)
        edge = (0.1 + 1.42 / (1 + (roughness / 0.36) ** 4)) * facing**0.25
        return facing * (1 - 0.65 * roughness**2.8), edge, 2 + 1.7 / (1 + (roughness / 0.4) ** 3)

    base, edge, power = lobe(value("Roughness", 0.5), value("IOR", 1.5), value("Specular IOR Level", 0.5))
    coat = float(np.clip(value("Coat Weight", 0.0), 0, 1))
    if coat:
        more, steep, rising = lobe(value("Coat Roughness", 0.03), value("Coat IOR", 1.5), 0.5)
        base, total = base + coat * more, edge + coat * steep
        edge, power = total, (edge * power + coat * steep * rising) / max(total, 1e-9)
    return min(base, 1.0), edge, power


def _shader(node, name, warnings) -> Look:
    if node is None:
        return Look(BLACK, BLACK, BLACK)
    reader = _READERS.get(node.type)
    if reader is not None:
        return reader(node, name, warnings)
    if node.type == "GROUP" and _passes_light(node.node_tree):
        warnings.append(f"Material '{name}' lets light through inside a node group, which is not honoured: ungroup it.")
    elif node.type in {"BSDF_TRANSLUCENT", "SUBSURFACE_SCATTERING"}:
        warnings.append(
            f"Material '{name}' scatters light through its surface, which is not honoured: it is taken as opaque."
        )
    return Look(None, None, BLACK)


def _passes_light(tree) -> bool:
    return tree is not None and any(
        node.type in {"BSDF_TRANSPARENT", "BSDF_GLASS", "BSDF_REFRACTION"}
        or (node.type == "BSDF_PRINCIPLED" and constant(node.inputs["Alpha"]) != 1.0)
        or (node.type == "GROUP" and _passes_light(node.node_tree))
        for node in tree.nodes
    )


def _principled(node, name, warnings) -> Look:
    base = constant(node.inputs["Base Color"])
    metallic, alpha = constant(node.inputs["Metallic"]), constant(node.inputs["Alpha"])
    glass = constant(node.inputs["Transmission Weight"])
    colour, strength = constant(node.inputs["Emission Color"]), constant(node.inputs["Emission Strength"])
    albedo = emission = transmission = None
    if alpha is not None:
        alpha = float(np.clip(alpha, 0.0, 1.0))
        if base is not None and metallic is not None and glass is not None:
            gloss = principled_gloss(node)
            albedo = alpha * (1 - metallic) * (1 - glass) * (base + gloss * (1 - base))
        elif metallic == 1.0 or glass == 1.0 or alpha == 0.0:
            # whatever its colour is, nothing is scattered
            albedo = BLACK
        if strength == 0.0:
            emission = BLACK
        elif colour is not None and strength is not None:
            emission = alpha * colour * strength
        if glass == 0.0 or metallic == 1.0:
            transmission = (1 - alpha) * WHITE
        elif base is not None and glass is not None and metallic is not None:
            # Cycles tints each of a pane's two faces by the root of the colour
            passing = glass * (1 - metallic) * np.sqrt(np.clip(base, 0, 1)) * (1 - principled_gloss(node))
            transmission = (1 - alpha) + alpha * passing
    elif strength == 0.0:
        emission = BLACK
    return Look(albedo, emission, transmission)


def _diffuse(node, name, warnings) -> Look:
    return Look(constant(node.inputs["Color"]), BLACK, BLACK)


def _emission(node, name, warnings) -> Look:
    colour, strength = constant(node.inputs["Color"]), constant(node.inputs["Strength"])
    return Look(BLACK, None if colour is None or strength is None else colour * strength, BLACK)


def _transparent(node, name, warnings) -> Look:
    return Look(BLACK, BLACK, constant(node.inputs["Color"]))


def _glass(node, name, warnings) -> Look:
    colour, ior = constant(node.inputs["Color"]), constant(node.inputs["IOR"])
    if colour is None:
        return Look(BLACK, BLACK, None)
    reflected = gloss_albedo(0.0, 1.45 if ior is None else ior) if node.type == "BSDF_GLASS" else 0.0
    return Look(BLACK, BLACK, colour * (1 - reflected))


def _opaque(node, name, warnings) -> Look:
    return Look(BLACK, BLACK, BLACK)


def _mix(node, name, warnings) -> Look:
    share = constant(node.inputs[0])
    first, second = (_shader(source(node.inputs[k]), name, warnings) for k in (1, 2))
    if share is not None:
        share = float(np.clip(share, 0, 1))
        if share in (0.0, 1.0):
            return second if share else first

    def blend(a, b):
        if a is not None and b is not None and np.array_equal(a, b):
            return a
        return None if a is None or b is None or share is None else (1 - share) * a + share * b

    return Look(
        *(blend(getattr(first, kind), getattr(second, kind)) for kind in ("albedo", "emission", "transmission"))
    )


def _add(node, name, warnings) -> Look:
    first, second = (_shader(source(node.inputs[k]), name, warnings) for k in (0, 1))

    def total(a, b):
        return None if a is None or b is None else a + b

    return Look(
        *(total(getattr(first, kind), getattr(second, kind)) for kind in ("albedo", "emission", "transmission"))
    )


_READERS = {
    "BSDF_PRINCIPLED": _principled,
    "BSDF_DIFFUSE": _diffuse,
    "EMISSION": _emission,
    "BSDF_TRANSPARENT": _transparent,
    "BSDF_GLASS": _glass,
    "BSDF_REFRACTION": _glass,
    "BSDF_GLOSSY": _opaque,
    "BSDF_METALLIC": _opaque,
    "HOLDOUT": _opaque,
    "MIX_SHADER": _mix,
    "ADD_SHADER": _add,
}


def digest(material: bpy.types.Material) -> bytes:
    """Short hash of all that the node tree sets, for telling whether a bake is stale."""
    result = hashlib.blake2b(digest_size=8)
    result.update(repr((material.name, tuple(material.diffuse_color))).encode())
    if material.node_tree is not None:
        digest_tree(material.node_tree, result)
    return result.digest()


def digest_tree(tree: bpy.types.NodeTree, result, seen: set | None = None) -> None:
    """Add to a hash all that a tree's nodes set, but for ours. seen: trees that it holds already."""
    seen = set() if seen is None else seen
    if tree in seen:
        return
    seen.add(tree)
    for node in tree.nodes:
        if node.get("lightpanes"):
            continue
        values = [_plain(socket.default_value) for socket in node.inputs if hasattr(socket, "default_value")]
        if node.type in CONSTANT_NODES:
            values.append(_plain(node.outputs[0].default_value))
        image = getattr(node, "image", None)
        result.update(repr((node.bl_idname, node.mute, image.name if image else "", values, _own(node))).encode())
        if node.type == "GROUP" and node.node_tree is not None:
            digest_tree(node.node_tree, result, seen)
    for link in tree.links:
        if not (link.from_node.get("lightpanes") or link.to_node.get("lightpanes")):
            ends = (link.from_node.name, link.from_socket.identifier, link.to_node.name, link.to_socket.identifier)
            result.update(repr(ends).encode())


def _own(node) -> list:
    """What a node of this type has beside its sockets, such as an operation or a ramp."""
    found = []
    for item in node.bl_rna.properties:
        name = item.identifier
        # which output is active changes by ours
        if name in bpy.types.Node.bl_rna.properties or name == "is_active_output":
            continue
        value = getattr(node, name)
        if item.type in {"BOOLEAN", "INT", "FLOAT", "STRING", "ENUM"}:
            found.append((name, _plain(value)))
        elif isinstance(value, bpy.types.ColorRamp):
            ramp = [(element.position, tuple(element.color)) for element in value.elements]
            found.append((name, value.interpolation, value.color_mode, ramp))
        elif isinstance(value, bpy.types.CurveMapping):
            found.append((name, [[tuple(point.location) for point in curve.points] for curve in value.curves]))
    return found


def _plain(value):
    if isinstance(value, bpy.types.ID):
        return value.name
    return tuple(value) if hasattr(value, "__len__") and not isinstance(value, str) else value
