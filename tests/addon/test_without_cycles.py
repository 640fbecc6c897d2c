"""Cycles is an add-on: with it switched off all works that does not ask it for a picture."""

import pytest

bpy = pytest.importorskip("bpy")

import addon_utils  # noqa: E402
from lightpanes.addon import former, preflight, relight  # noqa: E402


@pytest.fixture
def without_cycles(room):
    addon_utils.disable("cycles")
    yield room
    addon_utils.enable("cycles")


def test_everything_works_without_cycles(without_cycles, quick):
    """Its add-on may be switched off in the Preferences."""
    room = without_cycles
    assert not hasattr(room, "cycles")
    room.world = bpy.data.worlds.new("Sky")
    assert preflight.examine(bpy.context).forecast is not None
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert relight.check_stale(bpy.context) == ()
    room.lightpanes.cycles = True
    room.lightpanes.cycles = False
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}


@pytest.mark.parametrize("what", ["material", "world"])
def test_what_needs_cycles_says_so(without_cycles, quick, what):
    room = without_cycles
    if what == "world":
        room.world = bpy.data.worlds.new("Sky")
        if room.world.node_tree is None:
            room.world.use_nodes = True
        tree, kind, name = room.world.node_tree, "BACKGROUND", "Color"
    else:
        tree, kind, name = bpy.data.materials["Block"].node_tree, "BSDF_PRINCIPLED", "Base Color"
    shader = next(node for node in tree.nodes if node.type == kind)
    tree.links.new(tree.nodes.new("ShaderNodeTexChecker").outputs["Color"], shader.inputs[name])
    needs = "Textured materials need" if what == "material" else "World 'Sky' is not of one colour and needs"
    with pytest.raises(RuntimeError, match=f"{needs} Cycles: turn on the add-on Cycles Render Engine in Preferences"):
        bpy.ops.lightpanes.bake()
    assert len(bpy.data.scenes) == 1 and len(bpy.data.worlds) <= 1 and not bpy.data.images


def test_clear_after_cycles_was_switched_off(room, quick):
    room.lightpanes.cycles = True
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    former.change(room, "cycles.use_fast_gi", True)
    addon_utils.disable("cycles")
    try:
        assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    finally:
        addon_utils.enable("cycles")
    assert not former.is_any(room)
