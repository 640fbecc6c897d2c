"""A person's session in Blender's window: press Bake with the mouse, drag a lamp, cancel with Esc; judged by pixels."""

import numpy as np
import pytest

from . import window

plt = pytest.importorskip("matplotlib.pyplot")
pytestmark = pytest.mark.skipif(bool(window.missing()), reason=window.missing())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("window")


@pytest.fixture(scope="module")
def found(folder):
    return window.session(folder, window.build(folder, window.python_of_blender(folder)))


def pixels(folder, found, name):
    """(H, W, 3) of the viewport in a screenshot."""
    x, y, width, height = found["view"]
    return plt.imread(folder / f"{name}.png")[y : y + height, x : x + width, :3]


def test_the_button_bakes(found):
    assert 0 < found["report"]["error"] < 0.1


def test_the_viewport_follows_the_lamp(folder, found):
    assert found["relit"] and found["moved"] > 0.1
    before, after = pixels(folder, found, "before"), pixels(folder, found, "after")
    # where nothing but the render is: the middle of the room
    height, width = before.shape[:2]
    middle = np.s_[height // 3 : 2 * height // 3, 2 * width // 5 : 3 * width // 5]
    assert before[middle].std() > 0.02, "something is drawn"
    assert np.abs(after[middle] - before[middle]).mean() > 0.01


def test_esc_cancels_and_what_was_there_stays(found):
    # the session itself checks the bake's key after each
    assert len(found["ends"]) == 2


def test_progress_is_shown(folder, found):
    assert not np.array_equal(plt.imread(folder / "progress.png"), plt.imread(folder / "baked.png"))
    assert {stage.split(": ")[-1] for stage in found["stalls"]["bake"]} > {"Transport", "Lamps", "Exits"}
