"""What a material mirrors and bends: the lobes of its shader that can focus light, as `core.scene.Optics` has them.

As Cycles has them: a metal reflects by the F82 tint model (Kutz et al. 2021), which is Schlick's curve where the tint is
white; Principled tints refracted light by the root of its base colour at each crossing, a Glass node by its colour, and
what it reflects, too. Gloss over an opaque base, coat and sheen are left out: too weak to focus much.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import bpy
import numpy as np

from ..core.caustics.casters import SHARP, is_caster
from ..core.scene import Optics, Scene
from .trees import constant, source, surface_output, uses_nodes

BLACK, WHITE = np.zeros(3), np.ones(3)
GREY = np.full(3, 0.8)

SCHLICK_82 = (6 / 7) ** 5
"""Schlick's weight of the edge where the cosine is 1/7, near 82°, at which Cycles' metals have their tint."""

PIXELS = 1 << 16
"""Of an image, that its mean is taken from, about."""

ROUGH = 1.0


@dataclass(frozen=True)
class _Lobes:
    """As Optics, colours (3,) arrays."""

    mirror: np.ndarray = field(default_factory=BLACK.copy)
    mirror_edge: np.ndarray = field(default_factory=BLACK.copy)
    glass: np.ndarray = field(default_factory=BLACK.copy)
    gloss: np.ndarray = field(default_factory=BLACK.copy)
    clear: np.ndarray = field(default_factory=BLACK.copy)
    ior: float = 1.5
    roughness: float = 0.0

    def scaled(self, weight: float) -> _Lobes:
        """A part of it; nothing of none."""
        if weight <= 0:
            return _Lobes()
        colours = {name: getattr(self, name) * weight for name in COLOURS}
        return replace(self, **colours)

    @property
    def refracts(self) -> bool:
        return bool(self.glass.any() or self.gloss.any())

    @property
    def is_any(self) -> bool:
        """Whether anything is mirrored or bent; what passes straight on is no matter of caustics by itself."""
        return self.refracts or bool(self.mirror.any() or self.mirror_edge.any())

    def plus(self, other: _Lobes, notes: list[str]) -> _Lobes:
        if self.refracts and other.refracts and abs(self.ior - other.ior) > 1e-3:
            notes.append("mixes two kinds of glass: its caustics are bent by the first one's IOR")
        colours = {name: getattr(self, name) + getattr(other, name) for name in COLOURS}
        ior = self.ior if self.refracts or not other.is_any else other.ior
        return _Lobes(**colours, ior=ior, roughness=max(self.roughness, other.roughness))


COLOURS = ("mirror", "mirror_edge", "glass", "gloss", "clear")


def read_optics(material: bpy.types.Material | None, warnings: list[str]) -> Optics | None:
    """Its lobes that mirror or bend light, None where it has none. warnings: what caustics don't honour of them."""
    if material is None or not uses_nodes(material):
        return None
    output = surface_output(material.node_tree)
    shader = source(output.inputs["Surface"]) if output is not None else None
    if shader is None:
        return None
    notes: list[str] = []
    lobes = _shader(shader, notes)
    if not lobes.is_any:
        # parts whose share varies are none, and worth a word
        warnings += _sentences(material, [note for note in notes if note == VARIES])
        return None
    if lobes.refracts and SHARP < lobes.roughness < ROUGH:
        notes.append(
            f"is rough glass, through which light passes straight on, without caustics; they need {SHARP:g} or less"
        )
    absorption = _absorption(source(output.inputs["Volume"]), notes) if lobes.refracts else BLACK
    warnings += _sentences(material, notes)
    colours = {name: _three(np.clip(getattr(lobes, name), 0, None)) for name in COLOURS}
    return Optics(
        **colours, ior=lobes.ior, absorption=_three(absorption), roughness=float(np.clip(lobes.roughness, 0, 1))
    )


def scattered(material: bpy.types.Material) -> np.ndarray | None:
    """(3,) what a Principled material scatters diffusely beside its metal and glass, by the mean of its texture; None
    where that is not plain."""
    output = surface_output(material.node_tree)
    node = source(output.inputs["Surface"]) if output is not None else None
    if node is None or node.type != "BSDF_PRINCIPLED":
        return None
    shares = [constant(node.inputs[name]) for name in ("Metallic", "Transmission Weight", "Alpha")]
    if None in shares:
        return None
    metallic, glass, alpha = (float(np.clip(share, 0, 1)) for share in shares)
    return alpha * (1 - metallic) * (1 - glass) * np.clip(_colour(node.inputs["Base Color"], []), 0, 1)


def coarse_glass(scene: Scene) -> list[str]:
    """Sentences about objects whose glass has too few faces to focus light where it ought to."""
    refracts = np.array([is_caster(m) and bool(any(m.optics.glass)) for m in scene.materials], bool)
    rows = np.flatnonzero(refracts[scene.triangle_material])
    if not len(rows):
        return []
    normals, owner = scene.corner_normals[rows], scene.triangle_object[rows]
    # of the corner that differs most from the next
    least = np.einsum("tkd,tkd->tk", normals, np.roll(normals, 1, axis=1)).min(axis=1)
    curved, flat = least < SAME, least >= SAME
    told = []
    for k in np.unique(owner):
        mine, name = owner == k, scene.objects[k].name
        bends = np.degrees(np.arccos(np.clip(least[mine & curved], -1, 1)))
        if len(bends) and np.median(bends) > COARSE:
            told.append(f"'{name}' is coarse for glass, so that its caustics are not quite in place: subdivide it.")
        elif len(np.unique(np.round(normals[mine & flat, 0], 2), axis=0)) > FACETS:
            told.append(
                f"'{name}' is coarse for glass: its flat faces throw a patch of light each; shade it smooth where it is "
                "meant to be round."
            )
    return told


COARSE = 9.0
"""Degrees by which the normals of a face may differ: a sphere of 24 rings has 8 to 9, and focuses 1.4 % amiss (tests/core/test_caustic_meshes.py)."""

FACETS = 40
"""Directions that the flat faces of a cut stone may have, and a round thing more."""

SAME = 1 - 1e-5
"""Cosine between normals above which a face is flat."""

VARIES = "is partly metal or glass, by something that varies over it: it casts no caustics"


def _sentences(material, notes) -> list[str]:
    return [f"Material '{material.name}' {note}." for note in dict.fromkeys(notes)]


def _three(value) -> tuple[float, float, float]:
    return tuple(float(v) for v in value)


def _shader(node, notes) -> _Lobes:
    reader = _READERS.get(node.type) if node is not None else None
    if reader is not None:
        return reader(node, notes)
    if node is not None and node.type == "GROUP" and _has_lobes(node.node_tree):
        notes.append(VARIES)
    return _Lobes()


def _has_lobes(tree) -> bool:
    kinds = {"BSDF_GLASS", "BSDF_REFRACTION", "BSDF_GLOSSY", "BSDF_METALLIC"}
    return tree is not None and any(
        node.type in kinds or (node.type == "GROUP" and _has_lobes(node.node_tree)) for node in tree.nodes
    )


def _principled(node, notes) -> _Lobes:
    metallic, alpha = constant(node.inputs["Metallic"]), constant(node.inputs["Alpha"])
    glass = constant(node.inputs["Transmission Weight"])
    if metallic == 0.0 and glass == 0.0:
        return _Lobes() if alpha is None else _through(alpha)
    if metallic is None or alpha is None or glass is None:
        # what a texture makes metal is seldom polished, and not worth a word
        rough = constant(node.inputs["Roughness"])
        if rough is not None and rough < 0.1:
            notes.append(VARIES)
        return _Lobes()
    metallic, glass, alpha = (float(np.clip(value, 0, 1)) for value in (metallic, glass, alpha))
    thin = 0.0
    if _is_set(node, "Thin Wall"):
        # bends nothing: light passes it straight on
        thin, glass = glass, 0.0
    if not (alpha and (metallic or glass or thin)):
        return _through(alpha)
    base = np.clip(_colour(node.inputs["Base Color"], notes), 0, 1)
    tint = np.clip(_colour(node.inputs["Specular Tint"], notes), 0, 1)
    roughness = _surface(node, notes)
    metal = _Lobes(base, _edge(base, tint * (base + (1 - base) * SCHLICK_82)), roughness=roughness)
    inner = _Lobes(glass=np.sqrt(base), gloss=WHITE, ior=_ior(node, notes), roughness=roughness)
    lobes = metal.scaled(alpha * metallic).plus(inner.scaled(alpha * (1 - metallic) * glass), notes)
    return lobes.plus(_through(alpha), notes).plus(_Lobes(clear=alpha * (1 - metallic) * thin * np.sqrt(base)), notes)


def _through(alpha: float) -> _Lobes:
    """What a surface of this alpha lets straight on."""
    return _Lobes(clear=(1 - float(np.clip(alpha, 0, 1))) * WHITE)


def _is_set(node, name) -> bool:
    """Whether a switch that only newer Blenders have is on, or may be."""
    socket = node.inputs.get(name)
    return socket is not None and bool(socket.is_linked or socket.default_value)


def _glass(node, notes) -> _Lobes:
    colour = np.clip(_colour(node.inputs["Color"], notes), 0, None)
    return _Lobes(glass=colour, gloss=colour, ior=_ior(node, notes), roughness=_surface(node, notes))


def _transparent(node, notes) -> _Lobes:
    return _Lobes(clear=np.clip(_colour(node.inputs["Color"], notes), 0, 1))


def _refraction(node, notes) -> _Lobes:
    """Nothing is reflected, so that the part which Fresnel's equations take away has to be given back; that is exact
    where light comes from straight above."""
    colour, ior = np.clip(_colour(node.inputs["Color"], notes), 0, None), _ior(node, notes)
    lost = ((ior - 1) / (ior + 1)) ** 2
    return _Lobes(glass=colour / (1 - lost), ior=ior, roughness=_surface(node, notes))


def _glossy(node, notes) -> _Lobes:
    colour = np.clip(_colour(node.inputs["Color"], notes), 0, None)
    return _Lobes(colour, colour, roughness=_surface(node, notes))


def _metallic(node, notes) -> _Lobes:
    if node.fresnel_type == "F82":
        base, tint = (np.clip(_colour(node.inputs[name], notes), 0, 1) for name in ("Base Color", "Edge Tint"))
        steep = tint * (base + (1 - base) * SCHLICK_82)
    else:
        index = [np.array(node.inputs[name].default_value, np.float64) for name in ("IOR", "Extinction")]
        base, steep = (_conductor(*index, cosine) for cosine in (1.0, 1 / 7))
    return _Lobes(base, _edge(base, steep), roughness=_surface(node, notes))


def _edge(normal: np.ndarray, steep: np.ndarray) -> np.ndarray:
    """The edge with which Schlick's curve goes through what is reflected straight on and at 82°."""
    return np.clip(normal + (steep - normal) / SCHLICK_82, 0, 1)


def _conductor(n: np.ndarray, k: np.ndarray, cosine: float) -> np.ndarray:
    """Fresnel's equations for a metal of complex index n + ik, both polarisations alike."""
    square, sine = cosine**2, 1 - cosine**2
    inner = n**2 - k**2 - sine
    both = np.sqrt(inner**2 + 4 * n**2 * k**2)
    real = np.sqrt(np.maximum((both + inner) / 2, 0))
    across = (both + square - 2 * real * cosine) / (both + square + 2 * real * cosine)
    side, up = both * square + sine**2, 2 * real * cosine * sine
    return (across + across * (side - up) / (side + up)) / 2


def _mix(node, notes) -> _Lobes:
    share = constant(node.inputs[0])
    parts = [_shader(source(node.inputs[k]), notes) for k in (1, 2)]
    if share is None:
        if any(part.is_any for part in parts):
            notes.append(VARIES)
        return _Lobes()
    share = float(np.clip(share, 0, 1))
    return parts[0].scaled(1 - share).plus(parts[1].scaled(share), notes)


def _add(node, notes) -> _Lobes:
    first, second = (_shader(source(node.inputs[k]), notes) for k in (0, 1))
    return first.plus(second, notes)


def _ior(node, notes) -> float:
    value = constant(node.inputs["IOR"])
    if value is None:
        notes.append("has an IOR that varies: caustics take 1.5")
        return 1.5
    return float(max(value, 1e-3))


def _surface(node, notes) -> float:
    """Its roughness; ROUGH where that varies, which casts no caustics."""
    if node.inputs["Normal"].is_linked:
        notes.append("has a normal or bump map, which its caustics don't honour: displace the mesh")
    # a node that is set to Sharp in files of older versions has no roughness
    if getattr(node, "distribution", "") == "SHARP":
        return 0.0
    value = constant(node.inputs["Roughness"])
    if value is None:
        notes.append("has a roughness that varies: it casts no caustics")
        return ROUGH
    return float(value)


def _colour(socket, notes) -> np.ndarray:
    """(3,) its colour, or the mean of the image that it shows."""
    value = constant(socket)
    if value is not None:
        return value
    node = source(socket)
    if node.type == "TEX_IMAGE" and node.image is not None and node.image.size[0]:
        notes.append("has a textured colour: its caustics take the mean")
        return _mean(node.image)
    notes.append("has a colour that varies: its caustics take a light grey")
    return GREY


def _mean(image: bpy.types.Image) -> np.ndarray:
    """(3,) linear mean colour of an image."""
    width, height = image.size
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height * width, -1)
    pixels = pixels[:: max(1, len(pixels) // PIXELS)]
    colours = np.repeat(pixels[:, :1], 3, axis=1) if pixels.shape[1] < 3 else pixels[:, :3]
    if image.colorspace_settings.name == "sRGB" and not image.is_float:
        colours = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    return colours.mean(axis=0, dtype=np.float64)


def _absorption(node, notes) -> np.ndarray:
    """(3,) 1/m of a volume; what scatters is not honoured."""
    if node is None:
        return BLACK
    if node.type == "ADD_SHADER":
        return sum(_absorption(source(node.inputs[k]), notes) for k in (0, 1))
    if node.type == "VOLUME_ABSORPTION":
        colour, density = constant(node.inputs["Color"]), constant(node.inputs["Density"])
        if colour is not None and density is not None:
            return max(density, 0.0) * np.clip(1 - colour, 0, None)
    elif node.type == "VOLUME_COEFFICIENTS" and not node.inputs["Absorption Coefficients"].is_linked:
        if any(node.inputs["Scatter Coefficients"].default_value) or node.inputs["Scatter Coefficients"].is_linked:
            notes.append("has a volume that scatters, which its caustics don't honour")
        return np.clip(np.array(node.inputs["Absorption Coefficients"].default_value, np.float64), 0, None)
    notes.append("has a volume that varies or scatters, which its caustics don't honour: use Volume Absorption")
    return BLACK


_READERS = {
    "BSDF_PRINCIPLED": _principled,
    "BSDF_GLASS": _glass,
    "BSDF_TRANSPARENT": _transparent,
    "BSDF_REFRACTION": _refraction,
    "BSDF_GLOSSY": _glossy,
    "BSDF_METALLIC": _metallic,
    "MIX_SHADER": _mix,
    "ADD_SHADER": _add,
}
