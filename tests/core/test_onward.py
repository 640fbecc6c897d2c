"""Bounced light that mirrors, glass and rough metal pass on, against closed forms and mirrored rooms."""

import numpy as np
import pytest
from lightpanes.core.optics import unmasked, visible_facet
from lightpanes.core.rays import Bvh
from lightpanes.core.scene import Material, Optics
from lightpanes.core.surface import cut_patches, make_patches
from lightpanes.core.transfer import (
    ElementTransport,
    Gatherer,
    find_bending,
    find_elements,
    find_entries,
    link_elements,
    make_gatherer,
    make_transport,
)
from lightpanes.core.transfer.onward import opaque_part, passing

from .caustic_scenes import BLACK, MIRROR, WHITE, ball, floor, glass, panel, staged
from .shapes import GREY, box, room, scene
from .test_gather import collect

OFFSET = 1e-4
SIZE = 2.0


def steel(reflectance: float = 1.0, roughness: float = 0.5) -> Material:
    """A metal, rough enough to be no caster."""
    colour = (reflectance,) * 3
    return Material("Steel", BLACK, optics=Optics(mirror=colour, mirror_edge=colour, roughness=roughness))


def closed(*parts, material: Material):
    """A grey box around things of a material."""
    p, t, uv = box((0, 0, 0), (SIZE, SIZE, SIZE), inward=True)
    return staged(("Room", p, t, uv, None, 0), *parts, materials=(GREY, material))


def middle_ball(rings: int = 48):
    return ball((1.1, 0.9, 0.95), 0.5, rings)


def ground(made, count: int = 300):
    """Entries, which of them are the room's, a gatherer, and places on the walls, of which there are 4 an entry."""
    patches = make_patches(made, count)
    bvh = Bvh(patches.corners)
    every = patches.sample(made, np.arange(len(patches)), 5)
    entries, _, _ = find_entries(made, patches, bvh, every, OFFSET)
    owner = made.triangle_object[entries.places.triangle].reshape(len(entries), -1)[:, 0]
    rows = np.flatnonzero(made.triangle_object[entries.places.triangle] == 0)[::4]
    return entries, owner == 0, make_gatherer(made, patches, entries, bvh, OFFSET), entries.places.take(rows)


@pytest.mark.parametrize("material", [MIRROR, glass(), glass(2.4), steel(), steel(1.0, 1.0)])
def test_uniform_light_stays_uniform(material):
    """What neither takes nor gives light is not seen in a furnace: every ray from a wall ends on a wall."""
    made = closed(middle_ball(), material=material)
    entries, walls, gatherer, places = ground(made)
    assert gatherer.bends
    ids = collect(gatherer, places, 64)
    landed = np.append(walls, np.zeros(gatherer.size - len(entries), bool))[ids]
    # light that goes round and round in glass has an end
    assert landed.mean() > 0.9995
    transport = make_transport(entries, gatherer, 1024)
    source = walls[:, None].astype(np.float32)
    light = transport.solve(np.full((len(entries), 1), 0.5, np.float32) * source, source)[walls, 0]
    assert np.average(light, weights=entries.area[walls]) == pytest.approx(2, rel=0.005)
    assert np.abs(light / 2 - 1).max() < 0.03
    flow = entries.area[:, None] * entries.opaque[:, None] * transport.between
    assert np.abs(flow - flow.T).max() < 1e-5 * flow.max()


def test_a_sheet_of_glass_passes_light_unevenly():
    """Light enters a sheet from one side and is mostly reflected at the other; in a furnace it is not seen all the same."""
    made = closed(panel((0, 0, 1.1), (SIZE, 0, 0), (0, SIZE, 0)), material=glass())
    entries, walls, gatherer, _ = ground(made)
    assert not gatherer.both_ways
    transport = make_transport(entries, gatherer, 1024)
    source = walls[:, None].astype(np.float32)
    light = transport.solve(np.float32(0.5) * source, source)[walls, 0]
    assert np.average(light, weights=entries.area[walls]) == pytest.approx(2, rel=0.005)
    high = entries.position[:, 2] > 1.2
    low = walls & (entries.position[:, 2] < 1)
    upward = np.average(transport.between[walls & high][:, low].sum(axis=1), weights=entries.area[walls & high])
    downward = np.average(transport.between[low][:, walls & high].sum(axis=1), weights=entries.area[low])
    # what gets through from the side of the air, and from that of the glass, of light that is diffuse there
    assert downward * entries.area[low].sum() < 0.7 * upward * entries.area[walls & high].sum()


def test_a_wall_that_mirrors_is_a_room_twice_as_long():
    low, high = np.zeros(3), np.full(3, SIZE)
    p, t, uv = box(low, high, inward=True)
    # the wall at x = 0 is the mirror
    at_mirror = (p[t][:, :, 0] == 0).all(axis=1)
    alone = staged(
        ("Room", p, t[~at_mirror], uv[~at_mirror], None, 0),
        panel((0, 0, 0), (0, SIZE, 0), (0, 0, SIZE)),
        materials=(GREY, MIRROR),
    )
    double = scene((*box((-SIZE, 0, 0), high, inward=True), 0), materials=(GREY,))
    found = []
    for made, count in ((alone, 600), (double, 1000)):
        entries, walls, gatherer, _ = ground(made, count)
        transport = make_transport(entries, gatherer, 2048)
        place = np.abs(entries.position)
        lit = walls & (entries.normal[:, 2] > 0.9)
        # brighter the farther from the mirror
        source = (lit * place[:, 0])[:, None].astype(np.float32)
        arrives = transport.arriving(transport.solve(np.float32(0.5) * walls[:, None], source))[:, 0]
        sides = [
            walls & (entries.normal @ np.array(axis) > 0.9) & (low <= place[:, 0]) & (place[:, 0] < high)
            for axis in ((0, 0, 1), (0, 0, -1), (0, 1, 0))
            for low, high in ((0, 0.7), (0.7, 1.4), (1.4, 2))
        ]
        found.append([np.average(arrives[side], weights=entries.area[side]) for side in sides])
    assert np.abs(np.divide(*found) - 1).max() < 0.03


def plate(material) -> float:
    """Part of a floor's light that gets through a plate over it, both of them wide."""
    p, t, _ = box((-50, -50, 0.01), (50, 50, 0.21))
    made = staged(floor(100), ("Plate", p, t, None, None, 1), materials=(GREY, material))
    patches = make_patches(made, 200)
    ids = np.where(made.triangle_object[patches.parent] == 0, 0, 1)
    gatherer = Gatherer(made, patches, Bvh(patches.corners), ids, ids, 3, offset=1e-5, bending=find_bending(made))
    rows = np.flatnonzero(made.triangle_object[patches.parent] == 0)[:1]
    places = patches.sample(made, np.full(512, patches.patch[rows[0]], np.int32), 1)
    near = np.abs(places.position[:, :2]).max(axis=1) < 40
    return (collect(gatherer, places.take(np.flatnonzero(near)), 512) == 3).mean()


SLOPE = (np.arange(20_000) + 0.5) / 20_000


def test_a_layer_absorbs_as_the_exponential_integral_says():
    # 2 E₃
    expected = (2 * SLOPE * np.exp(-0.2 * 1.5 / SLOPE)).mean()
    assert plate(glass(1.0, absorption=(1.5,) * 3)) == pytest.approx(expected, rel=0.01)
    assert plate(glass(1.0)) == 1


def test_a_plate_lets_diffuse_light_through_as_fresnel_says():
    inner = np.sqrt(1 - (1 - SLOPE**2) / 1.5**2)
    across, along = (SLOPE - 1.5 * inner) / (SLOPE + 1.5 * inner), (1.5 * SLOPE - inner) / (1.5 * SLOPE + inner)
    lost = (across**2 + along**2) / 2
    # back and forth within
    expected = (2 * SLOPE * (1 - lost) / (1 + lost)).mean()
    assert plate(glass(1.5)) == pytest.approx(expected, rel=0.01)


def test_what_a_metal_takes_is_gone():
    """In a furnace a ball of reflectance 0.6 is at 0.6 of all light, a little below where facets mirror twice."""
    for material, low, high in ((steel(0.6, 0.2), 0.39, 0.41), (steel(0.6, 1.0), 0.5, 0.65)):
        made = closed(middle_ball(), material=material)
        _, _, gatherer, places = ground(made)
        ids = collect(gatherer, places, 128)
        white = closed(middle_ball(), material=steel())
        _, _, other, _ = ground(white)
        bare = Gatherer(made, other._patches, other.bvh, *_owners(made, other._patches), 3, offset=OFFSET)
        meets = collect(bare, places, 128) == 1
        assert low < (ids[meets] == gatherer.miss - 1).mean() < high
        assert (ids[~meets] < gatherer.miss - 1).all()


def _owners(made, patches):
    owner = made.triangle_object[patches.parent]
    return owner, owner


def test_half_a_metal_reflects_and_scatters():
    """Half mirror, half grey: what lands is the grey half, and the light is that of both."""
    half = Material("Half", (0.25,) * 3, optics=Optics(mirror=(0.5,) * 3, mirror_edge=(0.5,) * 3, roughness=0.4))
    made = closed(middle_ball(), material=half)
    entries, walls, gatherer, places = ground(made)
    assert np.allclose(entries.opaque[~walls], 0.5)
    assert np.allclose(entries.albedo[~walls], 0.5)
    ids = collect(gatherer, places, 256)
    bare = made.triangle_object[gatherer._patches.parent]
    first = Gatherer(made, gatherer._patches, gatherer.bvh, bare, bare, 3, offset=OFFSET)
    meets = collect(first, places, 256) == 1
    onto = np.append(~walls, np.zeros(gatherer.size - len(entries), bool))[ids[meets]]
    assert onto.mean() == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("alpha", [0.04, 0.25, 1.0])
def test_facets_are_those_that_are_seen(alpha):
    count = 200_000
    random = np.random.default_rng(1)
    a, b = random.random((2, count), np.float32)
    up = np.repeat(np.array([[0.6], [0], [0.8]], np.float32), count, axis=1)
    wide = np.full(count, alpha, np.float32)
    facet = visible_facet(up, up, wide, a, b)
    assert np.allclose((facet**2).sum(axis=0), 1, atol=1e-5)
    # seen from above, tan² / (α² + tan²) of the tilt is uniform
    tilt2 = 1 / np.maximum((facet * up).sum(axis=0).astype(float) ** 2, 1e-12) - 1
    uniform = np.sort(tilt2 / (alpha**2 + tilt2))
    assert np.abs(uniform - (np.arange(count) + 0.5) / count).max() < 0.005
    # all normals, as often as facets have them: D cos, by tilts and turns
    tilt = np.arctan(alpha * np.sqrt(1 / (1 - (np.arange(20_000) + 0.5) / 20_000) - 1))[:, None]
    turn = (np.arange(200) + 0.5) * np.pi / 100
    for cosine in (0.9, 0.3):
        sine = np.sqrt(1 - cosine**2)
        view = (cosine * up + sine * np.array([0.8, 0, -0.6])[:, None]).astype(np.float32)
        facet = visible_facet(view, up, wide, a, b)
        # per area of facets, hence over the cosine of their tilt
        area = np.maximum(sine * np.sin(tilt) * np.cos(turn) + cosine * np.cos(tilt), 0) / np.cos(tilt)
        assert cosine / area.mean() == pytest.approx(unmasked(np.array([cosine]), np.array([alpha]))[0], rel=0.005)
        for values, all_values in (
            ((facet * up).sum(axis=0), np.cos(tilt)),
            ((facet * view).sum(axis=0), area * np.cos(tilt)),
            (np.abs(facet[1]), np.abs(np.sin(tilt) * np.sin(turn))),
        ):
            assert values.mean() == pytest.approx((all_values * area).mean() / area.mean(), rel=0.01)


def test_threads_and_chunks_change_nothing():
    made = closed(middle_ball(16), material=glass(1.5, absorption=(1.0, 2.0, 0.5)))
    _, _, gatherer, places = ground(made)
    many = places.take(np.arange(9000) % len(places))
    alone, both = (collect(gatherer, many, 20, threads=n) for n in (1, 2))
    assert np.array_equal(alone, both)


def test_nothing_changes_without_mirrors_and_glass():
    made = room()
    assert passing(made) is None
    assert not make_gatherer(*_plain(made)).bends
    patches = make_patches(made, 100)
    assert (opaque_part(made, patches) == 1).all()


def _plain(made):
    patches = make_patches(made, 100)
    bvh = Bvh(patches.corners)
    entries, _, _ = find_entries(made, patches, bvh, patches.sample(made, np.arange(len(patches)), 5), OFFSET)
    return made, patches, entries, bvh, OFFSET


def test_what_glows_is_left_alone():
    glowing = Material("Glowing", BLACK, (1, 1, 1), optics=Optics(mirror=WHITE, mirror_edge=WHITE))
    assert passing(closed(middle_ball(), material=glowing)) is None


@pytest.mark.parametrize("material", [MIRROR, glass()])
def test_elements_keep_what_mirrors_and_glass_pass_on(material):
    made = closed(middle_ball(), material=material)
    patches = make_patches(made, 200)
    finer, patches, owner = cut_patches(made, patches, 800)
    bvh = Bvh(finer.corners)
    pilot = patches.sample(made, np.arange(len(patches)), 1)
    entries, _, is_buried = find_entries(made, patches, bvh, pilot, OFFSET)
    elements = find_elements(made, finer, owner, entries, is_buried)
    whole = make_transport(entries, make_gatherer(made, patches, entries, bvh, OFFSET), 512)
    links = link_elements(entries, elements, whole, make_gatherer(made, finer, elements.sides, bvh, OFFSET), 512)
    walls = made.triangle_object[elements.sides.places.triangle].reshape(len(elements), -1)[:, 0] == 0
    grey = np.float32(0.5) * walls[:, None]
    light = ElementTransport(elements, whole, links).solve(grey, walls[:, None].astype(np.float32))[walls, 0]
    assert np.average(light, weights=elements.sides.area[walls]) == pytest.approx(2, rel=0.01)
    assert np.abs(light / 2 - 1).mean() < 0.02
