"""Where panes are known to fail: bounded there, each with its bound.

The truth is the uncompressed solve of the same entries (see `Uncompressed`) or a closed form.
"""

from functools import cache

import numpy as np
import pytest
from lightpanes.core.bake import bake
from lightpanes.core.bake.steps import prepare
from lightpanes.core.panes import Relighter
from lightpanes.core.rays import Tracer
from lightpanes.core.scene import Material, Scene

from .shapes import box, globe, grid, lamp, moved, quad, quick, relighter, room_parts, scene
from .uncompressed import WHITISH, Uncompressed, red, relative, walled


@pytest.mark.parametrize("height", [0.01, 0.02, 0.04, 0.1])
def test_a_lamp_centimetres_from_a_surface(height):
    made, baked, truth = walled()
    lights = [lamp((3.3, 1.2, height)), lamp((2.6 - height, 1.3, 0.9)), lamp((1.7, 2.95, 1 + height))]
    found, expected = red(relighter(made, baked), lights), truth.texels(lights)
    assert np.isfinite(found).all()
    # the power that comes back is right, though the pool of light below the lamp is smaller than an entry
    assert np.allclose(found.mean(axis=1), expected.mean(axis=1), rtol=0.1)
    assert (relative(found, expected) < 0.6).all()
    assert found.min() > -0.15 * expected.mean()


def test_light_does_not_flicker_as_a_lamp_crosses_an_edge():
    # past the free wall's edge, 1 cm a frame
    made, baked, truth = walled()
    lights = [lamp((2.2, y, 1.0)) for y in np.linspace(2.25, 2.55, 31)]
    found, expected = red(relighter(made, baked), lights), truth.texels(lights)
    level = expected.mean()

    def jumps(frames):
        return np.sqrt((np.diff(frames, axis=0) ** 2).mean(axis=1)) / level

    # entries flip from shadow to light one by one, in the truth as well: panes may add little to that
    assert np.median(jumps(found)) < 1.5 * np.median(jumps(expected)) + 1e-3
    assert jumps(found).max() < 1.5 * jumps(expected).max() + 2e-3
    assert np.abs(np.diff(found.mean(axis=1))).max() < 0.03 * level


@pytest.mark.parametrize("meshes", [1, 2])
@pytest.mark.parametrize("thick", [0.0, 0.01, 0.1])
def test_no_light_through_a_thin_wall(meshes, thick):
    left = box((0, 0, 0), (2, 3, 2.5), True)
    right = box((2 + thick, 0, 0), (4 + thick, 3, 2.5), True)
    lights = [lamp((1, 1.5, 1.2)), lamp((1.98, 1.5, 1.2)), lamp((1.5, 0.1, 0.1))]
    if meshes == 2:
        parts = (*left, 0), (*right, 0)
    else:
        # two charts of one atlas, half each
        joined = np.concatenate([left[2] * [0.5, 1], right[2] * [0.5, 1] + [0.5, 0]])
        parts = ((np.r_[left[0], right[0]], np.r_[left[1], right[1] + 8], joined, 0),)
    made = scene(*parts, materials=(WHITISH,), lights=[lamp((1, 1.5, 1.2)), lamp((3 + thick, 1.5, 1.2))])
    settings = quick(entries=600)
    baked = bake(made, settings)
    exits = prepare(made, settings).exits.samples
    # the walls of thickness 0 coincide: their normals tell them apart
    there = exits.position[:, 0] + 1e-3 * exits.normal[:, 0] > 2 + thick / 2
    for light in lights:
        found = relighter(made, baked).texels([light])[:, 0]
        assert found[~there].mean() > 1
        assert np.abs(found[there]).max() < 0.005 * found[~there].mean()


def test_a_lamp_inside_a_closed_box_stays_there():
    inner = box((1, 1, 0.8), (1.6, 1.6, 1.4))
    made = scene((*box((0, 0, 0), (4, 3, 2.5), True), 0), (*inner, 0), materials=(WHITISH,), lights=[lamp((3, 1.5, 2))])
    baked = bake(made, quick())
    runtime = relighter(made, baked)
    outside = runtime.texels([lamp((3, 1.5, 2))]).mean()
    for place in [(1.3, 1.3, 1.1), (1.05, 1.3, 1.35), (1.001, 1.001, 0.801)]:
        assert np.abs(runtime.texels([lamp(place)])).max() < 0.005 * outside


def test_a_lamp_outside_the_room_does_not_shine_in():
    made = scene((*box((0, 0, 0), (4, 3, 2.5), True), 0), materials=(WHITISH,), lights=[lamp((3, 1.5, 2))])
    runtime = relighter(made, bake(made, quick()))
    inside = runtime.texels([lamp((3, 1.5, 2))]).mean()
    for place in [(4.01, 1.5, 1), (5, 5, 5), (2, 1.5, -0.001)]:
        assert np.abs(runtime.texels([lamp(place)])).max() < 0.005 * inside


@pytest.mark.parametrize("lit", [True, False])
def test_sheets_are_lit_from_both_sides(lit):
    # a sheet across the middle of a room: each half sees its own side; whether or not the bake knew a lamp there
    sheet = (*quad((0.2, 0.2, 1.25), (3.6, 0, 0), (0, 2.6, 0)), 1)
    made = scene(
        (*box((0, 0, 0), (4, 3, 2.5), True), 0),
        sheet,
        materials=(WHITISH, Material("Red sheet", (0.8, 0.0, 0.0))),
        lights=[lamp((2, 1.5, 2))] if lit else [],
    )
    settings = quick(entries=700)
    baked, exits = bake(made, settings), prepare(made, settings).exits
    runtime = relighter(made, baked)
    walls = made.triangle_object[exits.samples.triangle] == 0
    low, high = exits.samples.position[:, 2] < 0.02, exits.samples.position[:, 2] > 2.48
    above, below = runtime.texels([lamp((2, 1.5, 1.8))]), runtime.texels([lamp((2, 1.5, 0.7))])
    # the lamp's own half is the brighter, and reddened by the sheet
    for found, near, far in ((above, high & walls, low & walls), (below, low & walls, high & walls)):
        assert found[near, 0].mean() > 3 * found[far, 0].mean() > 0
        assert found[near, 0].mean() > 1.5 * found[near, 1].mean()
    # symmetrical, so the two are each other's mirror image
    assert above[high & walls].mean() == pytest.approx(below[low & walls].mean(), rel=0.05)


def test_coincident_surfaces_neither_leak_nor_blow_up():
    # the floor three times over, once upside down, and a block whose bottom lies in it
    floor = (*quad((0, 0, 0), (4, 0, 0), (0, 3, 0)), 0)
    flipped = (*quad((0, 0, 0), (0, 3, 0), (4, 0, 0)), 0)
    plain = scene(*room_parts(), materials=(WHITISH, WHITISH), lights=[lamp((3, 1.5, 2))])
    doubled = scene(*room_parts(), floor, floor, flipped, materials=(WHITISH, WHITISH), lights=[lamp((3, 1.5, 2))])
    images = []
    for made in (plain, doubled):
        texels = relighter(made, bake(made, quick(entries=600, resolution=64))).texels(made.lights)
        exits = prepare(made, quick(entries=600, resolution=64)).exits.samples
        roof = exits.position[:, 2] > 2.49
        assert np.isfinite(texels).all()
        images.append((texels[roof].mean(), texels.max()))
    # far pairs weigh each copy in full: up to a sixth is lost
    assert images[1][0] == pytest.approx(images[0][0], rel=0.18)
    assert images[1][1] < 1.5 * images[0][1]


@pytest.mark.parametrize("albedo", [0.0, 0.98, 1.0])
def test_no_albedo_makes_too_much_light(albedo):
    made = scene((*box((0, 0, 0), (2, 2, 2), True), 0), materials=(Material("Coat", (albedo,) * 3),))
    found = relighter(made, bake(made, quick(entries=400))).texels([lamp((1, 1, 1))])
    # energy: what arrives by bounces is Φ ρ / (1 − ρ) over the area, ρ at most 0.98
    shade = min(albedo, 0.98)
    assert found.mean() == pytest.approx(100 / 24 * shade / (1 - shade), rel=0.03, abs=1e-6)
    assert found.max() <= 1.3 * found.mean() + 1e-6


def test_shadow_edges_across_entries():
    # a lamp low behind a wall casts an edge over the floor that cuts entries in two: their mean must be right
    made, baked, truth = walled()
    lights = [lamp((2.3, 1.5, z)) for z in (1.62, 1.7, 1.9)]
    found, expected = red(relighter(made, baked), lights), truth.texels(lights)
    assert (relative(found, expected) < 0.15).all()
    assert np.allclose(found.mean(axis=1), expected.mean(axis=1), rtol=0.03)
    # and against entries a quarter the size
    finer = Uncompressed(made, quick(entries=3600))
    assert np.allclose(found.mean(axis=1), finer.texels(lights).mean(axis=1), rtol=0.04)


def test_corners_have_no_spikes():
    # virtual lights would make them: 1/r² at every corner
    made, baked, truth = walled()
    for light in [lamp((2, 1.5, 2)), lamp((0.3, 0.3, 0.3))]:
        found = red(relighter(made, baked), [light])[0]
        expected = truth.texels([light])[0]
        assert found.max() < 1.3 * expected.max()
        assert found.min() > -0.05 * expected.mean()
        brightest = np.quantile(found, 0.999) / np.median(found)
        assert brightest < 1.2 * np.quantile(expected, 0.999) / np.median(expected)


# ---- sizes, places, mirrors ----


def reference() -> Scene:
    """Fresh each time, since scenes are moved about."""
    return scene(*room_parts(), materials=(WHITISH, WHITISH), lights=[lamp((3, 1.5, 2))])


@cache
def reference_light() -> tuple[np.ndarray, np.ndarray]:
    """Irradiance and position of the reference room's texels."""
    made = reference()
    return relighter(made, bake(made, quick())).texels(made.lights), prepare(made, quick()).exits.samples.position


def compare(made: Scene, factor: float, mean: float, each: float) -> None:
    """Means of ceiling, floor and block, and the whole, against the reference times `factor`."""
    found = relighter(made, bake(made, quick())).texels(made.lights) / factor
    expected, _ = reference_light()
    assert np.isfinite(found).all()
    assert found.mean() == pytest.approx(expected.mean(), rel=mean)
    order = [0.05, 0.25, 0.5, 0.75, 0.95]
    assert np.allclose(np.quantile(found, order), np.quantile(expected, order), rtol=each)


@pytest.mark.parametrize("size", [1e-3 / 4, 1e-2, 1e2, 1e4 / 4])
def test_a_scene_of_any_size_has_the_same_light(size):
    # 1 mm to 10 km across; a lamp of the same power, so light falls with the square
    compare(moved(reference(), size * np.eye(3)), 1 / size**2, 0.01, 0.05)


@pytest.mark.parametrize("away", [(1e3, 0, 0), (1e4, -1e4, 0)])
def test_a_scene_far_from_the_origin_has_the_same_light(away):
    compare(moved(reference(), shift=away), 1, 0.02, 0.06)


def test_a_turned_scene_has_the_same_light():
    a, b = 0.7, 1.1
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]) @ np.array(
        [[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]
    )
    compare(moved(reference(), turn), 1, 0.02, 0.06)


def test_a_mirrored_scene_has_the_same_light():
    # extraction turns the winding of mirrored objects; here it is done by hand
    mirror = np.diag([-1.0, 1, 1])
    made = moved(reference(), mirror)
    made.triangles = made.triangles[:, ::-1].copy()
    made.atlas_uv = made.atlas_uv[:, ::-1].copy()
    made.corner_normals = -made.corner_normals
    compare(made, 1, 0.02, 0.06)


def test_a_mirrored_object_that_kept_its_winding_does_not_darken_the_room():
    # its faces look inwards: its outside is its back, which light reaches
    parts = list(room_parts())
    points, triangles, uv, material = parts[1]
    parts[1] = (points, triangles[:, ::-1], uv[:, ::-1], material)
    made = scene(*parts, materials=(WHITISH, WHITISH), lights=[lamp((3, 1.5, 2))])
    found = relighter(made, bake(made, quick())).texels(made.lights)
    exits = prepare(made, quick()).exits.samples
    expected, place = reference_light()
    roof, expected_roof = exits.position[:, 2] > 2.49, place[:, 2] > 2.49
    assert found[roof].mean() == pytest.approx(expected[expected_roof].mean(), rel=0.03)


def test_many_small_triangles_beside_few_large_ones():
    # a floor of 20,000 triangles weighs as one of two
    points, triangles, uv = box((0, 0, 0), (4, 3, 2.5), True)
    low = (points[triangles][:, :, 2] < 1e-6).all(axis=1)
    walls = (points, triangles[~low], uv[~low], 0)
    fine, coarse = ((*grid((0, 0, 0), (4, 0, 0), (0, 3, 0), cells), 0) for cells in (100, 1))
    light = []
    for floor in (fine, coarse):
        made = scene(walls, floor, materials=(WHITISH,), lights=[lamp((3, 1.5, 2))])
        light.append(relighter(made, bake(made, quick())).texels(made.lights).mean())
    assert light[0] == pytest.approx(light[1], rel=0.02)


def test_a_sphere_in_the_dark_half_gets_only_what_bounces():
    # nothing but the ball: no bounce can reach it
    made = scene((*globe(rings=16, inward=False), 0), lights=[lamp((3, 0, 0))])
    found = relighter(made, bake(made, quick(entries=200))).texels(made.lights)
    assert np.abs(found).max() < 1e-4


def walked(size, place, tint, albedo, count=100_000, bounces=40) -> np.ndarray:
    """(3,) mean indirect irradiance of the last quarter of a room `size` m under a lamp of 1 W at `place` in the first, by
    random walks: a pane across its middle tints the lamp's light and passes bounces by the mean of `tint`."""
    rng, row = np.random.default_rng(1), np.arange(count)
    sides = np.array([(axis, side) for axis in range(3) for side in (0, 1)][1:])
    area = np.array([size.prod() / size[axis] / (1 if axis == 0 else 4) for axis, _ in sides])
    axis, side = sides[rng.choice(len(sides), count, p=area / area.sum())].T
    here = rng.random((count, 3)) * size
    here[:, 0] = size[0] * (1 - rng.random(count) / 4)
    here[row, axis] = side * size[axis]
    normal = np.zeros((count, 3))
    normal[row, axis] = 1 - 2 * side
    kept, total = np.ones(count), np.zeros(3)
    for _ in range(bounces):
        # a unit vector added to the normal is cosine-distributed
        around = rng.normal(size=(count, 3))
        ahead = normal + around / np.linalg.norm(around, axis=1, keepdims=True)
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.where(ahead > 0, (size - here) / ahead, -here / ahead)
        axis = reach.argmin(axis=1)
        there = here + ahead * reach[row, axis][:, None]
        there[row, axis] = np.where(ahead[row, axis] > 0, size[axis], 0)
        normal = np.zeros((count, 3))
        normal[row, axis] = -np.sign(ahead[row, axis])
        middle = size[0] / 2
        kept *= albedo * np.where((here[:, 0] < middle) == (there[:, 0] < middle), 1, np.mean(tint))
        here = there
        away = place - here
        distance2 = (away**2).sum(axis=1)
        light = kept * np.maximum((away * normal).sum(axis=1), 0) / (4 * np.pi * distance2**1.5)
        behind = here[:, 0] > middle
        total += np.outer(light, [1, 1, 1])[~behind].sum(axis=0) + np.outer(light, tint)[behind].sum(axis=0)
    return total / count


def test_tinted_glass_between_lamp_and_room():
    # a pane of red glass halves the room: what bounces behind it is red
    glass = (*quad((2, 0, 0), (0, 3, 0), (0, 0, 2.5)), 1)
    tint = (0.9, 0.1, 0.1)
    made = scene(
        (*box((0, 0, 0), (4, 3, 2.5), True), 0),
        glass,
        materials=(WHITISH, Material("Red glass", (0, 0, 0), transmission=tint)),
        lights=[lamp((0.5, 1.5, 1.2))],
    )
    settings = quick(entries=600)
    exits = prepare(made, settings).exits.samples
    found = Relighter(bake(made, settings).panes(), Tracer(made)).texels(made.lights)
    far = exits.position[:, 0] > 3
    near = exits.position[:, 0] < 1
    expected = walked(np.array([4, 3, 2.5]), (0.5, 1.5, 1.2), tint, 0.8) * made.lights[0].power
    # bounces pass a pane by its mean colour, so the light behind it is less red than the glass
    assert expected[0] > 1.4 * expected[1]
    assert found[far].mean(axis=0) == pytest.approx(expected, rel=0.06)
    assert found[near].mean() > found[far].mean() > 0
