"""A bake goes into a .blend and comes back bit for bit, and only what is ours is ever deleted."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import store  # noqa: E402
from lightpanes.core.bake import Bake  # noqa: E402
from lightpanes.core.scene import SceneError  # noqa: E402

from .files import reopen  # noqa: E402


def make_bake(seed=0, resolution=16, entries=37):
    """A Bake of noise, odd values included, in every shape that can be stored."""
    rng = np.random.default_rng(seed)
    panes = rng.standard_normal((32, 48, 4)).astype(np.float32)
    panes[0, 0] = [1e-40, 3e38, -0.0, np.inf]
    panes[1, :, 3] = 0.0
    return Bake(
        resolution=resolution,
        images={
            "Lightpanes Panes": panes,
            "Lightpanes Weights": rng.standard_normal((5, 3, 7)).astype(np.float32),
            "Lightpanes Interpolation": rng.standard_normal(9001).astype(np.float32),
        },
        entries={
            "position": rng.standard_normal((entries, 3)).astype(np.float32),
            "normal": rng.standard_normal((entries, 3)).astype(np.float32),
            "area": rng.random(entries, dtype=np.float32),
            "region": rng.integers(-5, 2**31 - 1, entries).astype(np.int32),
            "corners": rng.integers(0, 9, (entries, 2)).astype(np.int32),
            "mixed": rng.random((entries, 5), dtype=np.float32),
        },
        direct=rng.random((resolution, resolution, 3), dtype=np.float32),
        meta={"report": {"error": 0.03}, "seed": seed, "name": "Gästezimmer"},
    )


def assert_same(a: Bake, b: Bake):
    assert a.resolution == b.resolution
    assert list(a.images) == list(b.images) and list(a.entries) == list(b.entries)
    pairs = [*zip(a.images.values(), b.images.values(), strict=True), (a.direct, b.direct)]
    pairs += zip(a.entries.values(), b.entries.values(), strict=True)
    for x, y in pairs:
        assert x.dtype == y.dtype and x.shape == y.shape
        assert np.ascontiguousarray(x).tobytes() == np.ascontiguousarray(y).tobytes()
    assert a.meta == b.meta


def ours():
    """Everything tagged ours, by kind."""
    kinds = (bpy.data.images, bpy.data.meshes, bpy.data.objects, bpy.data.collections, bpy.data.node_groups)
    return sorted(item.name for kind in kinds for item in kind if store.TAG in item)


def test_exact_after_save_and_reopen(blender, tmp_path):
    bake = make_bake()
    store.store_bake(bpy.context.scene, bake, np.full((16, 16, 3), 0.25, np.float32))
    assert_same(bake, store.load_bake(bpy.context.scene))
    scene = reopen(tmp_path)
    assert_same(bake, store.load_bake(scene))
    albedo = store.find_image(scene, store.ALBEDO)
    assert albedo.colorspace_settings.name == "Non-Color" and albedo.is_float
    assert np.allclose(np.array(albedo.pixels).reshape(16, 16, 4), [0.25, 0.25, 0.25, 1])


def test_no_bake(blender):
    assert store.load_bake(bpy.context.scene) is None
    assert store.find_image(bpy.context.scene, store.IRRADIANCE) is None
    assert not store.clear(bpy.context.scene)


def test_hidden_from_view_and_render(room):
    entries = store.store_bake(room, make_bake())
    collection = next(c for c in room.collection.children if store.TAG in c)
    assert collection.name == "Lightpanes" and collection.hide_render and collection.hide_viewport
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert entries.name not in [instance.object.name for instance in depsgraph.object_instances]


def test_found_after_renaming(room, tmp_path):
    bake = make_bake()
    entries = store.store_bake(room, bake)
    entries.name = "Something"
    entries.data.name = "Else"
    for image in bpy.data.images:
        image.name = "Picture"
    assert_same(bake, store.load_bake(reopen(tmp_path)))


def test_second_bake_replaces_the_first(room):
    store.store_bake(room, make_bake(0), np.zeros((16, 16, 3), np.float32))
    before = ours()
    second = make_bake(1)
    store.store_bake(room, second, np.zeros((16, 16, 3), np.float32))
    assert ours() == before
    assert_same(second, store.load_bake(room))
    assert store.find_image(room, store.IRRADIANCE).name == store.IRRADIANCE


def test_failure_leaves_the_previous_bake(room):
    first = make_bake(0)
    store.store_bake(room, first)
    before = ours()
    broken = make_bake(1)
    broken.entries["area"] = broken.entries["area"].astype(np.float64)
    with pytest.raises(SceneError, match="'area' is float64"):
        store.store_bake(room, broken)
    assert ours() == before
    assert_same(first, store.load_bake(room))


def test_two_scenes_each_have_their_own(room):
    first, second = make_bake(0), make_bake(1)
    other = bpy.data.scenes.new("Other")
    store.store_bake(room, first)
    store.store_bake(other, second)
    assert_same(first, store.load_bake(room))
    assert_same(second, store.load_bake(other))
    store.clear(room)
    assert store.load_bake(room) is None
    assert_same(second, store.load_bake(other))


def test_a_copied_scene_keeps_its_bake_when_the_original_is_cleared(room):
    bake = make_bake()
    store.store_bake(room, bake)
    bpy.ops.scene.new(type="FULL_COPY")
    copy = bpy.context.scene
    assert copy != room
    store.clear(room)
    assert_same(bake, store.load_bake(copy))


def test_clear_deletes_only_what_is_ours(room):
    bystander = bpy.data.images.new("Lightpanes Irradiance", 4, 4)
    mesh = bpy.data.meshes.new("Lightpanes Entries")
    names = sorted(item.name for item in (*bpy.data.objects, *bpy.data.meshes, *bpy.data.images, *bpy.data.collections))
    store.store_bake(room, make_bake())
    assert store.clear(room)
    after = sorted(item.name for item in (*bpy.data.objects, *bpy.data.meshes, *bpy.data.images, *bpy.data.collections))
    assert after == names and bystander.name and mesh.name
    assert ours() == []


def test_irradiance_survives_saving(room, tmp_path):
    room.lightpanes.live = False  # the picture is not what the lamp would give
    store.store_bake(room, make_bake())
    pixels = np.random.default_rng(3).random((16, 16, 4), dtype=np.float32)
    store.write_irradiance(room, pixels)
    image = store.find_image(reopen(tmp_path), store.IRRADIANCE)
    assert np.array_equal(np.array(image.pixels, np.float32).reshape(16, 16, 4), pixels)


@pytest.mark.parametrize("damage", ["image", "scaled", "layout", "mesh"])
def test_damaged_bakes_say_so(room, damage):
    entries = store.store_bake(room, make_bake())
    if damage == "image":
        bpy.data.images.remove(store.find_image(room, "Lightpanes Panes"))
    elif damage == "scaled":
        store.find_image(room, "Lightpanes Panes").scale(2, 2)
    elif damage == "layout":
        entries.data[store.LAYOUT] = "{"
    else:
        entries.data.clear_geometry()
    with pytest.raises(SceneError, match=r"The bake in scene 'Scene' is damaged \(.+\); bake again\."):
        store.load_bake(room)


def test_deleted_entries_are_no_bake(room):
    entries = store.store_bake(room, make_bake())
    bpy.data.objects.remove(entries)
    assert store.load_bake(room) is None
