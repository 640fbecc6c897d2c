"""What a bake stands on: surfaces, and entries with who meets them, before any light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..caustics import casters
from ..caustics.bending import Bending
from ..footprint import balanced, crowded, takes_points
from ..planner import Budget, Settings, needs_panes, plan
from ..rays import Bvh, Tracer
from ..scene import Scene, SceneError
from ..surface import Patches, SurfaceSamples, Texels, Vertices, cut_patches, make_patches, make_texels, make_vertices
from ..transfer import Elements, Entries, Gatherer, find_bending, find_elements, find_entries, make_gatherer
from ..transfer.covered import covered
from ..transfer.entries import MAX_ALBEDO
from .clock import Clock
from .steady import sky_bins

PILOTS = 32_768
"""Texels, about, whose rays find the entries where points are the exits."""

HURRIED_SCOUTS = 3000
"""In a hurried bake, which is but looked at, of places from which entries are sought (transfer.entries.SCOUTS)."""


@dataclass(frozen=True)
class Surfaces:
    """What a bake starts from, whatever its budget. texels: but for those that something covers; covered: how many those
    are. at_points: whether exits are points. focuses: whether anything casts caustics. bending: what mirrors or refracts
    bounced light, None for none. hurried: whether the bake is but looked at, and its texels are those where it is."""

    scene: Scene
    texels: Texels
    covered: int
    vertices: Vertices
    tracer: Tracer
    at_points: bool
    resolution: int
    focuses: bool
    bending: Bending | None = None
    hurried: bool = False


def find_surfaces(scene: Scene, settings: Settings, clock: Clock) -> Surfaces:
    """The surfaces, and whether exits are points. Raises SceneError for scenes that cannot be baked."""
    clock.start("Surfaces")
    texels, vertices = make_texels(scene, settings.resolution), make_vertices(scene)
    at_points = takes_points(settings, plan(scene, settings), len(scene.triangles), len(texels), len(vertices))
    focusing = casters(scene)
    # what focuses a lamp's light casts a shadow of it
    tracer = Tracer(scene, solid=None if focusing is None else focusing.triangles)
    hidden = covered(scene, texels, tracer if focusing is None else Tracer(scene), settings.seed, clock.pulse)
    count = 0 if hidden.all() else int(hidden.sum())
    if count:
        texels = texels.keep(~hidden)
    return Surfaces(
        scene,
        texels,
        count,
        vertices,
        tracer,
        at_points,
        settings.resolution,
        focusing is not None,
        find_bending(scene),
    )


@dataclass(frozen=True)
class Ground:
    """Entries and who meets them. whole: entries between which light is balanced, and their gatherer; these are `entries`
    and `gatherer` unless there are elements of them, which then stand in for entries. texels: those that are not inside
    of things, or covered; buried: how many are. Where points are exits, `texels` has those inside of things still. is_buried:
    tells of places whether they are. bins: of the sky."""

    patches: Patches
    bvh: Bvh
    entries: Entries
    gatherer: Gatherer
    whole: tuple[Entries, Gatherer]
    elements: Elements | None
    texels: Texels
    is_buried: Callable[[SurfaceSamples], np.ndarray]
    buried: int
    bins: np.ndarray | None
    warnings: list[str] = field(default_factory=list)


def part_name(kind: str, entries: int, hurried: bool) -> str:
    """What a kept part of so many entries asked for is called: a hurried bake finds others of them."""
    return f"{kind} {entries}, hurried" if hurried else f"{kind} {entries}"


def find_ground(surfaces: Surfaces, settings: Settings, budget: Budget, clock: Clock) -> Ground:
    """As many entries as the budget has. Raises SceneError where there are more than memory allows."""
    scene, seed, tracer, texels = surfaces.scene, settings.seed, surfaces.tracer, surfaces.texels
    warnings = list(scene.warnings)
    clock.start("Entries")
    # without live lamps pieces of entries tell them apart
    count = balanced(budget.entries, settings.memory)
    patches = make_patches(scene, count, seed, tracer)
    finer = None
    if count < budget.entries and needs_panes(scene):
        finer, patches, owner = cut_patches(scene, patches, budget.entries, seed)
    bvh = Bvh(patches.corners)
    # points need not ask of each texel: those that a point serves are not buried
    step = max(-(-len(texels) // PILOTS), 1) if surfaces.at_points else 1
    pilot = texels.samples.take(slice(None, None, step)).join(surfaces.vertices.samples)
    scouts = HURRIED_SCOUTS if surfaces.hurried else None
    entries, buried, is_buried = find_entries(scene, patches, bvh, pilot, tracer.offset, seed, scouts)
    if sentence := crowded(len(entries), settings.memory):
        raise SceneError(sentence)
    if buried.all():
        buried[:] = False
        is_buried = _nothing
        warnings.append("Every texel lies inside a closed object; put a lamp inside the room, or flip its normals.")
    lost = surfaces.covered
    if not surfaces.at_points and buried.any():
        lost += int(buried.sum())
        texels = texels.keep(~buried)
    warnings += _too_white(scene, patches)
    bins = sky_bins(scene.sky)
    gatherer = make_gatherer(scene, patches, entries, bvh, tracer.offset, bins, surfaces.bending)
    elements, whole = None, (entries, gatherer)
    if finer is not None:
        elements, patches = find_elements(scene, finer, owner, entries, is_buried, seed), finer
        entries = elements.sides
        gatherer = make_gatherer(scene, finer, entries, bvh, tracer.offset, bins, surfaces.bending)
    return Ground(patches, bvh, entries, gatherer, whole, elements, texels, is_buried, lost, bins, warnings)


def _nothing(samples: SurfaceSamples) -> np.ndarray:
    return np.zeros(len(samples), bool)


def _too_white(scene, patches):
    """Warnings for albedos that the solve lowers."""
    white = (patches.albedo > MAX_ALBEDO).any(axis=1)
    if not white.any():
        return []
    material = np.unique(scene.triangle_material[patches.parent[white[patches.patch]]])
    names = ", ".join(f"'{scene.materials[m].name}'" for m in material)
    return [f"Albedo above {MAX_ALBEDO} is lowered to {MAX_ALBEDO} (the light would never fade): {names}."]
