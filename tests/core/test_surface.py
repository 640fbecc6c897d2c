"""Patches and texels: areas conserved, rasterising against a point-in-triangle test of all pairs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lightpanes.core.scene import Material, Scene, SceneError, SceneObject
from lightpanes.core.surface import make_patches, make_texels, sample_triangles
from lightpanes.core.surface.components import components
from lightpanes.core.surface.patches import bisect
from lightpanes.core.surface.samples import surface_colour
from lightpanes.core.surface.texels import GUTTER

from .shapes import globe, quad, room, scene

place = st.floats(-10, 10, width=32)
triangle_corners = st.lists(place, min_size=9, max_size=9).map(lambda v: np.array(v, np.float32).reshape(1, 3, 3))


def areas(corners):
    wide = corners.astype(np.float64)
    return 0.5 * np.linalg.norm(np.cross(wide[:, 1] - wide[:, 0], wide[:, 2] - wide[:, 0]), axis=1)


def barycentric(points, triangles):
    """(n, t, 3) barycentric coordinates of 2D points (n, 2) in triangles (t, 3, 2), float64."""
    a, b, c = np.moveaxis(triangles.astype(np.float64), 1, 0)
    d = points[:, None].astype(np.float64) - a
    ab, ac = b - a, c - a
    det = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (d[..., 0] * ac[:, 1] - d[..., 1] * ac[:, 0]) / det
        v = (ab[:, 0] * d[..., 1] - ab[:, 1] * d[..., 0]) / det
    return np.stack([1 - u - v, u, v], -1)


@given(triangle_corners, st.floats(0.3, 5))
@settings(max_examples=60, deadline=None)
def test_bisection_conserves_area_and_weights(corners, longest):
    pieces, parent, weights = bisect(corners, longest)
    whole = areas(corners).sum()
    assert areas(pieces).sum() == pytest.approx(whole, rel=1e-4, abs=1e-4)
    assert (np.linalg.norm(pieces - np.roll(pieces, -1, axis=1), axis=2) <= longest * (1 + 1e-6)).all()
    assert (parent == 0).all()
    assert np.allclose(np.einsum("pkc,cd->pkd", weights, corners[0]), pieces, atol=1e-4)
    assert np.allclose(weights.sum(axis=2), 1)
    # the winding, and with it the side, is kept
    normal = np.cross(corners[0, 1] - corners[0, 0], corners[0, 2] - corners[0, 0])
    if whole > 0.1:
        assert (np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]) @ normal > 0).all()


def test_bisection_covers_the_triangle_once():
    corners = np.array([[[0, 0, 0], [3, 0.2, 0], [0.7, 1.4, 0]]], np.float32)
    pieces, *_ = bisect(corners, 0.3)
    inside = np.random.default_rng(0).dirichlet((1, 1, 1), 2000) @ corners[0].astype(np.float64)
    assert ((barycentric(inside[:, :2], pieces[:, :, :2]) > 0).all(axis=2).sum(axis=1) == 1).mean() > 0.999


def test_bisection_stops_at_its_limit():
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]] * 3, np.float32)
    pieces, parent, _ = bisect(corners, 1e-4, limit=1000)
    assert 300 < len(pieces) <= 1000
    assert areas(pieces).sum() == pytest.approx(1.5)
    assert set(parent) == {0, 1, 2}


@pytest.mark.parametrize("edges", [0, 30, 60, 200])
def test_components(edges):
    """Against a walk from node to node."""
    rng = np.random.default_rng(edges)
    here, there = rng.integers(0, 100, (2, edges))
    found, parts = np.full(100, -1), 0
    for start in range(100):
        pending = [start] if found[start] < 0 else []
        parts += len(pending)
        while pending:
            node = pending.pop()
            if found[node] < 0:
                found[node] = parts - 1
                pending += [*there[here == node], *here[there == node]]
    assert np.array_equal(components(100, here, there), found)


@pytest.mark.parametrize("count", [100, 800])
def test_patches_add_up_to_the_surface(count):
    made = room()
    patches = make_patches(made, count)
    # each patch has two sides, of which the planner counts one
    assert 0.6 * count < len(patches) < 1.6 * count
    assert patches.area.sum() == pytest.approx(areas(made.positions[made.triangles]).sum(), rel=1e-5)
    assert np.allclose(np.bincount(patches.patch, patches.piece_area), patches.area, rtol=1e-4)
    # of one material, object and face
    for what in (made.triangle_material, made.triangle_object):
        owner = what[patches.parent]
        first = np.full(len(patches), -1)
        first[patches.patch] = owner
        assert (first[patches.patch] == owner).all()
    assert np.allclose(np.abs(patches.normal).max(axis=1), 1, atol=1e-5)
    assert np.allclose(
        patches.albedo,
        np.array([m.albedo for m in made.materials])[made.triangle_material[patches.parent]][
            np.unique(patches.patch, return_index=True)[1]
        ],
    )


def test_places_on_patches_are_uniform_and_their_own():
    made = scene((*globe(rings=24), 0))
    patches = make_patches(made, 60)
    chosen = np.repeat(np.arange(len(patches)), 400)
    samples = patches.sample(made, chosen, 3)
    owners = {(int(p), int(t)) for p, t in zip(patches.patch, patches.parent, strict=True)}
    assert all((int(p), int(t)) in owners for p, t in zip(chosen[::37], samples.triangle[::37], strict=True))
    mean = samples.position.reshape(len(patches), 400, 3).mean(axis=1)
    size = np.sqrt(patches.area)[:, None]
    assert np.abs((mean - patches.position) / size).max() < 0.15
    # rows are independent of one another
    assert np.array_equal(patches.sample(made, chosen[:50], 3).position, samples.position[:50])


def test_a_textured_patch_has_the_texture_s_mean():
    random = np.random.default_rng(0)
    image = np.kron(random.uniform(0, 1, (8, 8, 3)), np.ones((32, 32, 1))).astype(np.float32)
    points, triangles, uv = quad((0, 0, 0), (1, 0, 0), (0, 1, 0))
    made = Scene(points, triangles, atlas_uv=uv, materials=(Material("Paint", mapped=True),), albedo_map=image)
    patches = make_patches(made, 600)
    mean = (patches.albedo * patches.area[:, None]).sum(axis=0) / patches.area.sum()
    inside = image[13:-13, 13:-13].mean(axis=(0, 1))
    assert np.allclose(mean, inside, atol=0.01)


def test_colours_come_from_the_map_only_where_there_is_one():
    points, triangles, uv = quad((0, 0, 0), (1, 0, 0), (0, 1, 0))
    image = np.zeros((4, 4, 3), np.float32)
    image[:, 2:] = (0.9, 0.1, 0.5)
    off = np.full_like(uv, np.nan)
    made = Scene(
        np.r_[points, points, points],
        np.r_[triangles, triangles + 4, triangles + 8],
        atlas_uv=np.r_[uv, uv, off],
        triangle_material=[0, 0, 1, 1, 0, 0],
        materials=(Material("Map", (0.2, 0.2, 0.2), mapped=True), Material("Plain", (0.3, 0.4, 0.5))),
        albedo_map=image,
    )
    right = np.tile([0.1, 0.8, 0.1], (3, 1))
    found = surface_colour(made, "albedo", np.array([0, 2, 4]), right)
    assert np.allclose(found, [[0.9, 0.1, 0.5], [0.3, 0.4, 0.5], [0.2, 0.2, 0.2]])


def test_the_flat_normal_is_on_the_shading_normal_s_side():
    points, triangles, _ = quad((0, 0, 0), (1, 0, 0), (0, 1, 0))
    tilted = np.tile(np.array([0.6, 0, -0.8]), (2, 3, 1))
    # of the second triangle the corner normals cancel
    tilted[1, 1] = -tilted[1, 0]
    tilted[1, 2] = 0
    made = Scene(points, triangles, corner_normals=tilted)
    third = np.full((2, 3), 1 / 3)
    samples = sample_triangles(made, np.array([0, 1]), third)
    assert np.allclose(samples.flat, [[0, 0, -1], [0, 0, 1]], atol=1e-6)
    assert np.allclose(samples.normal[0], [0.6, 0, -0.8], atol=1e-6)
    assert np.isfinite(samples.normal).all()
    assert np.allclose(samples.flipped(np.array([True, False])).flat, [[0, 0, 1], [0, 0, 1]], atol=1e-6)


# ---- texels ----


def random_charts(count=12, seed=0):
    """Triangles apart from one another, each in its own cell of the atlas, standing anywhere in space."""
    random = np.random.default_rng(seed)
    cell = np.stack(np.divmod(np.arange(count), 4), 1)[:, None]
    uv = (cell + random.uniform(0.08, 0.92, (count, 3, 2))) / 4
    points = random.normal(size=(count, 3, 3))
    return Scene(points.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), atlas_uv=uv)


@pytest.mark.parametrize("seed", range(3))
def test_texels_lie_where_a_point_in_triangle_test_says(seed):
    made, size = random_charts(seed=seed), 96
    texels = make_texels(made, size)
    row, column = np.divmod(np.arange(size * size), size)
    centre = (np.stack([column, row], 1) + 0.5) / size
    weights = barycentric(centre, made.atlas_uv)
    margin = weights.min(axis=2)
    on = margin.max(axis=1)
    found = np.zeros(size * size, bool)
    found[texels.index[texels.centred]] = True
    # float32 may decide otherwise on an edge
    clear = np.abs(on) > 1e-3
    assert np.array_equal(found[clear], (on > 0)[clear])
    rows = np.flatnonzero(texels.centred & (on[texels.index] > 1e-2))
    index = texels.index[rows]
    owner = margin[index].argmax(axis=1)
    assert np.array_equal(texels.samples.triangle[rows], owner)
    inside = weights[index, owner]
    expected = np.einsum("nk,nkd->nd", inside, made.positions[made.triangles[owner]])
    assert np.abs(texels.samples.position[rows] - expected).max() < 0.01


def test_bilinear_filtering_anywhere_on_a_chart_reads_texels_that_know_their_place():
    made, size = random_charts(seed=5), 64
    texels = make_texels(made, size)
    fill = texels.fill().reshape(size, size)
    random = np.random.default_rng(0)
    weights = random.dirichlet((0.5, 0.5, 0.5), (len(made.triangles), 500))
    uv = np.einsum("tnk,tkd->tnd", weights, made.atlas_uv) * size - 0.5
    for dy in (0, 1):
        for dx in (0, 1):
            x, y = np.floor(uv[..., 0]).astype(int) + dx, np.floor(uv[..., 1]).astype(int) + dy
            shown = fill[np.clip(y, 0, size - 1), np.clip(x, 0, size - 1)]
            assert (shown >= 0).all()
            # of the chart itself, not of a neighbour
            owner = texels.samples.triangle[shown]
            assert (owner == np.arange(len(owner))[:, None]).mean() > 0.995


def test_filled_texels_show_the_nearest_within_the_gutter():
    points, triangles, uv = quad((0, 0, 0), (1, 0, 0), (0, 1, 0))
    made = Scene(points, triangles, atlas_uv=uv * 0.25 + 0.375)
    size = 128
    texels = make_texels(made, size)
    fill = texels.fill().reshape(size, size)
    row, column = np.divmod(texels.index, size)
    y, x = np.mgrid[:size, :size]
    apart = np.maximum(np.maximum(row.min() - y, y - row.max()), np.maximum(column.min() - x, x - column.max()))
    assert np.array_equal(fill >= 0, apart <= GUTTER)
    shown = fill >= 0
    away = np.maximum(np.abs(row[fill] - y), np.abs(column[fill] - x))
    # Chebyshev distance: nearest there, within a texel of nearest elsewhere
    assert (away[shown] <= np.maximum(apart[shown], 0)).all()
    assert np.array_equal(fill.reshape(-1)[texels.index], np.arange(len(texels)))


def test_a_chart_thinner_than_a_texel_is_not_lost():
    points, triangles, uv = quad((0, 0, 0), (1, 0, 0), (0, 1, 0))
    thin = uv * [0.8, 0.002] + [0.1, 0.503]
    made = scene((points, triangles, uv, 0), (points + 5, triangles, thin, 0))
    texels = make_texels(made, 64)
    assert (np.bincount(made.triangle_object[texels.samples.triangle], minlength=2) > 5).all()


def test_objects_that_receive_nothing_have_no_texels():
    points, triangles, uv = quad((0, 0, 0), (1, 0, 0), (0, 1, 0))
    made = scene((points, triangles, uv, 0), (points + 5, triangles, uv, 0))
    made.objects = (made.objects[0], SceneObject("Excluded", receives=False))
    texels = make_texels(made, 64)
    assert set(made.triangle_object[texels.samples.triangle]) == {0}
    made.objects = (SceneObject("Excluded", receives=False),) * 2
    with pytest.raises(SceneError, match="No object has a place in the atlas"):
        make_texels(made, 64)


def test_no_atlas_at_all():
    points, triangles, _ = quad((0, 0, 0), (1, 0, 0), (0, 1, 0))
    with pytest.raises(SceneError, match="No object has a place in the atlas"):
        make_texels(Scene(points, triangles), 64)


def test_texels_of_overlapping_or_flipped_charts_are_one_each():
    points, triangles, uv = quad((0, 0, 0), (1, 0, 0), (0, 1, 0))
    mirrored = uv * [-1, 1] + [1, 0]
    made = Scene(np.r_[points, points + 5], np.r_[triangles, triangles + 4], atlas_uv=np.r_[uv, mirrored])
    texels = make_texels(made, 32)
    assert len(np.unique(texels.index)) == len(texels)
    assert np.isfinite(texels.samples.position).all()
    kept = texels.keep(np.arange(0, len(texels), 2))
    assert np.array_equal(kept.index, texels.index[::2])
