"""Caustics never show what is no more: after errors, edits, other scenes, frames and switches."""

import time

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import caustics, following, live_image, relight, store  # noqa: E402

from .files import baked_once  # noqa: E402
from .glassware import ball, image  # noqa: E402
from .soft import EEVEE  # noqa: E402
from .test_relight import update  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def baked(room, saved):
    """The room with a glass ball under its lamp."""
    room.render.engine = EEVEE
    room.lightpanes.photons = 5000
    ball(room)
    return baked_once(room, saved)


@pytest.fixture
def live(baked):
    """The same, which follows its lamp already: a bake that was only opened knows no surfaces yet."""
    lamp = bpy.data.objects["Lamp"]
    for x in (0.2, -0.2):
        lamp.location.x += x
        update()
    assert caustics.held(baked).atlas is not None
    return baked


@pytest.fixture
def window(baked, monkeypatch):
    """Changes are followed by the timer alone."""
    bpy.app.handlers.depsgraph_update_post.remove(following._on_update)
    monkeypatch.setattr(live_image, "REST", 0.0)
    yield baked
    bpy.app.handlers.depsgraph_update_post.append(following._on_update)


def drag(x):
    """Move the lamp, as in a window."""
    bpy.data.objects["Lamp"].location.x = x
    update()
    relight.update(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), at_once=False)


def look(until, seconds=20.0):
    end = time.monotonic() + seconds
    while not until():
        assert time.monotonic() < end
        live_image.look()
        time.sleep(0.001)


def differs(first, second):
    return np.abs(first - second).max() > 0.1 * second.max()


def test_an_error_beside_blender_is_told_and_nothing_counts_as_shown(window, monkeypatch, capsys):
    before, mine = image(), caustics.held(window)
    key = mine.shown

    def broken(self, atlas, asked, full):
        yield from ()
        raise MemoryError("not enough for the photons")

    with monkeypatch.context() as patched:
        patched.setattr(type(caustics._image), "images", broken)
        drag(0.1)
        look(lambda: mine.error)
    assert mine.shown == key and np.array_equal(image(), before)
    (told,) = caustics.sentences(window)
    assert "not enough for the photons" in told and store.CAUSTICS in told
    assert "Traceback" in capsys.readouterr().err
    # the next change tries again
    drag(0.15)
    look(lambda: mine.shown not in ("", key))
    assert not caustics.sentences(window) and differs(image(), before)


def test_what_is_dropped_ends_between_two_steps(window, monkeypatch):
    """Who drops work waits for it: for one step of it, not for the next picture."""
    drag(0.1)
    mine = caustics.held(window)
    look(lambda: mine.shown and mine.work is None)
    atlas, taken = mine.atlas, []
    refine = atlas.atlas.refine

    def counted(lights, photons):
        for step in refine(lights, photons):
            taken.append(step)
            # who starts a thread may hear of it later than the thread itself
            while mine.work is None:
                time.sleep(0.001)
            mine.work.dropped = True
            yield step

    monkeypatch.setattr(atlas.atlas, "refine", counted)
    monkeypatch.setattr(caustics, "STREAM", 1e9)
    drag(0.2)
    look(lambda: taken)
    live_image.settle(mine)
    assert len(taken) == 1 and taken[0].done < 1
