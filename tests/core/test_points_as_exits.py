"""Exits at points: the same light as at texels, from fewer rays, and stored so that a relight is a sum over a few."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from lightpanes.core import planner
from lightpanes.core.bake import Bake, bake, rounds, run, verdict
from lightpanes.core.bake.clock import Clock
from lightpanes.core.bake.stored import bake_points
from lightpanes.core.planner import Settings, plan, uses_points
from lightpanes.core.point_cache import Weights
from lightpanes.core.point_cache.codes import decode, encode, weight_bits
from lightpanes.core.scene import SceneError, SceneObject
from lightpanes.core.surface import make_vertices
from lightpanes.tests.frugal import save_rays

from .shapes import box, grid, lamp, quick, relighter, room, room_parts, scene

LIGHT = lamp((3, 1.5, 2))
POINTS = {"exits": "points", "points": 1200, "point_rays": 512}


@cache
def both():
    """One room baked with exits at texels and at points."""
    made = room(lights=[LIGHT])
    return made, bake(made, quick(exits="texels", exit_rays=512)), bake(made, quick(**POINTS))


def compare(made, texels, other, light):
    """Another bake of the room shows what that at texels does, wherever both do."""
    expected, found = (relighter(made, b).relight([light])[..., :3].astype(float).copy() for b in (texels, other))
    own = texels.own & other.own
    assert own.sum() > 0.98 * texels.own.sum()
    off = found[own] - expected[own]
    assert abs(off.mean()) < 0.01 * expected[own].mean()
    assert np.sqrt((off**2).mean()) < 0.06 * expected[own].mean()
    assert np.abs(off).max() < expected[own].mean()


@pytest.mark.parametrize("light", [LIGHT, lamp((0.8, 0.8, 1.6)), lamp((2, 2.4, 0.8))])
def test_points_show_what_texels_show(light):
    compare(*both(), light)


def test_the_image_is_the_weighted_sum_of_the_points():
    made, _, points = both()
    panes, runtime = points.panes(), relighter(made, points)
    light = runtime.light([LIGHT])
    rows = runtime.rows(light).astype(float)
    expected = np.zeros((panes.resolution**2, 3))
    for k in range(panes.shown.point.shape[1]):
        expected += panes.shown.weight[:, k, None] * rows[panes.shown.point[:, k]]
    image = runtime.image(light).reshape(-1, 4)
    assert np.allclose(image[:, :3], np.maximum(expected, 0), rtol=1e-4, atol=1e-6)
    assert (image[:, 3] == 1).all()


def test_rows_are_their_regions_panes():
    made, _, points = both()
    panes, runtime = points.panes(), relighter(made, points)
    weights = runtime.pane_weights([LIGHT]).reshape(len(panes.starts) - 1, -1, 3)
    expected = np.einsum("nk,nkc->nc", panes.rows.astype(float), weights[points.points["region"]])
    assert np.allclose(runtime.texels([LIGHT]), expected + panes.steady, rtol=1e-3, atol=1e-5)


def test_points_can_be_spread_to_an_atlas():
    made, texels, _ = both()
    atlas = bake(made, quick(**(POINTS | {"exits": "atlas"})))
    assert atlas.points == {} and atlas.report["exits"] == "atlas"
    assert {n: a.shape for n, a in atlas.images.items() if n != "Lightpanes Weights"} == {
        n: a.shape for n, a in texels.images.items() if n != "Lightpanes Weights"
    }
    compare(made, texels, atlas, LIGHT)
    with pytest.raises(SceneError, match="vertices"):
        bake(vertex_room(), quick(exits="atlas"))


def test_a_bake_of_points_survives_its_file(tmp_path):
    made, _, points = both()
    points.save(tmp_path / "points.npz")
    again = Bake.load(tmp_path / "points.npz")
    assert np.array_equal(relighter(made, again).relight([LIGHT]), relighter(made, points).relight([LIGHT]))
    assert {name: a.dtype for name, a in again.points.items()} == {name: a.dtype for name, a in points.points.items()}
    assert np.array_equal(again.own, points.own)


def test_same_seed_same_points():
    made, _, points = both()
    again = bake(made, quick(**POINTS))
    for name, array in points.points.items():
        assert np.array_equal(array, again.points[name]), name
    assert np.array_equal(points.images["Lightpanes Panes"], again.images["Lightpanes Panes"])


def test_the_report_tells_what_points_lose():
    _, texels, points = both()
    assert "points" not in texels.report["error_parts"] and texels.points == {}
    assert 0 < points.report["error_parts"]["points"] < 0.2
    assert points.report["gathered_points"] < points.report["stored_points"] == len(points.points["radius"])


@pytest.mark.parametrize("points", [10, 60_000, 300_000])
def test_codes_keep_weights(points):
    rng = np.random.default_rng(points)
    weight = rng.uniform(-0.2, 1, (500, 4)).astype(np.float32)
    weight[:, 3] = 0
    weight /= weight.sum(axis=1, keepdims=True)
    weight = weight[(np.abs(weight) < 1.4).all(axis=1) & (weight > -0.45).all(axis=1)]
    given = Weights(rng.integers(0, points, weight.shape).astype(np.int32), weight)
    bits = weight_bits(points)
    codes = encode(given, bits)
    assert codes.max() < 2**24 and np.array_equal(codes, np.rint(codes))
    found = decode(-codes, bits)
    assert np.allclose(found.weight.sum(axis=1), 1, atol=1e-5)
    assert np.abs(found.weight - given.weight).max() < 4 / 2**bits
    used = found.weight != 0
    assert np.array_equal(found.point[used], given.point[used]) and not used[:, 3].any()


def test_too_many_points_for_codes():
    with pytest.raises(ValueError, match="too many"):
        weight_bits(2**21)


# ---- light at vertices ----


def vertex_room():
    made = room(lights=[LIGHT])
    objects = [made.objects[0], replace(made.objects[1], at_vertices=True)]
    return replace(made, objects=objects)


def test_vertices_have_a_place_for_each_normal():
    places = make_vertices(vertex_room())
    # a block: eight corners, three faces at each
    assert len(places) == 24 and places.corner.shape == (12, 3)
    normal = places.samples.normal[places.corner]
    assert np.allclose(normal, normal[:, :1], atol=1e-5)
    assert len(make_vertices(room())) == 0


def test_light_at_vertices_is_that_of_texels_beside_them():
    made = vertex_room()
    baked = bake(made, quick(**POINTS))
    assert baked.report["exits"] == "points" and baked.report["vertices"] == 24
    runtime = relighter(made, baked)
    found = runtime.vertices(runtime.light([LIGHT]))
    fine = bake(made, quick(exits="points", points=6000, point_rays=1024))
    other = relighter(made, fine)
    expected = other.vertices(other.light([LIGHT]))
    assert found.shape == (24, 3) and found.min() >= 0
    assert np.sqrt(((found - expected) ** 2).mean()) < 0.15 * expected.mean()


def test_a_scene_of_vertices_alone():
    made = room(lights=[LIGHT])
    made = replace(made, objects=[replace(o, at_vertices=True) for o in made.objects])
    baked = bake(made, quick(**POINTS))
    runtime = relighter(made, baked)
    assert not baked.own.any()
    assert runtime.vertices(runtime.light([LIGHT])).mean() > 0
    assert not runtime.relight([LIGHT])[..., :3].any()


# ---- the planner ----


def test_points_are_taken_where_they_are_cheaper():
    made = room(lights=[LIGHT])
    budget = plan(made, Settings())
    assert not uses_points(Settings(), budget, 40_000, 0)
    assert uses_points(Settings(), budget, 900_000, 0)
    assert uses_points(Settings(), budget, 100, 5)
    assert uses_points(Settings(exits="points"), budget, 100, 0)
    assert not uses_points(Settings(exits="texels"), budget, 10_000_000, 0)
    with pytest.raises(SceneError, match="Exits"):
        Settings(exits="pixels")


@pytest.mark.parametrize("exits", ["points", "texels", "atlas"])
def test_a_time_budget_cuts_the_exits_rays(exits):
    made = room(lights=[LIGHT])
    # no time is left when the exits' turn comes
    budget = bake(made, quick(**(POINTS | {"exits": exits, "time_budget": 0.01}))).report["budget"]
    cut, whole = ("exit_rays", "point_rays") if exits == "texels" else ("point_rays", "exit_rays")
    assert budget[cut] == 16 and budget[whole] > 16


@pytest.mark.parametrize("at_vertices", [False, True])
def test_trials_of_more_points_serve_judged_places_alone_and_leave_no_trace(monkeypatch, at_vertices):
    place, planned, served = room(lights=[LIGHT]), planner.Budget(150, 64, 32, 4, 4, 30, 60, 64), []
    save_rays(monkeypatch)
    if at_vertices:
        points, faces, flat = grid((0.1, 0.1, 0.2), (3.8, 0, 0), (0, 2.8, 0), 24)
        place = scene(room_parts()[0], (points, faces, flat, 0), lights=[LIGHT])
        place = replace(place, objects=[SceneObject("Room", receives=False), SceneObject("Floor", at_vertices=True)])
    monkeypatch.setattr(rounds, "plan", lambda *_: planned)
    monkeypatch.setattr(rounds, "ROUNDS", 0)
    more = iter([replace(planned, points=90), replace(planned, points=120), None, None])
    monkeypatch.setattr(run, "more_points", lambda *_: next(more))
    monkeypatch.setattr(run, "no_more_points", lambda _, budget, *__: budget)

    def counted(made, *rest):
        served.append(len(made.exits) + len(made.vertices))
        return bake_points(made, *rest)

    monkeypatch.setattr(run, "bake_points", counted)
    # few are judged, or there would be no others
    monkeypatch.setattr(verdict, "BLOCKS", 16)
    settings = Settings(error_target=0.01, resolution=48, exits="points")
    found = bake(place, settings)
    some, again, once_more, last = served
    assert last > 2 * some and some == again == once_more
    # the pilot has half of the points
    monkeypatch.setattr(rounds, "plan", lambda *_: replace(planned, points=240))
    monkeypatch.setattr(run, "few_points", lambda budget: budget)
    monkeypatch.setattr(run, "more_points", lambda *_: None)
    at_once = bake(place, settings)
    assert np.array_equal(found.panes().rows, at_once.panes().rows)
    assert found.report["error"] == at_once.report["error"]


@pytest.mark.parametrize(("error", "points"), [(0.05, 32), (0.5, 80)])
def test_fewer_points_are_tried_at_judged_places_first(monkeypatch, error, points):
    """Where they are found to be too few, it is what was enough that all places get."""
    served, shown, found = [], [], iter([0.05, error, 0.05, 0.05])
    save_rays(monkeypatch)
    monkeypatch.setattr(verdict, "BLOCKS", 16)
    monkeypatch.setattr(rounds, "plan", lambda *_: planner.Budget(150, 64, 32, 4, 4, 30, 320, 64))
    monkeypatch.setattr(rounds, "ROUNDS", 0)
    monkeypatch.setattr(planner, "FEWEST_POINTS", 30)
    monkeypatch.setattr(run, "more_points", lambda *_: None)
    judge = run.judge

    def judged(*given):
        return replace(judge(*given), error=next(found), panes=0.0, exits=0.01, entries=0.0)

    def counted(made, *rest):
        served.append((len(made.exits), made.budget.points, shown[-1].fraction))
        return bake_points(made, *rest)

    monkeypatch.setattr(run, "judge", judged)
    monkeypatch.setattr(run, "bake_points", counted)
    bake(room(lights=[LIGHT]), Settings(error_target=0.3, resolution=48, exits="points"), shown.append)
    *trials, (places, last, fraction) = served
    assert [number for _, number, _ in trials] == [80, 32] and last == points
    assert all(place < 0.5 * places for place, _, _ in trials)
    # what is shown of the whole is where the points' part begins
    assert fraction <= Clock.STAGES["Caustics"]


def test_detailed_meshes_want_more_points():
    parts = [(*box((k % 20, k // 20, 0), (k % 20 + 0.5, k // 20 + 0.5, 0.5)), 0) for k in range(5000)]
    assert plan(scene(*parts), Settings()).points > plan(room(), Settings()).points
