"""The caustics' part of a bake: progress, cancel, and the time that they may take."""

import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import baking, caustics, store  # noqa: E402
from lightpanes.core.bake import Cancelled  # noqa: E402

from .files import reopen  # noqa: E402
from .glassware import ball, image  # noqa: E402
from .test_relight import update  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def glass(room):
    room.lightpanes.photons = 5000
    ball(room)
    return room


def test_progress_moves_and_a_cancel_leaves_nothing(glass):
    told = []
    baking.bake_scene(bpy.context, told.append)
    fractions = [each.fraction for each in told]
    assert fractions == sorted(fractions)
    found = [each.fraction for each in told if each.stage == "Caustics"]
    assert len(set(found)) > 5 and found[-1] - found[0] > 0.05
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    heard = []

    def cancel(progress):
        if progress.stage == "Caustics":
            heard.append(progress)
            if len(heard) == 3:
                raise Cancelled

    with pytest.raises(Cancelled):
        baking.bake_scene(bpy.context, cancel)
    assert len(heard) == 3 and store.find_entries(glass) is None and store.CAUSTICS not in bpy.data.images


def test_a_time_budget_leaves_fewer_photons(glass, tmp_path):
    glass.lightpanes.photons, glass.lightpanes.time_budget = 0, 0.01
    report = baking.bake_scene(bpy.context)
    assert report["caustics"]["photons"] == caustics.FEWEST < caustics.photons_asked(glass)
    (told,) = [line for line in report["warnings"] if "photons" in line]
    assert told.startswith(
        "There was time for 5,000 photons of each lamp, where caustics ask for 40,000: allow more Time"
    )
    before = image()
    assert before.max() > 0
    glass = reopen(tmp_path)
    assert caustics.photons_for(glass) == caustics.FEWEST
    bpy.data.objects["Lamp"].location.x += 0.3
    update()
    assert caustics.held(glass).milliseconds > 0
    # by hand, or without a budget, as many as are asked for
    glass.lightpanes.time_budget = 0
    assert caustics.photons_for(glass) == 40_000
    glass.lightpanes.time_budget, glass.lightpanes.photons = 0.01, 7000
    assert caustics.photons_for(glass) == 7000
    report = baking.bake_scene(bpy.context)
    assert report["caustics"]["photons"] == 7000 and not [line for line in report["warnings"] if "photons" in line]


def test_time_to_spare_leaves_all_photons(glass):
    glass.lightpanes.photons, glass.lightpanes.error_target, glass.lightpanes.time_budget = 0, 0.2, 1000.0
    report = baking.bake_scene(bpy.context)
    assert report["caustics"]["photons"] == 10_000 and not [line for line in report["warnings"] if "photons" in line]
