"""Light that the engine adds to what is baked: said, stopped by one click, and given back by Clear."""

import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import former, preflight, store, twice, world_light  # noqa: E402

from .mending import add, bakes, found, mend, without_fix  # noqa: E402
from .test_nodes import tree_state  # noqa: E402

EEVEE = "BLENDER_EEVEE" if bpy.app.version >= (5, 0) else "BLENDER_EEVEE_NEXT"


def sky(scene, strength=1.0):
    world = scene.world = bpy.data.worlds.new("Sky")
    if world.node_tree is None:
        world.use_nodes = True
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Strength"].default_value = strength
    background.inputs["Color"].default_value = (0.2, 0.4, 0.8, 1)
    return world


def test_the_worlds_light_in_eevee(room, quick):
    room.render.engine = EEVEE
    world = sky(room)
    before = tree_state(world.node_tree)
    users = world.node_tree.get_output_node("CYCLES")
    mend("WORLD_LIGHT")
    assert world.node_tree.get_output_node("CYCLES") == users
    shown = world.node_tree.get_output_node("EEVEE")
    assert shown != users and shown.inputs["Surface"].links[0].from_node.type == "MIX_SHADER"
    assert bakes() and store.find_image(room, store.DIRECT) is not None, "the bake still has the sky"
    assert tree_state(world.node_tree) != before
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert tree_state(world.node_tree) == before and world.node_tree.get_output_node("EEVEE") == users


def test_a_world_with_an_output_for_eevee_and_a_volume(room):
    world = sky(room)
    tree = world.node_tree
    volume, output = tree.nodes.new("ShaderNodeVolumeScatter"), tree.nodes.new("ShaderNodeOutputWorld")
    output.target = "EEVEE"
    output.is_active_output = True
    tree.links.new(volume.outputs[0], output.inputs["Volume"])
    before = tree_state(tree)
    world_light.hide(world)
    shown = tree.get_output_node("EEVEE")
    assert shown != output and shown.inputs["Volume"].links[0].from_node == volume
    world_light.give_back(world)
    assert tree_state(tree) == before and tree.get_output_node("EEVEE") == output


@pytest.mark.skipif(bpy.app.version >= (5, 0), reason="every world has nodes")
def test_a_world_without_nodes(room):
    room.render.engine = EEVEE
    world = room.world = bpy.data.worlds.new("Sky")
    world.use_nodes = False
    world.color = (0.2, 0.4, 0.8)
    mend("WORLD_LIGHT")
    source = world.node_tree.get_output_node("CYCLES").inputs["Surface"].links[0].from_node
    assert tuple(source.inputs["Color"].default_value) == pytest.approx((0.2, 0.4, 0.8, 1))
    world_light.give_back(world)
    assert not world.use_nodes and not world_light.is_hidden(world)


@pytest.mark.parametrize("change", ["engine", "black", "hidden", "none"])
def test_a_world_that_does_not_count_twice(room, change):
    room.render.engine = "CYCLES" if change == "engine" else EEVEE
    world = sky(room, 0.0 if change == "black" else 1.0)
    if change == "hidden":
        world.cycles_visibility.diffuse = False
    if change == "none":
        room.world = None
    assert not found("WORLD_LIGHT")


def test_a_world_of_another_scene_stays(room):
    room.render.engine = EEVEE
    world = sky(room)
    bpy.data.scenes.new("Other").world = world
    assert "'Other'" in without_fix("WORLD_LIGHT").sentence


def test_eevees_ray_tracing(room):
    room.render.engine = EEVEE
    assert not found("FAST_GI")
    eevee = room.eevee
    eevee.use_raytracing = True
    eevee.use_fast_gi = False
    eevee.ray_tracing_options.trace_max_roughness = 1.0
    mend("FAST_GI")
    assert eevee.use_raytracing, "reflections go on"
    twice.give_back(room)
    assert (eevee.use_fast_gi, eevee.fast_gi_method) == (False, "GLOBAL_ILLUMINATION")
    assert eevee.ray_tracing_options.trace_max_roughness == 1.0 and former.KEY not in room


def test_light_probes(room):
    room.render.engine = EEVEE
    probe = add(room, "Probe", bpy.data.lightprobes.new("Probe", "VOLUME"))
    add(room, "Mirror", bpy.data.lightprobes.new("Mirror", "SPHERE"))
    mend("LIGHT_PROBES")
    assert probe.hide_render and probe.hide_viewport
    twice.give_back(room)
    assert not probe.hide_render and not probe.hide_viewport and former.KEY not in probe


def test_cycles_own_bounces_beside_the_bake(room, quick):
    room.render.engine = "CYCLES"
    room.cycles.diffuse_bounces = 3
    assert bakes()
    room.lightpanes.cycles = True
    assert not found("CYCLES_BOUNCES") and not found("CYCLES_FAST_GI")
    room.cycles.diffuse_bounces = 4
    room.cycles.use_fast_gi = True
    mend("CYCLES_BOUNCES")
    mend("CYCLES_FAST_GI")
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert room.cycles.diffuse_bounces == 3 and room.cycles.use_fast_gi


def test_what_the_user_changed_since_is_not_given_back(room):
    former.change(room, "eevee.fast_gi_ray_count", 5)
    former.change(room, "eevee.fast_gi_ray_count", 7)
    room.eevee.fast_gi_ray_count = 3
    former.give_back(room)
    assert room.eevee.fast_gi_ray_count == 3 and not former.is_any(room)


def test_a_second_change_keeps_what_was_before_the_first(room):
    was = room.eevee.fast_gi_ray_count
    former.change(room, "eevee.fast_gi_ray_count", was + 1)
    former.change(room, "eevee.fast_gi_ray_count", was + 2)
    former.give_back(room)
    assert room.eevee.fast_gi_ray_count == was


def test_clear_gives_back_a_world_that_the_scene_has_no_more(room):
    room.render.engine = EEVEE
    world = sky(room)
    before = tree_state(world.node_tree)
    mend("WORLD_LIGHT")
    room.world = bpy.data.worlds.new("Other")
    assert preflight.examine(bpy.context).can_give_back
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert tree_state(world.node_tree) == before and not preflight.examine(bpy.context).can_give_back


def test_clear_leaves_another_scenes_world_alone(room):
    room.render.engine = EEVEE
    world = sky(room)
    mend("WORLD_LIGHT")
    other = bpy.data.scenes.new("Other")
    room.world, other.world = None, world
    assert not preflight.examine(bpy.context).can_give_back
    bpy.ops.lightpanes.clear()
    assert world_light.is_hidden(world)


@pytest.mark.parametrize("change", ["other", "none", "volume"])
def test_a_world_whose_nodes_are_linked_anew(room, change):
    room.render.engine = EEVEE
    world = sky(room)
    before = tree_state(world.node_tree)
    mend("WORLD_LIGHT")
    assert not found("WORLD_OUTDATED")
    tree, output = world.node_tree, world.node_tree.get_output_node("CYCLES")
    old = output.inputs["Surface"].links[0].from_socket
    new = tree.nodes.new("ShaderNodeVolumeScatter" if change == "volume" else "ShaderNodeBackground")
    socket = output.inputs["Volume" if change == "volume" else "Surface"]
    if change == "none":
        tree.nodes.remove(new)
        tree.links.remove(socket.links[0])
        # a world that is black has nothing to say
        assert not found("WORLD_OUTDATED") and world_light.is_outdated(world)
        world_light.follow(world)
        assert not world_light.is_outdated(world)
    else:
        tree.links.new(new.outputs[0], socket)
        mend("WORLD_OUTDATED")
    shown = tree.get_output_node("EEVEE")
    mix = shown.inputs["Surface"].links[0].from_node
    if change == "volume":
        assert shown.inputs["Volume"].links[0].from_node == new
        tree.nodes.remove(new)
    elif change == "other":
        assert mix.inputs[2].links[0].from_node == new
        tree.nodes.remove(new)
    else:
        assert not mix.inputs[2].is_linked
    tree.links.new(old, output.inputs["Surface"])
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert tree_state(tree) == before
