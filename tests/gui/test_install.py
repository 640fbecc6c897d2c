"""The real Blender installs the zip from its command line, and bakes with what it installed.

Blender is the executable that the variable BLENDER names, or else `blender` on PATH. All that it reads and writes is in
the folder that it runs in.
"""

import os
import subprocess

import pytest

from . import window

BLENDER = window.blender()

pytestmark = pytest.mark.skipif(not BLENDER, reason="no Blender: put it on PATH, or name it in the variable BLENDER")

MAKE_ROOM = """
import bpy
bpy.ops.wm.read_homefile(use_empty=True)
bpy.ops.mesh.primitive_cube_add(size=2)
bpy.context.object.data.flip_normals()
bpy.ops.object.light_add(type="POINT", location=(0.3, 0.2, 0.4))
bpy.ops.wm.save_as_mainfile(filepath="room.blend")
"""
CHECK = """
import bpy
assert max(bpy.data.images["Lightpanes Irradiance"].pixels[::4]) > 0
assert bpy.ops.lightpanes.bake.poll()
bpy.data.objects["Point"].location.x = -0.3
before = bpy.data.images["Lightpanes Irradiance"].pixels[:]
bpy.context.view_layer.update()
assert bpy.data.images["Lightpanes Irradiance"].pixels[:] != before
print("baked and relit")
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("blender")
    (made / "user").mkdir()
    return made


def run(folder, *arguments):
    """What Blender prints; it starts with the user resources in `folder`, and must succeed."""
    # Blender 4.5 takes relative paths to start from PWD
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(folder / "user"), "PWD": str(folder)}
    command = [BLENDER, "--python-exit-code", "3", *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def archive(folder):
    """The zip for this system and Blender's own Python."""
    return window.build(folder, window.python_of_blender(folder))


def test_install_file(folder, archive):
    run(folder, "--background", "--command", "extension", "validate", archive)
    run(folder, "--background", "--command", "extension", "install-file", "-r", "user_default", "--enable", archive)
    run(folder, "--background", "--python-expr", MAKE_ROOM)
    bake = ["bake", "--resolution", "32", "--error", "0.3", "--output", folder / "baked"]
    assert "Baked in" in run(folder, "--background", "room.blend", "--command", "lightpanes", *bake)
    said = run(folder, "--background", "baked/room_lightpanes.blend", "--python-expr", CHECK)
    assert "baked and relit" in said
