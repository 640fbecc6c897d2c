"""Light through glass counts once: a bake and what engines show of it against Cycles' own path tracing."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import reference, store, twice  # noqa: E402
from lightpanes.addon.fixes import FIXES  # noqa: E402
from lightpanes.addon.obstacles import Facts  # noqa: E402
from lightpanes.core.metrics import relative_rmse  # noqa: E402

from .files import baked_once  # noqa: E402
from .glassware import ball, floor, image  # noqa: E402
from .soft import camera, render  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")
DARK = 0.02


@pytest.fixture
def baked(room, saved):
    """A dark room, in which a coarse bake is exact enough, under a lamp that is soft enough for path tracing to converge."""
    for name in ("Room", "Block"):
        shader = bpy.data.materials[name].node_tree.nodes["Principled BSDF"]
        shader.inputs["Base Color"].default_value = (DARK, DARK, DARK, 1)
    lamp = bpy.data.objects["Lamp"]
    # a ball: the disk of Soft Falloff turns to whoever looks at it, and so sends glass less than is there
    lamp.data.shadow_soft_size, lamp.data.use_soft_falloff = 0.3, False
    room.lightpanes.direct, room.lightpanes.photons = "BAKED", 40_000
    ball(room)
    return baked_once(room, saved)


def test_the_whole_is_what_cycles_traces(baked):
    """Direct light, caustics and what bounces, in a bake's texels."""
    parts = {role: image(role) for role in (store.DIRECT, store.CAUSTICS, store.IRRADIANCE)}
    whole = sum(parts.values())
    traced = reference.halves(bpy.context, {"DIRECT", "INDIRECT"}, 64, 512)
    mask = store.load_bake(baked).own & traced.mask & floor()
    noise = relative_rmse(traced.halves[0], traced.halves[1], mask, 4) / 2
    assert parts[store.CAUSTICS][mask].mean() > 0.1 * whole[mask].mean(), "worth a test"
    error = relative_rmse(whole, traced.image, mask, 4)
    # the halves' difference tells paths' noise to half as much again: few of them carry most of the light
    assert noise < 0.07 and error < 0.02 + 1.5 * noise
    assert whole[mask].mean() == pytest.approx(traced.image[mask].mean(), rel=0.02)
    # twice or never would be far off
    for times in (-1, 1):
        assert relative_rmse(whole + times * parts[store.CAUSTICS], traced.image, mask, 4) > 0.3


def test_cycles_shows_it_once(baked, tmp_path):
    """A picture of the floor with Show in Cycles, Cycles' own caustics left on by the user, and one that Cycles traced."""
    camera(baked)
    eye = baked.camera
    eye.location, eye.rotation_euler, eye.data.lens = (0, 0, 0.9), (0, 0, 0), 30
    eye.data.clip_start = 0.5
    bpy.data.objects["Ball"].visible_camera = False
    baked.render.engine, baked.cycles.device = "CYCLES", "CPU"
    baked.cycles.use_denoising, baked.cycles.blur_glossy, baked.cycles.sample_clamp_indirect = False, 0.0, 0.0
    baked.render.resolution_x = baked.render.resolution_y = 32
    baked.lightpanes.direct = "OFF"
    baked.lightpanes.cycles = True
    assert not (baked.cycles.caustics_reflective or baked.cycles.caustics_refractive)
    baked.cycles.samples = 64
    shown = render(tmp_path)
    baked.lightpanes.cycles = False
    assert baked.cycles.caustics_reflective and baked.cycles.caustics_refractive
    baked.cycles.samples, baked.cycles.max_bounces = 1024, 12
    traced = render(tmp_path)
    everywhere = np.ones(traced.shape[:2], bool)
    assert shown.mean() == pytest.approx(traced.mean(), rel=0.03)
    assert relative_rmse(shown, traced, everywhere, 8) < 0.06


def test_what_cycles_adds_by_itself_is_found_and_mended(baked):
    baked.render.engine, baked.lightpanes.cycles = "CYCLES", True
    lamp = bpy.data.objects["Lamp"]

    def kinds():
        return [obstacle.kind for obstacle in twice.find(Facts(bpy.context))]

    assert kinds() == []
    lamp.data.cycles.is_caustics_light = True
    baked.cycles.caustics_refractive, baked.cycles.diffuse_bounces = True, 2
    found = {obstacle.kind: obstacle for obstacle in twice.find(Facts(bpy.context))}
    assert {"CYCLES_CAUSTICS", "SHADOW_CAUSTICS", "CYCLES_BOUNCES"} == set(found)
    for kind, obstacle in found.items():
        FIXES[kind](bpy.context, obstacle)
    assert kinds() == []
    assert bpy.ops.lightpanes.clear() == {"FINISHED"}
    assert lamp.data.cycles.is_caustics_light and baked.cycles.caustics_refractive
