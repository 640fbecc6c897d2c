"""The add-on's preferences, where Blender keeps any."""

from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

import lightpanes  # noqa: E402
from lightpanes.addon import preferences  # noqa: E402
from lightpanes.core import threads  # noqa: E402

from .drawing import Recorder, texts  # noqa: E402


def test_threads(blender):
    every = threads.thread_count()
    addon = bpy.context.preferences.addons.new()
    addon.module = preferences.ADDON
    try:
        addon.preferences.threads = 3
        assert threads.thread_count() == 3
        drawn = Recorder()
        preferences.LightpanesPreferences.draw(
            SimpleNamespace(layout=drawn, **{"bl_rna": addon.preferences.bl_rna}), None
        )
        assert texts(drawn.drawn, "prop") == ["threads"]
        lightpanes.unregister()
        assert threads.thread_count() == every
        lightpanes.register()
        assert threads.thread_count() == 3
        addon.preferences.threads = 0
        assert threads.thread_count() == every
    finally:
        bpy.context.preferences.addons.remove(addon)
        threads.use_threads(0)
