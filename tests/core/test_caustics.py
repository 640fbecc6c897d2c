"""Caustics as a whole: against a plain tracer of single photons, where methods fail, what is kept, and what entries get."""

from dataclasses import replace

import numpy as np
import pytest
from lightpanes.core.bake import Settings, bake
from lightpanes.core.caustics import CausticAtlas, casters
from lightpanes.core.caustics.lamp import LampCaustics
from lightpanes.core.caustics.quadtree import LEVELS
from lightpanes.core.metrics import relative_rmse
from lightpanes.core.panes import Relighter
from lightpanes.core.panes.caustic_light import CausticLight
from lightpanes.core.rays import Bvh, Tracer
from lightpanes.core.scene import Scene, SceneError, SceneObject

from .caustic_scenes import MIRROR, ball, closed, floor, floor_places, glass, panel, staged, within
from .shapes import GREY, box, lamp, room

RESOLUTION = 64


def plain_photons(scene: Scene, light, count: int, seed: int, bounces: int = 30) -> np.ndarray:
    """(RESOLUTION, RESOLUTION) W/m² on `floor` by random photons of a point lamp, in float64: the slow, clear oracle.

    All that meets a caster first; at each surface a die says whether a photon is reflected, refracted or absorbed. One
    object may be of glass, and there is no colour.
    """
    random = np.random.default_rng(seed)
    bvh = Bvh(scene.positions, scene.triangles)
    optics = [scene.materials[m].optics for m in scene.triangle_material]
    bends = np.array([o is not None for o in optics])
    metal = np.array([o is not None and max(o.glass) == 0 for o in optics])
    mirror = np.array([o.mirror[0] if o else 0.0 for o in optics])
    ior = np.array([o.ior if o else 1.0 for o in optics])
    dims = np.array([o.absorption[0] if o else 0.0 for o in optics])
    z = random.uniform(-1, 1, count)
    turn = random.uniform(0, 2 * np.pi, count)
    way = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], 1)
    place = np.tile(light.position, (count, 1))
    total = np.zeros(RESOLUTION**2)
    met = np.zeros(count, bool)
    for _ in range(bounces):
        hits = bvh.hits(place.astype(np.float32), way.astype(np.float32))
        found = hits.triangle >= 0
        lands = found & ~bends[hits.triangle] & met
        rows = np.flatnonzero(lands)
        u, v = hits.u[rows, None], hits.v[rows, None]
        uv = scene.atlas_uv[hits.triangle[rows]]
        at = uv[:, 0] * (1 - u - v) + uv[:, 1] * u + uv[:, 2] * v
        texel = (at[:, 1] * RESOLUTION).astype(int) * RESOLUTION + (at[:, 0] * RESOLUTION).astype(int)
        total += np.bincount(texel, minlength=RESOLUTION**2)
        keep = np.flatnonzero(found & bends[hits.triangle])
        if not len(keep):
            break
        triangle, distance = hits.triangle[keep], hits.distance[keep].astype(float)
        way, met = way[keep], np.ones(len(keep), bool)
        place = place[keep] + way * distance[:, None]
        flat = scene.triangle_cross(triangle).astype(float)
        flat /= np.linalg.norm(flat, axis=1, keepdims=True)
        weights = np.stack([1 - hits.u[keep] - hits.v[keep], hits.u[keep], hits.v[keep]], 1)
        normal = np.einsum("nk,nkd->nd", weights, scene.corner_normals[triangle].astype(float))
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        inside = (flat * way).sum(1) > 0
        sign = np.where(inside, -1, 1)[:, None]
        normal, flat = normal * sign, flat * sign
        cosine = np.maximum(-(normal * way).sum(1), 1e-6)
        eta = np.where(inside, ior[triangle], 1 / ior[triangle])
        inner2 = 1 - eta**2 * (1 - cosine**2)
        inner = np.sqrt(np.maximum(inner2, 0))
        across = (eta * cosine - inner) / (eta * cosine + inner)
        along = (cosine - eta * inner) / (cosine + eta * inner)
        reflectance = np.where(inner2 <= 0, 1.0, (across**2 + along**2) / 2)
        die = random.random(len(keep))
        survives = ~inside | metal[triangle] | (random.random(len(keep)) < np.exp(-dims[triangle] * distance))
        bounces_off = np.where(metal[triangle], True, die < reflectance)
        survives &= ~metal[triangle] | (die < mirror[triangle])
        bounced = way + 2 * cosine[:, None] * normal
        passed = way * eta[:, None] + normal * (eta * cosine - inner)[:, None]
        way = np.where(bounces_off[:, None], bounced, passed)
        place = place + flat * np.where(bounces_off, 1e-5, -1e-5)[:, None]
        place, way, met = place[survives], way[survives], met[survives]
    texel_area = (2 / 0.9 / RESOLUTION) ** 2
    return (total / count * light.power[0] / texel_area).reshape(RESOLUTION, RESOLUTION)


def test_it_is_what_single_photons_say():
    """A ball of tinted glass beside a mirror of half strength: light goes from each to the other."""
    dim = glass(absorption=(0.8, 0.8, 0.8))
    half = replace(MIRROR, optics=replace(MIRROR.optics, mirror=(0.6,) * 3, mirror_edge=(0.6,) * 3))
    light = lamp((-0.5, 0.1, 1.6))
    mirror = panel((0.7, -0.6, 0.02), (0, 0, 0.9), (0, 1.2, 0), material=2)
    scene = staged(floor(), ball((0.1, 0, 0.5), 0.35, 64), mirror, materials=(GREY, dim, half), lights=[light])
    atlas = CausticAtlas(scene, RESOLUTION)
    image = atlas.image([light])[..., 0]
    halves = [plain_photons(scene, light, 1_500_000, seed) for seed in (1, 2)]
    expected = (halves[0] + halves[1]) / 2
    _, inside = floor_places(RESOLUTION)
    mask = within(inside, 1)
    noise = relative_rmse(halves[0], halves[1], mask, block=4) / 2
    assert noise < 0.06
    assert relative_rmse(image, expected, mask, block=4) < 1.25 * noise
    assert np.isclose(image[mask].sum(), expected[mask].sum(), rtol=0.01)
    energy = atlas.energy(light)
    assert np.isclose(closed(energy), 1, atol=0.005) and energy.untraced < 0.02 * (energy.emitted - energy.missed)


@pytest.fixture(scope="module")
def glassy():
    """A glass ball above a floor, its lamp, and an atlas that has been lit."""
    light = lamp((0.6, 0.2, 2.5))
    atlas = CausticAtlas(staged(floor(), ball((0, 0, 0.7), 0.4), materials=(GREY, glass())), RESOLUTION)
    return light, atlas, atlas.image([light])


def test_the_focus_keeps_its_power_and_is_no_wider_than_it_is(glassy):
    """A ball's focus is a spike: whatever the resolution, as much light lies within its ring."""
    light, coarse, _ = glassy
    fine = CausticAtlas(staged(floor(), ball((0, 0, 0.7), 0.4), materials=(GREY, glass())), 256)
    sums = []
    for atlas in (coarse, fine):
        image = atlas.image([light])[..., 0]
        place, _ = floor_places(atlas.resolution)
        peak = place[np.unravel_index(image.argmax(), image.shape)]
        assert np.isfinite(image).all() and (image >= 0).all()
        near = np.hypot(*(place - peak).transpose(2, 0, 1)) < 0.1
        sums.append(image[near].sum() / atlas.resolution**2)
    assert np.isclose(sums[0], sums[1], rtol=0.03)


def test_total_reflection_turns_all_light():
    """Sun into the upright face of a prism of 45°: the long face reflects all of it down through the bottom."""
    corners = np.array([(-0.5, 0.2), (0.5, 0.2), (0.5, 1.2)])
    points = np.array([(x, y, z) for y in (-0.5, 0.5) for x, z in corners])
    triangles = np.array([(0, 1, 2), (3, 5, 4), (0, 3, 1), (1, 3, 4), (1, 4, 2), (2, 4, 5), (2, 5, 0), (0, 5, 3)])
    a, b, c = points[triangles].transpose(1, 0, 2)
    inward = (((a + b + c) / 3 - points.mean(axis=0)) * np.cross(b - a, c - a)).sum(axis=1) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([(0, 1.0, 0), (0, 0, 1.0), (1.0, 0, 0)], axis=1)
    sun = replace(lamp((0, 0, 0), power=1.0, kind="SUN"), matrix=matrix, angle=0.0)
    scene = staged(floor(), ("Prism", points, triangles, None, None, 1), materials=(GREY, glass()), lights=[sun])
    atlas = CausticAtlas(scene, RESOLUTION)
    image = atlas.image([sun])[..., 0]
    energy = atlas.energy(sun)
    assert np.isclose(closed(energy), 1, atol=0.005) and energy.untraced < 0.02 * energy.emitted
    # 1 W/m² goes in through 1 m², and crosses glass twice at right angles
    place, _ = floor_places(RESOLUTION)
    under = np.abs(place).max(axis=-1) < 0.45
    assert np.allclose(image[under], (1 - 0.04) ** 2, rtol=0.02)
    assert np.isclose(energy.landed, (1 - 0.04) ** 2, rtol=0.02)


def test_what_a_lamp_cannot_see_makes_no_caustics():
    """A ball behind a wall, one outside of a spot's cone, one behind an area lamp."""
    wall = panel((-2, -2, 1.5), (4, 0, 0), (0, 4, 0), material=0, name="Lid")
    behind = staged(floor(), ball((0, 0, 0.7), 0.3, 32), wall, materials=(GREY, glass()))
    assert not CausticAtlas(behind, 32).image([lamp((0, 0, 2.5))])[..., :3].any()
    free = CausticAtlas(staged(floor(), ball((0.7, 0, 0.4), 0.2, 32), materials=(GREY, glass())), 32)
    assert not free.image([lamp((-0.7, 0, 2), kind="SPOT", spot_angle=0.4)])[..., :3].any()
    below = replace(lamp((0.7, 0, 0.1), kind="AREA", size=(0.2, 0.2)))
    assert not free.image([below])[..., :3].any()
    assert free.energy(below).landed == 0 and not len(free.landings(below).power)
    unshadowed = replace(lamp((0.7, 0, 2)), casts_shadow=False)
    assert not free.image([unshadowed])[..., :3].any()


def test_a_lamp_inside_a_ball_of_glass_shines_out_of_it():
    """In the middle of a ball all light leaves straight, but for what Fresnel keeps in and sends round."""
    light = lamp((0, 0, 1.0))
    atlas = CausticAtlas(staged(floor(), ball((0, 0, 1.0), 0.3), materials=(GREY, glass())), RESOLUTION)
    image = atlas.image([light])[..., 0]
    place, inside = floor_places(RESOLUTION)
    far2 = (place**2).sum(-1) + 1
    expected = 100 / (4 * np.pi * far2) / np.sqrt(far2)
    middle = within(inside, 6)
    assert np.isclose(image[middle].mean() / expected[middle].mean(), 1, atol=0.03)


def test_only_lamps_that_changed_are_traced_and_light_is_linear(glassy, monkeypatch):
    light, atlas, first = glassy
    traced = []
    photons = LampCaustics._photons
    monkeypatch.setattr(LampCaustics, "_photons", lambda self, *a: traced.append(self.light.name) or photons(self, *a))
    assert np.allclose(atlas.image([replace(light, power=2 * light.power)])[..., :3], 2 * first[..., :3], rtol=1e-5)
    assert not traced
    other = replace(light, name="Other", matrix=lamp((-0.3, 0.2, 2.0)).matrix)
    atlas.image([light, other])
    assert set(traced) == {"Other"}
    assert np.array_equal(atlas.image([light]), first)


def test_pictures_come_from_coarse_to_fine_and_may_be_cancelled(glassy):
    light, atlas, first = glassy
    moved = replace(light, matrix=lamp((0.5, 0.2, 2.5)).matrix)
    steps = atlas.refine([moved])
    coarse = next(steps)
    assert coarse.photons < 5_000 and 0 < coarse.done < 1
    early = coarse.image
    steps.close()
    # a call that was cancelled goes on
    rest = list(atlas.refine([moved]))
    assert rest[-1].done == 1 and [p.photons for p in rest] == sorted(p.photons for p in rest)
    final = rest[-1].image
    again = CausticAtlas(staged(floor(), ball((0, 0, 0.7), 0.4), materials=(GREY, glass())), RESOLUTION, threads=1)
    assert np.array_equal(again.image([moved]), final)
    _, inside = floor_places(RESOLUTION)
    assert relative_rmse(early[..., 0], final[..., 0], within(inside), block=4) < 0.5
    assert not np.array_equal(final, first)


def test_many_photons_are_traced_in_parts(glassy, monkeypatch):
    from lightpanes.core.caustics import lamp as module

    light, _, first = glassy
    monkeypatch.setattr(module, "WHOLE", 20_000)
    monkeypatch.setattr(module, "PART", 8_000)
    parts = CausticAtlas(staged(floor(), ball((0, 0, 0.7), 0.4), materials=(GREY, glass())), RESOLUTION)
    last = list(parts.refine([light], 60_000))[-1]
    assert 50_000 < last.photons < 70_000
    _, inside = floor_places(RESOLUTION)
    assert relative_rmse(last.image[..., 0], first[..., 0], within(inside), block=4) < 0.02
    assert LEVELS >= 19


def test_a_scene_without_mirrors_or_glass_has_no_casters():
    assert casters(room()) is None
    with pytest.raises(SceneError, match="no caustics"):
        CausticAtlas(room(), 32)
    made = staged(floor(), ball((0, 0, 1), 0.3, 16))
    assert casters(made).objects == ("Ball",) and not casters(made).triangles[:2].any()
    made.objects = (made.objects[0], SceneObject("Ball", casts_shadow=False))
    assert casters(made) is None
    rough = replace(MIRROR, optics=replace(MIRROR.optics, roughness=0.4))
    assert casters(staged(floor(), ball((0, 0, 1), 0.3, 16), materials=(GREY, rough))) is None
    nowhere = staged(("Floor", *floor()[1:3], None, None, 0), ball((0, 0, 1), 0.3, 16))
    with pytest.raises(SceneError, match="place in the atlas"):
        CausticAtlas(nowhere, 32)


def test_casters_block_shadow_rays_where_caustics_are_on():
    made = staged(floor(), ball((0, 0, 1), 0.3, 16), materials=(GREY, glass()))
    start, way = np.zeros((1, 3), np.float32) + np.float32([0, 0, 0.01]), np.float32([[0, 0, 3]])
    assert Tracer(made).visibility(start, way)[0] == 1
    assert Tracer(made, solid=casters(made).triangles).visibility(start, way)[0] == 0


def test_entries_get_what_a_mirror_sends_them():
    """A mirror in front of a whole wall: the room's other surfaces see a second lamp in it."""
    light = lamp((1.4, 1.2, 1.2))
    p, t, uv = box((0, 0, 0), (4, 3, 2.5), True)
    mirror = panel((0.01, 0, 0), (0, 3, 0), (0, 0, 2.5))
    scene = staged(("Room", p, t, uv, None, 0), mirror, lights=[light])
    baked = bake(scene, Settings(resolution=48, entries=800, lamps=150, regions=16, entry_rays=128, exit_rays=64))
    panes = baked.panes()
    atlas = CausticAtlas(scene, 48)
    tracer = Tracer(scene, solid=atlas.casters.triangles)
    found = CausticLight(panes.surface, atlas.landings, tracer.offset)
    unit = found.unit(light)
    area = panes.surface.size.astype(float) ** 2
    assert np.isclose((unit[:, 0] * area).sum(), atlas.energy(light).landed, rtol=0.01)
    # all that an entry receives is the part of the lamp's light in the angle that it fills
    plain, mirrored = (Relighter(panes, tracer, extra=extra) for extra in (None, found.unit))
    dark, bright = (r.relight([light])[..., 0][baked.own.reshape(48, 48)].mean() for r in (plain, mirrored))
    angle = plain.entry_light._solid_angle(np.arange(len(area)), np.array([0.02 - 1.4, 1.2, 1.2]))
    expected = angle / (4 * np.pi * area)
    beyond = panes.surface.position.reshape(len(area), -1, 3)[:, :, 0].min(axis=1) > 0.05
    error = np.sqrt(np.average((unit[beyond, 0] - expected[beyond]) ** 2, weights=area[beyond]))
    assert error < 0.05 * np.average(expected[beyond], weights=area[beyond])
    direct = np.average(plain.entry_light.unit(light), weights=area)
    # bounces follow direct light, in the mean
    assert np.isclose(bright / dark, 1 + np.average(unit[:, 0], weights=area) / direct, rtol=0.1)
