"""The sample scenes are what they say: small files, animated, lit from free air, seen from the front."""

from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix, Vector  # noqa: E402
from mathutils.bvhtree import BVHTree  # noqa: E402

from .files import empty  # noqa: E402

FOLDER = Path(__file__).resolve().parents[2] / "sample_blends"
SAMPLES = {
    "cornell": (4_000, 24_000),
    "pillars": (3_200, 3_450),
    "two_rooms": (500, 5_000),
    "stairs": (1_000, 5_000),
    "atrium": (60_000, 120_000),
    "glass": (15_000, 24_000),
}
LAMPS = {
    "cornell": {"POINT"},
    "pillars": {"POINT", "SPOT"},
    "two_rooms": {"POINT", "SUN"},
    "stairs": {"AREA"},
    "atrium": {"POINT", "AREA", "SUN"},
    "glass": {"POINT", "SPOT"},
}


@pytest.fixture(params=SAMPLES)
def sample(request):
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / f"{request.param}.blend"))
    yield request.param
    empty()


def tree_of_scene():
    """A BVH of all evaluated meshes, in world space, and its number of triangles."""
    graph = bpy.context.evaluated_depsgraph_get()
    points, triangles = [], []
    for instance in graph.object_instances:
        if instance.object.type != "MESH":
            continue
        mesh = instance.object.data
        mesh.calc_loop_triangles()
        start = len(points)
        points += [instance.matrix_world @ v.co for v in mesh.vertices]
        triangles += [[start + i for i in t.vertices] for t in mesh.loop_triangles]
    return BVHTree.FromPolygons(points, triangles), len(triangles)


def lamps():
    return [o for o in bpy.context.scene.objects if o.type == "LIGHT"]


def test_file_is_small_and_self_contained(sample):
    path = FOLDER / f"{sample}.blend"
    assert path.stat().st_size < 2 << 20
    assert all(i.packed_file for i in bpy.data.images if i.source == "FILE")
    assert not bpy.data.libraries
    scene = bpy.context.scene
    assert scene.camera is not None and scene.render.engine == "CYCLES" and scene.cycles.device == "CPU"


def test_triangles_and_lamps(sample):
    _, count = tree_of_scene()
    low, high = SAMPLES[sample]
    assert low <= count <= high
    assert {o.data.type for o in lamps()} == LAMPS[sample]
    assert any(o.animation_data and o.animation_data.action for o in lamps())


def test_lamps_fly_through_free_air(sample):
    tree, _ = tree_of_scene()
    scene = bpy.context.scene
    positions = []
    for frame in range(1, 101, 3):
        scene.frame_set(frame)
        for lamp in lamps():
            if lamp.data.type == "SUN":
                continue
            place = lamp.matrix_world.translation
            assert tree.find_nearest(place)[3] > 0.1, f"{lamp.name} at frame {frame}"
            if lamp.animation_data:
                positions.append(tuple(place))
    assert np.ptp(np.array(positions), axis=0).max() > 1.0


def test_normals_point_into_the_lit_space(sample):
    """Rays from the lamps meet fronts: any back that they meet would be a wall turned round."""
    tree, _ = tree_of_scene()
    scene = bpy.context.scene
    rng = np.random.default_rng(3)
    met = backs = 0
    for frame in (1, 30, 60, 90):
        scene.frame_set(frame)
        for lamp in lamps():
            if lamp.data.type == "SUN":
                continue
            for direction in rng.normal(size=(300, 3)):
                place, normal, _, _ = tree.ray_cast(lamp.matrix_world.translation, Vector(direction))
                if place is None:
                    continue
                met += 1
                backs += normal.dot(Vector(direction)) > 0
    assert met > 500
    # single leaves of the plant are seen from behind, rightly
    assert backs / met < 0.01


def test_built_by_the_script_deterministically(tmp_path, monkeypatch):
    """Building twice gives the same meshes and keys."""
    monkeypatch.syspath_prepend(str(FOLDER))
    import build

    def snapshot():
        build.cornell()
        graph = bpy.context.evaluated_depsgraph_get()
        points = [
            tuple(round(c, 6) for c in v.co) for v in bpy.data.objects["Monkey"].evaluated_get(graph).data.vertices
        ]
        bpy.context.scene.frame_set(40)
        return points, tuple(lamps()[0].matrix_world.translation), Matrix(bpy.data.objects["Monkey"].matrix_world)

    assert snapshot() == snapshot()
