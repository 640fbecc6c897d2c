"""What is baked: surfaces, materials, lamps and sky, as plain validated arrays.

Units are Blender's: metres (the unit scale is ignored, as Cycles ignores it), watts, linear
Rec.709 colour. Everything is in world space.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .memory import slices

LIGHT_KINDS = ("POINT", "SPOT", "SUN", "AREA")
AREA_SHAPES = ("SQUARE", "RECTANGLE", "DISK", "ELLIPSE")


class SceneError(ValueError):
    """The scene cannot be used; the message says which object is at fault and what to do."""


@dataclass(frozen=True)
class Optics:
    """How a smooth surface mirrors and bends light, beside what it scatters diffusely; colours as 3 linear floats.

    mirror, mirror_edge: reflectance of metallic lobes seen straight on and at grazing angles, Schlick's curve between
        them, weights multiplied in; equal where it does not depend on the angle.
    glass: tint of light that is refracted at one crossing; gloss: tint of what a dielectric reflects by Fresnel's
        equations. Weights are multiplied in; both black where the surface lets nothing in.
    clear: the part of light that passes straight on beside these lobes (alpha, a mix with Transparent), without what
        glass refracts, in [0, 1]. Shadow rays carry it where caustics are on.
    ior: refractive index of the inside over that of the outside, the side that normals point to.
    absorption: of the inside, 1/m (Beer and Lambert).
    roughness: as Blender's sliders have it, in [0, 1]; of the roughest lobe that counts.
    """

    mirror: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mirror_edge: tuple[float, float, float] = (0.0, 0.0, 0.0)
    glass: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gloss: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ior: float = 1.5
    absorption: tuple[float, float, float] = (0.0, 0.0, 0.0)
    roughness: float = 0.0
    clear: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Material:
    """Diffuse view of a material, colours as 3 linear floats.

    albedo: diffuse reflectance in [0, 1], metallic and transmitting parts taken out.
    emission: emitted radiance, W/(m² sr).
    transmission: the part of light that passes straight on, in [0, 1]: 0 is opaque, 1 invisible
        (cut-out alpha and thin glazing). `albedo` is what remains beside it.
    mapped: albedo, emission and transmission vary over the surface and are read from the scene's
        maps wherever a triangle has a place in the atlas; the constants are then their means.
    optics: of its mirror and glass lobes, None where it has none.
    """

    name: str
    albedo: tuple[float, float, float] = (0.8, 0.8, 0.8)
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    transmission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mapped: bool = False
    optics: Optics | None = None


@dataclass(frozen=True)
class SceneObject:
    """An object or one instance of it.

    receives: has a place in the atlas, so its texels are exits.
    at_vertices: takes its light at its vertices instead, without a place in the atlas.
    casts_shadow: blocks the lamps' shadow rays (Blender's ray visibility, Shadow).
    reflects: seen by diffuse rays (Blender's ray visibility, Diffuse).
    seen: by the camera (Blender's ray visibility, Camera).
    weight: texel density relative to the other objects.
    """

    name: str
    receives: bool = True
    casts_shadow: bool = True
    reflects: bool = True
    weight: float = 1.0
    at_vertices: bool = False
    seen: bool = True


@dataclass(frozen=True)
class Light:
    """A lamp. It shines along its own -Z, as in Blender.

    matrix: (4, 4) world matrix, scale removed from its rotation part (the scale is in `size`).
    power: (3,) radiant flux in W per channel; for a SUN the irradiance in W/m² of a surface that
        faces it. Energy, colour, exposure and temperature are multiplied in.
    radius: of a POINT or SPOT lamp, m. angle: angular diameter of a SUN, rad.
    spot_angle: full cone angle, rad; spot_blend: softness of its edge in [0, 1].
    shape, size: of an AREA lamp; full extents along local X and Y, m. spread: full angle, rad. For POINT and SPOT,
        shape "DISK" means Blender's soft falloff (a disk that faces the receiver), any other a sphere; for a SPOT,
        size is its X and Y scale over Z, (1, 1) for a round cone.
    casts_shadow: whether anything blocks it.
    live: whether it may change after the bake. A lamp that is not belongs to the light that the bake holds, like the
        sky; it costs no panes, and relighting leaves it alone.
    group: of lamps whose light is wanted by itself, "" for none.
    """

    name: str
    kind: str
    matrix: np.ndarray
    power: np.ndarray
    radius: float = 0.0
    angle: float = 0.0
    spot_angle: float = np.pi / 4
    spot_blend: float = 0.15
    shape: str = "SQUARE"
    size: tuple[float, float] = (1.0, 1.0)
    spread: float = np.pi
    casts_shadow: bool = True
    live: bool = True
    group: str = ""

    def __post_init__(self):
        if self.kind not in LIGHT_KINDS:
            raise SceneError(f"Lamp '{self.name}': unknown kind {self.kind!r}, use one of {', '.join(LIGHT_KINDS)}.")
        if self.kind == "AREA" and self.shape not in AREA_SHAPES:
            raise SceneError(f"Lamp '{self.name}': unknown shape {self.shape!r}, use one of {', '.join(AREA_SHAPES)}.")
        object.__setattr__(self, "matrix", np.asarray(self.matrix, np.float64).reshape(4, 4))
        object.__setattr__(self, "power", np.broadcast_to(np.asarray(self.power, np.float64), 3).copy())
        if not (np.isfinite(self.matrix).all() and np.isfinite(self.power).all()):
            raise SceneError(f"Lamp '{self.name}' has a place or power that is not a number; reset its transform.")

    @property
    def position(self) -> np.ndarray:
        """(3,) float64, m."""
        return self.matrix[:3, 3]

    @property
    def direction(self) -> np.ndarray:
        """(3,) float64 unit vector along which it shines."""
        axis = -self.matrix[:3, 2]
        return axis / np.linalg.norm(axis)

    @property
    def geometry(self) -> tuple:
        """Hashable key of all that shapes the lamp's light, its power excepted."""
        return (self.kind, self.matrix.tobytes(), self.radius, self.angle, self.spot_angle, self.spot_blend,
                self.shape, tuple(self.size), self.spread, self.casts_shadow)  # fmt: skip


@dataclass(frozen=True)
class Sky:
    """Light from infinity.

    radiance: (H, W, 3) float32, W/(m² sr), equirectangular in world space as Blender maps it:
        u = ½ − atan2(y, x)/2π, v = ½ + asin(z)/π, row 0 at v = 0 (straight down).
        A uniform sky is one texel.
    """

    radiance: np.ndarray

    def __post_init__(self):
        radiance = np.ascontiguousarray(self.radiance, np.float32)
        if radiance.ndim != 3 or radiance.shape[2] != 3 or not np.isfinite(radiance).all():
            raise SceneError("The world's radiance must be a (height, width, 3) array of finite numbers.")
        object.__setattr__(self, "radiance", radiance)

    @property
    def is_black(self) -> bool:
        return not self.radiance.any()


@dataclass
class Scene:
    """All that a bake reads.

    positions: (V, 3) float32, m. triangles: (T, 3) int32 into positions.
    corner_normals: (T, 3, 3) float32 unit shading normals; the flat normal where shading is flat.
    atlas_uv: (T, 3, 2) float32 in [0, 1]; NaN for triangles without a place in the atlas.
    texture_uv: (T, 3, 2) float32 of the image texture that a triangle's material reads, NaN where it reads none; None
        where nobody asked. Bakes don't read it.
    triangle_material, triangle_object: (T,) int32 into materials and objects.
    albedo_map, emission_map, transmission_map: (H, W, 3) float32 over the atlas, or None;
        row 0 is v = 0 (Blender's order). Read for `mapped` materials only.
    warnings: sentences for the user, each naming an object, gathered by whoever built the scene.

    Triangles with no area are dropped on construction; vertices that are not numbers raise
    SceneError with the object's name.
    """

    positions: np.ndarray
    triangles: np.ndarray
    corner_normals: np.ndarray | None = None
    atlas_uv: np.ndarray | None = None
    triangle_material: np.ndarray | None = None
    triangle_object: np.ndarray | None = None
    materials: tuple[Material, ...] = (Material("Default"),)
    objects: tuple[SceneObject, ...] = (SceneObject("Object"),)
    lights: tuple[Light, ...] = ()
    sky: Sky | None = None
    albedo_map: np.ndarray | None = None
    emission_map: np.ndarray | None = None
    transmission_map: np.ndarray | None = None
    warnings: list[str] = field(default_factory=list)
    texture_uv: np.ndarray | None = None

    def __post_init__(self):
        self.positions = np.ascontiguousarray(self.positions, np.float32).reshape(-1, 3)
        self.triangles = np.ascontiguousarray(self.triangles, np.int32).reshape(-1, 3)
        count = len(self.triangles)
        if self.triangle_material is None:
            self.triangle_material = np.zeros(count, np.int32)
        if self.triangle_object is None:
            self.triangle_object = np.zeros(count, np.int32)
        if self.atlas_uv is None:
            self.atlas_uv = np.full((count, 3, 2), np.nan, np.float32)
        self.materials, self.objects, self.lights = tuple(self.materials), tuple(self.objects), tuple(self.lights)
        self.triangle_material = np.ascontiguousarray(self.triangle_material, np.int32)
        self.triangle_object = np.ascontiguousarray(self.triangle_object, np.int32)
        self.atlas_uv = np.ascontiguousarray(self.atlas_uv, np.float32)
        self._validate()
        cross = self.triangle_cross()
        if self.corner_normals is None:
            unit = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-30)
            self.corner_normals = np.repeat(unit[:, None], 3, axis=1)
        self.corner_normals = np.ascontiguousarray(self.corner_normals, np.float32)
        self._drop_degenerate(cross)

    def _validate(self):
        count = len(self.triangles)
        if count == 0:
            raise SceneError(
                "There are no faces to bake: the scene has no visible mesh. Add one, or turn on its camera icon in the Outliner."
            )
        for name in ("triangle_material", "triangle_object", "atlas_uv"):
            if len(getattr(self, name)) != count:
                raise SceneError(f"{name} has {len(getattr(self, name))} rows for {count} triangles.")
        if self.triangles.min() < 0 or self.triangles.max() >= len(self.positions):
            raise SceneError("A triangle names a vertex that does not exist.")
        if self.triangle_material.min() < 0 or self.triangle_material.max() >= len(self.materials):
            raise SceneError("A triangle names a material that does not exist.")
        if self.triangle_object.min() < 0 or self.triangle_object.max() >= len(self.objects):
            raise SceneError("A triangle names an object that does not exist.")
        bad = ~np.isfinite(self.positions).all(axis=1)
        if bad.any():
            owners = np.unique(self.triangle_object[bad[self.triangles].any(axis=1)])
            names = ", ".join(f"'{self.objects[i].name}'" for i in owners) or "an object"
            raise SceneError(
                f"{names} has vertices that are not numbers (NaN or infinite); run Mesh > Clean Up > Delete Loose on it, or undo the edit that broke it."
            )

    def _drop_degenerate(self, cross):
        keep = np.empty(len(self.triangles), bool)
        for s in slices(len(keep), 500):
            # float64: the square of a small edge underflows float32 in millimetre scenes
            area2 = np.linalg.norm(cross[s].astype(np.float64), axis=1)
            corners = self.positions[self.triangles[s]].astype(np.float64)
            edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
            keep[s] = area2 > 1e-7 * edges.max(axis=1) ** 2
        if keep.all():
            return
        if not keep.any():
            raise SceneError("Every face has zero area; scale the objects up or apply their scale.")
        for name in ("triangles", "corner_normals", "atlas_uv", "texture_uv", "triangle_material", "triangle_object"):
            if getattr(self, name) is not None:
                setattr(self, name, np.ascontiguousarray(getattr(self, name)[keep]))

    def triangle_cross(self, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """(n, 3) float32 of the triangles at `rows`, all if not given: geometric normal times twice the area."""
        named = self.triangles[rows]
        cross = np.empty((len(named), 3), np.float32)
        for s in slices(len(named), 100):
            a, b, c = self.positions[named[s].T]
            cross[s] = np.cross(b - a, c - a)
        return cross

    @property
    def extent(self) -> float:
        """Diagonal of the bounding box, m."""
        used = self.positions[used_rows(self.triangles, len(self.positions))]
        return float(np.linalg.norm(np.ptp(used.astype(np.float64), axis=0)))


def used_rows(names: np.ndarray, count: int) -> np.ndarray:
    """(u,) of `count` rows those that `names`, an int array of any shape, holds; in order.

    What np.unique gives, which takes a hundred times as long for a mesh and holds the GIL.
    """
    used = np.zeros(count, bool)
    used[names] = True
    return np.flatnonzero(used)
