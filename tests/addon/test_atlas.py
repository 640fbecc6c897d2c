"""The atlas: charts apart, texels evenly spread, nothing of the user's touched."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import atlas, charts, layout, packing  # noqa: E402
from lightpanes.addon.meshes import LAYER, loop_triangles, read_attribute  # noqa: E402
from lightpanes.addon.snapshot import Snapshot  # noqa: E402
from lightpanes.core.scene import SceneError  # noqa: E402

from .files import empty  # noqa: E402


def add(kind, **options):
    getattr(bpy.ops.mesh, f"primitive_{kind}_add")(**options)
    return bpy.context.object


def make(resolution=256):
    return atlas.make_atlas(bpy.context, bpy.context.scene.objects, resolution)


def atlas_uv(obj):
    uv = read_attribute(obj.data, LAYER, len(obj.data.loops), 2, "vector", np.float32).astype(np.float64)
    return uv * np.array(obj["lightpanes_scale"]) + np.array(obj["lightpanes_offset"])


def world_area(obj):
    points = read_attribute(obj.data, "position", len(obj.data.vertices), 3, "vector", np.float32)
    points = points @ np.array(obj.matrix_world)[:3, :3].T
    vertices = read_attribute(obj.data, ".corner_vert", len(obj.data.loops), 1, "value", np.int32)
    a, b, c = np.moveaxis(points[vertices[loop_triangles(obj.data)]], 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def uv_area(obj):
    a, b, c = np.moveaxis(atlas_uv(obj)[loop_triangles(obj.data)], 1, 0)
    return np.abs(_cross2(b - a, c - a)).sum() / 2


def _cross2(a, b):
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def chart_labels(obj):
    """(L,) charts by brute force: faces joined wherever two loops share vertex and UV."""
    uv = atlas_uv(obj)
    parent = {}

    def find(key):
        while parent.setdefault(key, key) != key:
            parent[key] = key = parent[parent[key]]
        return key

    keys = [(loop.vertex_index, *np.round(uv[loop.index], 5)) for loop in obj.data.loops]
    for face in obj.data.polygons:
        for loop in face.loop_indices:
            parent[find(keys[loop])] = find(keys[face.loop_start])
    return [find(key) for key in keys]


def occupancy(objects, resolution):
    """(H, W) label of the chart that touches each texel, −1 where none does, and whether charts collided."""
    grid = np.full((resolution, resolution), -1)
    names, collided = {}, False
    for obj in objects:
        uv, labels = atlas_uv(obj) * resolution, chart_labels(obj)
        for loops in loop_triangles(obj.data):
            label = names.setdefault((obj.name, labels[loops[0]]), len(names))
            corners = uv[loops]
            n = int(np.ceil(max(np.ptp(corners, axis=0)) * 3)) + 2
            u, v = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
            keep = u + v <= 1 + 1e-9
            points = corners[0] + u[keep, None] * (corners[1] - corners[0]) + v[keep, None] * (corners[2] - corners[0])
            x, y = np.floor(points).astype(int).T
            collided |= bool(np.any((grid[y, x] != -1) & (grid[y, x] != label)))
            grid[y, x] = label
    return grid, collided


def assert_apart(objects, resolution, texels=2):
    grid, collided = occupancy(objects, resolution)
    assert not collided
    padded = np.pad(grid, texels, constant_values=-1)
    for dy in range(-texels, texels + 1):
        for dx in range(-texels, texels + 1):
            other = padded[texels + dy :, texels + dx :][: grid.shape[0], : grid.shape[1]]
            assert not np.any((grid >= 0) & (other >= 0) & (grid != other)), (dx, dy)
    return grid


@pytest.fixture
def mixed(blender):
    """A room, a turned and a stretched box, a sphere, and three monkeys that share their mesh."""
    room = add("cube", size=4)
    room.name = "Room"
    box = add("cube", size=0.7, location=(0.5, 0.2, -1.6), rotation=(0.3, 0.4, 0.5))
    slab = add("cube", size=1, location=(-1, 0, -1.9))
    slab.scale = (1.5, 0.5, 0.1)
    ball = add("uv_sphere", segments=24, ring_count=12, radius=0.5, location=(1, 1, 0))
    monkey = add("monkey", size=1, location=(-1, -1, 0))
    others = []
    for k, scale in enumerate((0.5, -1.0)):
        other = monkey.copy()
        other.scale = (scale, abs(scale), abs(scale))
        other.location = (k, -1, 1)
        bpy.context.scene.collection.objects.link(other)
        others.append(other)
    bpy.context.view_layer.update()
    return [room, box, slab, ball, monkey, *others]


@pytest.mark.parametrize("resolution", [256, 300])
def test_charts_are_two_texels_apart(mixed, resolution):
    assert make(resolution) == []
    assert_apart(mixed, resolution)
    for obj in mixed:
        uv = atlas_uv(obj)
        assert uv.min() >= 1 / resolution - 1e-6 and uv.max() <= 1 - 1 / resolution + 1e-6


def test_ordinary_room_fills_the_atlas(blender):
    room = add("cube", size=1, location=(0, 0, 1.25))
    room.scale = (5, 4, 2.5)
    for k in range(6):
        add("cube", size=0.4 + 0.1 * k, location=(k - 2.5, 0, 0.5), rotation=(0, 0, 0.3 * k))
    add("cylinder", radius=0.3, depth=2, location=(0, 1, 1))
    add("monkey", size=1.5, location=(0, -1, 1))
    bpy.context.view_layer.update()
    make()
    grid = assert_apart(list(bpy.context.scene.objects), 256)
    assert (grid >= 0).mean() > 0.65


def test_texels_are_as_dense_everywhere(mixed):
    make()
    density = np.array([uv_area(obj) / world_area(obj) for obj in mixed])
    np.testing.assert_allclose(density, density[0], rtol=0.02)


def test_weight_multiplies_the_texels(mixed):
    mixed[1].lightpanes.weight = 3.0
    mixed[5].lightpanes.weight = 2.0
    make()
    density = [uv_area(obj) / world_area(obj) for obj in mixed]
    assert density[1] / density[0] == pytest.approx(3.0, rel=0.02)
    assert density[5] / density[4] == pytest.approx(2.0, rel=0.02)


def test_turned_box_is_not_stretched(blender):
    """A projection along the box's mean normal would shear its faces; each must stay a rectangle of true sides."""
    obj = add("cube", size=1, rotation=(0.5, 0.6, 0.7))
    obj.scale = (1, 2, 3)
    bpy.context.view_layer.update()
    make()
    uv = atlas_uv(obj)
    ratios = []
    world = np.array(obj.matrix_world)[:3, :3]
    for edge_face in obj.data.polygons:
        loops = list(edge_face.loop_indices)
        for a, b in zip(loops, loops[1:] + loops[:1], strict=True):
            va, vb = (np.array(obj.data.vertices[obj.data.loops[k].vertex_index].co) for k in (a, b))
            ratios.append(np.linalg.norm(uv[a] - uv[b]) / np.linalg.norm(world @ (va - vb)))
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-3)


def test_other_layers_selection_and_data_stay_as_they_were(mixed):
    room, ball = mixed[0], mixed[3]
    room.data.uv_layers.new(name="Artist")
    room.data.uv_layers["Artist"].active_render = True
    room.data.uv_layers.active_index = 0
    before = {
        layer.name: read_attribute(room.data, layer.name, len(room.data.loops), 2, "vector", np.float32).tobytes()
        for layer in room.data.uv_layers
    }
    bpy.ops.object.select_all(action="DESELECT")
    ball.select_set(True)
    bpy.context.view_layer.objects.active = room
    counts = [len(getattr(bpy.data, kind)) for kind in ("objects", "meshes", "scenes", "collections", "images")]
    make()
    make()
    assert [obj.name for obj in bpy.context.selected_objects] == [ball.name]
    assert bpy.context.view_layer.objects.active == room and bpy.context.mode == "OBJECT"
    assert counts == [len(getattr(bpy.data, kind)) for kind in ("objects", "meshes", "scenes", "collections", "images")]
    layers = room.data.uv_layers
    assert [layer.name for layer in layers] == ["UVMap", "Artist", LAYER]
    assert layers.active.name == "UVMap" and layers["Artist"].active_render
    for name, data in before.items():
        assert read_attribute(room.data, name, len(room.data.loops), 2, "vector", np.float32).tobytes() == data


def test_a_snapshot_puts_the_atlas_back(mixed):
    taken = Snapshot.of(bpy.context.scene, mixed)
    make()
    taken.restore()
    assert all(LAYER not in obj.data.uv_layers and "lightpanes_baked" not in obj for obj in mixed)
    make()
    places = [atlas_uv(obj) for obj in mixed]
    taken = Snapshot.of(bpy.context.scene, mixed)
    mixed[0].scale = (3, 1, 1)
    bpy.context.view_layer.update()
    make()
    assert not np.array_equal(atlas_uv(mixed[0]), places[0])
    taken.restore()
    assert all(np.array_equal(atlas_uv(obj), place) for obj, place in zip(mixed, places, strict=True))


def test_same_scene_same_atlas(mixed):
    make()
    first = [atlas_uv(obj) for obj in mixed]
    make()
    assert all(np.array_equal(atlas_uv(obj), uv) for obj, uv in zip(mixed, first, strict=True))


def test_objects_left_out_lose_their_place(mixed):
    make()
    mixed[1].hide_render = True
    mixed[2].lightpanes.exclude = True
    make()
    assert ["lightpanes_baked" in obj for obj in mixed] == [True, False, False, True, True, True, True]


def test_smooth_surface_with_many_faces(blender):
    ball = add("ico_sphere", subdivisions=5, radius=1)
    make()
    assert uv_area(ball) > 0.5
    assert_apart([ball], 256)


@pytest.mark.parametrize("kind", ["MIRROR", "ARRAY", "SOLIDIFY"])
def test_modifiers_that_copy_faces_are_named(blender, kind):
    obj = add("plane")
    obj.modifiers.new("Doubler", kind)
    (warning,) = make()
    assert "'Plane'" in warning and "'Doubler'" in warning and "apply" in warning


def test_ordinary_modifiers_are_fine(blender):
    obj = add("cube")
    obj.modifiers.new("Smooth", "SUBSURF")
    obj.modifiers.new("Round", "BEVEL")
    assert make() == []


def refuse(resolution=256):
    before = [(obj.name, LAYER in obj.data.uv_layers, "lightpanes_baked" in obj) for obj in bpy.context.scene.objects]
    counts = len(bpy.data.meshes), len(bpy.data.scenes)
    with pytest.raises(SceneError) as error:
        make(resolution)
    bpy.ops.object.mode_set(mode="OBJECT")
    assert before == [
        (obj.name, LAYER in obj.data.uv_layers, "lightpanes_baked" in obj) for obj in bpy.context.scene.objects
    ]
    assert counts == (len(bpy.data.meshes), len(bpy.data.scenes))
    return str(error.value)


def test_eight_layers(blender):
    obj = add("cube")
    for k in range(7):
        obj.data.uv_layers.new(name=f"Layer {k}")
    message = refuse()
    assert "'Cube' has 8 UV layers" in message and "delete" in message


def test_edit_mode(blender):
    add("cube")
    bpy.ops.object.mode_set(mode="EDIT")
    message = refuse()
    assert "'Cube' is in Edit Mode" in message and "Tab" in message


def test_attribute_of_our_name(blender):
    add("cube").data.attributes.new(LAYER, "FLOAT", "POINT")
    assert f"attribute named '{LAYER}'" in refuse()


def test_vertices_that_are_not_numbers(blender):
    add("cube").data.vertices[0].co.x = float("nan")
    assert "'Cube' has vertices that are not numbers" in refuse()


def test_nothing_to_light(blender):
    assert "No object can receive light" in refuse_empty()


def refuse_empty():
    with pytest.raises(SceneError) as error:
        make()
    return str(error.value)


def test_atlas_too_small(blender):
    obj = add("grid", x_subdivisions=40, y_subdivisions=40)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.edge_split()
    bpy.ops.object.mode_set(mode="OBJECT")
    message = refuse(64)
    assert "too small" in message and "raise Resolution" in message and obj.name in message


def test_linked_mesh_receives_nothing(blender, tmp_path):
    library = tmp_path / "library.blend"
    obj = add("cube")
    bpy.data.libraries.write(str(library), {obj})
    empty()
    with bpy.data.libraries.load(str(library), link=True) as (found, into):
        into.objects = found.objects
    bpy.context.scene.collection.objects.link(into.objects[0])
    add("plane")
    (warning,) = make()
    assert "'Cube' comes from a linked library" in warning
    assert "lightpanes_baked" not in into.objects[0]


def test_charts_of_a_sheared_projection_are_true():
    """A square seen at a slant, as a projection leaves it, gets its sides back."""
    positions = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 1], [0, 1, 1]], float)
    uv = np.array([[0, 0], [0.5, 0.1], [0.6, 0.4], [0.1, 0.3]])
    layout = charts.lay_flat(positions, np.arange(4), np.array([0]), np.array([[0, 1, 2], [0, 2, 3]]), uv)
    sides = np.linalg.norm(layout.points - np.roll(layout.points, -1, axis=0), axis=1)
    np.testing.assert_allclose(sides, [2, np.sqrt(2), 2, np.sqrt(2)], rtol=1e-6)
    np.testing.assert_allclose(layout.areas, 2 * np.sqrt(2), rtol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_hopeless_layouts_are_those_that_packing_refuses(seed):
    """An attempt that is given up for its blocks' sizes alone would not have been packed either."""
    rng, grid = np.random.default_rng(seed), 64
    meshes = [separate_triangles(rng, 3, rng.uniform(0.4, 1, users)) for users in (1, 2, 5, 9)]
    laid = [charts.lay_flat(m.positions, m.corners, m.faces, m.triangles, m.uv) for m in meshes]
    outcomes = set()
    for density in np.geomspace(2, 40, 25):
        sizes, fits = [], True
        for mesh, flat in zip(meshes, laid, strict=True):
            if mesh.shared:
                block = layout._block(flat, density * mesh.ratios.min(), grid)
                fits &= block is not None
                sizes += [block[1] * ratio / mesh.ratios.min() for ratio in mesh.ratios] if block else []
        if fits:
            boxes = (np.ceil(np.array(sizes) - 1e-6) - 2 * packing.MARGIN - 2 * packing.INSET) / density
            fits = packing.pack(layout._together(laid[:1], boxes), density, grid, grid) is not None
        found = layout._attempt(meshes, laid, density, grid)
        assert (found is not None) == fits
        outcomes.add(fits)
    assert outcomes == {True, False}


def separate_triangles(rng, count, ratios):
    """A mesh of triangles of about a metre, each a chart."""
    corners = np.arange(3 * count)
    cells = np.stack([np.arange(count) / count, np.zeros(count)], axis=1)
    triangle = np.array([[0, 0], [0.8 / count, 0], [0, 0.8 / count]])
    users = [f"{count}.{k}" for k in range(len(ratios))]
    faces = corners.reshape(-1, 3)
    return layout.Unwrapped(
        users,
        ratios,
        rng.random((3 * count, 3)),
        corners,
        corners[::3],
        faces,
        (cells[:, None] + triangle).reshape(-1, 2),
    )


@pytest.mark.parametrize("seed", range(3))
def test_packing_in_every_turn_keeps_charts_apart(seed):
    """Random triangles against brute force: no cell near one chart is touched by another."""
    rng = np.random.default_rng(seed)
    count, size = 60, 128
    points = rng.random((count, 3, 2)) * rng.uniform(3, 25, (count, 1, 1))
    points -= points.min(axis=1, keepdims=True)
    edges = np.arange(count * 3).reshape(count, 3)
    edges = np.stack([edges, np.roll(edges, -1, axis=1)], axis=2).reshape(-1, 2)
    owner = np.repeat(np.arange(count), 3)
    placed = packing.pack(packing.Charts(points.reshape(-1, 2), owner, edges, count, np.ones(count, bool)), 1.0, size)
    moved = placed.apply(points.reshape(-1, 2), owner).reshape(count, 3, 2)
    assert set(placed.turn) == {0, 1, 2, 3}
    cells = np.full((placed.height, size), -1)
    t = np.stack(np.meshgrid(np.linspace(0, 1, 100), np.linspace(0, 1, 100)), axis=-1).reshape(-1, 2)
    t = t[t.sum(axis=1) <= 1]
    for k, corners in enumerate(moved):
        x, y = np.floor(corners[0] + t @ (corners[1:] - corners[0])).astype(int).T
        assert np.all((cells[y, x] == -1) | (cells[y, x] == k))
        cells[y, x] = k
    for dy in range(3):
        for dx in range(-2, 3):
            a = cells[dy:, max(dx, 0) : size + min(dx, 0)]
            b = cells[: placed.height - dy, max(-dx, 0) : size + min(-dx, 0)]
            assert not np.any((a >= 0) & (b >= 0) & (a != b))
