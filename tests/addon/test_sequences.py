"""Whatever a user does, in whatever order: no exception, nothing of ours left over, and never a wrong light.

LIGHTPANES_SEQUENCES says how many random sequences to try; `make sequences` tries 200.
"""

import functools
import os
import tempfile
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import lightpanes  # noqa: E402
from hypothesis import HealthCheck, Phase, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule  # noqa: E402
from lightpanes.addon import baking, direct, job, nodes, relight, sessions, store  # noqa: E402

from .conftest import SMALL, furnish  # noqa: E402
from .files import empty  # noqa: E402

SEQUENCES = int(os.environ.get("LIGHTPANES_SEQUENCES", "4"))
STEPS = 12
PLAIN = baking.Settings


def ours():
    """Data-blocks of ours, by kind and name."""
    kinds = ("images", "meshes", "objects", "collections", "node_groups")
    return {(kind, item.name) for kind in kinds for item in getattr(bpy.data, kind) if store.TAG in item}


def in_use(scene):
    """Those of them that the scene's bake needs."""
    entries = store.find_entries(scene)
    if entries is None:
        return set()
    found = {("objects", entries.name), ("meshes", entries.data.name)}
    found |= {("images", image.name) for image in entries.data[store.IMAGES].values()}
    points = store.find_points(scene)
    if points is not None:
        found |= {("objects", points.name), ("meshes", points.data.name)}
    group = nodes.group_of(scene)
    if group is not None:
        found.add(("node_groups", group.name))
    receivers = scene.lightpanes.receivers
    if receivers is not None and direct.is_baked(scene):
        found.add(("collections", receivers.name))
    return found | {("collections", c.name) for c in scene.collection.children if store.TAG in c}


def trees():
    """All node trees of materials, whatever these are named now, without what is ours."""
    found = []
    for material in bpy.data.materials:
        if material.node_tree is None or store.TAG in material:
            continue
        tree = material.node_tree
        theirs = [node for node in tree.nodes if nodes.NODE_TAG not in node]
        links = sorted(
            (link.from_node.name, link.from_socket.identifier, link.to_node.name, link.to_socket.identifier)
            for link in tree.links
            if nodes.NODE_TAG not in link.from_node and nodes.NODE_TAG not in link.to_node
        )
        found.append(([(node.name, node.bl_idname) for node in theirs], links))
    return sorted(found)


class Sequences(RuleBasedStateMachine):
    """One user at one file."""

    @initialize()
    def begin(self):
        empty()
        lightpanes.register()
        baking.Settings = functools.partial(PLAIN, **SMALL)
        furnish()
        self.folder = tempfile.TemporaryDirectory()
        self.file = Path(self.folder.name) / "room.blend"
        self.trees = trees()
        bpy.ops.wm.save_as_mainfile(filepath=str(self.file))
        bpy.ops.ed.undo_push(message="Begin")

    def teardown(self):
        if not hasattr(self, "folder"):
            return
        job.cancel()
        self.finish()
        job._kept.clear()
        baking.Settings = PLAIN
        lightpanes.unregister()
        self.folder.cleanup()

    @staticmethod
    def finish():
        """Wait for the thread of a cancelled bake."""
        current = job.current()
        if current is not None and current.thread is not None:
            current.thread.join()

    @property
    def scene(self):
        return bpy.context.scene

    @property
    def meshes(self):
        return [item for item in self.scene.objects if item.type == "MESH" and store.TAG not in item]

    @property
    def lamps(self):
        return [item for item in self.scene.objects if item.type == "LIGHT"]

    def push(self, message):
        bpy.context.view_layer.update()
        bpy.ops.ed.undo_push(message=message)

    @precondition(lambda self: self.meshes)
    @rule(exits=st.sampled_from(["TEXELS", "POINTS"]))
    def bake(self, exits):
        self.scene.lightpanes.exits = exits
        assert bpy.ops.lightpanes.bake() == {"FINISHED"}
        self.push("Bake")

    @precondition(lambda self: self.meshes)
    @rule(part=st.floats(0, 1), seed=st.integers(0, 2))
    def cancel(self, part, seed):
        self.scene.lightpanes.seed = seed
        before = store.bake_key(self.scene)
        running = job.start(bpy.context)
        while not running.advance() and running.progress.fraction < part:
            pass
        running.cancel()
        self.finish()
        if running.report is None:
            assert not running.error
            assert store.bake_key(self.scene) == before
        else:
            self.push("Bake")

    @rule()
    def undo(self):
        if bpy.ops.ed.undo.poll():
            bpy.ops.ed.undo()

    @rule()
    def redo(self):
        if bpy.ops.ed.redo.poll():
            bpy.ops.ed.redo()

    @precondition(lambda self: len(self.meshes) > 1)
    @rule(pick=st.integers(0, 9))
    def delete(self, pick):
        meshes = self.meshes
        bpy.data.objects.remove(meshes[pick % len(meshes)])
        self.push("Delete")

    @rule(pick=st.integers(0, 9), number=st.integers(0, 99))
    def rename(self, pick, number):
        things = [*self.scene.objects, *bpy.data.images, *bpy.data.materials, self.scene]
        things[pick % len(things)].name = f"Thing {number}"
        self.push("Rename")

    @rule()
    def save(self):
        bpy.ops.wm.save_as_mainfile(filepath=str(self.file))

    @rule(storage=st.sampled_from(["PACKED", "BESIDE"]))
    def store_images(self, storage):
        self.scene.lightpanes.storage = storage
        self.push("Images")

    @rule()
    def reload(self):
        bpy.ops.wm.open_mainfile(filepath=str(self.file))
        self.trees = trees()

    @precondition(lambda self: self.lamps)
    @rule(x=st.floats(-0.8, 0.8), energy=st.floats(0, 50), shown=st.booleans())
    def move_lamp(self, x, energy, shown):
        lamp = self.lamps[0]
        lamp.location.x, lamp.data.energy, lamp.hide_render = x, energy, not shown
        self.push("Lamp")

    @rule()
    def add_lamp(self):
        lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
        lamp.location = (0.4, -0.4, 0.1)
        self.scene.collection.objects.link(lamp)
        self.push("Add lamp")

    @rule()
    def duplicate_an_object(self):
        if self.meshes:
            copy = self.meshes[0].copy()
            copy.location.z += 0.1
            self.scene.collection.objects.link(copy)
            self.push("Duplicate")

    @rule(baked=st.booleans())
    def direct_light(self, baked):
        self.scene.lightpanes.direct = "BAKED" if baked else "OFF"
        self.push("Direct light")

    @rule()
    def clear(self):
        assert bpy.ops.lightpanes.clear() == {"FINISHED"}
        assert store.find_entries(self.scene) is None
        assert not [item.name for item in self.scene.objects if "lightpanes_baked" in item]
        assert trees() == self.trees
        assert not [lamp.name for lamp in self.lamps if lamp.light_linking.receiver_collection is not None]
        self.push("Clear")

    @invariant()
    def nothing_is_left_over(self):
        if not hasattr(self, "file"):
            return
        # undo keeps data-blocks that another step needs; what a reload would drop has no users
        left = ours() - in_use(self.scene)
        assert not {(kind, name) for kind, name in left if getattr(bpy.data, kind)[name].users}

    @invariant()
    def the_user_s_nodes_stay(self):
        if hasattr(self, "file"):
            assert trees() == self.trees or store.find_entries(self.scene) is not None

    @invariant()
    def the_light_is_right(self):
        if not hasattr(self, "file") or store.find_entries(self.scene) is None:
            return
        if not self.meshes:
            return
        shown = self.pixels()
        sessions.forget(self.scene)
        direct.forget(self.scene)
        relight.relight(bpy.context)
        # a bake whose objects are gone can't be read anew, and says so
        if not sessions.of(self.scene).stale:
            for before, fresh in zip(shown, self.pixels(), strict=True):
                assert np.allclose(before, fresh, rtol=1e-3, atol=1e-4 * max(fresh.max(), 1e-6))

    def pixels(self):
        roles = (store.IRRADIANCE, store.DIRECT) if direct.is_baked(self.scene) else (store.IRRADIANCE,)
        return [store.read_image(self.scene, role) for role in roles]


TestSequences = Sequences.TestCase
TestSequences.settings = settings(
    max_examples=SEQUENCES,
    stateful_step_count=STEPS,
    deadline=None,
    derandomize=SEQUENCES < 100,
    suppress_health_check=list(HealthCheck),
    # shrinking a failure takes minutes
    phases=(Phase.generate,),
    database=None,
)
