"""A bake that misses the error it was asked for says so."""

import pytest
from lightpanes.core.bake import bake, rounds, run
from lightpanes.core.planner import Budget, Settings

from .shapes import lamp, quick, room

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("frugal")]


@pytest.mark.parametrize(
    ("cut", "more", "told"),
    [
        ({"panes": 1, "regions": 2}, {}, "most of it in the panes: ask for a lower Error"),
        ({"exit_rays": 1}, {}, "most of it noise: ask for a lower Error"),
        ({"exit_rays": 1}, {"time_budget": 600.0}, "most of it noise: allow more Time"),
        ({"points": 30}, {"exits": "points"}, "most of it between points: set Light At to Texels"),
        ({}, {"error_target": 1.0}, ""),
    ],
)
def test_a_missed_error_is_told_with_its_remedy(monkeypatch, cut, more, told):
    small = {"entries": 300, "entry_rays": 128, "exit_rays": 256, "regions": 8, "panes": 8, "lamps": 60}
    small |= {"points": 400, "point_rays": 256}
    monkeypatch.setattr(rounds, "plan", lambda *_: Budget(**(small | cut)))
    # nothing is added
    monkeypatch.setattr(rounds, "ROUNDS", 0)
    monkeypatch.setattr(run, "more_points", lambda *_: None)
    settings = Settings(**({"error_target": 0.01, "resolution": 64} | more))
    # without live lamps there are no panes that could be wrong
    report = bake(room(lights=[lamp((1, 1, 2), live="exit_rays" not in cut)]), settings).report
    found = [text for text in report["warnings"] if text.startswith("The error is")]
    assert found == ([f"The error is {100 * report['error']:.1f} % where 1.0 % was asked for, {told}."] if told else [])


def test_budgets_set_by_hand_are_nobodys_surprise():
    report = bake(room(lights=[lamp((1, 1, 2))]), quick(error_target=0.001)).report
    assert report["error"] > 0.002 and not report["warnings"]
