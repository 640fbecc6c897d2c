"""Caustics within a bake: their progress, a cancel, and their time."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from lightpanes.core.bake import Cancelled, bake, photons
from lightpanes.core.caustics import CausticAtlas

from .caustic_scenes import ball, floor, glass, staged
from .shapes import GREY, lamp, quick

pytestmark = pytest.mark.usefixtures("frugal")

LAMPS = tuple(replace(lamp((x, 0.3, 1.5)), live=False) for x in (-0.4, 0.0, 0.4))


def table(*lights):
    return staged(floor(), ball((0, 0, 0.4), 0.25, 32), materials=(GREY, glass()), lights=lights)


class Machine:
    """Traces a lamp's photons in four steps, at so many photons a second."""

    def __init__(self, rate, monkeypatch):
        self.rate, self.seconds = rate, 0.0
        monkeypatch.setattr(photons, "now", lambda: self.seconds)

    def refine(self, lights, count):
        for k in range(4):
            self.seconds += count / 4 / self.rate
            yield SimpleNamespace(done=(k + 1) / 4)


@pytest.mark.parametrize("seconds", [0.01, 1.0, 3.0, 100.0])
def test_no_more_photons_than_there_is_time_for(monkeypatch, seconds):
    machine, told = Machine(40_000, monkeypatch), []
    found = photons.trace_lamps(machine, LAMPS, 40_000, told.append, seconds)
    # the least took 3 · 5000 / 40,000 s
    assert found == (40_000 if seconds == 100 else pytest.approx(max(5000, (seconds - 0.375) * 40_000 / 3), abs=100))
    assert machine.seconds <= max(seconds, 0.376)
    assert told == sorted(told) and told[0] == 0 and told[-1] == 1 and len(told) > 12


def test_few_photons_take_no_trial(monkeypatch):
    machine = Machine(40_000, monkeypatch)
    assert photons.trace_lamps(machine, LAMPS, 3000, lambda part: None, 0.0) == 3000
    assert machine.seconds == pytest.approx(3 * 3000 / 40_000)


def test_lamp_after_lamp_is_as_all_at_once():
    scene, told = table(*LAMPS), []
    one, all_of_them = (CausticAtlas(scene, 64) for _ in range(2))
    assert photons.trace_lamps(one, LAMPS, 4000, told.append) == 4000
    assert np.array_equal(one.image(LAMPS, 4000), all_of_them.image(LAMPS, 4000))
    assert one.image(LAMPS, 4000)[..., :3].max() > 0
    assert told == sorted(told) and len(set(told)) > 3 * 5


def test_lamps_that_are_not_live_show_progress_and_are_cancelled():
    told = []
    made = bake(table(*LAMPS), quick(photons=4000), told.append)
    found = [each.fraction for each in told if each.stage == "Caustics"]
    assert len(set(found)) > 3 * 5 and found == sorted(found)
    assert made.report["stages"]["Caustics"] > 0
    fractions = [each.fraction for each in told]
    assert fractions == sorted(fractions)

    def cancel(progress):
        if progress.stage == "Caustics" and progress.fraction > np.mean(found):
            raise Cancelled

    with pytest.raises(Cancelled):
        bake(table(*LAMPS), quick(photons=4000), cancel)


def test_lamps_that_are_not_live_keep_to_the_time(monkeypatch):
    asked = []
    monkeypatch.setattr(photons, "FEWEST", 500)
    refine = CausticAtlas.refine
    monkeypatch.setattr(CausticAtlas, "refine", lambda self, *given: asked.append(given[1]) or refine(self, *given))
    bake(table(*LAMPS), quick(photons=4000, time_budget=0.01))
    assert set(asked) == {500}
