"""Entries share a lamp's light so that its middle stays where it falls: against quadrature, the lamp's place, and the light
that its pool sends to a ceiling."""

import numpy as np
import pytest
from lightpanes.core.bake.steady import QUARTERS
from lightpanes.core.bake.steps import prepare
from lightpanes.core.form_factors import triangles_from
from lightpanes.core.panes.entry_light import EntryLight
from lightpanes.core.panes.sharing import Sharing
from lightpanes.core.scene import Material

from .shapes import box, lamp, moved, quad, quick, scene
from .uncompressed import WHITISH

HALL = (4.0, 3.0, 2.0)
"""m."""

LOW = 0.01
"""m above the floor, where half of a lamp's light falls within 2 cm of its foot."""


def hall(*things, materials=(WHITISH,)):
    return scene((*box((0, 0, 0), HALL, True), 0), *things, materials=materials, lights=[lamp((1, 1.5, 1.2))])


def looks(made, entries=400, **more):
    ready = prepare(made, quick(entries=entries, lamps=30, regions=4, panes=2, **more))
    return ready, EntryLight(ready.surface, ready.tracer)


@pytest.fixture(scope="module")
def bare():
    return looks(hall())


def along(count=9):
    """Places low above the floor, over middles of entries and over their borders."""
    return np.linspace((1.0, 0.9, LOW), (3.0, 2.1, LOW), count)


def unshared(eyes, light, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(Sharing, "share", lambda *given: None)
        return eyes.look(light)


@pytest.mark.parametrize("height", [0.02, 0.3, 2.0])
def test_light_on_a_triangle(height):
    """The angle and where its middle is, by sums over many small parts."""
    rng = np.random.default_rng(4)
    corners = rng.uniform(-0.5, 0.5, (6, 3, 3))
    corners[:, :, 2] *= 0.1
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    place = np.array([0.1, 0.05, height + 0.05])
    angle, moment = triangles_from(corners @ turn, place @ turn)
    side = 900
    i, j = (v[np.add(*np.indices((side, side))) < side] for v in np.indices((side, side)))
    # upward and downward halves of the squares
    both = np.concatenate([np.stack([i + 1 / 3, j + 1 / 3]), np.stack([i + 2 / 3, j + 2 / 3])[:, i + j < side - 1]], 1)
    b, c = both / side
    weights = np.stack([1 - b - c, b, c], 1)
    for k, triangle in enumerate(corners):
        points = weights @ triangle - place
        cross = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        light = -(points @ cross) / 2 / len(points) / np.linalg.norm(points, axis=1) ** 3
        expected = np.zeros(4) if light.mean() < 0 else np.array([light.sum(), *(light @ points)])
        assert angle[k] == pytest.approx(expected[0], rel=1e-3, abs=1e-9)
        assert np.allclose(moment[k], expected[1:] @ turn, atol=1e-3 * max(expected[0], 1e-9))
    behind = triangles_from(corners[:, ::-1] @ turn, place @ turn)[0]
    assert ((angle > 0) != (behind > 0)).all()


def test_light_stays_where_it_falls(bare, monkeypatch):
    """The middle of what the floor gets wanders with the lamp, where it jumped from entry to entry."""
    ready, eyes = bare
    floor = ready.entries.normal[:, 2] > 0.9
    size = eyes.surface.size[floor].mean()
    flux, middle = eyes.surface.size[floor] ** 2, eyes.surface.middle[floor]

    def off(unit, place):
        # of the pool alone: what falls on the floor afar has a middle of its own
        near = np.linalg.norm(middle - place, axis=1) < 2 * size
        light = (unit[floor] * flux)[near]
        return np.linalg.norm(light @ middle[near] / light.sum() - place * (1, 1, 0)) / size

    found, before = [], []
    for place in along():
        light = lamp(place, 1.0)
        found.append(off(eyes.unit(light), place))
        before.append(off(unshared(eyes, light, monkeypatch)[0], place))
    assert max(found) < 0.02 and max(before) > 0.25


def test_power_stays(bare, monkeypatch):
    ready, eyes = bare
    area = eyes.surface.size.astype(np.float64) ** 2
    for place in along():
        light = lamp(place, 1.0)
        plain, _ = unshared(eyes, light, monkeypatch)
        found = eyes.unit(light)
        assert found @ area == pytest.approx(plain @ area, rel=1e-5) and (found >= 0).all()
        assert found @ ready.entries.area == pytest.approx(1, rel=0.01)


def test_a_pool_of_light_below_a_ceiling(bare, monkeypatch):
    """One bounce: of the flux Φ that falls on the floor ρ Φ h² / π d⁴ comes to the ceiling, from the lamp's foot; from entries
    that shine evenly, here sums over their pieces' quarters, about as much."""
    ready, eyes = bare
    entries, surface = ready.entries, eyes.surface
    floor, ceiling = (sign * entries.normal[:, 2] > 0.9 for sign in (1, -1))
    to = entries.position[ceiling]
    owner = np.repeat(np.arange(len(surface)), surface.counts)
    a, b, c = np.moveaxis(surface.pieces.astype(float), 1, 0)
    piece_area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2

    def falls(way):
        return HALL[2] ** 2 / (np.pi * (way**2).sum(axis=-1) ** 2)

    quarters = QUARTERS @ surface.pieces.astype(float)
    brings = falls(quarters[:, :, None] - to).mean(axis=1) * piece_area[:, None]
    each = np.stack([np.bincount(owner, column, len(surface)) for column in brings.T], 1)[floor]
    wrong = {"shared": [], "not": []}
    for place in along():
        light = lamp(place, 1.0)
        for name, unit in (("shared", eyes.unit(light)), ("not", unshared(eyes, light, monkeypatch)[0])):
            pool = unit[floor] * (np.linalg.norm(entries.position[floor] - place, axis=1) < 1)
            truth = (pool @ entries.area[floor]) * falls(to - place * (1, 1, 0))
            wrong[name].append(np.sqrt(((pool @ each - truth) ** 2).mean()) / truth.mean())
    shared, plain = (np.sqrt(np.mean(np.square(wrong[name]))) for name in ("shared", "not"))
    # what spreads the pool over an entry and those beside it is left
    assert shared < 0.6 * plain


def test_moments_that_are_left_are_smaller(bare, monkeypatch):
    _, eyes = bare
    for place in along():
        light = lamp(place, 1.0)
        left, before = (
            np.linalg.norm(moment * eyes.surface.size[:, None] ** 2, axis=1).sum()
            for moment in (eyes.look(light)[1], unshared(eyes, light, monkeypatch)[1])
        )
        assert left <= before


WALLS = {
    "a box": box((2, -1, 0), (2.05, 4, 3)),
    "a sheet": quad((2, -1, -0.01), (0, 5, 0), (0, 0, 3)),
}


@pytest.mark.parametrize("name", WALLS)
def test_nothing_is_shared_through_a_wall(name):
    _, eyes = looks(hall((*WALLS[name], 0)))
    for away in (0.02, 0.1, 0.3):
        unit = eyes.unit(lamp((2 - away, 1.3, LOW), 1.0))
        assert not unit[eyes.surface.middle[:, 0] > 2.06].any() and unit.any()


def test_colours_are_not_shared():
    """Light on a white floor does not come back from a black one."""
    floors = (*quad((0, 0, 0.001), (2, 0, 0), (0, 3, 0)), 0), (*quad((2, 0, 0.001), (2, 0, 0), (0, 3, 0)), 1)
    _, eyes = looks(hall(*floors, materials=(WHITISH, Material("Dark", (0.1,) * 3))))
    beside, albedo = Sharing(eyes.surface, eyes.tracer).beside, eyes.surface.albedo[:, 0]
    here, k = np.nonzero(beside >= 0)
    assert len(here) > len(beside) and np.allclose(albedo[here], albedo[beside[here, k]])
    assert len(np.unique(albedo.round(3))) == 2


def test_what_is_beside_is_so_both_ways_and_on_one_surface(bare):
    _, eyes = bare
    shared = Sharing(eyes.surface, eyes.tracer)
    here, k = np.nonzero(shared.beside >= 0)
    there = shared.beside[here, k]
    assert (np.einsum("md,md->m", shared.normal[here], shared.normal[there]) > 0.99).all() and (here != there).all()
    apart = np.linalg.norm(shared.middle[here] - shared.middle[there], axis=1)
    assert (apart[1:] >= apart[:-1])[here[1:] == here[:-1]].all()
    inside = (np.abs(shared.middle - np.array(HALL) / 2) < np.array(HALL) / 2 - 0.5).sum(axis=1) == 2
    assert (shared.beside[inside] >= 0).sum(axis=1).min() >= 5


def test_one_with_nothing_beside_it_keeps_its_light(monkeypatch):
    """Each board is about an entry wide, and none lies on a surface with others."""
    boards = [(*quad((2 * k, 0, 0.1 * k), (0.3, 0, 0), (0, 0.3, 0)), 0) for k in range(9)]
    _, eyes = looks(scene(*boards, materials=(WHITISH,), lights=[lamp((0.2, 0.2, 1))]), 9)
    alone = (Sharing(eyes.surface, eyes.tracer).beside < 0).all(axis=1)
    assert alone.any()
    for k in range(9):
        light = lamp((2 * k + 0.1, 0.2, 0.1 * k + LOW), 1.0)
        assert np.allclose(eyes.unit(light)[alone], unshared(eyes, light, monkeypatch)[0][alone], rtol=1e-6)


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_sharing_is_the_same_in_scenes_of_any_size(bare, size):
    _, eyes = bare
    _, other = looks(moved(hall(), size * np.eye(3)))
    beside, there = (Sharing(e.surface, e.tracer).beside for e in (eyes, other))
    # which of some that are as far comes first is chance
    assert len(beside) == len(there) and (np.sort(beside) == np.sort(there)).mean() > 0.95
    place = np.array((1.1, 0.93, LOW))
    near = np.linalg.norm(eyes.surface.middle - place, axis=1) < 1
    middles = []
    for one, scale in ((eyes, 1), (other, size)):
        flux = one.unit(lamp(scale * place, 1.0))[near] * one.surface.size[near].astype(float) ** 2
        middles.append(flux @ one.surface.middle[near] / flux.sum() / scale)
    assert np.allclose(*middles, atol=2e-3)


def test_part_of_an_entry_below_a_thing():
    """What is left of it is what it sends, and has its middle there."""
    _, eyes = looks(hall((*box((1.1, 0.7, -0.5), (1.25, 0.85, 0.5)), 0)), 100)
    surface = eyes.surface
    each = surface.position.reshape(len(surface), -1, 3)
    assert np.array_equal(surface.left * each.shape[1], [len(np.unique(place, axis=0)) for place in each])
    # that part of the floor is cut away, or its entry has fewer places
    some = surface.left < 1
    assert np.allclose(surface.middle[some], each[some].mean(axis=1), atol=1e-5)


def test_no_light_is_below_nothing_or_lost(bare):
    _, eyes = bare
    rng = np.random.default_rng(2)
    for place in rng.uniform((0.005,) * 3, np.array(HALL) - 0.005, (40, 3)):
        unit = eyes.unit(lamp(place, 1.0))
        assert unit.min() >= 0 and unit @ eyes.surface.size.astype(float) ** 2 == pytest.approx(1, rel=0.03)
