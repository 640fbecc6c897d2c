"""Where caustics went wrong: ordinary scenes that lost light or failed, each with what outside truth says of it."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from lightpanes.core.caustics import CausticAtlas, casters
from lightpanes.core.caustics.emission import _on_disk, _project, emitters
from lightpanes.core.caustics.lamp import LampCaustics
from lightpanes.core.caustics.receivers import Receivers
from lightpanes.core.caustics.splat import divided, splat
from lightpanes.core.caustics.surfaces import Surfaces
from lightpanes.core.rays import Tracer
from lightpanes.core.scene import Light, Material, Optics

from .caustic_scenes import BLACK, ball, closed, floor, floor_places, glass, panel, staged, within
from .shapes import GREY, lamp

WINDOW = Material(
    "Window", BLACK, transmission=(0.8,) * 3, optics=Optics(mirror=(0.2,) * 3, mirror_edge=(0.2,) * 3, clear=(0.8,) * 3)
)


def lit(scene, resolution: int = 64, **more) -> np.ndarray:
    """(resolution, resolution) W/m², red, of the scene's lamps."""
    return CausticAtlas(scene, resolution).image(scene.lights, **more)[..., 0]


# ---- what goes straight on ----


def test_shadow_rays_carry_what_a_caster_lets_straight_on():
    """Four fifths of the light pass a window that mirrors the fifth: no photon carries them."""
    light = lamp((0.3, 0.1, 2.2))
    scene = staged(floor(), panel((-1, -1, 1), (2, 0, 0), (0, 2, 0)), materials=(GREY, WINDOW), lights=[light])
    found = casters(scene)
    start, way = np.float32([[0, 0, 0.01]]), np.float32([[0.3, 0.1, 2.19]])
    assert np.isclose(Tracer(scene, solid=found.triangles).visibility(start, way)[0], 0.8)
    atlas = CausticAtlas(scene, 32)
    assert not atlas.image([light])[..., :3].any()
    energy = atlas.energy(light)
    met = energy.escaped / 0.2
    assert energy.absorbed == 0 and energy.untraced == 0
    assert np.isclose(closed(energy), 1, atol=0.002) and np.isclose(
        energy.emitted - energy.missed, 0.2 * met, rtol=0.01
    )


def test_photons_go_on_through_a_window():
    """A ball's caustic behind a window, on the lamp's side or on the floor's: four fifths of it."""
    light = lamp((0.3, 0.1, 2.2))
    ball_ = ball((0, 0, 0.8), 0.3, 64)
    alone = lit(staged(floor(), ball_, materials=(GREY, glass()), lights=[light]))
    for height in (1.5, 0.2):
        pane = panel((-2, -2, height), (4, 0, 0), (0, 4, 0), material=2, name="Pane")
        # black on the mirroring side, so that what comes back from it does not count
        plain = replace(WINDOW, optics=replace(WINDOW.optics, mirror=(0.1,) * 3, mirror_edge=(0.1,) * 3))
        image = lit(staged(floor(), ball_, pane, materials=(GREY, glass(), plain), lights=[light]))
        bright = alone > 0.3 * alone.max()
        assert bright.sum() > 5
        assert np.isclose(image[bright].sum() / alone[bright].sum(), 0.8, atol=0.03)


@pytest.mark.parametrize("mapped", [False, True])
def test_a_textured_floor_is_lit_and_a_curtain_lets_its_part_on(mapped):
    """A map of transmission makes no floor see-through; a half-clear sheet shows a caustic, and the floor half of it."""
    light = lamp((0.3, 0.1, 2.2))
    ball_ = ball((0, 0, 0.9), 0.3, 64)
    scene = staged(floor(), ball_, materials=(GREY, glass()), lights=[light])
    alone = CausticAtlas(scene, 64)
    expected = alone.image([light])[..., 0]
    cloth = replace(GREY, transmission=(0.5,) * 3)
    p, t, uv = floor()[1:4]
    raised = p + np.array([0, 0, 0.02])
    half = staged(
        ("Floor", p, t, uv / [2, 1], None, 0), ball_, ("Cloth", raised, t, uv / [2, 1] + [0.5, 0], None, 2),
        materials=(replace(GREY, mapped=mapped), glass(), replace(cloth, mapped=mapped)), lights=[light],
    )  # fmt: skip
    if mapped:
        half.transmission_map = np.zeros((8, 8, 3), np.float32)
        half.transmission_map[:, 4:] = 0.5
    atlas = CausticAtlas(half, 128)
    image = atlas.image([light])[::2, :, 0].reshape(64, 2, 64)
    _, inside = floor_places(64)
    inside = within(inside)
    below, on = (image[:, k][inside].sum() / expected[inside].sum() for k in (0, 1))
    assert np.isclose(on, 1, atol=0.05) and np.isclose(below, 0.5, atol=0.04)
    before, after = alone.energy(light), atlas.energy(light)
    assert np.isclose(after.landed + after.untraced, before.landed + before.untraced, rtol=0.02)
    assert np.isclose(closed(after), 1, atol=0.005)
    if mapped:
        opaque = staged(floor(), ball_, materials=(replace(GREY, mapped=True), glass()), lights=[light])
        opaque.transmission_map = np.zeros((8, 8, 3), np.float32)
        assert np.array_equal(lit(opaque), expected)


# ---- meshes without an inside ----


def test_a_sheet_of_glass_spoils_no_glass_behind_it():
    """A window of one face bends the sun's parallel light by nothing, since it falls in at right angles; a ball focuses it
    as behind a slab."""
    sun = replace(lamp((0, 0, 5), power=10.0, kind="SUN"), angle=0.0)
    ball_ = ball((0, 0, 0.6), 0.3, 64)
    peaks = {}
    for name, turned in (("none", None), ("up", False), ("down", True)):
        parts = [floor(), ball_]
        if name != "none":
            along, across = ((0, 2, 0), (2, 0, 0)) if turned else ((2, 0, 0), (0, 2, 0))
            parts.append(panel((-1, -1, 1.5), along, across, name="Window"))
        peaks[name] = lit(staged(*parts, materials=(GREY, glass()), lights=[sun])).max()
    assert np.isclose(peaks["up"], 0.96 * peaks["none"], rtol=0.03)
    assert np.isclose(peaks["down"], 0.96 * peaks["none"], rtol=0.03)


# ---- receivers ----


def test_a_scene_lit_at_its_vertices_alone_has_landings():
    """No texel shows them, but the panes' entries want to know where they are."""
    light = lamp((0.3, 0.1, 2.2))
    scene = staged(floor(), ball((0, 0, 0.7), 0.4, 24), materials=(GREY, glass()), lights=[light])
    shown = CausticAtlas(scene, 32)
    shown.image([light])
    expected = shown.landings(light).power.sum()
    for uv in (True, False):
        scene.objects = (replace(scene.objects[0], at_vertices=True), scene.objects[1])
        if not uv:
            scene.atlas_uv[:] = np.nan
        atlas = CausticAtlas(scene, 32)
        assert not atlas.image([light])[..., :3].any()
        assert np.isclose(atlas.landings(light).power.sum(), expected, rtol=0.03)
        assert np.isclose(closed(atlas.energy(light)), 1, atol=0.005)


# ---- lamps ----


@pytest.mark.parametrize("points", [16, 17, 18, 19])
def test_weaker_families_have_all_of_the_lamp_s_power(points):
    """They start from every fourth of its points, whatever their number."""
    light = lamp((0.3, 0.1, 2.2), radius=0.1)
    scene = staged(floor(), ball((0, 0, 0.7), 0.4, 32), materials=(GREY, glass()), lights=[light])
    found = casters(scene)
    photons = LampCaustics(light, Surfaces(scene, found), Receivers(scene, 32), 40_000)
    photons._plant(points, 2_500)
    shares = {}
    for tree in photons._trees:
        shares[tree.family] = shares.get(tree.family, 0.0) + tree.emitter.share
    assert len(shares) > 2 and np.allclose(list(shares.values()), shares[0])


@pytest.mark.parametrize("spread", [1.2, 0.2, 0.05, 0.02])
def test_a_narrow_soft_box_sends_all_its_light(spread):
    """Upwards into a mirror that takes all of it: 1 W is accounted for, and lands."""
    matrix = np.diag([1.0, -1, -1, 1])
    matrix[:3, 3] = (0.2, -0.1, 1)
    light = Light("Box", "AREA", matrix, 100.0, size=(0.3, 0.3), spread=spread)
    scene = staged(floor(4), panel((-3, -3, 2), (0, 6, 0), (6, 0, 0)), lights=[light])
    atlas = CausticAtlas(scene, 64)
    atlas.image([light], 10_000)
    energy = atlas.energy(light)
    assert np.isclose(energy.emitted, 1, atol=0.02) and np.isclose(closed(energy), 1, atol=0.02)
    assert np.isclose(energy.landed, 1, atol=0.02)


@pytest.mark.parametrize(
    ("place", "more"),
    [
        ((0, 0, 0.5), {}),
        ((1.5, 0.3, 0.2), {}),
        ((1.9, 0.3, 0.05), {}),
        ((1.2, 0.9, 0.1), {}),
        ((1.9, 1.9, 0.1), {}),
        ((0.7, -1.2, 0.002), {}),
        ((0.5, 1.0, 0.3), {"radius": 0.2}),
        ((0.5, 1.0, 0.3), {"kind": "AREA", "size": (1.0, 0.5)}),
    ],
)
def test_the_square_covers_a_large_mirror_near_the_lamp(place, more):
    """All directions that meet 4 × 4 m of two triangles lie in the square of photons, wherever the lamp is."""
    light = lamp(place, **more)
    mirror = panel((-2, -2, 0), (4, 0, 0), (0, 4, 0))
    scene = staged(floor(6, 3.0), mirror, lights=[light])
    surfaces = Surfaces(scene, casters(scene))
    found = emitters(light, surfaces.bounding(1, light), 16, 0, scene.extent)
    assert len(found) == (16 if more else 1)
    way = np.random.default_rng(0).normal(size=(50_000, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    for emitter in found:
        start = np.broadcast_to(emitter.origin[:, None], way.T.shape)
        if emitter.lens is not None:
            start = start + _on_disk(emitter.axes, emitter.lens, way.T)
        with np.errstate(divide="ignore"):
            distance = -start[2] / way[:, 2]
        at = start[:2].T + way[:, :2] * distance[:, None]
        meets = (distance > 0) & (np.abs(at) < 2).all(axis=1)
        flat = _project(emitter.axes, way[meets])
        covered = ((flat >= emitter.low) & (flat <= emitter.low + emitter.span)).all(axis=1)
        assert covered.mean() > 0.999


# ---- large atlases ----


@pytest.mark.parametrize("size", [256, 1024])
def test_a_patch_longer_than_its_samples_leaves_no_gaps(size):
    """One even patch over most of the atlas is as bright everywhere, and its quarters are its parabola's."""

    class Flat:
        resolution = size
        inner = np.ones(size * size, bool)

    step = np.linspace(0.05, 0.95, 3) * size
    place = np.stack(np.meshgrid(step, step, indexing="ij"), -1).reshape(9, 1, 2)
    patch = np.concatenate([place, np.full((9, 1, 1), 7.0)], axis=2).astype(np.float32)
    power = splat(patch, np.ones(1, np.int32), np.zeros(1, bool), Flat(), 1.0).reshape(size, size)
    assert np.isclose(power.sum(), 7)
    middle = power[size // 8 : -size // 8, size // 8 : -size // 8]
    assert np.allclose(middle, 7 / (0.9 * size) ** 2, rtol=0.35)
    assert middle.reshape(-1).std() < 0.1 * middle.mean()
    bent = np.random.default_rng(2).random((9, 1, 3)).astype(np.float32) * np.float32([size, size, 1])
    row = divided(bent)[1]
    assert (row == 0).all() and len(row) > 1
    # a fine rule's sums are those of the whole
    whole = splat(bent, np.ones(1, np.int32), np.zeros(1, bool), Flat(), 1.0)
    assert np.isclose(whole.sum(), (np.outer((1, 4, 1), (1, 4, 1)).ravel() / 36 * bent[:, 0, 2]).sum(), rtol=0.02)


def test_what_is_held_while_light_is_spread_is_little():
    """Not eight sums as large as the atlas, nor batches that grow with it."""
    light = lamp((0.3, 0.1, 2.2))
    tinted = replace(glass(), optics=replace(glass().optics, glass=(1.0, 0.9, 0.8)))
    scene = staged(floor(), ball((0, 0, 0.7), 0.4, 32), materials=(GREY, tinted), lights=[light])
    size = 1024
    atlas = CausticAtlas(scene, size, threads=1)
    tracemalloc.start()
    atlas.image([light], 2_500)
    peak = tracemalloc.get_traced_memory()[1]
    held = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    image = 3 * 4 * size * size
    assert peak < 20 * image
    assert held < 3 * image


def test_many_casters_share_the_photons():
    """40 balls under a soft lamp: no more photons than asked for, and most of them refine."""
    light = lamp((0, 0, 2.5), radius=0.1)
    balls = [ball((-1.5 + k % 7 / 2, -1.5 + k // 7 / 2, 0.3), 0.1, 12, name=f"Ball {k}") for k in range(40)]
    scene = staged(floor(4), *balls, materials=(GREY, glass()), lights=[light])
    photons = 20_000
    atlas = CausticAtlas(scene, 32)
    last = list(atlas.refine([light], photons))[-1]
    assert 0.8 * photons < last.photons < 1.1 * photons
    lamp_ = atlas._lamps[light.geometry]
    coarsest = lamp_._forest.level.min()
    assert (lamp_._forest.level > coarsest).mean() > 0.5
    assert np.isclose(closed(atlas.energy(light)), 1, atol=0.03)
