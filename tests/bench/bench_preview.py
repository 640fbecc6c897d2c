"""The preview engine: its light against Cycles' through a camera, its frames against their rays, its bias and flicker.

SSIM of indirect light is that of the pass Diffuse Indirect (radiance on white), of whole images that of Combined; both
are linear, times two to the scene's exposure, clipped to [0, 1]. Cycles' reference is path traced, 12 bounces, unbiased:
two images of independent noise, which SSIM leaves out (`views.similarity`), for even a thousand samples a pixel have more
noise than what is measured here.
Times are the best of interleaved runs at 480 × 270; those of the cache are beside those of the frame's rays alone.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import bpy
import lightpanes
import numpy as np
from lightpanes.addon import render, shown, view
from lightpanes.core import metrics
from lightpanes.core.preview import Camera, Preview, Settings
from lightpanes.core.rays import chunks
from lightpanes.core.threads import in_threads

from . import harness, preview_race, scenes, views

SAMPLE, PERCENT, BOUNCES = "two_rooms", 40, 12
REFERENCE = ((1024, 0), (512, 1))
"""Samples and seed of both."""
FRAMES = 64
TRUE_FRAMES = 128
"""Of paths without caches, at half the size, that the bias of several bounces is measured against."""

WIDTH, HEIGHT = 480, 270
BAKE = {"resolution": 512, "error_target": 0.02}


def rows() -> Iterator[dict]:
    """Rows of the table in the issue that are the engine's."""
    lightpanes.register()
    scene = _open()
    truth = [views.cycles_view(scene, samples, seed=seed, bounces=BOUNCES).passes for samples, seed in REFERENCE]
    exposure = 2.0**scene.view_settings.exposure
    surfaces, lighting, camera = _read(scene)
    yield from _against(surfaces, lighting, camera, truth, exposure, "without a bake", 0.95)
    yield from _times(surfaces, lighting, scene)
    yield from _bias(surfaces, lighting, camera)
    yield from _jump(surfaces, lighting, camera)
    yield from preview_race.rows(
        scene, BOUNCES, lambda: _begin(camera), lambda image: _similar(image, truth, "Combined", exposure)
    )
    for name, value in BAKE.items():
        setattr(scene.lightpanes, name, value)
    bpy.ops.lightpanes.bake()
    surfaces, lighting, camera = _read(scene)
    yield from _against(surfaces, lighting, camera, truth, exposure, "with a bake", 0.97)
    yield from _navigation(surfaces, lighting, scene)


def _open():
    bpy.ops.wm.open_mainfile(filepath=str(scenes.FOLDER / f"{SAMPLE}.blend"))
    scene = bpy.context.scene
    scene.render.resolution_percentage = PERCENT
    return scene


def _read(scene):
    graph = bpy.context.evaluated_depsgraph_get()
    warnings: list[str] = []
    width, height = (int(s * PERCENT / 100) for s in (scene.render.resolution_x, scene.render.resolution_y))
    camera = view.through_camera(scene.camera.evaluated_get(graph), scene.render, width, height, warnings)
    return shown.read_surfaces(graph, warnings), shown.read_lighting(graph, warnings), camera


def _preview(surfaces, lighting, camera, **settings) -> Preview:
    more = {"bounces": BOUNCES} | settings
    return Preview(surfaces, camera, lighting.lights, lighting.sky, Settings(**more), lighting.baked)


def _similar(image, truth, name, exposure) -> float:
    image, *halves = (
        np.clip(picture[..., :3].astype(np.float64) * exposure, 0, 1)
        for picture in (image, *(half[name] for half in truth))
    )
    return views.similarity(image, halves, [samples for samples, _ in REFERENCE])


def _against(surfaces, lighting, camera, truth, exposure, label, bar):
    preview = _preview(surfaces, lighting, camera, places=render.PLACES)
    for _ in range(FRAMES):
        preview.frame()
    for name, mine in (("Diffuse Indirect", bar), ("Combined", None)):
        image, reference = (
            preview.image(name)[..., :3],
            sum(
                half[name][..., :3] * (samples / sum(s for s, _ in REFERENCE))
                for half, (samples, _) in zip(truth, REFERENCE, strict=True)
            ),
        )
        detail = f"relative RMSE {metrics.relative_rmse(image, reference):.3f}, bias {metrics.mean_bias(image, reference):+.4f}"
        yield harness.row(
            f"preview, {SAMPLE} against Cycles, {FRAMES} frames {label}: SSIM of {name}",
            _similar(image, truth, name, exposure),
            mine,
            at_least=True,
            detail=detail,
        )
    last = preview.image()[..., :3]
    preview.frame()
    change = np.sqrt(((preview.image()[..., :3] - last) ** 2).mean()) / last.mean()
    yield harness.row(f"preview, flicker after {FRAMES} frames {label}", 100 * change, 0.5, "%")


def _interior(scene):
    """A camera inside the room that has a lamp, and the same one, step by step."""
    from mathutils import Vector

    def at(step):
        place = Vector((-3.4 + 0.01 * step, -1.5, 1.5))
        turn = (Vector((-1.0, 1.0, 1.0)) - place).to_track_quat("-Z", "Y")
        matrix = turn.to_matrix().to_4x4()
        matrix.translation = place
        return Camera.from_lens(np.array(matrix), WIDTH, HEIGHT, lens=20)

    return at


def _times(surfaces, lighting, scene):
    """Frames of one bounce and of occlusion, beside the rays that they trace."""
    at = _interior(scene)
    kinds = {"one-bounce RGB": {"bounces": 1, "passes": ()}, "AO and one-bounce RGB": {"bounces": 1, "passes": ("AO",)}}
    for kind, settings in kinds.items():
        still = _preview(surfaces, lighting, at(0), places=1, **settings)
        moving = _preview(surfaces, lighting, at(0), places=1, **settings)
        alone = _preview(surfaces, lighting, at(0), places=1, cached=False, **settings)
        for preview in (still, moving, alone):
            preview.frame()
        buffer = still._views[0].buffer
        ways = surfaces.scatter(
            buffer.normal, buffer.flat, np.random.default_rng(0).random((2, len(buffer.rows)), np.float32)
        )
        pieces = chunks(len(buffer.rows), 1 << 14)

        def rays(buffer=buffer, ways=ways, pieces=pieces):
            def part(s):
                surfaces.land(surfaces.reflecting, buffer.position[s], ways[s])
                for _ in range(2):
                    surfaces.tracer.visibility(buffer.position[s], ways[s])

            in_threads(part, pieces)

        best = {"still": np.inf, "moving": np.inf, "alone": np.inf, "rays": np.inf}
        for step in range(12):

            def walk(step=step, moving=moving):
                moving.look(at(step + 1))
                moving.frame()

            runs = {"still": still.frame, "moving": walk, "alone": alone.frame, "rays": rays}
            for name, run in runs.items():
                started = time.perf_counter()
                run()
                best[name] = min(best[name], time.perf_counter() - started)
        detail = f"without the cache {best['alone']:.3f} s, its rays alone {best['rays']:.3f} s"
        yield harness.row(f"preview, {kind}, {WIDTH} × {HEIGHT}, at rest", best["still"], 0.06, "s", detail=detail)
        yield harness.row(f"preview, {kind}, {WIDTH} × {HEIGHT}, moving", best["moving"], 0.12, "s")


def _bias(surfaces, lighting, camera):
    """Eight bounces by the caches against eight bounces by paths alone."""
    small = Camera(camera.view, camera.projection, camera.width // 2, camera.height // 2)
    paths = _preview(surfaces, lighting, small, bounces=8, cached=False, seed=5)
    for _ in range(TRUE_FRAMES):
        paths.frame()
    reference = paths.image("Diffuse Indirect")
    cached = _preview(surfaces, lighting, small, bounces=8)
    for _ in range(FRAMES):
        cached.frame()
    bias = metrics.mean_bias(cached.image("Diffuse Indirect"), reference)
    yield harness.row(
        f"preview, bias of eight bounces after {FRAMES} frames", 100 * abs(bias), 1.0, "%", detail=f"{bias:+.4f}"
    )


def _begin(camera):
    surfaces, lighting, _ = _read(bpy.context.scene)
    return _preview(surfaces, lighting, camera, passes=(), places=render.PLACES)


def _jump(surfaces, lighting, camera):
    """The lamp jumps: how much of the change is shown ten frames on."""
    small = Camera(camera.view, camera.projection, camera.width // 2, camera.height // 2)
    step = np.zeros((4, 4))
    step[:3, 3] = 0.8, 0.8, -1.0
    moved = tuple(
        replace(light, matrix=light.matrix + step) if light.kind == "POINT" else light for light in lighting.lights
    )
    preview = _preview(surfaces, lighting, small)
    for _ in range(FRAMES):
        preview.frame()
    before = preview.image()[..., :3]
    preview.light(moved, lighting.sky, lighting.baked)
    for _ in range(10):
        preview.frame()
    after = preview.image()[..., :3]
    settled = Preview(surfaces, small, moved, lighting.sky, preview.settings, lighting.baked)
    for _ in range(FRAMES):
        settled.frame()
    wanted = settled.image()[..., :3] - before
    shown = ((after - before) * wanted).sum() / (wanted * wanted).sum()
    yield harness.row("preview, a lamp jumps: change shown after 10 frames", 100 * shown, 80, "%", at_least=True)


def _navigation(surfaces, lighting, scene):
    """Frames a second while the camera moves and a bake holds the indirect light."""
    at = _interior(scene)
    preview = _preview(surfaces, lighting, at(0), places=1, passes=())
    best = np.inf
    for step in range(16):
        started = time.perf_counter()
        preview.look(at(step))
        preview.frame()
        best = min(best, time.perf_counter() - started)
    yield harness.row(
        f"preview, relit navigation, {WIDTH} × {HEIGHT}",
        1 / best,
        8,
        "frames/s",
        at_least=True,
        detail=f"{best:.3f} s a frame",
    )
