"""Caustics against closed forms: the ball, the lens, the cylinder, the plate, and mirrored lamps of all kinds."""

from dataclasses import replace

import numpy as np
import pytest
from lightpanes.core.caustics import CausticAtlas
from lightpanes.core.lights import irradiance
from lightpanes.core.metrics import relative_rmse

from .caustic_scenes import MIRROR, ball, band, closed, floor, floor_places, glass, lens, panel, staged, within
from .shapes import GREY, lamp

RESOLUTION = 128
INDEX = 1.5


def fresnel(cosine, index=INDEX):
    """Reflectance from air into glass, and the cosine inside; float64."""
    inner = np.sqrt(1 - (1 - cosine**2) / index**2)
    across = ((cosine - index * inner) / (cosine + index * inner)) ** 2
    along = ((inner - index * cosine) / (inner + index * cosine)) ** 2
    return (across + along) / 2, inner


def rings(image, place, middle, edges):
    """W in rings around `middle`, radii `edges` (k + 1,), of an image in W/m² on `floor`."""
    radius = np.hypot(*(place - middle).transpose(2, 0, 1))
    # m² of a texel of a floor that fills all but a margin of the atlas
    texel = (2 / 0.9 / len(image)) ** 2
    return np.histogram(radius, edges, weights=image * texel)[0]


def test_a_flat_mirror_is_a_mirrored_lamp():
    # a mirror stands at x = 1 and faces back; its lamp's image is at x = 1.5
    light = lamp((0.5, 0.1, 1.2))
    mirror = panel((1, -0.8, 0.3), (0, 0, 1.2), (0, 1.6, 0))
    atlas = CausticAtlas(staged(floor(), mirror, lights=[light]), RESOLUTION)
    image = atlas.image([light])[..., 0]
    place, inside = floor_places(RESOLUTION)
    way = np.concatenate([place, np.zeros_like(place[..., :1])], -1) - (1.5, 0.1, 1.2)
    cut = (1 - 1.5) / way[..., 0]
    y, z = 0.1 + way[..., 1] * cut, 1.2 + way[..., 2] * cut
    through = (0 < cut) & (cut < 1) & (np.abs(y) < 0.8) & (0.3 < z) & (z < 1.5)
    far2 = (way**2).sum(-1)
    expected = np.where(through, 100 / (4 * np.pi * far2) * 1.2 / np.sqrt(far2), 0)
    assert relative_rmse(image, expected, within(inside) & (within(through) | within(~through))) < 0.005
    energy = atlas.energy(light)
    assert np.isclose(closed(energy), 1, atol=0.005) and energy.untraced < 1e-4


def up(kind, place=(0.2, -0.1, 1.0), **more):
    """A lamp that shines up, and its image in a mirror at z = 2, which shines down."""
    matrix = np.diag([1.0, -1, -1, 1])
    matrix[:3, 3] = place
    below = replace(lamp(place, kind=kind, **more), matrix=matrix)
    return below, lamp((place[0], place[1], 4 - place[2]), kind=kind, **more)


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        ("POINT", {"radius": 0.15}),
        ("SPOT", {"spot_angle": 0.7, "spot_blend": 0.5}),
        ("SPOT", {"spot_angle": 0.7, "spot_blend": 0.5, "radius": 0.1}),
        ("SUN", {"power": 3.0}),
        ("SUN", {"power": 3.0, "angle": 0.1}),
        ("AREA", {"size": (0.4, 0.2)}),
        ("AREA", {"size": (0.4, 0.4), "shape": "DISK", "spread": 1.2}),
        ("AREA", {"size": (0.7, 0.9), "spread": 0.0}),
    ],
)
def test_a_mirrored_lamp_of_any_kind_shines_as_it_does(kind, more):
    light, mirrored = up(kind, **more)
    mirror = panel((-3, -3, 2), (0, 6, 0), (6, 0, 0))
    if kind == "SUN":
        light = replace(light, matrix=np.diag([1.0, -1, -1, 1]))
    scene = staged(floor(), mirror, lights=[light])
    if kind == "SUN":
        # from below the floor would stand in its way: it shines on a mirror of its own size beside
        scene.objects = tuple(replace(o, casts_shadow=o.name != "Floor") for o in scene.objects)
    image = CausticAtlas(scene, 64).image([light])[..., 0]
    place, inside = floor_places(64)
    points = np.concatenate([place, np.zeros_like(place[..., :1])], -1).reshape(-1, 3)
    normals = np.tile([0.0, 0, 1], (len(points), 1))
    expected = (irradiance(mirrored, points, normals, None, 64) * mirrored.power[0]).reshape(64, 64)
    # parallel light ends within a texel
    sharp = within(expected > 0) | within(expected == 0) if more.get("spread") == 0 else inside
    assert relative_rmse(image, expected, within(inside) & sharp, block=4) < 0.02


def test_light_through_a_ball_spreads_as_snell_says():
    """Rays from a lamp straight above a ball, ring by ring: Fresnel and Snell in closed form."""
    height, middle, size = 2.4, 0.75, 0.4
    light = lamp((0, 0, height))
    scene = staged(floor(), ball((0, 0, middle), size, 128), materials=(GREY, glass(INDEX)), lights=[light])
    atlas = CausticAtlas(scene, RESOLUTION)
    away = height - middle
    theta = (np.arange(200_000) + 0.5) / 200_000 * np.arcsin(size / away)
    i = np.arcsin(away * np.sin(theta) / size)
    lost, inner = fresnel(np.cos(i))
    r = np.arccos(inner)
    # the exit's polar angle, and the last direction's angle to the axis
    polar, final = i - theta + np.pi - 2 * r, theta - 2 * (i - r)
    x, z = size * np.sin(polar), middle + size * np.cos(polar)
    landed = np.abs(x + z * np.tan(final))
    power = 100 / (4 * np.pi) * 2 * np.pi * np.sin(theta) * (1 - lost) ** 2 * (theta[1] - theta[0])
    down = np.cos(final) > 0
    edges = np.array([0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4])
    expected = np.histogram(landed[down], edges, weights=power[down])[0]
    image = atlas.image([light])[..., 0]
    # what is reflected inside lands elsewhere, but for a few percent
    place, _ = floor_places(RESOLUTION)
    found = rings(image, place, (0, 0), edges)
    assert np.isclose(found.sum(), expected.sum(), rtol=0.02)
    assert np.isclose(found[0], expected[0], rtol=0.02)
    energy = atlas.energy(light)
    assert np.isclose(closed(energy), 1, atol=0.005) and energy.untraced < 0.02 * (energy.emitted - energy.missed)


def spot_of(image, place):
    """Root mean square radius, m, of the light in an image around its middle."""
    weight = image / image.sum()
    middle = (weight[..., None] * place).sum(axis=(0, 1))
    return np.sqrt((weight * ((place - middle) ** 2).sum(axis=-1)).sum())


def test_a_thin_lens_has_its_focal_length():
    """Parallel light onto a plano-convex lens: half the aperture before the focus the spot is half as wide."""
    radius, aperture, edge = 1.2, 0.12, 0.004
    focal = radius / (INDEX - 1)
    sun = replace(lamp((0, 0, 5), power=10.0, kind="SUN"), angle=0.0)
    thickness = edge + radius - np.sqrt(radius**2 - aperture**2)
    back = focal - thickness / INDEX
    place, _ = floor_places(RESOLUTION, 0.4)
    spots, powers = [], []
    for part in (0.5, 0.75, 1.0):
        # the flat side is down, at this height
        made = staged(
            floor(0.4), lens(radius, aperture, edge, part * back), materials=(GREY, glass(INDEX)), lights=[sun]
        )
        image = CausticAtlas(made, RESOLUTION).image([sun])[..., 0]
        spots.append(spot_of(np.where(image > 0.02 * image.max(), image, 0), place))
        powers.append(image.sum() * (0.4 / 0.9 / RESOLUTION) ** 2)
    # a line through the sizes before the focus meets zero at it
    crossing = 0.75 + 0.25 * spots[1] / (spots[0] - spots[1])
    assert np.isclose(crossing * back, back, rtol=0.02)
    # at the focus all that Fresnel leaves lies within a few texels
    through = 10.0 * np.pi * aperture**2 * (1 - ((INDEX - 1) / (INDEX + 1)) ** 2) ** 2
    assert np.allclose(powers, through, rtol=0.02)
    assert spots[2] < 2.5 * 0.4 / 0.9 / RESOLUTION


def test_a_cylinder_makes_the_nephroid():
    """Parallel light in a reflecting ring: its cusp and curve are where geometrical optics has them."""
    size = 0.8
    tilt = np.radians(30)
    matrix = np.eye(4)
    # comes from −x and down
    direction = np.array([np.cos(tilt), 0, -np.sin(tilt)])
    side = np.array([0.0, 1, 0])
    matrix[:3, :3] = np.stack([side, np.cross(-direction, side), -direction], axis=1)
    sun = replace(lamp((0, 0, 0), power=1.0, kind="SUN"), matrix=matrix, angle=0.0)
    made = staged(floor(), band(size, 0.4), lights=[sun])
    image = CausticAtlas(made, 256).image([sun], 80_000)[..., 0]
    place, _ = floor_places(256)
    # rays that meet the wall at angle φ are reflected by 2φ; their envelope is the nephroid
    phi = np.radians(np.linspace(-35, 35, 29))
    curve = size * np.stack([(3 * np.cos(phi) - np.cos(3 * phi)) / 4, (3 * np.sin(phi) - np.sin(3 * phi)) / 4], 1)
    brightest = []
    for y in curve[np.abs(phi) > 0.2][:, 1]:
        row = int(np.abs(place[:, 0, 1] - y).argmin())
        line = np.where(place[row, :, 0] > 0, image[row], 0)
        brightest.append(place[row, line.argmax(), 0])
    expected = curve[np.abs(phi) > 0.2][:, 0]
    assert np.abs(np.array(brightest) - expected).max() < 0.02 * size
    # the cusp is half way to the wall; within a texel of the axis its branches part 0.03 m beyond it
    row = int(np.abs(place[:, 0, 1]).argmin())
    assert -0.01 < place[row, image[row].argmax(), 0] - size / 2 < 0.03


def test_a_parallel_plate_only_reflects_and_shifts():
    """A lamp above a slab: each ray goes on as it came, a little aside, less what four passes of Fresnel's law take."""
    height, top, thick, absorbs = 2.0, 1.2, 0.2, 1.5
    light = lamp((0, 0, height))
    clear = glass(INDEX, absorption=(absorbs,) * 3)
    slab = ("Plate", *_slab(12.0, top - thick, top), None, None, 1)
    atlas = CausticAtlas(staged(floor(), slab, materials=(GREY, clear), lights=[light]), RESOLUTION)
    image = atlas.image([light])[..., 0]
    theta = (np.arange(100_000) + 0.5) / 100_000 * 0.9
    lost, inner = fresnel(np.cos(theta))
    tangent = np.sqrt(1 - inner**2) / inner
    landed = (height - thick) * np.tan(theta) + thick * tangent
    pass_once = np.exp(-absorbs * thick / inner)
    # all even numbers of reflections inside
    through = (1 - lost) ** 2 * pass_once / (1 - (lost * pass_once) ** 2)
    power = 100 / (4 * np.pi) * 2 * np.pi * np.sin(theta) * through * (theta[1] - theta[0])
    edges = np.linspace(0, 0.9, 10)
    expected = np.histogram(landed, edges, weights=power)[0]
    place, _ = floor_places(RESOLUTION)
    assert np.allclose(rings(image, place, (0, 0), edges)[2:], expected[2:], rtol=0.02)
    assert np.isclose(rings(image, place, (0, 0), edges).sum(), expected.sum(), rtol=0.01)


def _slab(side, low, high):
    from .shapes import box

    return box((-side / 2, -side / 2, low), (side / 2, side / 2, high))[:2]


def test_a_ball_of_the_same_glass_inside_changes_nothing():
    light = lamp((0.3, 0.1, 2.2))
    alone = staged(floor(), ball((0, 0, 0.7), 0.4), materials=(GREY, glass()), lights=[light])
    nested = staged(
        floor(), ball((0, 0, 0.7), 0.4), ball((0.05, 0, 0.72), 0.2, 48, name="Inner"), materials=(GREY, glass()), lights=[light]
    )  # fmt: skip
    images = [CausticAtlas(scene, 64).image([light])[..., 0] for scene in (alone, nested)]
    _, inside = floor_places(64)
    assert relative_rmse(images[1], images[0], within(inside), block=4) < 0.02


def test_metal_follows_schlick():
    """A tinted mirror at 60°: each channel has its own reflectance."""
    tinted = replace(MIRROR, optics=replace(MIRROR.optics, mirror=(0.9, 0.5, 0.1), mirror_edge=(1.0, 1.0, 1.0)))
    light = lamp((0.5, 0.1, 1.2))
    mirror = panel((1, -0.8, 0.3), (0, 0, 1.2), (0, 1.6, 0))
    scenes = [staged(floor(), mirror, materials=(GREY, m), lights=[light]) for m in (MIRROR, tinted)]
    plain, coloured = (CausticAtlas(scene, 64).image([light]) for scene in scenes)
    place, inside = floor_places(64)
    way = np.concatenate([place, np.zeros_like(place[..., :1])], -1) - (1.5, 0.1, 1.2)
    cosine = np.abs(way[..., 0]) / np.linalg.norm(way, axis=-1)
    lit = within(inside) & within(plain[..., 0] > 0)
    for channel, facing in enumerate((0.9, 0.5, 0.1)):
        expected = plain[..., channel] * (facing + (1 - facing) * (1 - cosine) ** 5)
        assert relative_rmse(coloured[..., channel], expected, lit) < 0.01
