"""What Blender's window does by itself, done by hand in a test."""

import time

import bpy
from lightpanes.addon import live_image, relight


def follow():
    """What a window does after a change."""
    relight.update(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), at_once=False)


def look(until, seconds=20.0):
    """Let the timer look until something holds."""
    end = time.monotonic() + seconds
    while not until():
        assert time.monotonic() < end
        live_image.look()
        time.sleep(0.001)
