"""The preview against closed forms, the lamps' own closed forms, and path tracing without caches."""

import numpy as np
import pytest
from lightpanes.core import metrics, threads
from lightpanes.core.lights import irradiance
from lightpanes.core.preview import PASSES, Baked, Camera, Lamps, Preview, Settings, Surfaces, background
from lightpanes.core.preview.baked import BakedLight
from lightpanes.core.preview.gbuffer import make_gbuffer
from lightpanes.core.preview.looks import Looks, Texture
from lightpanes.core.preview.pixel_filter import blackman_harris, offsets
from lightpanes.core.rays import Tracer
from lightpanes.core.sampling import r2_points
from lightpanes.core.scene import Material, Optics, SceneError, Sky

from . import shapes


def looking(place, at, up=(0, 0, 1)):
    """(4, 4) matrix of a camera at `place` that looks at `at`."""
    z = np.subtract(place, at) / np.linalg.norm(np.subtract(place, at))
    x = np.cross(up, z) / np.linalg.norm(np.cross(up, z))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), place
    return matrix


INSIDE = looking((0.3, 0.3, 1.5), (3.3, 2.5, 1.0))


def room_camera(width=48, height=32, **more):
    return Camera.from_lens(INSIDE, width, height, lens=20, **more)


def shown(scene, camera, frames=1, sky=None, **settings):
    preview = Preview(Surfaces(scene), camera, scene.lights, sky, Settings(**settings))
    for _ in range(frames):
        preview.frame()
    return preview


def white_sky(radiance=1.0):
    return Sky(np.full((1, 1, 3), radiance, np.float32))


def floor(material, **more):
    """A floor of 40 × 40 m and a camera that looks straight down on 2 × 2 m of it."""
    scene = shapes.scene((*shapes.quad((-20, -20, 0), (40, 0, 0), (0, 40, 0)), 0), materials=[material], **more)
    camera = Camera.from_lens(looking((0, 0, 5), (0, 0, 0), (0, 1, 0)), 16, 16, orthographic=True, scale=2)
    return scene, camera


@pytest.mark.parametrize("cached", [False, True])
def test_a_closed_box_that_glows_is_as_bright_as_the_series_says(cached):
    glow = Material("Glow", (0.5, 0.4, 0.2), (1.0, 1.0, 1.0))
    scene = shapes.scene((*shapes.box((0, 0, 0), (4, 3, 2.5), True), 0), materials=[glow])
    image = shown(scene, room_camera(), 12, bounces=30, cached=cached, places=4).image()
    assert image[..., :3].mean((0, 1)) == pytest.approx(1 / (1 - np.array([0.5, 0.4, 0.2])), rel=0.01)
    assert np.isfinite(image).all() and (image[..., 3] == 1).all()


def test_a_floor_under_an_even_sky_shows_its_albedo():
    scene, camera = floor(Material("Floor", (0.7, 0.5, 0.3)))
    preview = shown(scene, camera, 2, white_sky(2.0))
    assert preview.image()[..., :3] == pytest.approx(np.broadcast_to([1.4, 1.0, 0.6], (16, 16, 3)), rel=1e-4)
    assert preview.image("AO") == pytest.approx(1, abs=1e-5)


def test_a_lamp_over_a_plane():
    scene, camera = floor(shapes.GREY, lights=[shapes.lamp((0, 0, 2), 100.0)])
    image = shown(scene, camera, bounces=1, places=1).image()
    x = (np.arange(16) + 0.5) / 8 - 1
    d2 = x[:, None] ** 2 + x**2 + 4
    expected = 0.5 / np.pi * 100 / (4 * np.pi * d2) * 2 / np.sqrt(d2)
    # points are lifted off the floor by a millimetre
    assert image[..., 0] == pytest.approx(expected, rel=2e-3)


def test_a_pixel_is_as_wide_wherever_the_camera_begins_to_see():
    # cells of the caches follow from it; two_rooms is cut open by the near plane
    scene, _ = floor(shapes.GREY)
    for near in (0.1, 4.9):
        camera = Camera.from_lens(looking((0, 0, 5), (0, 0, 0), (0, 1, 0)), 36, 24, lens=36, clip=(near, 100))
        found = make_gbuffer(Surfaces(scene), camera, None, (0.5, 0.5), 0, 0)
        # 36 mm of sensor over 36 mm of lens: at 5 m the image is 5 m wide
        assert found.footprint[12 * 36 + 18] == pytest.approx(5 / 36, rel=1e-2)


def test_texels_are_mixed_as_cycles_mixes_them():
    image = np.zeros((1, 2, 3), np.float32)
    image[0, 1] = 1
    for encoded, middle in ((False, 0.5), (True, 0.21404)):
        texture = Texture(image, np.ones(3), np.zeros(3), "EXTEND", True, None, encoded)
        scene = shapes.scene((*shapes.quad((0, 0, 0), (1, 0, 0), (0, 1, 0)), 0))
        scene.texture_uv = scene.positions[scene.triangles][..., :2].astype(np.float32)
        at = np.full(1, 0.5, np.float32)
        # halfway along the diagonal that both triangles share
        assert Looks(scene, {0: texture}).albedo(np.zeros(1, np.int32), 0 * at, at) == pytest.approx(middle, abs=2e-3)


def test_occlusion_beside_a_long_wall():
    """Of a point x before a wall of height h the sky is ½ (1 + x / √(x² + h²))."""
    wall = shapes.quad((0, -400, 0), (0, 800, 0), (0, 0, 1.0))
    ground = shapes.quad((-40, -400, 0), (80, 0, 0), (0, 800, 0))
    scene = shapes.scene((*wall, 0), (*ground, 0))
    camera = Camera.from_lens(looking((1.0, 0, 5), (1.0, 0, 0), (0, 1, 0)), 16, 16, orthographic=True, scale=1.5)
    occlusion = shown(scene, camera, 64, bounces=0, ao_distance=1e4, places=1, cached=False).image("AO")[..., 0]
    x = 1 + ((np.arange(16) + 0.5) / 16 - 0.5) * 1.5
    assert occlusion.mean(axis=0) == pytest.approx((1 + x / np.sqrt(x * x + 1)) / 2, abs=0.015)


LAMPS = {
    "point": shapes.lamp((0.6, 0.4, 1.5), radius=0.3),
    "soft falloff": shapes.lamp((0.6, 0.4, 1.5), radius=0.3, shape="DISK"),
    "spot": shapes.lamp((0.6, 0.4, 1.5), kind="SPOT", radius=0.1, spot_angle=1.2, spot_blend=0.5),
    "sun": shapes.lamp((0, 0, 3), 3.0, kind="SUN", angle=0.4),
    "panel": shapes.lamp((0.2, 0.1, 1.2), kind="AREA", shape="RECTANGLE", size=(1.0, 0.6)),
    "ellipse": shapes.lamp((0.2, 0.1, 1.2), kind="AREA", shape="ELLIPSE", size=(1.0, 0.6)),
    "soft box": shapes.lamp((0.2, 0.1, 1.2), kind="AREA", size=(1.0, 1.0), spread=1.0),
    "beam": shapes.lamp((0.2, 0.1, 1.2), kind="AREA", size=(1.0, 1.0), spread=0.0),
    "sharp": shapes.lamp((0.6, 0.4, 1.5)),
}


@pytest.mark.parametrize("name", LAMPS)
def test_samples_of_a_lamp_average_to_its_irradiance(name):
    light = LAMPS[name]
    blocker = shapes.box((-0.1, -0.4, 0.4), (0.3, 0.4, 0.6))
    scene = shapes.scene((*shapes.quad((-9, -9, 0), (18, 0, 0), (0, 18, 0)), 0), (*blocker, 0))
    tracer = Tracer(scene)
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-1, 1, (40, 2)), np.full(40, 1e-3)]).astype(np.float32)
    normals = np.array([0.1, 0.2, 1.0]) + 0.3 * rng.normal(size=(40, 3))
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    truth = irradiance(light, points, normals, tracer.visibility, 4096) * light.power[0]
    bounds = np.array([[-9, -9, 0], [9, 9, 0.6]])
    each = 1500
    at = np.repeat(np.arange(40), each)
    u = np.tile(r2_points(each, 7).T, 40)
    found = Lamps([light], tracer.alone(), bounds).irradiance(points[at], normals[at], u, u[0])
    mean = found[:, 0].reshape(40, each).mean(axis=1)
    assert np.abs(mean - truth).mean() < 0.02 * truth.mean()
    assert mean.mean() == pytest.approx(truth.mean(), rel=0.01)


def test_many_lamps_by_the_few_that_each_point_picks():
    rng = np.random.default_rng(5)
    lights = [shapes.lamp((*rng.uniform(0.5, 2.5, 2), 2.2), rng.uniform(0, 60, 3)) for _ in range(30)]
    scene = shapes.room(lights=lights)
    points = np.repeat(rng.uniform((2, 0.2, 0.01), (3.8, 2.8, 0.01), (20, 3)), 2000, axis=0).astype(np.float32)
    normals = np.tile(np.array([0, 0, 1], np.float32), (len(points), 1))
    u, pick = rng.random((2, len(points))).astype(np.float32), rng.random(len(points)).astype(np.float32)
    lamps = Lamps(lights, Tracer(scene).alone(), np.array([[0, 0, 0], [4, 3, 2.5]]))
    few = lamps.irradiance(points, normals, u, pick, most=4).reshape(20, 2000, 3).mean(axis=1)
    every = lamps.irradiance(points[::2000], normals[::2000], u[:, ::2000], pick[::2000], most=30)
    assert few == pytest.approx(every, rel=0.06)
    assert few.mean() == pytest.approx(every.mean(), rel=0.01)


def test_passes_sum_up():
    glow = Material("Glow", (0.6, 0.5, 0.4), (0.2, 0.1, 0.0))
    parts = (*shapes.room_parts(), (*shapes.quad((2.5, 2.5, 0.8), (1, 0, 0), (0, 0, 1)), 2))
    scene = shapes.scene(*parts, materials=[*shapes.COLOURS, glow], lights=[shapes.lamp((3, 1.5, 2), radius=0.1)])
    preview = shown(scene, room_camera(), 4)
    made = {name: preview.image(name) for name in PASSES}
    assert {name: image.shape[2] for name, image in made.items()} == PASSES
    light = (made["Diffuse Direct"] + made["Diffuse Indirect"]) * made["Diffuse Color"]
    emitted = made["Combined"][..., :3] - light
    assert emitted.min() > -1e-4 and emitted.max() == pytest.approx(0.2, abs=2e-3)
    assert (made["Depth"] > 0).all() and (made["Depth"] < 6).all()
    assert np.linalg.norm(made["Normal"], axis=2).max() == pytest.approx(1, abs=1e-4)


@pytest.fixture(scope="module")
def truth():
    """A room by eight bounces of path tracing, no caches, one place a pixel; two independent halves."""
    made = shapes.room(lights=[shapes.lamp((3, 1.5, 2), radius=0.05)])
    surfaces, halves = Surfaces(made), []
    for seed in (100, 101):
        settings = Settings(bounces=8, cached=False, places=1, seed=seed)
        preview = Preview(surfaces, room_camera(), made.lights, None, settings)
        for _ in range(150):
            preview.frame()
        halves.append(preview.image("Diffuse Indirect"))
    return surfaces, halves


def test_bounces_by_the_cache_are_unbiased_within_a_percent(truth):
    surfaces, halves = truth
    reference = np.mean(halves, axis=0)
    assert abs(metrics.mean_bias(halves[0], halves[1])) < 0.003
    preview = Preview(surfaces, room_camera(), surfaces.scene.lights, None, Settings(bounces=8, places=1))
    for _ in range(64):
        preview.frame()
    image = preview.image("Diffuse Indirect")
    assert abs(metrics.mean_bias(image, reference)) < 0.01
    still = [image]
    for _ in range(3):
        preview.frame()
        still.append(preview.image("Diffuse Indirect"))
    assert np.sqrt(np.mean(np.diff(still, axis=0) ** 2)) < 0.005 * reference.mean()


def test_a_lamp_that_jumps_is_followed(truth):
    surfaces, _ = truth
    camera, lights = room_camera(), surfaces.scene.lights
    moved = [shapes.lamp((0.5, 2.6, 0.4), 40.0, radius=0.05)]
    preview = Preview(surfaces, camera, lights, None, Settings())
    for _ in range(40):
        preview.frame()
    before = preview.image()[..., :3]
    preview.light(moved, None)
    for _ in range(10):
        preview.frame()
    after = preview.image()[..., :3]
    settled = Preview(surfaces, camera, moved, None, Settings(seed=4))
    for _ in range(40):
        settled.frame()
    wanted = settled.image()[..., :3] - before
    assert ((after - before) * wanted).sum() / (wanted * wanted).sum() > 0.8


def test_seeds_and_threads():
    made = shapes.room(lights=[shapes.lamp((3, 1.5, 2), radius=0.1)])
    camera = room_camera(180, 120)
    first = shown(made, camera, 2, bounces=3).image()
    threads.use_threads(1)
    try:
        alone = shown(made, camera, 2, bounces=3).image()
    finally:
        threads.use_threads(0)
    assert (first == alone).all()
    assert (first != shown(made, camera, 2, bounces=3, seed=1).image()).any()


def test_a_mirror_shows_what_is_before_it():
    silver = Material("Silver", (0, 0, 0), optics=Optics(mirror=(0.9, 0.6, 0.3), mirror_edge=(0.9, 0.6, 0.3)))
    scene, camera = floor(silver)
    image = shown(scene, camera, 2, white_sky(2.0)).image()
    assert image[..., :3] == pytest.approx(np.broadcast_to([1.8, 1.2, 0.6], (16, 16, 3)), rel=1e-3)


def test_clear_glass_in_an_even_sky_cannot_be_seen():
    glass = Material("Glass", (0, 0, 0), transmission=(1, 1, 1), optics=Optics(glass=(1, 1, 1), gloss=(1, 1, 1)))
    ball = shapes.globe(24, 1.0, inward=False)
    scene = shapes.scene((*ball, 0), materials=[glass])
    camera = Camera.from_lens(looking((0, -4, 0), (0, 0, 0)), 32, 32, lens=50)
    image = shown(scene, camera, 16, white_sky(), places=16).image()
    # a few rays are still inside after the last bounce
    assert image[..., :3].mean() == pytest.approx(1, abs=0.01)


def test_a_pane_lets_its_part_through():
    pane = Material("Pane", (0, 0, 0), transmission=(0.5, 0.25, 0.0))
    parts = (*shapes.quad((-2, -2, 1), (4, 0, 0), (0, 4, 0)), 1), (*shapes.quad((-2, -2, 0), (4, 0, 0), (0, 4, 0)), 0)
    glow = Material("Glow", (0, 0, 0), (2.0, 2.0, 2.0))
    scene = shapes.scene(*parts, materials=[glow, pane])
    camera = Camera.from_lens(looking((0, 0, 5), (0, 0, 0), (0, 1, 0)), 16, 16, orthographic=True, scale=2)
    image = shown(scene, camera, 2).image()
    assert image[..., :3] == pytest.approx(np.broadcast_to([1.0, 0.5, 0.0], (16, 16, 3)), abs=1e-3)


def test_a_bake_is_read_where_there_is_one():
    scene, camera = floor(Material("Floor", (0.5, 0.5, 0.5)))
    size = np.full((8, 8, 3), np.pi, np.float32)
    preview = Preview(Surfaces(scene), camera, (), None, Settings(), Baked(size, 2 * size, size))
    preview.frame()
    assert preview.image()[..., :3] == pytest.approx(0.5 * 4, rel=1e-4)
    assert preview.image("Diffuse Indirect") == pytest.approx(1.0, rel=1e-4)
    assert (preview.image("AO") == 1).all()


def test_a_bake_is_not_read_on_the_back_of_a_sheet_nor_on_strips_finer_than_its_texels():
    sheet = (*shapes.quad((0, 0, 0), (1, 0, 0), (0, 1, 0)), 0)
    strip = (*shapes.quad((2, 0, 0), (1, 0, 0), (0, 1, 0)), 0)
    made = shapes.scene(sheet, strip)
    made.atlas_uv[2:] = [[[0.9, 0.1], [0.901, 0.1], [0.901, 0.9]], [[0.9, 0.1], [0.901, 0.9], [0.9, 0.9]]]
    surfaces = Surfaces(made)
    assert surfaces.strip_width[2:] == pytest.approx(0.001, rel=0.01)
    bake, facing = BakedLight(surfaces, Baked(np.ones((64, 64, 3), np.float32))), surfaces.flat
    assert bake.holds(np.arange(4), facing).tolist() == [True, True, False, False]
    assert not bake.holds(np.arange(4), -facing).any()


def test_light_through_glass_counts_once():
    # a bake that shows what glass focuses brings all the light that comes through it
    pane = (*shapes.quad((-3, -3, 1), (6, 0, 0), (0, 6, 0)), 1)
    lit = (*shapes.quad((-1, -1, 0), (2, 0, 0), (0, 2, 0)), 0)
    clear = Material("Glass", (0, 0, 0), transmission=(1, 1, 1), optics=Optics(glass=(1, 1, 1), gloss=(1, 1, 1)))
    scene = shapes.scene(
        lit, pane, materials=(Material("Floor", (0.5, 0.5, 0.5)), clear), lights=[shapes.lamp((0, 0, 2))]
    )
    camera = Camera.from_lens(looking((0, -2, 0.5), (0, 0, 0)), 24, 16)
    black = np.zeros((8, 8, 3), np.float32)
    means = []
    for caustics in (None, black):
        preview = Preview(Surfaces(scene), camera, scene.lights, None, Settings(), Baked(black, None, caustics))
        preview.frame()
        means.append(preview.image("Diffuse Direct").mean())
    assert means[0] > 0.1 and means[1] == 0


def test_transparent_film_and_nothing_at_all():
    camera = Camera.from_lens(looking((0, -4, 0), (0, 0, 0)), 24, 16)
    scene = shapes.scene((*shapes.box((-0.3, -0.3, -0.3), (0.3, 0.3, 0.3)), 0))
    image = shown(scene, camera, 2, white_sky(), transparent=True).image()
    assert image[0, 0].tolist() == [0, 0, 0, 0] and image[8, 12, 3] == 1
    assert (background(camera, white_sky(0.5)) == [0.5, 0.5, 0.5, 1]).all()
    assert (background(camera, None, True) == 0).all()


def test_no_lamps_and_no_light():
    image = shown(shapes.room(), room_camera(), 2).image()
    assert (image[..., :3] == 0).all() and (image[..., 3] == 1).all()


def test_what_cannot_be_shown_is_named():
    with pytest.raises(SceneError, match="camera"):
        Camera.from_lens(np.full((4, 4), np.nan), 8, 8)
    with pytest.raises(SceneError, match="fit"):
        room_camera(fit="SIDEWAYS")
    with pytest.raises(SceneError, match="pixels"):
        room_camera(0, 8)
    preview = Preview(Surfaces(shapes.room()), room_camera(), (), None, Settings())
    with pytest.raises(SceneError, match="first frame"):
        preview.image()
    preview.frame()
    with pytest.raises(SceneError, match="Mist"):
        preview.image("Mist")


def test_places_in_a_pixel_are_its_filter():
    places = offsets(2001, 1.5) - 0.5
    assert places[0] == pytest.approx([0, 0], abs=1e-3) and places.mean(axis=0) == pytest.approx([0, 0], abs=1e-6)
    at = np.linspace(-1.5, 1.5, 4001)
    weight = blackman_harris(at, 1.5)
    spread = np.sqrt((weight * at**2).sum() / weight.sum())
    assert places.std(axis=0) == pytest.approx([spread, spread], rel=0.02)
    assert (np.abs(places) <= 1.5).all()
    # any few of them are about centred
    assert np.abs(offsets(16, 1.5).mean(axis=0) - 0.5).max() < 0.06
