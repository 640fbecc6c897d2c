"""Input that is wrong, odd or missing: what a bake in Blender makes of it. Needs bpy."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import bpy
import lightpanes
import numpy as np
import pytest
from lightpanes.addon import baking, beside, extract, store

from ..addon.conftest import SMALL, furnish
from ..addon.files import empty
from ..frugal import save_rays
from .entry import Found, Images, Wires, entry
from .looks import look

EYE, TARGET, FIELD = (-0.9, -0.85, 0.7), (0.25, 0.2, -0.6), 1.5
"""A look into the test room."""

SAME = 0.05
"""What noise and another layout of the atlas change in the mean light of bakes as small as these."""


@contextmanager
def blender():
    """An empty Blender with Lightpanes, whose bakes are small."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(baking, "Settings", functools.partial(baking.Settings, **SMALL))
        save_rays(patch)
        empty()
        lightpanes.register()
        try:
            yield furnish()
        finally:
            lightpanes.unregister()


def view(scene) -> np.ndarray:
    """(H, W) red irradiance as a camera in the room sees it."""
    image = store.find_image(scene, store.IRRADIANCE)
    size = image.size[0]
    pixels = np.array(image.pixels, np.float32).reshape(size, size, 4)
    made = extract.extract(bpy.context, resolution=size, albedo=False)
    return look(made, pixels[..., 0], EYE, TARGET, FIELD)


def bake() -> None:
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}


@functools.cache
def usual() -> np.ndarray:
    """What the room looks like without anything amiss."""
    with blender() as scene:
        bake()
        return view(scene)


def changed(change: Callable, label: str, expected: np.ndarray | None = None, against: str = "as usual") -> Found:
    """How much the mean light changes where the scene is first changed and then baked."""
    with blender() as scene:
        change(scene)
        bpy.context.view_layer.update()
        bake()
        found = view(scene)
        warnings = " ".join(store.read_meta(scene)["report"]["warnings"])
    expected = usual() if expected is None else expected
    shown = Images({against: expected, label: found}, "W/m²", high=float(np.quantile(expected, 0.995)))
    return Found(abs(float(found.mean() / expected.mean()) - 1), shown, warnings and f"It says: “{warnings}”")


def baked_with(change: Callable) -> np.ndarray:
    with blender() as scene:
        change(scene)
        bpy.context.view_layer.update()
        bake()
        return view(scene)


def refused(change: Callable, words: str) -> Found:
    """1 where the bake is refused in a sentence with these words, and leaves the file as it was; else 0."""
    with blender() as scene:
        change(scene)
        before = sorted(item.name for item in (*bpy.data.images, *bpy.data.objects, *bpy.data.node_groups))
        wires, marks = edges(scene)
        try:
            bpy.ops.lightpanes.bake()
            said = "It was baked."
        except RuntimeError as error:
            said = str(error).strip().removeprefix("Error: ")
        after = sorted(item.name for item in (*bpy.data.images, *bpy.data.objects, *bpy.data.node_groups))
    shown = Wires({"the scene": (wires, said)}, {"the scene": marks})
    return Found(float(words in said and before == after), shown, f"It says: “{said}”")


def edges(scene):
    """Edges (n, 2, 3) of all meshes, m, and the places of lamps (m, 3); what is not a number is left out."""
    found, lamps = [np.zeros((0, 2, 3))], [np.zeros((0, 3))]
    for item in scene.objects:
        matrix = np.array(item.matrix_world)
        if item.type == "LIGHT":
            lamps.append(matrix[None, :3, 3])
        elif item.type == "MESH":
            points = (
                np.array([v.co for v in item.data.vertices], float).reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
            )
            ends = np.array([edge.vertices for edge in item.data.edges], int).reshape(-1, 2)
            lines = points[ends]
            found.append(lines[np.isfinite(lines).all((1, 2))])
    return np.concatenate(found), np.concatenate(lamps)


def remove(*names: str):
    for name in names:
        bpy.data.objects.remove(bpy.data.objects[name])


@entry(
    "Input",
    "no lamps",
    """A scene without lamps is baked for those that may come, and the report says so; the light follows as soon as there
    is one.""",
    "difference of the light of a lamp that came after the bake from one that was there",
    SAME,
    "addon/test_operators.py::test_no_lamps addon/test_preflight.py::test_no_lamp_at_all",
)
def no_lamps() -> Found:
    with blender() as scene:
        lamp = bpy.data.objects["Lamp"]
        scene.collection.objects.unlink(lamp)
        bake()
        warnings = " ".join(store.read_meta(scene)["report"]["warnings"])
        dark = view(scene)
        scene.collection.objects.link(lamp)
        bpy.context.view_layer.update()
        bpy.ops.lightpanes.relight()
        found = view(scene)
    shown = {"as usual": usual(), "no lamp": dark, "a lamp that came later": found}
    value = abs(float(found.mean() / usual().mean()) - 1)
    return Found(value, Images(shown, "W/m²", high=float(np.quantile(usual(), 0.995))), f"It says: “{warnings}”")


@entry(
    "Input",
    "no meshes",
    "There is nothing to bake, which is said in one sentence; the file stays as it was.",
    "1: refused in a sentence that names the scene",
    1,
    "addon/test_operators.py::test_no_objects addon/test_preflight.py::test_no_mesh",
    at_least=True,
)
def no_meshes() -> Found:
    return refused(lambda scene: remove("Room", "Block"), "has no mesh. Add one.")


@entry(
    "Input",
    "no UVs",
    "Lightpanes unwraps into a layer of its own, so UVs of the scene's are not needed.",
    "difference of the mean light",
    1e-6,
    "addon/test_atlas.py::test_charts_are_two_texels_apart addon/test_unfolded.py::test_it_is_read_as_if_it_had_the_atlas",
)
def no_uvs() -> Found:
    def change(scene):
        for item in scene.objects:
            while item.type == "MESH" and item.data.uv_layers:
                item.data.uv_layers.remove(item.data.uv_layers[0])

    return changed(change, "no UVs")


@entry(
    "Input",
    "overlapping UVs",
    "For the same reason UVs that lie on each other do no harm, and stay as they are.",
    "difference of the mean light",
    1e-6,
    "addon/test_atlas.py::test_other_layers_selection_and_data_stay_as_they_were",
)
def overlapping_uvs() -> Found:
    def change(scene):
        for item in scene.objects:
            if item.type == "MESH":
                layer = item.data.uv_layers[0] if item.data.uv_layers else item.data.uv_layers.new()
                layer.uv.foreach_set("vector", np.zeros(2 * len(item.data.loops), np.float32))

    return changed(change, "all UVs in one place")


def with_slivers(scene):
    """The block, with faces without area added."""
    mesh = bpy.data.objects["Block"].data
    corners = [tuple(v.co) for v in mesh.vertices]
    faces = [tuple(face.vertices) for face in mesh.polygons]
    material = mesh.materials[0]
    mesh.clear_geometry()
    extra = [(0, 0, 0.26), (0, 0, 0.36), (0, 0, 0.46)]
    mesh.from_pydata([*corners, *extra], [], [*faces, (8, 9, 10)])
    mesh.materials[0] = material


@entry(
    "Input",
    "zero-area faces",
    "They are left out; a mesh of nothing else is refused.",
    "difference of the mean light",
    SAME,
    """addon/test_operators.py::test_zero_area_faces_among_others addon/test_operators.py::test_zero_area_faces_alone
    core/test_scene.py::test_faces_without_area_are_dropped""",
)
def zero_area() -> Found:
    return changed(with_slivers, "a face without area on the block")


@entry(
    "Input",
    "NaN vertices",
    "A mesh with vertices that are not numbers is named, and nothing is baked.",
    "1: refused in a sentence that names the object",
    1,
    "addon/test_operators.py::test_nan_vertices core/test_scene.py::test_vertices_that_are_not_numbers_name_their_object",
    at_least=True,
)
def nan_vertices() -> Found:
    def change(scene):
        bpy.data.objects["Block"].data.vertices[0].co.x = float("nan")

    return refused(change, "'Block' has vertices that are not numbers")


def stretched(scene):
    block = bpy.data.objects["Block"]
    block.scale, block.rotation_euler = (1.4, 0.8, 1.5), (0, 0, 0.4)


@entry(
    "Input",
    "mirrored or non-uniform scale",
    "Normals point out of a mesh whatever its scale, and texels are as dense all over it.",
    "difference of the mean light, a block stretched and mirrored, from one whose scale is applied",
    SAME,
    "addon/test_extract.py::test_normals_point_outside_whatever_the_scale core/test_failures.py::test_a_mirrored_scene_has_the_same_light",
)
def scales() -> Found:
    def applied(scene):
        stretched(scene)
        bpy.context.view_layer.update()
        item = bpy.data.objects["Block"]
        item.data.transform(item.matrix_world)
        item.matrix_world.identity()

    def mirrored(scene):
        stretched(scene)
        bpy.data.objects["Block"].scale.x *= -1

    return changed(mirrored, "stretched and mirrored", baked_with(applied), "scale applied")


def second_block(share: bool):
    def change(scene):
        twin = bpy.data.objects["Block"].copy()
        if not share:
            twin.data = twin.data.copy()
        twin.location = (-0.4, 0.5, -0.5)
        scene.collection.objects.link(twin)

    return change


@entry(
    "Input",
    "linked duplicates",
    "Objects that share a mesh each have their place in the atlas, and so their own light.",
    "difference of the mean light from copies that share nothing",
    SAME,
    """addon/test_extract.py::test_linked_duplicates_and_collection_instances
    addon/test_materials.py::test_objects_that_share_a_mesh_have_their_own_texels""",
)
def duplicates() -> Found:
    return changed(second_block(True), "linked duplicate", baked_with(second_block(False)), "copy")


@entry(
    "Input",
    "instances",
    """Instances block and reflect light as others do, but have no texels, so that they receive none (black in the
    picture); the panel offers Make Instances Real.""",
    "difference of the mean light of the rest from that beside a real object",
    SAME,
    "addon/test_extract.py::test_linked_duplicates_and_collection_instances addon/test_preflight.py::test_instances",
)
def instances() -> Found:
    def change(scene):
        block = bpy.data.objects["Block"]
        hidden = bpy.data.collections.new("Parts")
        scene.collection.objects.unlink(block)
        hidden.objects.link(block)
        empty_ = bpy.data.objects.new("Instancer", None)
        empty_.instance_type, empty_.instance_collection = "COLLECTION", hidden
        scene.collection.objects.link(empty_)

    found = changed(change, "instance")
    expected, seen = found.picture.images.values()
    lit = seen > 0
    return Found(abs(float(seen[lit].mean() / expected[lit].mean()) - 1), found.picture, found.detail)


@entry(
    "Input",
    "modifiers",
    "Objects are baked as they render; modifiers stay in place.",
    "difference of the mean light from that of the applied modifier",
    SAME,
    "addon/test_extract.py::test_modifiers_are_evaluated_as_for_rendering_and_put_back addon/test_atlas.py::test_modifiers_that_copy_faces_are_named",
)
def modifiers() -> Found:
    def rounded(scene):
        modifier = bpy.data.objects["Block"].modifiers.new("Bevel", "BEVEL")
        modifier.width, modifier.segments = 0.1, 2

    def applied(scene):
        rounded(scene)
        with bpy.context.temp_override(object=bpy.data.objects["Block"], active_object=bpy.data.objects["Block"]):
            bpy.ops.object.modifier_apply(modifier="Bevel")

    return changed(rounded, "modifier", baked_with(applied), "applied")


@entry(
    "Input",
    "hidden objects",
    "What is hidden from renders is not there; a scene of nothing else is refused.",
    "difference of the mean light from that of a scene without the object",
    SAME,
    "addon/test_extract.py::test_render_visibility_counts_not_the_viewports addon/test_operators.py::test_everything_hidden",
)
def hidden_objects() -> Found:
    def change(scene):
        bpy.data.objects["Block"].hide_render = True

    return changed(change, "hidden from renders", baked_with(lambda scene: remove("Block")), "removed")


def reopened(folder_is_there: bool) -> Found:
    """How far the light of a file that was saved and opened again is from what was baked in the unsaved file."""
    with blender() as scene, tempfile.TemporaryDirectory() as name:
        scene.lightpanes.storage = "BESIDE"
        assert not bpy.data.filepath
        bake()
        before = view(scene)
        blend = Path(name) / "room.blend"
        if not folder_is_there:
            beside.folder_of(blend).write_text("a file in its place")
        bpy.ops.wm.save_as_mainfile(filepath=str(blend))
        said = beside.problem()
        bpy.ops.wm.open_mainfile(filepath=str(blend))
        after = view(bpy.context.scene)
        empty()
    shown = {"in the unsaved file": before, "saved and opened again": after}
    value = float(np.abs(after - before).max() / before.mean())
    said = " ".join((said or "").replace(name, "…").split())
    return Found(value, Images(shown, "W/m²", high=float(np.quantile(before, 0.995))), said and f"It says: “{said}”")


@entry(
    "Input",
    "unsaved files",
    "They bake as others do; where images are kept beside the .blend they are packed until it is saved.",
    "largest difference after saving and opening again, over the mean",
    1e-6,
    "addon/test_operators.py::test_an_unsaved_file_bakes addon/test_beside.py::test_unsaved_files_keep_their_images_packed",
)
def unsaved() -> Found:
    return reopened(True)


@entry(
    "Input",
    "read-only folders",
    "Where no folder can be made the images are packed into the .blend after all, and the panel says why.",
    "largest difference after saving and opening again, over the mean",
    1e-6,
    """addon/test_beside_lost.py::test_where_no_folder_can_be_made addon/test_commands.py::test_a_folder_that_refuses
    addon/test_saving.py::test_saving_images_where_none_can_be""",
)
def read_only() -> Found:
    return reopened(False)
