"""A bake up to its panes: ground, transport, what is live, what is steady, and what rays then bring to the exits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..panes.entry_light import EntrySurface
from ..panes.modes import Modes
from ..panes.regions import features, nearest, starts_of
from ..panes.weights import PaneWeights
from ..planner import Budget, Settings, needs_panes, plan
from ..rays import Bvh, Tracer
from ..scene import Light, Scene
from ..surface import Patches, SurfaceSamples, Texels, Vertices
from ..transfer import (
    ElementTransport,
    Entries,
    Gatherer,
    Transport,
    link_elements,
    make_piece_gatherer,
    make_transport,
)
from .clock import Clock
from .ground import Ground, Surfaces, find_ground, find_surfaces, part_name
from .kept import Kept
from .live import learn, nothing_live
from .steady import piece_excess, static_caustics, static_light, steady_light

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

GUIDES = 16
"""Training lamps that steer the points' density."""


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
    begin; where points are, all texels that nothing covers, and no starts. vertices: places of objects that are lit at their
    vertices. is_buried: tells of places whether they lie inside solid things; buried: how many texels are covered, or, where
    texels are the exits, were found to lie inside things. tables:
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


def prepare(scene: Scene, settings: Settings, clock: Clock | None = None, kept: Kept | None = None) -> Prepared:
    """Run all stages up to the exits' gather, but for parts that are `kept`, with the budgets that the planner begins
    with. Raises SceneError for scenes that cannot be baked."""
    clock, budget = clock or Clock(), plan(scene, settings)
    return prepare_with(find_surfaces(scene, settings, clock), settings, budget, clock, kept or Kept())


def transport_parts(entries: int) -> tuple[str, ...]:
    """Names of the kept parts that nothing needs once a bake is prepared."""
    return tuple(
        part_name(kind, entries, hurried) for kind in ("transport", "links", "lamps") for hurried in (False, True)
    )


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
    """The stages after the surfaces', with a budget. What is kept goes by the number of entries asked for (`part_name`).

    judges: held-out lamps, None for some that are drawn here.
    """
    scene, seed, at_points, tracer = surfaces.scene, settings.seed, surfaces.at_points, surfaces.tracer
    ground = find_ground(surfaces, settings, budget, clock)
    patches, entries, gatherer = ground.patches, ground.entries, ground.gatherer
    transport = _transport(ground, surfaces.hurried, budget, clock, kept, seed)
    surface = EntrySurface.of(entries, patches, entries.places, tracer.offset)
    if needs_panes(scene):
        live = learn(surfaces, ground, surface, transport, budget, clock, kept, seed, judges)
    else:
        live = nothing_live(entries)
    modes = live.modes
    static = static_light(scene, surface, tracer, seed)
    arriving = static
    if static is not None and surfaces.focuses:
        arriving = static + _focused(surfaces, surface, settings, clock)
    tables = _tables(modes, *steady_light(scene.sky, ground.bins, entries, transport, arriving), gatherer.size)
    # the tables hold them
    modes = replace(modes, makers=None)
    guide = None
    if live.test_direct is None:
        # without panes there is room for a row for every piece of every entry
        given = scene, patches, entries, ground.bvh, tracer.offset, ground.bins, surfaces.bending
        gatherer, owner = make_piece_gatherer(*given)
        tables = tables[:, np.append(owner, np.arange(len(entries), tables.shape[1]))]
        bounces = slice(modes.panes, modes.panes + 3)
        tables[0, : len(owner), bounces] += piece_excess(scene, patches, entries, owner, static, tracer, seed)
        guide = tables[:, :, bounces] if at_points else None
    elif at_points:
        some = transport.solve(entries.albedo.mean(axis=1, keepdims=True), live.radiosity[:, :GUIDES], 1e-2)
        guide = np.zeros((1, gatherer.size, some.shape[1]), np.float32)
        guide[0, : len(entries)] = some
    made = Prepared(
        scene, budget, patches, ground.bvh, tracer, entries, gatherer, transport, entries.places, surface, modes,
        live.weights, ground.texels, None, surfaces.vertices, tables, guide, ground.is_buried, live.test_lamps,
        live.test_direct, ground.buried, ground.warnings, kept,
    )  # fmt: skip
    if not at_points:
        own = own_region(made, ground.texels.samples)
        made.exits = ground.texels.keep(np.lexsort((ground.texels.index, own)))
        made.starts = starts_of(own, modes.regions)
    return made


def _transport(
    ground: Ground, hurried: bool, budget: Budget, clock: Clock, kept: Kept, seed: int
) -> Transport | ElementTransport:
    """Between all entries, or between the whole ones, with links to the elements of near ones."""
    elements, rays = ground.elements, budget.entry_rays
    clock.start("Transport", (len(ground.whole[0]) + (0 if elements is None else len(elements))) * rays)
    transport = kept.part(
        part_name("transport", budget.entries, hurried),
        lambda: make_transport(*ground.whole, rays, seed, clock.tick),
    )
    if elements is None:
        return transport
    links = kept.part(
        part_name("links", budget.entries, hurried),
        lambda: link_elements(ground.whole[0], elements, transport, ground.gatherer, rays, seed, clock.tick),
    )
    return ElementTransport(elements, transport, links)


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
    # some more than a few are hardly worth beginning anew, unless they are all
    if rays <= FEW_RAYS or more < min(rays, 2 * FEW_RAYS + 1):
        made.budget = replace(made.budget, **{field: min(FEW_RAYS, rays)})
        return few
    made.budget = replace(made.budget, **{field: more})
    return gather(more, seed)


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
