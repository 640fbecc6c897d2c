"""Indirect light against closed forms, through whole bakes."""

import numpy as np
import pytest
from lightpanes.core.bake import Settings, bake
from lightpanes.core.panes import Relighter
from lightpanes.core.rays import Bvh, Tracer
from lightpanes.core.scene import Material, Scene
from lightpanes.core.surface import make_patches
from lightpanes.core.transfer import find_entries, make_gatherer, make_transport

from .shapes import box, globe, lamp, scene


@pytest.fixture(scope="module")
def sphere():
    """A bake of an integrating sphere of radius 2 m."""
    made = scene((*globe(radius=2.0), 0), materials=(Material("Coat", (0.8, 0.5, 0.2)),))
    return made, bake(made, Settings(resolution=128, entries=2000))


@pytest.mark.parametrize("place", [(0, 0, 0), (0.9, -0.6, 0.7), (0, 1.2, -1.2), (1.9, 0, 0)])
def test_integrating_sphere(sphere, place):
    # E = Φ / 4πR² · ρ / (1 − ρ) everywhere, wherever the lamp is
    made, baked = sphere
    light = lamp(place)
    texels = Relighter(baked.panes(), Tracer(made)).texels([light])
    albedo = np.array(made.materials[0].albedo)
    expected = 100 / (4 * np.pi * 2.0**2) * albedo / (1 - albedo)
    assert np.allclose(texels.mean(axis=0) / expected, 1, atol=0.01)
    # everywhere, and not only on average: the spread is the gather's noise and the entries' size
    assert (texels.std(axis=0) / expected < (0.03 if np.linalg.norm(place) < 1.8 else 0.12)).all()


def test_white_furnace():
    # radiosity of a closed, glowing room of one albedo: π L / (1 − ρ), whatever its shape
    glow = Material("Glow", (0.6, 0.6, 0.3), emission=(1.0, 2.0, 3.0))
    made = scene((*box((0, 0, 0), (4, 3, 2.5), True), 0), (*box((1, 1, 0.4), (1.7, 2, 1.4)), 0), materials=(glow,))
    baked = bake(made, Settings(resolution=64, entries=800))
    albedo, first = np.array(glow.albedo), np.pi * np.array(glow.emission)
    panes = baked.panes()
    shown = panes.fill >= 0
    assert np.allclose(baked.direct.reshape(-1, 3)[shown].mean(axis=0), first, rtol=0.01)
    assert np.allclose(panes.steady.mean(axis=0), first * albedo / (1 - albedo), rtol=0.01)
    assert np.allclose(panes.steady, first * albedo / (1 - albedo), rtol=0.06)


def test_parallel_plates():
    # infinite plates, one lit by b: it gets ρ₁ρ₂ b / (1 − ρ₁ρ₂) back, the other ρ₁ b / (1 − ρ₁ρ₂)
    half, gap = 60.0, 1.0
    square = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    low, high = np.c_[square, np.zeros(4)], np.c_[square, np.full(4, gap)]
    triangles = np.array([[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]])
    made = Scene(
        np.concatenate([low, high]),
        triangles,
        triangle_material=np.array([0, 0, 1, 1]),
        materials=(Material("Low", (0.7,) * 3), Material("High", (0.4,) * 3)),
    )
    patches = make_patches(made, 4000)
    bvh = Bvh(patches.corners)
    entries, _, _ = find_entries(made, patches, bvh, patches.sample(made, np.arange(len(patches)), 1), 1e-3)
    transport = make_transport(entries, make_gatherer(made, patches, entries, bvh, 1e-3), 2048)
    lit = (entries.position[:, 2] < 0.5 * gap).astype(np.float32)[:, None]
    radiosity = transport.solve(entries.albedo[:, :1], entries.albedo[:, :1] * lit)
    back = (transport.between @ radiosity)[:, 0]
    middle = (np.abs(entries.position[:, :2]) < 30).all(axis=1)
    low_side = entries.position[:, 2] < 0.5 * gap
    area = entries.area
    for side, expected in ((low_side, 0.28 / 0.72), (~low_side, 0.7 / 0.72)):
        rows = side & middle
        assert np.average(back[rows], weights=area[rows]) == pytest.approx(expected, rel=0.01)


def test_no_light_without_albedo():
    made = scene((*box((0, 0, 0), (2, 2, 2), True), 0), materials=(Material("Black", (0.0, 0.0, 0.0)),))
    baked = bake(made, Settings(resolution=32, entries=400))
    assert not Relighter(baked.panes(), Tracer(made)).texels([lamp((1, 1, 1))]).any()


def test_albedo_of_one_is_bounded():
    made = scene((*globe(rings=24), 0), materials=(Material("Snow", (1.0, 1.0, 1.0)),))
    baked = bake(made, Settings(resolution=64, entries=600))
    texels = Relighter(baked.panes(), Tracer(made)).texels([lamp((0, 0, 0))])
    # lowered to 0.98, and said so
    assert texels.mean() == pytest.approx(100 / (4 * np.pi) * 0.98 / 0.02, rel=0.03)
    assert any("Snow" in warning for warning in baked.report["warnings"])
