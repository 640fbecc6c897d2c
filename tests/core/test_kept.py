"""A cancelled bake goes on where it ended, and ends the same."""

from dataclasses import replace
from functools import cache
from itertools import count

import numpy as np
import pytest
from lightpanes.core.bake import Cancelled, Kept, bake, clock
from lightpanes.core.bake.kept import digest
from lightpanes.core.bake.steps import find_surfaces, prepare_with, transport_parts
from lightpanes.core.planner import plan

from .shapes import COLOURS, box, lamp, quick, room, room_parts, scene

pytestmark = pytest.mark.usefixtures("frugal")


def made():
    return room(lights=[lamp((1, 1, 2))])


@cache
def plain(seed=0):
    """The bake that nothing has disturbed."""
    return bake(made(), quick(seed=seed))


def long(exits):
    """A bake whose exits take several chunks of rays."""
    return quick(exits=exits, points=2000, point_rays=64, resolution={"texels": 256, "points": 64}[exits], exit_rays=32)


@cache
def whole(exits):
    """The long bake, in one go."""
    return bake(made(), long(exits))


def same(one, other) -> bool:
    return all(np.array_equal(one.images[name], other.images[name]) for name in one.images)


def cancel_at(stage: str, part: float, seen: list):
    """A progress callback that cancels once a part of a stage is done."""
    begin = {}

    def progress(now):
        seen.append((now.stage, now.rays))
        if now.stage == stage and now.fraction - begin.setdefault(stage, now.fraction) >= part:
            raise Cancelled

    return progress


@pytest.mark.parametrize("exits", ["texels", "points"])
def test_a_bake_in_several_goes(exits):
    settings, kept = long(exits), Kept()
    goes = [("Transport", 0.01), ("Lamps", 0.01), ("Exits", 0.02), ("Exits", 0.02), ("Check", 0.0)]
    for stage, part in goes:
        with pytest.raises(Cancelled):
            bake(made(), settings, cancel_at(stage, part, []), kept)
    seen = []
    again = bake(made(), settings, lambda now: seen.append((now.stage, now.rays)), kept)
    assert same(whole(exits), again)
    # all rays but those of the check had been traced
    assert seen[-1][1] < 0.3 * whole(exits).meta["report"]["rays"]
    # the next one asks for it again, unless it is told that the bake has arrived
    assert bake(made(), settings, kept=kept) is again and list(kept.parts) == ["bake"]


def test_what_is_kept_belongs_to_one_scene_and_its_settings():
    kept = Kept()
    with pytest.raises(Cancelled):
        bake(made(), quick(), cancel_at("Exits", 0.0, []), kept)
    assert "prepared" in kept.parts
    other = room(lights=[lamp((2, 1, 2))])
    assert same(bake(other, quick(), kept=kept), bake(other, quick()))
    with pytest.raises(Cancelled):
        bake(made(), quick(), cancel_at("Exits", 0.0, []), kept)
    assert same(bake(made(), quick(seed=3), kept=kept), plain(3))


@pytest.mark.parametrize(("exits", "kind"), [("texels", "SUN"), ("points", "AREA")])
def test_a_live_lamp_that_was_dimmed_changes_no_bake(exits, kind):
    """Nor does its size; so what was finished before is of use."""

    def lit(**more):
        return room(lights=[lamp((1, 1, 2), kind=kind, **more)])

    other = lit(power=(0.1, 2, 3), radius=0.3, size=(0.2, 0.1), angle=0.1, spot_angle=0.5)
    settings = quick(exits=exits, points=1000, point_rays=64)
    kept, seen = Kept(), []
    with pytest.raises(Cancelled):
        bake(lit(), settings, cancel_at("Exits", 0.0, []), kept)
    again = bake(other, settings, lambda now: seen.append(now.stage), kept)
    assert same(again, bake(other, settings))
    assert "Transport" not in seen


@pytest.mark.parametrize("change", ["moved", "baked in", "another kind", "another"])
def test_a_lamp_by_which_light_gets_elsewhere(change):
    lights = {
        "moved": [lamp((1, 1, 2.1))],
        "baked in": [lamp((1, 1, 2), live=False)],
        "another kind": [lamp((1, 1, 2), kind="SUN")],
        "another": [lamp((1, 1, 2)), lamp((2, 1, 2))],
    }
    kept = Kept()
    kept.open(made(), quick())
    key = kept.key
    kept.open(room(lights=lights[change]), quick())
    assert kept.key != key


def test_an_error_leaves_nothing():
    """It may have come in the middle of a chunk, half of whose rays are counted."""
    kept = Kept()

    def fail(now):
        if now.stage == "Exits":
            raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        bake(made(), quick(), fail, kept)
    assert not kept.parts


def test_a_time_budget_keeps_nothing():
    kept = Kept()
    with pytest.raises(Cancelled):
        bake(made(), quick(time_budget=60.0), cancel_at("Exits", 0.0, []), kept)
    assert not kept.parts


def test_a_digest_sees_each_number():
    scene = made()
    first = digest(scene, quick())
    assert digest(made(), quick()) == first
    assert digest(scene, quick(seed=1)) != first
    moved = made()
    moved.positions[3, 1] += 1e-4
    assert digest(moved, quick()) != first


def test_time_left_counts_what_cancelled_goes_took(monkeypatch):
    ticks = count()
    # every look at the clock is a second later
    monkeypatch.setattr(clock, "now", lambda: float(next(ticks)))
    whole, kept = [], Kept()
    bake(made(), quick(), whole.append)
    goes = []
    for stage in ("Lamps", "Exits"):
        with pytest.raises(Cancelled):
            bake(made(), quick(), cancel_at(stage, 0.0, []), kept)
        goes.append(kept.seconds)
    assert 0 < goes[0] < goes[1] and kept.reached >= clock.Clock.STAGES["Points"]
    left = []
    report = bake(made(), quick(), left.append, kept).report
    assert report["earlier_seconds"] == goes[1]
    assert kept.seconds == kept.reached == 0
    # as far along, about as much is left as in one go, and more, since some was done twice
    for told in left[:-1]:
        then = next(one for one in whole if one.fraction >= max(told.fraction, clock.Clock.STAGES["Points"]))
        assert told.seconds_left >= 0.9 * then.seconds_left


def test_a_hurried_bake_leaves_parts_that_no_other_takes_for_its_own():
    """Of as many entries asked for; it finds fewer of them."""
    random = np.random.default_rng(0)
    low = random.uniform((0.2, 0.2, 0.1), (3.6, 2.6, 2.2), (150, 3))
    boxes = [(*box(a, a + random.uniform(0.02, 0.3, 3)), 1) for a in low]
    made = scene(*room_parts(), *boxes, materials=COLOURS, lights=[lamp((3, 1.5, 2))])
    settings, kept, told = quick(), Kept(), clock.Clock()
    surfaces, budget = find_surfaces(made, settings, told), plan(made, settings)
    counts = []
    for hurried in (True, False):
        found = prepare_with(replace(surfaces, hurried=hurried), settings, budget, told, kept)
        counts.append(len(found.entries))
        assert len(found.transport) == counts[-1]
    assert counts[0] != counts[1]
    kept.drop(*transport_parts(budget.entries))
    assert not kept.parts
