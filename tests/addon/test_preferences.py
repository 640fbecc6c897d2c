"""The add-on's preferences, where Blender keeps any."""

import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import lightpanes  # noqa: E402
from lightpanes.addon import job, preferences, store  # noqa: E402
from lightpanes.core import threads  # noqa: E402

from .drawing import Recorder, texts  # noqa: E402
from .test_job import drive, stage  # noqa: E402


def test_threads(blender):
    every = threads.thread_count()
    addon = bpy.context.preferences.addons.new()
    addon.module = preferences.ADDON
    try:
        addon.preferences.threads = 3
        assert threads.thread_count() == 3
        drawn = Recorder()
        shown = SimpleNamespace(layout=drawn, bl_rna=addon.preferences.bl_rna, cache_folder="")
        preferences.LightpanesPreferences.draw(shown, None)
        assert texts(drawn.drawn, "prop") == ["threads", "cache_folder", "cache_size"]
        lightpanes.unregister()
        assert threads.thread_count() == every
        lightpanes.register()
        assert threads.thread_count() == 3
        addon.preferences.threads = 0
        assert threads.thread_count() == every
    finally:
        bpy.context.preferences.addons.remove(addon)
        threads.use_threads(0)


@pytest.fixture
def settings(blender):
    """The preferences, as of an add-on that is enabled."""
    addon = bpy.context.preferences.addons.new()
    addon.module = preferences.ADDON
    yield addon.preferences
    job.cancel()
    wait()
    job._kept.clear()
    job._kept.cache = None
    bpy.context.preferences.addons.remove(addon)


def wait():
    while job.current() is not None and job.current().thread is not None:
        time.sleep(0.01)


def restart():
    """All that another Blender would know: files."""
    wait()
    job._kept = type(job._kept)()


def test_where_the_cache_is(settings, tmp_path):
    # no extension, so no folder of its own
    assert settings.cache_folder == "" and preferences.cache() is None
    settings.cache_folder, settings.cache_size = str(tmp_path), 0.5
    found = preferences.cache()
    assert found.folder == tmp_path and found.limit == 500_000_000
    settings.cache_folder = "~/cache"
    assert preferences.cache().folder == Path("~/cache").expanduser()
    settings.cache_folder = "  "
    assert preferences.cache() is None


def test_a_cancelled_bake_goes_on_after_a_restart(settings, room, quick, tmp_path):
    settings.cache_folder = str(tmp_path / "cache")
    file = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    whole = drive()
    images = {name: array.tobytes() for name, array in store.load_bake(room).images.items()}
    assert not (tmp_path / "cache").exists()
    bpy.ops.wm.open_mainfile(filepath=str(file))
    drive(stage("Exits")).cancel()
    restart()
    assert list((tmp_path / "cache").glob("lightpanes-*.npz"))
    bpy.ops.wm.open_mainfile(filepath=str(file))
    again = drive()
    assert again.report["rays"] < 0.7 * whole.report["rays"]
    bake = store.load_bake(bpy.context.scene)
    assert {name: array.tobytes() for name, array in bake.images.items()} == images
    assert not list((tmp_path / "cache").iterdir())


def test_without_a_folder_nothing_is_written(settings, room, quick, tmp_path, monkeypatch):
    written = []
    monkeypatch.setattr(np, "savez", lambda *_, **__: written.append(1))
    drive(stage("Exits")).cancel()
    wait()
    assert not written and job._kept.parts


def test_a_small_cache_keeps_what_fits(settings, room, quick, tmp_path, monkeypatch):
    settings.cache_folder = str(tmp_path / "cache")
    monkeypatch.setattr(preferences, "GB", 1e6)
    settings.cache_size = 0.2
    drive(stage("Exits")).cancel()
    restart()
    files = list((tmp_path / "cache").glob("lightpanes-*.npz"))
    assert sum(file.stat().st_size for file in files) <= 200_000
    assert drive().report is not None
