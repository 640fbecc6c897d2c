"""A time budget holds for all of a bake, by a clock that only the work itself moves."""

from dataclasses import replace
from threading import Lock

import pytest
from lightpanes.core.bake import Settings, bake, clock
from lightpanes.core.planner import LEAST, Took, fit, part_of, plan

from .shapes import lamp, room

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("frugal")]

ASKED = Settings(error_target=0.03, resolution=64, points=1500)


class Machine:
    """Traces so many rays a second; finding entries takes it `fixed` seconds, panes as long as their transport."""

    def __init__(self, rate: float, fixed: float = 0.1):
        self.rate, self.fixed, self.seconds, self.transport, self.lock = rate, fixed, 0.0, 0.0, Lock()

    def work(self, stage: str, rays: int) -> None:
        with self.lock:
            self.seconds += rays / self.rate
            self.transport += rays / self.rate if stage == "Transport" else 0

    def start(self, stage: str) -> None:
        self.seconds += {"Entries": self.fixed, "Panes": self.transport}.get(stage, 0.0)
        if stage == "Panes":
            self.transport = 0.0


@pytest.fixture
def on(monkeypatch):
    """Bakes the room on a machine of that many rays a second within a time; returns the report and its seconds."""

    def run(rate: float, seconds: float, spent: float = 0.0, **more):
        machine, tick, start = Machine(rate), clock.Clock.tick, clock.Clock.start

        def ticked(self, steps, rays=None):
            machine.work(self._stage, steps if rays is None else rays)
            tick(self, steps, rays)

        def started(self, stage, steps=1):
            start(self, stage, steps)
            machine.start(stage)

        with monkeypatch.context() as patch:
            patch.setattr(clock, "now", lambda: machine.seconds)
            patch.setattr(clock.Clock, "tick", ticked)
            patch.setattr(clock.Clock, "start", started)
            made = room(lights=[lamp((1, 1, 2))])
            settings = replace(ASKED, time_budget=seconds, **more)
            return bake(made, settings, spent=spent).report, machine.seconds

    return run


@pytest.mark.parametrize("exits", ["texels", "points"])
@pytest.mark.parametrize("rate", [3e5, 3e6])
def test_a_bake_keeps_to_its_time(on, rate, exits):
    least, took = on(rate, 0.01, exits=exits)
    # the least of everything, and said so
    assert least["budget"]["entries"] == LEAST["entries"]
    assert least["budget"]["exit_rays" if exits == "texels" else "point_rays"] == 16
    assert any("time budget of 0.01 s is too short" in line for line in least["warnings"]) == (took > 1.01)
    found = []
    for times in (1.2, 2.5, 5):
        report, used = on(rate, times * took, exits=exits, error_target=0.01)
        assert used <= 1.1 * times * took
        assert not [line for line in report["warnings"] if "time budget" in line]
        found.append(report["budget"]["entries"])
    assert found == sorted(found) and found[-1] > found[0]


def test_with_time_to_spare_the_error_binds(on):
    report, used = on(3e6, 1000)
    assert report["bound"] == "error" and report["error"] < 1.1 * ASKED.error_target
    assert used < 100


@pytest.mark.parametrize("rays", [8, 24, 40])
def test_rays_that_are_asked_for_are_sent_where_there_is_time(on, rays):
    report, _ = on(3e7, 1000.0, exit_rays=rays)
    assert report["budget"]["exit_rays"] == rays


def test_time_spent_on_reading_the_scene_counts(on):
    report, used = on(3e6, 12.0, spent=10.0)
    assert 10 + used <= 13 and report["budget"] == on(3e6, 2.0)[0]["budget"]
    assert "of 12 s is too short: at the least quality the bake took 2" in on(3e6, 12.0, spent=20.0)[0]["warnings"][-1]


def test_parts_of_a_budget():
    full = plan(room(), Settings())
    assert part_of(full, Settings(), 1.0) == full
    parts = [part_of(full, Settings(), part) for part in (1.0, 0.5, 0.1, 0.0)]
    for name, least in LEAST.items():
        values = [getattr(part, name) for part in parts]
        assert values == sorted(values, reverse=True) and values[-1] == min(least, values[0])
    # what the user gives stays
    assert part_of(full, Settings(entries=5000, lamps=10), 0.0).entries == 5000


def test_what_fits():
    full = plan(room(), Settings())
    small = part_of(full, Settings(), 0.0)
    took = Took(small, entries=1.0, transport=1.0, lamps=1.0, panes=1.0, rays=800 * 256 * 2)
    assert took.foresee(small, 0) > 4
    assert fit(full, Settings(), took, 50_000, 1e6) == full
    assert fit(full, Settings(), took, 50_000, 1.0) is None
    some = fit(full, Settings(), took, 50_000, 0.5 * took.foresee(full, 50_000))
    assert small.entries < some.entries < full.entries
    assert 0.3 < took.foresee(some, 50_000) / took.foresee(full, 50_000) <= 0.5
