"""A bake's own measure of its error, against errors that are put in by hand."""

from dataclasses import replace

import numpy as np
import pytest
from lightpanes.core.bake import bake, error_map, fresh_light, verdict
from lightpanes.core.bake.clock import Clock
from lightpanes.core.bake.fresh_light import entry_fields, even_light, uneven_light
from lightpanes.core.bake.kept import Kept
from lightpanes.core.bake.rounds import settle
from lightpanes.core.bake.steps import prepare
from lightpanes.core.panes.exits import gather_panes
from lightpanes.core.panes.held_out import CLEAR, REACH, held_out_lamps, representative
from lightpanes.core.panes.regions import region_of
from lightpanes.core.panes.training import NAME, room_around
from lightpanes.core.planner import (
    FALL,
    FEWEST_POINTS,
    MOST_ENTRIES,
    RAYS_FALL,
    SURE,
    Judged,
    Settings,
    cheap_rays,
    few_points,
    first_try,
    more_points,
    no_more_points,
    plan,
    refine,
    sized,
)
from lightpanes.core.threads import use_threads
from lightpanes.tests.frugal import save_rays

from .shapes import box, lamp, quad, quick, room, scene

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("exact")]


@pytest.fixture(scope="module")
def exact():
    """Bakes save rays, but not on the measure of their error."""
    with pytest.MonkeyPatch.context() as patch:
        save_rays(patch, judge=True)
        yield


@pytest.fixture(scope="module")
def made(exact):
    return prepare(room(lights=[lamp((3, 1.5, 2)), lamp((1, 1, 2), kind="SUN")]), quick())


@pytest.fixture(scope="module")
def truth(made):
    """Light gathered anew with many rays, by other random numbers than the judge's."""
    places = made.exits.samples
    even, _ = even_light(made, places, region_of(made.starts), no_panes(made), 2048, 900)
    return even + uneven_light(made, places, entry_fields(made), 64, 901)


def test_no_judge_is_inside_a_thing_with_a_slit():
    """Such a lamp lights the thing's back alone, which nothing shows."""
    low, high = np.array((1.0, 0.8, 0.4)), np.array((2.2, 1.8, 1.6))
    points, faces, flat = box(low, high)
    top = (points[faces][..., 2] == high[2]).all(axis=1)
    lid = quad((*low[:2], high[2]), (1.2, 0, 0), (0, 0.97, 0))
    place = scene((*box((0, 0, 0), (4, 3, 2.5), True), 0), (points, faces[~top], flat[~top], 0), (*lid, 0))
    made = prepare(place, quick())
    # there is air inside, and walls that pass light on
    assert made.entries.back.sum() > 20
    at = np.array([light.position for light in made.test_lamps])
    assert len(at) > 12 and not ((at > low) & (at < high)).all(axis=1).any()


def no_panes(made):
    return np.zeros((made.modes.regions, made.modes.panes, 1), np.float32)


def judged(made, show):
    return verdict.judge(made, 0, show)


def shows(light):
    """What shows (t, l, 3) at all texels."""
    return lambda chosen, value: light[chosen].reshape(len(chosen), -1)


def test_held_out_lamps_stand_in_the_air_and_half_are_the_scenes_own(made):
    scene = made.scene
    found, are_own = held_out_lamps(scene, made.places, made.gatherer, 12, 5)
    assert len(found) == 12
    own, anywhere = found[::2], found[1::2]
    assert are_own[::2].all() and not are_own[1::2].any()
    assert {light.name for light in own} == {light.name for light in scene.lights}
    suns = [light for light in own if light.kind == "SUN"]
    points = [light for light in own if light.kind == "POINT"]
    assert len(suns) == len(points) == 3
    for light in points:
        assert 0 < np.linalg.norm(light.position - scene.lights[0].position) <= REACH * scene.extent
    around = room_around(np.array([light.position for light in (*points, *anywhere)], np.float32), made.gatherer)
    assert around.min() > 0.99 * CLEAR * scene.extent
    # no sun gets into a closed room, wherever it stands
    assert all(np.allclose(light.direction, scene.lights[1].direction) for light in suns)
    again, _ = held_out_lamps(scene, made.places, made.gatherer, 12, 5)
    assert all(np.array_equal(a.matrix, b.matrix) for a, b in zip(found, again, strict=True))


def test_the_scenes_own_lamps_are_told_apart_whatever_they_are_called(made):
    """Their names are the user's, and may be those that lamps of no scene have."""
    scene = replace(made.scene, lights=tuple(replace(light, name=NAME) for light in made.scene.lights))
    found, own = held_out_lamps(scene, made.places, made.gatherer, 12, 5)
    assert np.array_equal(own, held_out_lamps(made.scene, made.places, made.gatherer, 12, 5)[1])
    some = representative(found, own, np.arange(12.0), 6)
    kinds = [any(one is light for light, mine in zip(found, own, strict=True) if mine) for one in some]
    assert kinds == [True, False] * 3


def test_fresh_light_is_what_a_plain_gather_brings(made):
    """Of the entries' light, all whose bounces are solved for without panes, and of the panes, by the same rays."""
    places, lamps = made.exits.samples, len(made.test_lamps)
    value = made.weights.of_white(made.test_direct).reshape(made.modes.regions, made.modes.panes, -1)
    even, panes = even_light(made, places, region_of(made.starts), value, 48, 5)
    albedo = np.tile(made.entries.albedo, (1, lamps))
    solved = made.transport.solve(albedo, albedo * np.repeat(made.test_direct, 3, axis=1), 1e-5)
    table = np.zeros((1, made.gatherer.size, solved.shape[1]), np.float32)
    table[0, : len(solved)] = solved
    plain = gather_panes(made.gatherer, places, np.array([0, len(places)]), table, 48, 5)
    level = plain.mean(axis=0).max()
    assert np.abs(even.reshape(plain.shape) - plain).max() < 0.03 * plain.max()
    assert np.abs(even.reshape(plain.shape) - plain).mean() < 2e-3 * level
    rows = gather_panes(made.gatherer, places, made.starts, made.tables, 48, 5)[:, : made.modes.panes]
    asked = np.einsum("tk,tks->ts", rows, value[region_of(made.starts)])
    assert np.allclose(panes, asked, atol=1e-4 * np.abs(asked).max())


def test_far_entries_may_shine_evenly(made, monkeypatch):
    """Their unevenness is noise to whoever looks from afar."""
    places, fields = made.exits.samples.take(np.arange(0, len(made.exits), 8)), entry_fields(made)
    near = uneven_light(made, places, fields, 512, 3)
    monkeypatch.setattr(fresh_light, "NEAR", np.inf)
    whole = uneven_light(made, places, fields, 512, 3)
    mean = made.fields.arriving.mean(axis=(0, 2))
    lit = mean > 1e-6 * mean.max()
    apart = (whole - near).mean(axis=0)[lit] / mean[lit, None]
    assert np.abs(apart).max() < 0.01


def test_what_is_right_is_found_right(made, truth):
    found = judged(made, shows(truth))
    assert found.error < 0.012


@pytest.mark.parametrize("part", [0.03, 0.2])
def test_an_error_is_found_as_large_as_it_is(made, truth, part):
    """Blocks that are too bright by a known part."""
    size = made.exits.resolution
    block = made.exits.index // size // 4 * size + made.exits.index % size // 4
    wrong = 1 + part * np.random.default_rng(3).standard_normal(size * size)[block]
    light = (truth * wrong[:, None, None]).astype(np.float32)
    mean = truth.mean(axis=(0, 2))
    lit = mean > 1e-6 * mean.max()
    asked = np.sqrt((((light - truth)[:, lit] / mean[lit, None]) ** 2).mean(axis=(0, 2))).mean()
    found = judged(made, shows(light))
    assert found.error == pytest.approx(asked, rel=0.15)
    assert found.worst > 1.4 * found.error


def test_parts_tell_where_an_error_is(made):
    base = verdict.judge(made, 0)
    coarse = replace(made, budget=replace(made.budget, exit_rays=made.budget.exit_rays // 4))
    noisy = verdict.judge(coarse, 0)
    assert noisy.exits == pytest.approx(4**RAYS_FALL * base.exits, rel=1e-6) and noisy.error > base.error
    assert (noisy.entries, noisy.panes, noisy.lamps) == (base.entries, base.panes, base.lamps)


def test_the_noise_of_exits_is_known_before_they_are(made):
    """By what gathers of as many rays then have: each is known to within a fifth or so alone."""
    rays, found = verdict.EVEN_RAYS, []
    for seed in (41, 42, 43):
        rows = gather_panes(made.gatherer, made.exits.samples, made.starts, made.tables, rays, seed)
        found.append(judged(made, verdict.shown_by_texels(made, rows, made.starts)).exits)
    foreseen = verdict.judge(replace(made, budget=replace(made.budget, exit_rays=rays)), 0)
    assert foreseen.exits == pytest.approx(np.sqrt(np.mean(np.square(found))), rel=0.25)


def test_a_verdict_does_not_depend_on_threads(made):
    try:
        use_threads(1)
        alone = verdict.judge(replace(made, looks=None), 0)
    finally:
        use_threads(0)
    both = verdict.judge(replace(made, looks=None), 0)
    assert alone.error == both.error and np.array_equal(alone.squares, both.squares)


def test_the_map_of_errors(made, truth):
    """Half of the room is wrong, and the map shows which."""
    left = made.exits.samples.position[:, 0] < 2
    light = np.where(left[:, None, None], 1.3 * truth, truth).astype(np.float32)
    errors = error_map.error_map(judged(made, shows(light)), made.exits, made.scene.extent)
    size = made.exits.resolution
    assert errors.shape == (size, size)
    own = errors.reshape(-1)[made.exits.index]
    assert own.min() >= 0 and np.median(own[left]) > 2.5 * np.median(own[~left])
    kept = error_map.decode(error_map.encode(errors))
    assert np.allclose(kept, errors, rtol=1e-3, atol=1e-4)
    picture = error_map.coloured(kept, 0.05)
    assert (picture[errors < 0] == 0).all()
    red = picture[..., 0] - picture[..., 2]
    assert red[np.unravel_index(errors.argmax(), errors.shape)] > 0.5


def test_a_bake_reports_its_error():
    report = (made := bake(room(lights=[lamp((3, 1.5, 2))]), quick())).report
    assert 0 < report["error"] < report["error_95"] < 1
    assert set(report["error_parts"]) == {"panes", "gather noise", "entries", "lamps"}
    assert report["bound"] == "given" and report["rounds"] == []
    assert error_map.decode(made.meta["error_map"]).max() > 0
    unlit = bake(room(lights=[lamp((3, 1.5, 2), live=False)]), quick())
    assert unlit.report["error_95"] is None and "error_map" not in unlit.meta


def scene_whose_error_falls(power, at_600, noise_192):
    def look(budget):
        noise = noise_192 * (192 / budget.exit_rays) ** RAYS_FALL
        return Judged(budget, ((at_600 * (600 / budget.entries) ** power) ** 2 + noise**2) ** 0.5, noise)

    return look


def test_one_small_bake_tells_what_a_target_takes():
    """Where the error falls as it usually does."""
    look, settings = scene_whose_error_falls(FALL, 0.12, 0.01), Settings(error_target=0.05)
    budget = refine(settings, [look(first_try(settings, plan(room(), settings)))], False)
    assert 0.8 * SURE * 0.05 < look(budget).error <= SURE * 0.05


@pytest.mark.parametrize("power", [0.4, 0.6, 0.9])
@pytest.mark.parametrize("target", [0.1, 0.05])
def test_rounds_end_at_the_target_and_not_far_below(power, target):
    look, settings = scene_whose_error_falls(power, 0.12, 0.01), Settings(error_target=target)
    judged = [look(replace(sized(plan(room(), settings), 600, settings), exit_rays=192))]
    for _ in range(6):
        budget = refine(settings, judged, False)
        if budget.entries == judged[-1].budget.entries:
            break
        judged.append(look(budget))
    error = look(budget).error
    if budget.entries < MOST_ENTRIES:
        assert 0.6 * SURE * target < error <= SURE * target
        # half the entries would not do
        if len(judged) > 1:
            assert look(replace(budget, entries=budget.entries // 2)).error > target
    assert look(budget).noise <= 0.401 * target


def test_rays_at_few_texels_are_free():
    """Beside those of entries and training lamps, which a large atlas outnumbers."""
    settings = Settings()
    budget = replace(plan(room(), settings), exit_rays=150)
    traced = budget.entries * (budget.entry_rays + budget.lamps)
    rays = [cheap_rays(settings, budget, texels).exit_rays for texels in (100, 10_000, 1_000_000)]
    assert rays[0] == 2048 and 150 < rays[1] < 2048 and rays[2] == 150
    assert rays[1] * 10_000 <= 0.51 * traced
    assert cheap_rays(Settings(exit_rays=64), budget, 100).exit_rays == 64


def test_where_no_entries_are_enough_the_most_are_tried_at_once():
    settings = Settings(error_target=0.05)
    small = first_try(settings, plan(room(), settings))
    steps = {error: refine(settings, [Judged(small, error, 0.01)], False).entries for error in (0.2, 1.4)}
    assert steps[0.2] == 6 * small.entries < MOST_ENTRIES and steps[1.4] == MOST_ENTRIES


def test_points_are_added_where_they_are_what_is_wrong():
    settings = Settings(error_target=0.05)
    budget = plan(room(), settings)
    assert more_points(settings, budget, SURE * 0.049, SURE * 0.04) is None
    more = more_points(settings, budget, 0.07, 0.06)
    assert 1.5 < more.points / budget.points <= 3
    assert more_points(replace(settings, points=budget.points), budget, 0.07, 0.06) is None
    assert more_points(settings, replace(budget, points=60_000), 0.07, 0.06) is None
    # where most of the error is elsewhere, they change little
    assert more_points(settings, budget, 0.07, 0.02) is None


def test_no_more_points_than_the_error_asks_for():
    settings = Settings(error_target=0.05)
    budget = plan(room(), settings)
    assert few_points(budget).points == budget.points // 2
    assert no_more_points(settings, budget, 0.06, 0.05) == budget
    fewer = no_more_points(settings, budget, 0.035, 0.02)
    # their part of the error falls with the root of their number
    share = 0.02**2 * budget.points / fewer.points + 0.035**2 - 0.02**2
    assert fewer.points < budget.points and 0.9 * SURE * 0.05 < share**0.5 <= SURE * 0.05
    few = replace(budget, points=FEWEST_POINTS)
    assert few_points(few) == no_more_points(settings, few, 0.01, 0.005) == few


def test_a_small_target_takes_more_rounds():
    scene, found = room(lights=[lamp((3, 1.5, 2))]), []
    for target in (0.3, 0.02):
        # in a small atlas many rays are free
        settings = Settings(error_target=target, resolution=128)
        settled = settle(scene, settings, Clock(), Kept())
        assert settled.bound == "error"
        found.append(settled)
    coarse, fine = found
    assert len(coarse.judged) == 2 and len(fine.judged) >= 2
    assert fine.judged[-1].error <= coarse.judged[-1].error
    assert fine.made.budget.exit_rays > coarse.made.budget.exit_rays
