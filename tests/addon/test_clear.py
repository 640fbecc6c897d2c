"""Every sample scene: baked and cleared, its materials and its data are what they were."""

from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import store  # noqa: E402

from .test_operators import everything  # noqa: E402

FOLDER = Path(__file__).resolve().parents[2] / "sample_blends"
SAMPLES = sorted(FOLDER.glob("*.blend"))


def dump(thing, deep=True):
    """All properties that are plain values, by name; those of pointers to nodes' own parts too."""
    found = {}
    for item in thing.bl_rna.properties:
        name = item.identifier
        if name in {"rna_type", "select", "session_uid", "is_active_output"} or item.is_runtime:
            continue
        value = getattr(thing, name)
        if item.type in {"BOOLEAN", "INT", "FLOAT", "STRING", "ENUM"}:
            found[name] = tuple(value) if getattr(item, "is_array", False) else value
        elif item.type == "POINTER" and deep and value is not None and isinstance(value, bpy.types.ColorRamp):
            found[name] = [(e.position, tuple(e.color)) for e in value.elements]
    return found


def trees():
    """Node trees of all materials, down to the sockets' values."""
    found = {}
    for material in bpy.data.materials:
        tree = material.node_tree
        if tree is None:
            found[material.name] = None
            continue
        found[material.name] = (
            [
                (
                    dump(node),
                    [dump(socket, deep=False) for socket in (*node.inputs, *node.outputs)],
                    sorted(node.keys()),
                )
                for node in tree.nodes
            ],
            [
                (a.from_node.name, a.from_socket.identifier, a.to_node.name, a.to_socket.identifier, a.is_muted)
                for a in tree.links
            ],
            [node.name for node in tree.nodes if getattr(node, "is_active_output", False)],
            tree.nodes.active.name if tree.nodes.active else "",
            sorted(tree.keys()),
            sorted(key for key in material.keys() if key != "cycles"),
            material.cycles.emission_sampling,
        )
    return found


@pytest.mark.parametrize("sample", SAMPLES, ids=lambda path: path.stem)
def test_materials_are_what_they_were_after_clear(blender, quick, tmp_path, sample):
    bpy.ops.wm.open_mainfile(filepath=str(sample))
    scene = bpy.context.scene
    # the smallest atlas that has room for all charts
    scene.lightpanes.resolution, scene.lightpanes.exits = 384 if sample.stem == "atrium" else 128, "TEXELS"
    before, names = trees(), everything()
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "baked.blend"), copy=True)
    for cycles in (False, True):
        scene.lightpanes.cycles = cycles
        assert trees() != before
        assert store.find_entries(scene) is not None
        assert bpy.ops.lightpanes.clear() == {"FINISHED"}
        assert trees() == before
        assert everything() == names
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "baked.blend"))
        scene = bpy.context.scene
