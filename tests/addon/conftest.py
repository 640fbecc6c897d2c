"""A registered add-on and a small scene around every test that needs Blender."""

import functools
import os
import sys

import pytest

bpy = pytest.importorskip("bpy")

import lightpanes  # noqa: E402
from lightpanes.tests.frugal import judge_lightly, save_rays  # noqa: E402

from .files import baked_once, empty  # noqa: E402
from .soft import hang_panel  # noqa: E402

# Budgets of a bake that is done in half a second and still looks like the room.
SMALL = {"entries": 300, "entry_rays": 128, "exit_rays": 32, "regions": 8, "panes": 8, "lamps": 60}
SMALL |= {"points": 400, "point_rays": 1024}


STATUS = pytest.StashKey[int]()


def pytest_sessionfinish(session, exitstatus):
    session.config.stash[STATUS] = int(exitstatus)


def pytest_unconfigure(config):
    """End here on Blender 4.5, which as a module can hang in its exit handlers."""
    if bpy.app.version < (5, 0) and STATUS in config.stash:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(config.stash[STATUS])


@pytest.fixture(scope="session", autouse=True)
def factory():
    """No test sees the preferences of whoever runs it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)


@pytest.fixture
def blender():
    """An empty Blender with Lightpanes registered, and no trace of the test before."""
    empty()
    lightpanes.register()
    yield bpy
    lightpanes.unregister()


@pytest.fixture
def quick(monkeypatch):
    """Bakes through the add-on take small budgets instead of the planner's."""
    from lightpanes.addon import baking

    monkeypatch.setattr(baking, "Settings", functools.partial(baking.Settings, **SMALL))
    save_rays(monkeypatch)
    judge_lightly(monkeypatch)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Where the first test of a module that bakes leaves the scene for the others (`files.baked_once`)."""
    return tmp_path_factory.mktemp("baked") / "room.blend"


@pytest.fixture
def room(blender):
    """A closed room 2 m wide with a block in it and a point lamp; returns the scene."""
    return furnish()


@pytest.fixture
def panel(room):
    """The room with an area lamp alone, whose direct light is wanted in the bake, not baked yet."""
    return hang_panel(room)


@pytest.fixture
def fresh_panel(panel):
    """The same, just baked."""
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    return panel


@pytest.fixture
def baked_panel(panel, saved):
    """The same, but for all tests but the first opened from a file."""
    return baked_once(panel, saved)


@pytest.fixture
def unwatched():
    """No handler follows changes meanwhile: only the timer does, and the test itself."""
    from lightpanes.addon import following

    handlers = bpy.app.handlers.depsgraph_update_post
    handlers.remove(following._on_update)
    yield
    handlers.append(following._on_update)


def furnish():
    """The room, in the empty scene that is there."""
    scene = bpy.context.scene
    scene.lightpanes.resolution = 64
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    walls = bpy.context.object
    walls.name = "Room"
    walls.data.flip_normals()
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0.3, 0.2, -0.75))
    bpy.context.object.name = "Block"
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.data.energy = 20.0
    lamp.data.shadow_soft_size = 0.0
    lamp.location = (-0.3, -0.2, 0.4)
    scene.collection.objects.link(lamp)
    for name, color in (("Room", (0.7, 0.6, 0.5)), ("Block", (0.2, 0.4, 0.7))):
        material = bpy.data.materials.new(name)
        if material.node_tree is None:
            material.use_nodes = True
        shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
        shader.inputs["Base Color"].default_value = (*color, 1)
        shader.inputs["Specular IOR Level"].default_value = 0.0  # diffuse alone, so that closed forms hold
        bpy.data.objects[name].data.materials.append(material)
    bpy.context.view_layer.update()
    return scene
