"""The runtime against slow, clear versions: the full solve with stored ids, plain products, closed forms."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lightpanes.core.bake.steps import prepare
from lightpanes.core.panes import Relighter
from lightpanes.core.panes.clusters import cluster_mean, gather_clusters, make_clusters
from lightpanes.core.panes.entry_light import EntryLight
from lightpanes.core.panes.exits import STEPS, gather_panes
from lightpanes.core.panes.regions import features, make_regions, nearest, split_regions
from lightpanes.core.panes.spans import leading
from lightpanes.core.panes.training import free_air, room_around, training_lamps
from lightpanes.core.rays import Tracer
from lightpanes.core.scene import Material
from lightpanes.core.surface import make_patches
from lightpanes.core.transfer.entries import PLACES

from .shapes import baked_room, box, globe, lamp, quick, relighter, room, scene

ORACLE_RAYS = 512
"""So many that the oracle's own noise is well below what is compared."""

PLACES_IN_ROOM = [(3, 1.5, 2), (0.5, 2.6, 1.2), (2.4, 0.5, 0.4)]


@cache
def prepared_room():
    """The room of `baked_room`, prepared alike, and the ids of its gather, (rays, texels)."""
    made = baked_room()[0]
    ready = prepare(made, quick())
    ids = np.zeros((ORACLE_RAYS, len(ready.exits)), np.int32)
    at: dict[int, int] = {}

    def keep(piece, block):
        first = at.get(piece.start, 0)
        ids[first : first + len(block), piece] = block
        at[piece.start] = first + len(block)

    ready.gatherer.gather(ready.exits.samples, ORACLE_RAYS, 5, keep)
    return ready, ids


def solve(ready, light) -> np.ndarray:
    """(n, 3) radiosity of the entries, all bounces, nothing compressed."""
    surface = ready.surface
    direct = EntryLight(surface, ready.tracer).unit(light)
    source = ready.entries.albedo * direct.reshape(len(surface), -1) * light.power.astype(np.float32)
    channels = [ready.transport.solve(ready.entries.albedo[:, c : c + 1], source[:, c : c + 1]) for c in range(3)]
    return np.concatenate(channels, 1)


def oracle(ready, ids, light) -> np.ndarray:
    """(t, 3) irradiance: mean of the radiosities on which stored rays landed."""
    radiosity = np.append(solve(ready, light), np.zeros((ready.gatherer.size - len(ready.entries), 3)), axis=0)
    return radiosity[ids].mean(axis=0)


@pytest.mark.parametrize("place", PLACES_IN_ROOM)
def test_panes_equal_the_uncompressed_oracle(place):
    made, baked = baked_room()
    ready, ids = prepared_room()
    light = lamp(place)
    found = relighter(made, baked).texels([light])
    truth = oracle(ready, ids, light)
    assert found.shape == truth.shape
    # the mean over the room, each wall's and block's means, and every texel; the oracle has noise of its own
    assert np.allclose(found.mean(axis=0), truth.mean(axis=0), rtol=0.02)
    wall = np.unique(np.rint(ready.exits.samples.flat), axis=0, return_inverse=True)[1].reshape(-1)
    for side in range(6):
        assert np.allclose(found[wall == side].mean(axis=0), truth[wall == side].mean(axis=0), rtol=0.05)
    assert np.sqrt(((found - truth) ** 2).mean()) < 0.15 * truth.mean()


def blended(panes, values):
    """Texel by texel: at a region's border the average with the neighbours on the same surface."""
    size, region = panes.resolution, np.repeat(np.arange(len(panes.starts) - 1), np.diff(panes.starts))
    row = {int(place): t for t, place in enumerate(panes.texel)}
    result = values.copy()
    for t, place in enumerate(panes.texel):
        near = [t]
        for k, (dy, dx) in enumerate(STEPS):
            if panes.beside[t, k] and 0 in (dy, dx):
                near.append(row[int(place) + dy * size + dx])
        if any(region[n] != region[t] for n in near):
            result[t] = np.mean([values[n] for n in near], axis=0)
    return result


def test_combine_is_a_plain_product_but_at_borders():
    made, baked = baked_room()
    panes = baked.panes()
    runtime = relighter(made, baked)
    lights = [lamp(PLACES_IN_ROOM[0], (30, 60, 90))]
    weights = runtime.pane_weights(lights)
    regions = len(panes.starts) - 1
    own = weights.reshape(regions, -1, 3)[np.repeat(np.arange(regions), np.diff(panes.starts))]
    expected = blended(panes, np.einsum("tk,tkc->tc", panes.rows.astype(np.float64), own)) + panes.steady
    assert 0.05 < (expected != np.einsum("tk,tkc->tc", panes.rows.astype(np.float64), own)).mean() < 0.9
    assert np.allclose(runtime.texels(lights), expected, rtol=1e-4, atol=1e-4 * expected.max())
    image = runtime.relight(lights)
    shown = np.append(np.maximum(expected, 0), [[0, 0, 0]], axis=0)[panes.fill]
    assert np.allclose(image[..., :3].reshape(-1, 3), shown, rtol=1e-4, atol=1e-4 * expected.max())
    assert (image[..., 3] == 1).all()


# ---- linearity ----

powers = st.tuples(*[st.floats(0, 1000, width=32)] * 3)
lamps_in_room = st.lists(st.tuples(st.sampled_from(PLACES_IN_ROOM), powers), min_size=1, max_size=4)


@cache
def room_relighter() -> Relighter:
    return relighter(*baked_room())


def shine(lights) -> np.ndarray:
    return room_relighter().texels([lamp(*light) for light in lights]).copy()


@given(lamps_in_room, lamps_in_room)
@settings(max_examples=15, deadline=None)
def test_light_of_lamps_adds_up(first, second):
    apart = shine(first) + shine(second)
    together = shine(first + second)
    assert np.allclose(together, apart, rtol=1e-3, atol=1e-4 * max(np.abs(apart).max(), 1e-3))


@given(lamps_in_room, st.randoms())
@settings(max_examples=10, deadline=None)
def test_the_order_of_lamps_does_not_matter(lights, random):
    shuffled = list(lights)
    random.shuffle(shuffled)
    level = max(np.abs(shine(lights)).max(), 1e-3)
    assert np.allclose(shine(shuffled), shine(lights), rtol=1e-3, atol=1e-4 * level)


@given(st.sampled_from(PLACES_IN_ROOM), powers, st.floats(0, 100, width=32))
@settings(max_examples=10, deadline=None)
def test_light_is_in_proportion_to_power(place, power, factor):
    once, more = shine([(place, power)]), shine([(place, tuple(factor * p for p in power))])
    assert np.allclose(more, factor * once, rtol=1e-3, atol=1e-4 * max(factor * np.abs(once).max(), 1e-3))


def test_shares_of_lamps_add_up():
    lights = [lamp((1.0, 1.0, 2.0)), lamp((0.5, 2.0, 1.0)), lamp((1.5, 0.5, 0.7))]
    relighter = room_relighter()
    whole = relighter.relight(lights)[..., :3].copy()
    parts, steady = relighter.shares([lights[:2], [], lights[2:]])
    assert not steady.any() and not parts[1].any()
    assert np.allclose(sum(parts) + steady, whole, rtol=1e-5, atol=1e-6 * whole.max())
    for part, group in ((parts[0], lights[:2]), (parts[2], lights[2:])):
        off = np.abs(part - relighter.relight(group)[..., :3])
        assert part.mean() > 0 and (off > 1e-5 * whole.max()).mean() < 0.01
    assert np.array_equal(relighter.relight(lights)[..., :3], whole)


def test_shares_cost_no_shadow_rays(monkeypatch):
    """The lamps' light is known from the whole."""
    lights = [lamp((1.0, 1.0, 2.0)), lamp((0.5, 2.0, 1.0))]
    relighter, counts = room_relighter(), []
    look = relighter.entry_light.look
    monkeypatch.setattr(relighter.entry_light, "look", lambda light: counts.append(light) or look(light))
    relighter.relight([])
    counts.clear()
    relighter.shares([lights[:1], lights[1:]])
    relighter.relight(lights)
    assert len(counts) == 2


def test_no_lamps_is_black():
    assert not shine([]).any()
    assert not shine([((3, 1.5, 2), (0, 0, 0))]).any()


def test_only_changed_lamps_are_computed_again(monkeypatch):
    made, baked = baked_room()
    runtime = relighter(made, baked)
    seen = []
    look = runtime.entry_light.look
    monkeypatch.setattr(runtime.entry_light, "look", lambda light: seen.append(light.name) or look(light))
    lights = [lamp(place) for place in PLACES_IN_ROOM]
    first = runtime.relight(lights).copy()
    assert len(seen) == 3
    assert np.array_equal(runtime.relight(lights), first)
    runtime.relight([lamp(PLACES_IN_ROOM[0], 5), *lights[1:]])
    assert len(seen) == 3
    moved = [lamp((3, 1.5, 1.9)), *lights[1:]]
    after = runtime.relight(moved).copy()
    assert len(seen) == 4
    assert np.allclose(after, relighter(made, baked).relight(moved), rtol=1e-5, atol=1e-5)
    assert np.allclose(runtime.relight(lights), first, rtol=1e-5, atol=1e-5)


# ---- a lamp at the entries ----


def slow_solid_angle(corners, place):
    """sr of one triangle: its spherical excess by l'Huilier's theorem, float64."""
    a, b, c = (v / np.linalg.norm(v) for v in corners.astype(np.float64) - place)
    x, y, z = (np.arccos(np.clip(p @ q, -1, 1)) for p, q in ((a, b), (b, c), (c, a)))
    s = (x + y + z) / 2
    product = np.tan(s / 2) * np.tan((s - x) / 2) * np.tan((s - y) / 2) * np.tan((s - z) / 2)
    return 4 * np.arctan(np.sqrt(max(product, 0)))


def test_solid_angles_of_entries():
    ready, _ = prepared_room()
    surface = ready.surface
    place = np.array([3.1, 1.4, 0.35])
    rows = np.arange(0, len(surface), 7)
    found = EntryLight(surface, ready.tracer)._solid_angle(rows, place)
    ends = np.cumsum(surface.counts)
    for row, angle in zip(rows, found, strict=True):
        pieces = surface.pieces[ends[row] - surface.counts[row] : ends[row]]
        facing = [(place - p[0]) @ np.cross(p[1] - p[0], p[2] - p[0]) > 0 for p in pieces]
        expected = sum(slow_solid_angle(p, place) for p, f in zip(pieces, facing, strict=True) if f)
        assert angle == pytest.approx(expected, rel=1e-3, abs=1e-6)


@pytest.mark.parametrize("height", [0.02, 0.1, 0.5, 1.2])
def test_all_of_a_lamp_s_power_arrives(height):
    # Σ E A = Φ in a sealed room, however near the lamp is to the floor
    ready, _ = prepared_room()
    surface = ready.surface
    arrived = EntryLight(surface, ready.tracer).unit(lamp((2.9, 1.2, height), 1.0)) @ ready.entries.area
    assert arrived == pytest.approx(1, rel=0.03)


def test_places_are_on_the_entries():
    ready, _ = prepared_room()
    surface = ready.surface
    place = surface.position.reshape(len(surface), PLACES, 3)
    assert np.abs(place.mean(axis=1) - ready.entries.position).max() < 0.5 * surface.size.max()
    corners = np.split(surface.pieces, np.cumsum(surface.counts)[:-1])
    area = [0.5 * np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1).sum() for c in corners]
    assert np.allclose(np.sqrt(area), surface.size, rtol=1e-3)


# ---- modes and regions ----


def test_modes_are_orthonormal_in_each_region():
    ready, _ = prepared_room()
    modes = ready.modes
    for r in range(modes.regions):
        basis = modes.basis[modes.region == r].astype(np.float64)
        gram = basis.T @ basis
        used = np.diag(gram) > 0.5
        assert np.allclose(gram[np.ix_(used, used)], np.eye(used.sum()), atol=1e-4)
        assert not gram[~used].any()
        assert used.any()


@pytest.mark.parametrize("rank", [0, 5, 40])
def test_leading_fields_are_orthonormal_whatever_their_rank(rank):
    random = np.random.default_rng(rank)
    # the strongest is a million times as bright as the weakest
    bright = np.logspace(0, -6, rank)[:, None]
    fields = (random.normal(size=(300, rank)) @ (bright * random.normal(size=(rank, 60)))).astype(np.float32)
    found = leading(fields, 24)
    assert found.dtype == np.float32 and found.shape[1] <= min(24, max(rank, 1))
    assert np.allclose(found.T @ found, np.eye(found.shape[1]), atol=1e-5)
    lost = fields - found @ (found.T @ fields)
    assert np.linalg.norm(lost) <= (1e-5 if rank < 24 else 1e-3) * np.linalg.norm(fields)


def test_gathered_modes_are_means_over_ids():
    ready, _ = prepared_room()
    some = np.arange(0, len(ready.exits), 17)
    region = np.searchsorted(ready.starts, some, side="right") - 1
    starts = np.concatenate([[0], np.cumsum(np.bincount(region, minlength=ready.modes.regions))])
    points = ready.exits.samples.take(some)
    ids = []
    ready.gatherer.gather(points, 40, 9, lambda piece, block: ids.append(block.copy()))
    slow = np.stack(
        [ready.tables[r][ids_of].mean(axis=0) for r, ids_of in zip(region, np.concatenate(ids).T, strict=True)]
    )
    found = gather_panes(ready.gatherer, points, starts, ready.tables, 40, 9)
    assert np.allclose(found, slow, rtol=1e-3, atol=1e-4 * np.abs(slow).max())


@given(st.integers(1, 40), st.integers(1, 60), st.integers(0, 5))
@settings(max_examples=25, deadline=None)
def test_regions_are_numbered_without_gaps(count, points, seed):
    random = np.random.default_rng(seed)
    place = random.uniform(size=(points, 6)).astype(np.float32)
    area = random.uniform(0.1, 1, points)
    region = make_regions(place, area, count, seed)
    assert set(region) == set(range(region.max() + 1)) and region.max() < min(count, points)
    field = random.uniform(size=(points, 12)).astype(np.float32)
    split = split_regions(region, place, area, field, count + 5, 2)
    assert set(split) == set(range(split.max() + 1)) and split.max() < max(count + 5, region.max() + 1)
    # a split region is part of one that was
    assert all(len(set(region[split == r])) == 1 for r in range(split.max() + 1))


def test_nearest_is_the_nearest():
    random = np.random.default_rng(0)
    points, centre = random.normal(size=(500, 6)), random.normal(size=(30, 6))
    slow = ((points[:, None] - centre) ** 2).sum(-1).argmin(1)
    assert np.array_equal(nearest(points.astype(np.float32), centre.astype(np.float32)), slow)


def test_training_lamps_hang_in_free_air():
    ready, _ = prepared_room()
    made = ready.scene
    lights = training_lamps(made, ready.places, ready.gatherer, 150, 3)
    place = np.array([light.position for light in lights])
    assert 100 <= len(place) <= 151
    assert (place > 0).all() and (place < [4, 3, 2.5]).all()
    low, high = made.positions[8:].min(axis=0), made.positions[8:].max(axis=0)
    assert not ((place > low) & (place < high)).all(axis=1).any()
    air = free_air(ready.places, ready.bvh, made.extent, 1, near=(0.05, 0.2))
    clear = room_around(air, ready.gatherer)
    distance = np.minimum(air, np.array([4, 3, 2.5]) - air).min(axis=1)
    block = np.linalg.norm(np.maximum(np.maximum(low - air, air - high), 0), axis=1)
    exact = np.minimum(distance, block)
    # by 64 rays, which miss the nearest point a little
    assert (clear > exact - 1e-3).all()
    assert np.median(clear - exact) < 0.02


@pytest.mark.parametrize("length", [60, 210, 2000])
def test_a_long_tunnel_has_as_many_training_lamps_as_a_room(length):
    """Its width is a crack, measured by its length."""
    made = scene((*box((0, 0, 0), (length, 3, 2.5), True), 0), lights=[lamp((1, 1.5, 2))])
    ready = prepare(made, quick(entries=200, lamps=20, regions=4, panes=2))
    lights = training_lamps(made, ready.places, ready.gatherer, 150, 3)
    place = np.array([light.position for light in lights])
    assert 145 <= len(place) <= 151
    assert (place > 0).all() and (place < [length, 3, 2.5]).all()


# ---- the paper's compression ----


def test_as_many_clusters_as_entries_lose_nothing():
    made = scene((*globe(rings=12), 0), materials=(Material("Coat", (0.6, 0.6, 0.3)),))
    ready = prepare(made, quick(entries=120, resolution=32))
    own = np.arange(len(ready.entries), dtype=np.int32)
    panes = gather_clusters(ready.entries, ready.transport, ready.gatherer, ready.exits.samples, own, 64, 5)
    light = lamp((0.3, 0.2, -0.4))
    surface = ready.surface
    direct = EntryLight(surface, ready.tracer).unit(light)[:, None] * light.power.astype(np.float32)
    ids = []
    ready.gatherer.gather(ready.exits.samples, 64, 5, lambda piece, block: ids.append(block.copy()))
    assert np.allclose(panes.texels(direct), oracle(ready, np.concatenate(ids), light), rtol=2e-3)
    # the strongest alone are less, and all of them are all
    assert (panes.texels(direct, top=20) <= panes.texels(direct) + 1e-5).all()
    assert np.array_equal(panes.texels(direct, top=len(own)), panes.texels(direct))


def test_clusters_share_their_mean():
    made = room()
    patches = make_patches(made, 200)
    area, direct = patches.area, np.random.default_rng(0).uniform(size=(len(patches), 3)).astype(np.float32)
    cluster = make_regions(features(patches.position, patches.normal, made.extent), area, 12)
    means = cluster_mean(direct, cluster, area)
    assert np.allclose(means[5], np.average(direct[cluster == 5], axis=0, weights=area[cluster == 5]), rtol=1e-5)
    ready, _ = prepared_room()
    assert make_clusters(ready.entries, 9, made.extent).max() == 8


def test_runtime_needs_no_more_than_the_bake_holds(tmp_path):
    made, baked = baked_room()
    baked.save(tmp_path / "room.npz")
    again = Relighter(type(baked).load(tmp_path / "room.npz").panes(), Tracer(made))
    lights = [lamp(PLACES_IN_ROOM[1])]
    assert np.array_equal(again.relight(lights), relighter(made, baked).relight(lights))


def test_a_lamp_behind_a_wall_and_tinted_glass():
    """The entries near the lamp face away from it, so that no ray says that light there is tinted."""
    baked = baked_room()[1]
    tinted = SimpleNamespace(
        visibility=lambda origins, _: np.tile(np.float32([1, 0.5, 0]), (len(origins), 1)),
        blocked=lambda origins, _: np.zeros(len(origins), bool),
        offset=1e-4,
    )
    behind = lamp((-0.9, 1.5, 1.25))
    found = EntryLight(baked.panes().surface, tinted).unit(behind)
    assert found.shape == (len(baked.panes().surface), 3) and found[:, 0].max() > 0
    assert np.allclose(found[:, 1], 0.5 * found[:, 0]) and not found[:, 2].any()
