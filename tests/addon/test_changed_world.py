"""A world that gives other light than when it was baked makes the bake stale."""

import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import following, relight, sessions, world_light  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def world(room):
    made = room.world = bpy.data.worlds.new("Sky")
    if made.node_tree is None:
        made.use_nodes = True
    background(made).inputs["Color"].default_value = (0.2, 0.3, 0.5, 1)
    return made


def background(world):
    return next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")


WORLD = ("The world was changed since the bake; bake again.",)


def test_a_world_of_another_colour_is_stale(world):
    bpy.ops.lightpanes.bake()
    assert relight.check_stale(bpy.context) == ()
    background(world).inputs["Color"].default_value = (1, 0, 0, 1)
    assert relight.check_stale(bpy.context) == WORLD
    background(world).inputs["Color"].default_value = (0.2, 0.3, 0.5, 1)
    assert relight.check_stale(bpy.context) == ()


def test_another_world_is_stale(room, world):
    bpy.ops.lightpanes.bake()
    room.world = None
    assert relight.check_stale(bpy.context) == WORLD
    room.world = world.copy()
    assert relight.check_stale(bpy.context) == ()
    world.color = (1, 1, 1)
    assert relight.check_stale(bpy.context) == ()


def test_a_sky_whose_sun_moved_is_stale(world):
    sky = world.node_tree.nodes.new("ShaderNodeTexSky")
    world.node_tree.links.new(sky.outputs[0], background(world).inputs["Color"])
    bpy.ops.lightpanes.bake()
    assert relight.check_stale(bpy.context) == ()
    sky.sun_elevation *= 0.5
    assert relight.check_stale(bpy.context) == WORLD


@pytest.mark.parametrize("nodes", [False, True])
def test_the_world_is_the_same_behind_our_nodes(world, nodes):
    if not nodes and bpy.app.version < (5, 0):
        world.use_nodes = False
    elif nodes:
        sky = world.node_tree.nodes.new("ShaderNodeTexSky")
        world.node_tree.links.new(sky.outputs[0], background(world).inputs["Color"])
    bpy.ops.lightpanes.bake()
    world_light.hide(world)
    assert relight.check_stale(bpy.context) == ()


def test_the_world_is_looked_at_again_when_it_changes(world, monkeypatch):
    bpy.ops.lightpanes.bake()
    seen = []

    def note(scene, depsgraph):
        current = sessions.of(scene)
        seen.extend(change.id.name for change in depsgraph.updates if following._may_stale(scene, current, change))

    bpy.app.handlers.depsgraph_update_post.append(note)
    try:
        background(world).inputs["Strength"].default_value = 2.0
        bpy.context.view_layer.update()
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(note)
    assert seen == ["Sky"]
