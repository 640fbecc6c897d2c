"""What lamps that may change are shown by: panes that are learnt from training lamps, and lamps that judge them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..panes.entry_light import EntryLight, EntrySurface
from ..panes.held_out import held_out_lamps, representative
from ..panes.modes import Modes, learn_modes, training_fields
from ..panes.regions import features, make_regions, rooms, signature, split_regions
from ..panes.training import illuminate, training_lamps
from ..panes.weights import PaneWeights, make_weights
from ..planner import Budget
from ..scene import Light
from ..transfer import ElementTransport, Entries, Transport
from ..transfer.entries import PLACES
from .clock import Clock
from .ground import Ground, Surfaces, part_name
from .kept import Kept

CANDIDATES = 72
"""Lamps of which TEST_LAMPS are chosen."""

DIM = 0.1
"""Lamps somewhere in the air that light less than this part of what most of them do are no test: outside, say, or in a crack."""

TEST_LAMPS = 24
"""Held-out lamps that measure the error at the end of a bake; three at a time take red, green and blue."""


@dataclass(frozen=True)
class Live:
    """modes and weights: the panes at the entries. test_lamps: held-out ones, of unit power, and test_direct: (n, l) the
    irradiance of each at the entries, seen from all places; none, and None, where no lamp is live. radiosity: (n, c) of
    training lamps, before any bounce."""

    modes: Modes
    weights: PaneWeights
    test_lamps: list[Light]
    test_direct: np.ndarray | None
    radiosity: np.ndarray | None


def learn(
    surfaces: Surfaces,
    ground: Ground,
    surface: EntrySurface,
    transport: Transport | ElementTransport,
    budget: Budget,
    clock: Clock,
    kept: Kept,
    seed: int,
    judges: list[Light] | None,
) -> Live:
    """Panes for lamps anywhere in the scene's air. judges: held-out lamps, None for some that are drawn here."""
    scene, tracer, entries, places = surfaces.scene, surfaces.tracer, ground.entries, ground.entries.places
    lamps = training_lamps(scene, places, ground.gatherer, budget.lamps, seed + 6)
    clock.start("Lamps", len(lamps))
    direct = kept.part(
        part_name("lamps", budget.entries, surfaces.hurried),
        lambda: illuminate(lamps, places, PLACES, tracer, seed, lambda n: clock.tick(n, n * len(entries))),
    )
    test = _judges(surfaces, ground, surface, transport, seed) if judges is None else judges
    test = [replace(lamp, power=np.ones(3)) for lamp in test[: len(test) // 3 * 3]]
    test_direct = _seen(EntryLight(surface, tracer, seed, few=PLACES), test, entries)

    clock.start("Panes", 4)
    radiosity, field = training_fields(entries, transport, direct)
    clock.tick(1, 0)
    points = features(entries.position, entries.normal, scene.extent)
    # rooms lie farther apart than anything within one
    elements = ground.elements
    room = rooms(transport.between) if elements is None else rooms(transport.whole.between)[elements.entry]
    far = 4 * room[:, None].astype(np.float32)
    alike = np.concatenate([points, signature(field[:, ::2]), far], 1)
    region = make_regions(alike, entries.area, max(budget.regions // 4, 1), seed)
    region = split_regions(region, alike, entries.area, field[:, ::2], budget.regions, budget.panes)
    modes = learn_modes(entries, transport, region, radiosity, field, budget.panes)
    clock.tick(1, 0)
    weights = make_weights(entries, transport, modes, room, direct[:, ::8], seed)
    clock.tick(1, 0)
    return Live(modes, weights, test, test_direct, radiosity)


def nothing_live(entries: Entries) -> Live:
    """One region with one black pane: for scenes in which no lamp may change."""
    count = len(entries)
    nothing = np.zeros((count, 1), np.float32)
    region = np.zeros(count, np.int32)
    modes = Modes(region, 1, 1, nothing, nothing, nothing)
    small = np.zeros((3, 1, 1), np.float32)
    weights = PaneWeights(nothing.T.copy(), small[0], small, region, nothing, entries.albedo)
    return Live(modes, weights, [], None, None)


def grey(values: np.ndarray) -> np.ndarray:
    """(n,) of (n,) or (n, 3)."""
    return values if values.ndim == 1 else values.mean(axis=1)


def _seen(eyes: EntryLight, lamps: list[Light], entries: Entries) -> np.ndarray:
    """(n, l) float32 irradiance of lamps at the entries."""
    if not lamps:
        return np.zeros((len(entries), 0), np.float32)
    return np.stack([grey(eyes.unit(lamp)) for lamp in lamps], 1)


def _judges(surfaces, ground, surface, transport, seed):
    """TEST_LAMPS held-out lamps that stand for many."""
    entries = ground.entries
    many, own = held_out_lamps(surfaces.scene, entries.places, ground.gatherer, CANDIDATES, seed + 1006)
    if not many:
        return many
    direct = _seen(EntryLight(surface, surfaces.tracer, seed, few=1), many, entries)
    field = transport.arriving(entries.albedo.mean(axis=1, keepdims=True) * direct)
    # what is shown are fronts: a lamp inside a thing with a slit lights its backs alone
    area = np.where(entries.back, 0, entries.area) if not entries.back.all() else entries.area
    area = (area / area.sum()).astype(np.float32)
    mean = area @ field
    # suns, which may be among the scene's own, are measured in other units; where nothing is passed on, all are alike
    kept = np.flatnonzero(own | (mean >= DIM * np.median(mean[~own]))) if not own.all() else np.arange(len(many))
    uneven = np.sqrt(area @ field**2) / np.maximum(mean, 1e-30)
    return representative([many[k] for k in kept], own[kept], uneven[kept], TEST_LAMPS)
