"""The parts of a bake up to its panes: surfaces, entries, transport, training lamps, modes, weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..caustics import casters
from ..footprint import balanced, crowded, takes_points
from ..panes.entry_light import EntryLight, EntrySurface
from ..panes.held_out import held_out_lamps, representative
from ..panes.modes import Modes, learn_modes, training_fields
from ..panes.regions import features, make_regions, nearest, rooms, signature, split_regions, starts_of
from ..panes.training import NAME as ANYWHERE
from ..panes.training import illuminate, training_lamps
from ..panes.weights import PaneWeights, make_weights
from ..planner import Budget, Settings, needs_panes, plan
from ..rays import Bvh, Tracer
from ..scene import Light, Scene, SceneError
from ..surface import Patches, SurfaceSamples, Texels, Vertices, cut_patches, make_patches, make_texels, make_vertices
from ..transfer import (
    ElementTransport,
    Entries,
    Gatherer,
    Transport,
    find_elements,
    find_entries,
    link_elements,
    make_gatherer,
    make_piece_gatherer,
    make_transport,
)
from ..transfer.covered import covered
from ..transfer.entries import MAX_ALBEDO, PLACES
from .clock import Clock
from .kept import Kept
from .steady import piece_excess, sky_bins, static_caustics, static_light, steady_light

PILOTS = 32_768
"""Texels, about, whose rays find the entries where points are the exits."""

KEPT_BACK = 0.88
"""Part of the time left that is planned for: no plan is kept exactly."""

KEPT_FOR_CHECK = 0.9
"""The same of the rays at exits, after which there is but the check, and what is written."""

FEW_RAYS = 16
"""Of an exit, by which it is seen how long more of them take."""

FOCUSING = 0.05
"""Part of the time left in which caustics of lamps that are not live are traced, in the hurried bake and in the other."""

TICKS = 1000
"""Of the clock, in which they are counted."""

HURRIED_SCOUTS = 3000
"""In a hurried bake, which is but looked at, of places from which entries are sought (transfer.entries.SCOUTS)."""

GUIDES = 16
"""Training lamps that steer the points' density."""

CANDIDATES = 72
"""Lamps of which TEST_LAMPS are chosen."""

DIM = 0.1
"""Lamps somewhere in the air that light less than this part of what most of them do are no test: outside, say, or in a crack."""

TEST_LAMPS = 24
"""Held-out lamps that measure the error at the end of a bake; three at a time take red, green and blue."""


@dataclass(frozen=True)
class EntryFields:
    """Light of lamps of unit power at the entries, W/m². radiosity: (ids, l, 3) float32, 0 where an id is no entry;
    arriving: (n, l, 3) float32 indirect irradiance."""

    radiosity: np.ndarray
    arriving: np.ndarray


@dataclass
class Prepared:
    """Everything but the exits' gather.

    exits: where texels are the exits, the valid ones, sorted by region, and starts: (regions + 1,) where each region's
    begin; where points are, all texels, and no starts. vertices: places of objects that are lit at their vertices.
    is_buried: tells of places whether they lie inside solid things; buried: how many texels were found to. tables:
    (regions, ids, c) what a ray that lands on an id brings: the region's modes, then, where the scene has light that no
    live lamp changes, its bounces (3) and, where sky or faces shine, their first hit (3). guide: (1, ids, c) radiosity
    of a few lamps, None where texels are the exits. test_lamps: held-out ones, of unit power, and test_direct: (n, l) the
    irradiance of each at the entries, seen from all places; none where no lamp is live. kept: parts that were finished
    before. fields: of the test lamps, all their bounces, and looks: light gathered anew at the places that are judged
    (`verdict.judge`); both made when first asked for.
    """

    scene: Scene
    budget: Budget
    patches: Patches
    bvh: Bvh
    tracer: Tracer
    entries: Entries
    gatherer: Gatherer
    transport: Transport | ElementTransport | None
    places: SurfaceSamples
    surface: EntrySurface
    modes: Modes
    weights: PaneWeights
    exits: Texels
    starts: np.ndarray | None
    vertices: Vertices
    tables: np.ndarray
    guide: np.ndarray | None
    is_buried: Callable[[SurfaceSamples], np.ndarray]
    test_lamps: list[Light]
    test_direct: np.ndarray | None
    buried: int
    warnings: list[str]
    kept: Kept
    fields: EntryFields | None = None
    looks: object = None

    @property
    def has_steady_light(self) -> bool:
        return self.tables.shape[2] > self.modes.panes

    @property
    def has_first_hit(self) -> bool:
        return self.tables.shape[2] > self.modes.panes + 3


@dataclass(frozen=True)
class Surfaces:
    """What a bake starts from, whatever its budget. at_points: whether exits are points. focuses: whether anything casts
    caustics. hurried: whether the bake is but looked at, and its texels are those where it is."""

    scene: Scene
    texels: Texels
    vertices: Vertices
    tracer: Tracer
    at_points: bool
    resolution: int
    focuses: bool
    hurried: bool = False


def prepare(scene: Scene, settings: Settings, clock: Clock | None = None, kept: Kept | None = None) -> Prepared:
    """Run all stages up to the exits' gather, but for parts that are `kept`, with the budgets that the planner begins
    with. Raises SceneError for scenes that cannot be baked."""
    clock, budget = clock or Clock(), plan(scene, settings)
    return prepare_with(find_surfaces(scene, settings, clock), settings, budget, clock, kept or Kept())


def find_surfaces(scene: Scene, settings: Settings, clock: Clock) -> Surfaces:
    """The surfaces, and whether exits are points. Raises SceneError for scenes that cannot be baked."""
    clock.start("Surfaces")
    texels, vertices = make_texels(scene, settings.resolution), make_vertices(scene)
    at_points = takes_points(settings, plan(scene, settings), len(scene.triangles), len(texels), len(vertices))
    focusing = casters(scene)
    # what focuses a lamp's light casts a shadow of it
    tracer = Tracer(scene, solid=None if focusing is None else focusing.triangles)
    return Surfaces(scene, texels, vertices, tracer, at_points, settings.resolution, focusing is not None)


def transport_parts(entries: int) -> tuple[str, ...]:
    """Names of the kept parts that nothing needs once a bake is prepared."""
    return f"transport {entries}", f"links {entries}", f"lamps {entries}"


def time_left(settings: Settings, clock: Clock) -> float:
    """s of the time budget."""
    return settings.time_budget - clock.ahead - clock.spent


def prepare_with(
    surfaces: Surfaces,
    settings: Settings,
    budget: Budget,
    clock: Clock,
    kept: Kept,
    judges: list[Light] | None = None,
) -> Prepared:
    """The stages after the surfaces', with a budget. What is kept goes by the number of entries asked for.

    judges: held-out lamps, None for some that are drawn here.
    """
    scene, seed, at_points = surfaces.scene, settings.seed, surfaces.at_points
    texels, vertices, tracer = surfaces.texels, surfaces.vertices, surfaces.tracer
    warnings = list(scene.warnings)
    clock.start("Entries")
    # without live lamps pieces of entries tell them apart
    count = balanced(budget.entries, settings.memory)
    patches = make_patches(scene, count, seed)
    finer = None
    if count < budget.entries and needs_panes(scene):
        finer, patches, owner = cut_patches(scene, patches, budget.entries, seed)
    bvh = Bvh(patches.corners)
    # points need not ask of each texel: those that a point serves are not buried
    step = max(-(-len(texels) // PILOTS), 1) if at_points else 1
    pilot = texels.samples.take(slice(None, None, step)).join(vertices.samples)
    entries, buried, is_buried = find_entries(
        scene, patches, bvh, pilot, tracer.offset, seed, HURRIED_SCOUTS if surfaces.hurried else None
    )
    if sentence := crowded(len(entries), settings.memory):
        raise SceneError(sentence)
    if buried.all():
        buried[:] = False
        is_buried = _nothing
        warnings.append("Every texel lies inside a closed object; put a lamp inside the room, or flip its normals.")
    if not at_points:
        buried |= covered(scene, texels, Tracer(scene) if surfaces.focuses else tracer, seed)
        texels = texels.keep(~buried | buried.all())
    warnings += _too_white(scene, patches)
    bins = sky_bins(scene.sky)
    gatherer = make_gatherer(scene, patches, entries, bvh, tracer.offset, bins)

    elements, whole = None, (entries, gatherer)
    if finer is not None:
        elements, patches = find_elements(scene, finer, owner, entries, is_buried, seed), finer
        entries, gatherer = elements.sides, make_gatherer(scene, finer, elements.sides, bvh, tracer.offset, bins)

    clock.start("Transport", (len(whole[0]) + (0 if elements is None else len(elements))) * budget.entry_rays)

    transport = kept.part(
        f"transport {budget.entries}", lambda: make_transport(*whole, budget.entry_rays, seed, clock.tick)
    )
    if elements is not None:
        links = kept.part(
            f"links {budget.entries}",
            lambda: link_elements(whole[0], elements, transport, gatherer, budget.entry_rays, seed, clock.tick),
        )
        transport = ElementTransport(elements, transport, links)

    places = entries.places
    surface = EntrySurface.of(entries, patches, places, tracer.offset)
    if needs_panes(scene):
        lamps = training_lamps(scene, places, gatherer, budget.lamps, seed + 6)
        clock.start("Lamps", len(lamps))
        direct = kept.part(
            f"lamps {budget.entries}",
            lambda: illuminate(lamps, places, PLACES, tracer, seed, lambda n: clock.tick(n, n * len(entries))),
        )
        test = _judges(scene, entries, gatherer, transport, surface, tracer, seed) if judges is None else judges
        test = [replace(lamp, power=np.ones(3)) for lamp in test[: len(test) // 3 * 3]]
        eyes = EntryLight(surface, tracer, seed, few=PLACES)
        test_direct = np.stack([grey(eyes.unit(lamp)) for lamp in test], 1)

        clock.start("Panes", 4)
        radiosity, field = training_fields(entries, transport, direct)
        clock.tick(1, 0)
        points = features(entries.position, entries.normal, scene.extent)
        # rooms lie farther apart than anything within one
        room = rooms(transport.between) if elements is None else rooms(transport.whole.between)[elements.entry]
        far = 4 * room[:, None].astype(np.float32)
        alike = np.concatenate([points, signature(field[:, ::2]), far], 1)
        region = make_regions(alike, entries.area, max(budget.regions // 4, 1), seed)
        region = split_regions(region, alike, entries.area, field[:, ::2], budget.regions, budget.panes)
        modes = learn_modes(entries, transport, region, radiosity, field, budget.panes)
        clock.tick(1, 0)
        weights = make_weights(entries, transport, modes, room, direct[:, ::8], seed)
        clock.tick(1, 0)
    else:
        modes, weights, test, test_direct = *no_panes(entries), [], None
    static = static_light(scene, surface, tracer, seed)
    arriving = static
    if static is not None and surfaces.focuses:
        arriving = static + _focused(surfaces, surface, settings, clock)
    steady, shine = steady_light(scene.sky, bins, entries, transport, arriving)
    tables = _tables(modes, steady, shine, gatherer.size)
    # the tables hold them
    modes = replace(modes, makers=None)
    if test_direct is None:
        # without panes there is room for a row for every piece of every entry
        gatherer, owner = make_piece_gatherer(scene, patches, entries, bvh, tracer.offset, bins)
        tables = tables[:, np.append(owner, np.arange(len(entries), tables.shape[1]))]
        bounces = slice(modes.panes, modes.panes + 3)
        tables[0, : len(owner), bounces] += piece_excess(scene, patches, entries, owner, static, tracer, seed)
    guide = None
    if at_points and test_direct is None:
        guide = tables[:, :, bounces]
    elif at_points:
        some = transport.solve(entries.albedo.mean(axis=1, keepdims=True), radiosity[:, :GUIDES], 1e-2)
        guide = np.zeros((1, gatherer.size, some.shape[1]), np.float32)
        guide[0, : len(entries)] = some
    made = Prepared(
        scene, budget, patches, bvh, tracer, entries, gatherer, transport, places, surface, modes, weights,
        texels, None, vertices, tables, guide, is_buried, test, test_direct, int(buried.sum()), warnings, kept,
    )  # fmt: skip
    if not at_points:
        own = own_region(made, texels.samples)
        made.exits = texels.keep(np.lexsort((texels.index, own)))
        made.starts = starts_of(own, modes.regions)
    return made


def _judges(scene, entries, gatherer, transport, surface, tracer, seed):
    """TEST_LAMPS held-out lamps that stand for many."""
    many = held_out_lamps(scene, entries.places, gatherer, CANDIDATES, seed + 1006)
    if not many:
        return many
    eyes = EntryLight(surface, tracer, seed, few=1)
    direct = np.stack([grey(eyes.unit(lamp)) for lamp in many], 1)
    field = transport.arriving(entries.albedo.mean(axis=1, keepdims=True) * direct)
    area = (entries.area / entries.area.sum()).astype(np.float32)
    mean = area @ field
    alike = np.array([lamp.name for lamp in many]) == ANYWHERE
    # suns are measured in other units; where nothing is passed on, all are alike
    kept = np.flatnonzero(~alike | (mean >= DIM * np.median(mean[alike]))) if alike.any() else np.arange(len(many))
    uneven = np.sqrt(area @ field**2) / np.maximum(mean, 1e-30)
    return representative([many[k] for k in kept], uneven[kept], TEST_LAMPS)


def _focused(surfaces: Surfaces, surface: EntrySurface, settings: Settings, clock: Clock) -> np.ndarray:
    """(n, 3) caustics of the lamps that are not live at the entries."""
    clock.start("Caustics", TICKS)
    told = 0

    def tell(part):
        nonlocal told
        clock.tick(int(TICKS * part) - told, 0)
        told = int(TICKS * part)

    seconds = FOCUSING * time_left(settings, clock) if settings.time_budget else np.inf
    given = surfaces.scene, surface, surfaces.resolution, surfaces.tracer, settings.seed, settings.photons
    return static_caustics(*given, tell, seconds)


def gather_in_time(
    made: Prepared, settings: Settings, clock: Clock, field: str, places: int, gather: Callable[[int, int], np.ndarray]
) -> np.ndarray:
    """What `gather` returns of rays, a number, and a seed: so many as the budget's `field` says, from so many places, or,
    where a time budget binds, as there is time for.

    How long they take is seen from a few.
    """
    seed, rays = settings.seed + 41, getattr(made.budget, field)
    clock.start("Exits", places * rays)
    if not settings.time_budget:
        return gather(rays, seed)
    began = clock.spent
    few = gather(min(FEW_RAYS, rays), seed + 100)
    each = max(clock.spent - began, 1e-4) / min(FEW_RAYS, rays)
    more = int(min(rays, KEPT_FOR_CHECK * time_left(settings, clock) / each))
    if more <= 2 * FEW_RAYS:
        made.budget = replace(made.budget, **{field: min(FEW_RAYS, rays)})
        return few
    made.budget = replace(made.budget, **{field: more})
    return gather(more, seed)


def grey(values: np.ndarray) -> np.ndarray:
    """(n,) of (n,) or (n, 3)."""
    return values if values.ndim == 1 else values.mean(axis=1)


def _nothing(samples: SurfaceSamples) -> np.ndarray:
    return np.zeros(len(samples), bool)


def no_panes(entries: Entries) -> tuple[Modes, PaneWeights]:
    """One region with one black pane: for scenes in which no lamp may change."""
    count = len(entries)
    nothing = np.zeros((count, 1), np.float32)
    region = np.zeros(count, np.int32)
    modes = Modes(region, 1, 1, nothing, nothing, nothing)
    small = np.zeros((3, 1, 1), np.float32)
    return modes, PaneWeights(nothing.T.copy(), small[0], small, region, nothing, entries.albedo)


def _too_white(scene, patches):
    """Warnings for albedos that the solve lowers."""
    white = (patches.albedo > MAX_ALBEDO).any(axis=1)
    if not white.any():
        return []
    material = np.unique(scene.triangle_material[patches.parent[white[patches.patch]]])
    names = ", ".join(f"'{scene.materials[m].name}'" for m in material)
    return [f"Albedo above {MAX_ALBEDO} is lowered to {MAX_ALBEDO} (the light would never fade): {names}."]


def _tables(modes, steady, shine, ids):
    """(regions, ids, c): what a ray that lands on an id brings: the region's modes, then the steady shares."""
    count, k = len(modes.basis), modes.panes
    extra = 0 if steady is None else 3 if shine is None else 6
    tables = np.zeros((modes.regions, ids, k + extra), np.float32)
    tables[:, :count, :k] = modes.makers.reshape(count, modes.regions, k).swapaxes(0, 1)
    if steady is not None:
        tables[:, :count, k : k + 3] = steady
    if shine is not None:
        tables[:, :, k + 3 :] = shine
    return tables


def own_region(made: Prepared, samples: SurfaceSamples) -> np.ndarray:
    """(t,) region of each place: that of the entry it lies on, else of the nearest."""
    bvh, entries, patches, region, extent = made.bvh, made.entries, made.patches, made.modes.region, made.scene.extent
    lift = np.float32(4 * made.tracer.offset)
    triangle = np.concatenate(
        [
            bvh.closest(
                np.ascontiguousarray(samples.position[s] + samples.flat[s] * lift),
                np.ascontiguousarray(-samples.flat[s]),
            )
            for s in (slice(i, i + 65536) for i in range(0, len(samples), 65536))
        ]
    )
    cross = np.cross(patches.corners[:, 1] - patches.corners[:, 0], patches.corners[:, 2] - patches.corners[:, 0])
    front = np.einsum("nd,nd->n", cross[triangle], samples.flat) > 0
    patch = patches.patch[triangle]
    entry = np.where(front, entries.front_id[patch], entries.back_id[patch])
    own = np.append(region, 0)[entry]
    lost = np.flatnonzero((triangle < 0) | (entry == len(entries)) | (patches.parent[triangle] != samples.triangle))
    if len(lost):
        points = features(entries.position, entries.normal, extent)
        near = nearest(features(samples.position[lost], samples.flat[lost], extent), points)
        own[lost] = region[near]
    return own
