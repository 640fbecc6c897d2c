"""Empty files, saving and opening again, and a folder that takes none."""

import sys

import bpy
import pytest

REFUSES = "/proc"
"""On Linux nobody, not even root, makes files or folders there."""

needs_a_refusing_folder = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason=f"needs {REFUSES}, which refuses files even to root"
)


def empty():
    """A new file without anything in it. Unlike `read_factory_settings` it leaves the preferences, which takes a fifth
    of the time."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def reopen(tmp_path):
    """Save, forget everything and open what was saved; returns its scene."""
    path = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    empty()
    bpy.ops.wm.open_mainfile(filepath=path)
    return bpy.context.scene


def baked_once(scene, saved):
    """The scene baked, for all tests of a module: the first bakes it and leaves it at `saved`, the others open that."""
    if saved.exists():
        bpy.ops.wm.open_mainfile(filepath=str(saved))
        return bpy.context.scene
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    bpy.ops.wm.save_as_mainfile(filepath=str(saved), copy=True)
    return scene
