"""Lamps against brute-force integrals in double precision, closed forms, and each other."""

import numpy as np
import pytest
from lightpanes.core.lights import irradiance, sky_radiance
from lightpanes.core.scene import Light, SceneError, Sky

PLACE = np.array([0.3, 0.2, 1.5])


def turn(x, y, z):
    """Rotation matrix from three angles, any order will do."""
    cx, sx, cy, sy, cz, sz = np.cos(x), np.sin(x), np.cos(y), np.sin(y), np.cos(z), np.sin(z)
    return (
        np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    )


def lamp(kind, rotation=(0.2, -0.3, 0.5), **settings):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn(*rotation), PLACE
    return Light(kind, kind, matrix, 1.0, **settings)


def receivers(count=300, seed=0, away=0.25):
    """Points around the lamps, none too near for the brute-force grid, with normals of all directions."""
    random = np.random.default_rng(seed)
    points = random.uniform(-2, 2, (count * 3, 3))
    points = points[np.linalg.norm(points - PLACE, axis=1) > away][:count]
    normals = random.normal(size=(len(points), 3))
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def smoothstep(x):
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)


def brute_force(light, points, normals, detail=200):
    """Irradiance by midpoints over the lamp, float64, with Cycles' definition of each lamp's radiance."""
    cell = (np.arange(detail) + 0.5) / detail
    u, v = (g.ravel() for g in np.meshgrid(cell, cell))
    axes = light.matrix[:3, :3]
    out = []
    for point, normal in zip(points, normals, strict=True):
        if light.kind == "AREA":
            a, b = (u - 0.5) * light.size[0], (v - 0.5) * light.size[1]
            area = light.size[0] * light.size[1]
            if light.shape in ("DISK", "ELLIPSE"):
                keep = (2 * u - 1) ** 2 + (2 * v - 1) ** 2 <= 1
                a, b, area = a[keep], b[keep], area * np.pi / 4
            # in the lamp's own coordinates
            (x, y, z), (nx, ny, nz) = (point - light.position) @ axes, normal @ axes
            d2 = (a - x) ** 2 + (b - y) ** 2 + z**2
            away = np.maximum(-z, 0) / np.sqrt(d2)
            radiance = 1 / (np.pi * area)
            if light.spread < np.pi:
                half, tangent = light.spread / 2, np.sqrt(np.maximum(1 / np.maximum(away, 1e-9) ** 2 - 1, 0))
                radiance = radiance * np.maximum(np.tan(half) - tangent, 0) / (np.tan(half) - half)
            value = radiance * np.maximum((a - x) * nx + (b - y) * ny - z * nz, 0) / np.sqrt(d2) * away / d2
            out.append(value.mean() * area)
            continue
        if light.kind == "SUN":
            middle, sine2, radiance = -light.direction, np.sin(light.angle / 2) ** 2, None
            radiance = 1 / (np.pi * sine2)
        else:
            middle = light.position - point
            d2 = middle @ middle
            middle = middle / np.sqrt(d2)
            sine2 = light.radius**2 / (d2 + (light.radius**2 if light.shape == "DISK" else 0))
            radiance = 1 / (4 * np.pi**2 * light.radius**2)
            if sine2 >= 1:
                out.append(np.pi * radiance)
                continue
        side = np.cross(middle, [0.6, 0.8, 0.0])
        side /= np.linalg.norm(side)
        cap = 1 - np.sqrt(1 - sine2)
        z, angle = 1 - u * cap, 2 * np.pi * v
        sine = np.sqrt(1 - z * z)
        direction = np.stack([z, sine * np.cos(angle), sine * np.sin(angle)])
        frame = np.stack([middle, side, np.cross(middle, side)])
        value = radiance * np.maximum(frame @ normal @ direction, 0) * 2 * np.pi * cap
        if light.kind == "SPOT":
            local = (frame @ axes / [*light.size, 1.0]).T @ direction
            local /= np.linalg.norm(local, axis=0)
            edge = np.cos(light.spot_angle / 2)
            value = value * smoothstep((local[2] - edge) / ((1 - edge) * light.spot_blend))
        out.append(value.mean())
    return np.array(out)


LAMPS = {
    "point, sphere": lamp("POINT", radius=0.3),
    "point, soft falloff": lamp("POINT", radius=0.3, shape="DISK"),
    "sun": lamp("SUN", angle=0.8),
    "sun, half the sky": lamp("SUN", angle=3.1),
    "square": lamp("AREA", size=(0.7, 0.7)),
    "rectangle": lamp("AREA", shape="RECTANGLE", size=(1.0, 0.4)),
    "disk": lamp("AREA", shape="DISK", size=(0.7, 0.7)),
    "ellipse": lamp("AREA", shape="ELLIPSE", size=(1.0, 0.4)),
    "soft box": lamp("AREA", shape="RECTANGLE", size=(1.0, 0.4), spread=1.7),
    "soft box, narrow": lamp("AREA", shape="RECTANGLE", size=(1.5, 1.1), spread=0.5),
    "soft box, ellipse": lamp("AREA", shape="ELLIPSE", size=(1.5, 1.1), spread=1.2),
}


@pytest.mark.parametrize("name", LAMPS)
def test_free_lamps_equal_their_integral_without_noise(name):
    light = LAMPS[name]
    points, normals = receivers(120)
    # the grid of the brute-force sum steps at the border of disks, of soft boxes' cones and at the horizon
    box = "soft box" in name
    expected = brute_force(light, points, normals, 400 if box else 200)
    for samples in (1, 5):
        found = irradiance(light, points, normals, None, samples=samples)
        assert found.shape == (120,) and found.dtype == np.float32
        assert found.mean() == pytest.approx(expected.mean(), rel=4e-3 if box else 2e-3)
        assert np.abs(found - expected).max() < (0.1 if box else 0.01) * np.percentile(expected, 95)


@pytest.mark.parametrize("name", LAMPS)
def test_samples_stand_for_the_lamp(name):
    """With half of the lamp hidden the estimate follows the integral over the other half."""
    light = LAMPS[name]
    points, normals = receivers(60)

    def left_half(origins, vectors):
        return (vectors[:, 0] > vectors[:, 1]).astype(np.float32)

    found = irradiance(light, points, normals, left_half, samples=512, seed=3)
    other = irradiance(light, points, normals, lambda o, w: 1 - left_half(o, w), samples=512, seed=3)
    free = irradiance(light, points, normals, None)
    assert np.allclose(found + other, free, rtol=1e-4, atol=1e-7)
    few = np.mean([irradiance(light, points, normals, left_half, 16, seed) for seed in range(64)], axis=0)
    assert np.abs(few - found).max() < 0.03 * free.max()


@pytest.mark.parametrize("shape", ["SQUARE", "DISK"])
@pytest.mark.parametrize("size", [(1.0, 1.0), (1.0, 2.0)])
def test_spot_equals_its_integral(shape, size):
    light = lamp("SPOT", radius=0.2, shape=shape, spot_angle=1.4, spot_blend=0.5, size=size)
    points, normals = receivers(300, 4)
    expected = brute_force(light, points, normals)
    found = irradiance(light, points, normals, None, samples=512)
    assert found.mean() == pytest.approx(expected.mean(), rel=5e-3)
    assert np.abs(found - expected).max() < 0.01 * expected.max()


def test_sharp_lamps():
    points, normals = receivers()
    way = PLACE - points
    distance = np.linalg.norm(way, axis=1)
    cosine = np.maximum((way * normals).sum(1) / distance, 0)
    point = cosine / (4 * np.pi * distance**2)
    assert np.allclose(irradiance(lamp("POINT"), points, normals, None, samples=7), point, rtol=1e-4, atol=1e-8)
    spot = lamp("SPOT", spot_angle=2.0, spot_blend=0.4)
    edge = np.cos(1.0)
    cone = smoothstep(((way / distance[:, None]) @ -spot.direction - edge) / ((1 - edge) * 0.4))
    assert np.allclose(irradiance(spot, points, normals, None), point * cone, rtol=1e-3, atol=1e-7)
    sun = lamp("SUN", angle=0.0)
    assert np.allclose(irradiance(sun, points, normals, None), np.maximum(-normals @ sun.direction, 0), atol=1e-6)


def test_beam_is_a_shadow_of_the_lamp():
    light = lamp("AREA", rotation=(0, 0, 0), shape="RECTANGLE", size=(1.0, 0.5), spread=0.0)
    points = np.array([[0.3, 0.2, 0], [0.79, 0.44, 0], [0.81, 0.2, 0], [0.3, 0.46, 0], [0.3, 0.2, 2]], float)
    found = irradiance(light, points, np.tile([0.0, 0.6, 0.8], (5, 1)), None)
    assert np.allclose(found, [1.6, 1.6, 0, 0, 0])


def test_inside_a_spherical_lamp_light_comes_from_everywhere():
    light = lamp("POINT", radius=0.5)
    points = PLACE + np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.1, -0.4]])
    seen = []

    def note(origins, vectors):
        seen.append(np.linalg.norm(origins + vectors - PLACE, axis=1))
        return np.ones(len(origins), np.float32)

    found = irradiance(light, points, np.eye(3), note, samples=16)
    assert np.allclose(found, 1 / (4 * np.pi * 0.25), rtol=1e-5)
    assert np.allclose(np.concatenate(seen), 0.5, atol=1e-5)


@pytest.mark.parametrize("name", LAMPS)
def test_shadow_rays_end_on_the_lamp_and_start_where_it_shines(name):
    light = LAMPS[name]
    points, normals = receivers(1000, 7)
    rays = []

    def note(origins, vectors):
        rays.append((origins, vectors))
        return np.ones(len(origins), np.float32)

    irradiance(light, points, normals, note, samples=4)
    origins, vectors = (np.concatenate(r) for r in zip(*rays, strict=True))
    lookup = {tuple(p): n for p, n in zip(points.astype(np.float32), normals, strict=True)}
    facing = np.array([lookup[tuple(o)] for o in origins])
    assert ((facing * vectors).sum(1) > -1e-5 * np.linalg.norm(vectors, axis=1)).all()
    ends = (origins + vectors - PLACE) @ light.matrix[:3, :3]
    if light.kind == "AREA":
        assert np.abs(ends[:, 2]).max() < 1e-5 and (vectors @ light.direction < 0).all()
        assert (np.abs(ends[:, :2]) <= np.array(light.size) / 2 + 1e-5).all()
    elif light.kind == "POINT":
        reach = np.linalg.norm(ends, axis=1)
        if light.shape == "DISK":
            assert reach.max() < 0.3001
            assert np.abs((ends * ((PLACE - origins) @ light.matrix[:3, :3])).sum(1)).max() < 1e-4
        else:
            assert np.abs(reach - 0.3).max() < 1e-4
    else:
        cosine = -(vectors @ light.direction) / np.linalg.norm(vectors, axis=1)
        assert cosine.min() > np.cos(light.angle / 2) - 1e-4


@pytest.mark.parametrize(
    "light",
    [
        lamp("SPOT", spot_angle=0.6),
        lamp("SPOT", spot_angle=0.6, radius=0.1),
        lamp("AREA", shape="DISK", size=(0.5, 0.5), spread=0.6),
        lamp("AREA", size=(0.5, 0.5)),
        lamp("POINT", radius=0.1),
    ],
    ids=["spot", "soft spot", "soft box", "area", "point"],
)
def test_points_in_the_dark_cast_no_rays(light):
    points, normals = receivers(4000, 2)
    count = []
    irradiance(light, points, normals, lambda o, v: count.append(len(o)) or np.ones(len(o), np.float32), samples=4)
    lit = irradiance(light, points, normals, None, samples=4) > 0
    assert sum(count) <= 4 * lit.sum()
    assert sum(count) >= (0 if light.kind == "SPOT" else 2 * lit.sum())


def test_results_depend_on_seed_and_not_on_chunks(monkeypatch):
    from lightpanes.core import lights

    light = lamp("AREA", size=(1.0, 1.0))
    points, normals = receivers(800)

    def stripes(origins, vectors):
        return (np.sin(40 * (origins + 0.5 * vectors)[:, 0]) > 0).astype(np.float32)

    first = irradiance(light, points, normals, stripes, 4, seed=1)
    assert np.array_equal(first, irradiance(light, points, normals, stripes, 4, seed=1))
    assert not np.array_equal(first, irradiance(light, points, normals, stripes, 4, seed=2))
    monkeypatch.setattr(lights, "CHUNK", 256)
    assert np.allclose(first, irradiance(light, points, normals, stripes, 4, seed=1), rtol=1e-5)


def test_neighbours_do_not_share_samples():
    light = lamp("AREA", size=(1.0, 1.0))
    points, normals = np.tile([[0.0, 0.0, -1.0]], (2000, 1)), np.tile([[0.0, 0.0, 1.0]], (2000, 1))
    half = irradiance(light, points, normals, lambda o, v: (v[:, 0] > 0.3).astype(np.float32), samples=1)
    assert 0.2 < np.corrcoef(half[1:], half[:-1])[0, 1] + 0.25 < 0.3
    assert 0.3 < (half > 0).mean() < 0.7


def test_tinted_visibility_gives_three_channels():
    light = lamp("POINT", radius=0.1)
    points, normals = receivers(500)
    tint = np.array([1.0, 0.5, 0.25], np.float32)
    found = irradiance(light, points, normals, lambda o, v: np.tile(tint, (len(o), 1)), samples=3)
    assert found.shape == (500, 3)
    assert np.allclose(found, irradiance(light, points, normals, None)[:, None] * tint, rtol=1e-4, atol=1e-9)


def test_shadows_off_and_bad_input():
    points, normals = receivers(50)
    light = lamp("POINT", casts_shadow=False)
    assert irradiance(light, points, normals, lambda o, v: np.zeros(len(o), np.float32)).max() > 0
    with pytest.raises(SceneError, match="'POINT' needs at least one sample"):
        irradiance(light, points, normals, None, samples=0)
    assert irradiance(light, np.zeros((0, 3)), np.zeros((0, 3)), None).shape == (0,)
    assert np.isfinite(irradiance(light, PLACE[None], np.eye(3)[:1], None)).all()
    assert irradiance(lamp("AREA", size=(0.0, 1.0)), points, normals, None).max() == 0


@pytest.mark.parametrize("scale", [1e-3, 1e3])
@pytest.mark.parametrize("name", [n for n in LAMPS if "sun" not in n])
def test_any_scale_of_scene(name, scale):
    """Millimetres and kilometres: E of unit power goes with the inverse square of lengths."""
    light = LAMPS[name]
    matrix = light.matrix.copy()
    matrix[:3, 3] *= scale
    scaled = Light(
        name, light.kind, matrix, 1.0, light.radius * scale, light.angle, shape=light.shape,
        size=(light.size[0] * scale, light.size[1] * scale), spread=light.spread,
    )  # fmt: skip
    points, normals = receivers(200)
    small = irradiance(scaled, points * scale, normals, None) * scale**2
    assert np.allclose(small, irradiance(light, points, normals, None), rtol=1e-3, atol=1e-6)


def test_sky_is_read_as_blender_maps_it():
    height, width = 16, 32
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    azimuth, elevation = (0.5 - u) * 2 * np.pi, (v - 0.5) * np.pi
    direction = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1
    )
    sky = Sky(1 + direction)
    assert np.abs(sky_radiance(sky, direction.reshape(-1, 3) * 5) - sky.radiance.reshape(-1, 3)).max() < 1e-5
    random = np.random.default_rng(0).normal(size=(1000, 3))
    random /= np.linalg.norm(random, axis=1, keepdims=True)
    assert np.abs(sky_radiance(sky, random) - (1 + random)).max() < 0.11
    uniform = Sky(np.full((1, 1, 3), 0.7))
    assert np.allclose(sky_radiance(uniform, random), 0.7) and sky_radiance(uniform, random).shape == (1000, 3)
