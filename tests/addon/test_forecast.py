"""What a bake will take, said before it."""

import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import baking, forecast, preflight, store  # noqa: E402
from lightpanes.core.planner import Budget  # noqa: E402
from lightpanes.core.scene import SceneError  # noqa: E402

from .mending import bakes  # noqa: E402


def test_the_forecast_grows_with_what_is_asked(room):
    def at(**settings):
        for name, value in settings.items():
            setattr(room.lightpanes, name, value)
        return preflight.examine(bpy.context).forecast

    coarse, fine = at(error_target=0.1), at(error_target=0.02)
    assert coarse.seconds < fine.seconds and coarse.bytes < fine.bytes
    small, large = at(error_target=0.05, resolution=128, exits="TEXELS"), at(resolution=512)
    assert small.texels * 16 == pytest.approx(large.texels, rel=0.01) and small.points == 0
    assert small.seconds < large.seconds and small.bytes < large.bytes
    assert at(exits="POINTS").points > 0
    assert at(time_budget=1.0).seconds == 1.0


def test_the_forecast_learns_from_the_last_bake(room, quick):
    assert bakes()
    meta = store.read_meta(room)
    report = meta["report"]
    preflight.forget()
    slow = preflight.examine(bpy.context).forecast.seconds
    report["total_seconds"] /= 2
    store.write_meta(room, meta)
    assert preflight.examine(bpy.context).forecast.seconds <= slow
    report.pop("budget")
    store.write_meta(room, meta)
    assert preflight.examine(bpy.context).forecast.seconds > 0


def test_a_second_go_at_a_bake_says_nothing_without_the_first(room, quick):
    assert bakes()
    meta = store.read_meta(room)
    report = meta["report"]

    def said():
        store.write_meta(room, meta)
        preflight.forget()
        return preflight.examine(bpy.context).forecast.seconds

    budget, places = Budget(**report["budget"]), report["texels"]
    report["total_seconds"], _ = forecast.model(budget, report["triangles"], places, False, True)
    once = said()
    report["earlier_seconds"] = report["total_seconds"]
    assert said() == pytest.approx(2 * once)
    meta["report"] = {}
    assert said() == pytest.approx(once)


def test_what_does_not_fit_into_the_memory_is_said_before_a_bake(room):
    room.lightpanes.resolution, room.lightpanes.memory_budget = 4096, 0.5
    found = preflight.examine(bpy.context)
    sentence = "raise Memory to 2.7 GiB, or lower Resolution to 1024."
    [told] = [each for each in found.obstacles if each.kind == "MEMORY"]
    assert told.sentence.endswith(sentence) and told.severity == "ERROR"
    with pytest.raises(SceneError, match=r"2\.7 GiB"):
        baking.bake_scene(bpy.context)
    room.lightpanes.memory_budget = 2.7
    assert not any(each.kind == "MEMORY" for each in preflight.examine(bpy.context).obstacles)


def test_subdivision_counts(room):
    plain = preflight.examine(bpy.context).forecast
    modifier = bpy.data.objects["Block"].modifiers.new("Subdivision", "SUBSURF")
    modifier.render_levels = 6
    assert preflight.examine(bpy.context).forecast.bytes - plain.bytes == pytest.approx(
        12 * (4**6 - 1) * forecast.IN_TRIANGLE
    )
