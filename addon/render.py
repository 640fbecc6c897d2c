"""The render engine LIGHTPANES: F12, the command line and the viewport, by `core.preview`."""

from __future__ import annotations

import threading
import time

import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from gpu_extras.presets import draw_texture_2d

from ..core.preview import Preview, background
from ..core.rays import EngineError
from ..core.scene import SceneError
from . import engine, handlers, prepared, relight, shown, textures, view, viewport

ENGINE = "LIGHTPANES"

# Preview's passes → what switches them on in a view layer, what Blender calls them from 5.0 on and before, and their type.
PASSES = {
    "Depth": ("use_pass_z", "Depth", "Depth", "Z", "VALUE"),
    "Normal": ("use_pass_normal", "Normal", "Normal", "XYZ", "VECTOR"),
    "Diffuse Color": ("use_pass_diffuse_color", "Diffuse Color", "DiffCol", "RGB", "COLOR"),
    "Diffuse Direct": ("use_pass_diffuse_direct", "Diffuse Direct", "DiffDir", "RGB", "COLOR"),
    "Diffuse Indirect": ("use_pass_diffuse_indirect", "Diffuse Indirect", "DiffInd", "RGB", "COLOR"),
    "AO": ("use_pass_ambient_occlusion", "Ambient Occlusion", "AO", "RGB", "COLOR"),
}

PLACES = 16
"""Places in a pixel that a render goes through, at most."""

SHOW_EVERY = 1.0
"""Seconds between the images that a render shows while it goes on."""


def passes_of(layer: bpy.types.ViewLayer) -> dict[str, str]:
    """The passes that a view layer asks for, beside Combined, and their names in Blender."""
    new = bpy.app.version >= (5, 0)
    return {name: long if new else short for name, (flag, long, short, *_) in PASSES.items() if getattr(layer, flag)}


def cancelled(running: bpy.types.RenderEngine) -> bool:
    """Whether the user ended the render."""
    return running.test_break()


class LIGHTPANES_render_engine(bpy.types.RenderEngine):
    bl_idname = ENGINE
    bl_label = "Lightpanes"
    bl_use_preview = False
    bl_use_eevee_viewport = True
    bl_use_spherical_stereo = False

    # ---- renders ----

    def update_render_passes(self, scene=None, renderlayer=None):
        self.register_pass(scene, renderlayer, "Combined", 4, "RGBA", "COLOR")
        names = passes_of(renderlayer)
        for name, (*_, channels, kind) in PASSES.items():
            if name in names:
                self.register_pass(scene, renderlayer, names[name], len(channels), channels, kind)

    def render(self, depsgraph):
        try:
            if reason := engine.unusable():
                raise EngineError(reason)
            self._render(depsgraph)
        except (SceneError, EngineError) as error:
            # the one is for the window of the image, the other for scripts
            self.error_set(str(error))
            self.report({"ERROR"}, str(error))

    def _render(self, depsgraph):
        scene, layer = depsgraph.scene, depsgraph.view_layer
        camera = self.camera_override or scene.camera
        if camera is None:
            raise SceneError(f"Scene '{scene.name}' has no camera; add one, or press Ctrl+Alt+Numpad 0 in a viewport.")
        warnings: list[str] = []
        eye = view.through_camera(
            camera.evaluated_get(depsgraph), scene.render, self.resolution_x, self.resolution_y, warnings
        )
        part = view.border(scene.render, self.resolution_x, self.resolution_y)
        if part is not None:
            eye = eye.part(*part)
        self.update_stats("", "Reading the scene")
        surfaces, lighting = shown.read_surfaces(depsgraph, warnings), shown.read_lighting(depsgraph, warnings)
        for sentence in dict.fromkeys(warnings):
            self.report({"WARNING"}, sentence)
        names = passes_of(layer)
        result = self.begin_result(0, 0, *eye.size, layer=layer.name)
        try:
            if surfaces is None:
                _write(result, "Combined", background(eye, lighting.sky, scene.render.film_transparent))
            else:
                samples = scene.lightpanes.samples
                settings = shown.settings_of(scene, passes=tuple(names), places=max(1, min(samples, PLACES)))
                preview = Preview(surfaces, eye, lighting.lights, lighting.sky, settings, lighting.baked)
                self._sample(preview, result, names, samples)
        finally:
            self.end_result(result)

    def _sample(self, preview, result, names, samples):
        told = time.perf_counter()
        for k in range(samples):
            if cancelled(self):
                break
            preview.frame()
            self.update_progress((k + 1) / samples)
            self.update_stats("", f"Sample {k + 1}/{samples}")
            if not bpy.app.background and time.perf_counter() - told > SHOW_EVERY:
                _write(result, "Combined", preview.image())
                self.update_result(result)
                told = time.perf_counter()
        if preview.frames:
            _write(result, "Combined", preview.image())
            for name, blenders in names.items():
                _write(result, blenders, preview.image(name))

    # ---- viewports ----

    def view_update(self, context, depsgraph):
        state = viewport.of(self)
        if engine.unusable():
            return
        state.read(depsgraph)
        _prepare_soon()

    def view_draw(self, context, depsgraph):
        state, region = viewport.of(self), context.region
        if reason := engine.unusable():
            self.update_stats("Lightpanes", reason)
            return
        pixels = max(1, int(self.get_preview_pixel_size(depsgraph.scene)))
        again = state.advance(depsgraph, context.region_data, region.width, region.height, pixels)
        self.update_stats("Lightpanes", state.message)
        if state.texture is not None:
            gpu.state.blend_set("ALPHA_PREMULT")
            self.bind_display_space_shader(depsgraph.scene)
            draw_texture_2d(state.texture, (0, 0), region.width, region.height)
            self.unbind_display_space_shader()
            gpu.state.blend_set("NONE")
        if again:
            self.tag_redraw()


def _write(result, name, image) -> None:
    found = result.layers[0].passes.get(name)
    if found is not None:
        found.rect.foreach_set(np.ascontiguousarray(image, np.float32).ravel())


# ---- what Cycles is asked beforehand ----


def _prepare_soon() -> None:
    if not bpy.app.timers.is_registered(_prepare_later):
        bpy.app.timers.register(_prepare_later, first_interval=0.3)


def _prepare_later():
    scene = bpy.context.scene
    if scene is None or scene.render.engine != ENGINE or bpy.app.is_job_running("RENDER"):
        return
    if _can_prepare() and prepared.missing(scene):
        _prepare(scene)
        viewport.forget_surfaces()
        scene.update_tag()


def _can_prepare() -> bool:
    return hasattr(bpy.types.Scene, "cycles") and threading.current_thread() is threading.main_thread()


def _prepare(scene) -> None:
    try:
        told = prepared.prepare(bpy.context, scene)
    except (SceneError, RuntimeError) as error:
        told = [str(error)]
    for sentence in told:
        print(f"Lightpanes: {sentence}")


@persistent
def _on_render(scene, *_):
    if scene.render.engine != ENGINE or scene != bpy.context.scene:
        return
    if threading.current_thread() is threading.main_thread():
        relight.check_stale(bpy.context)
        if _can_prepare() and prepared.missing(scene):
            _prepare(scene)


@persistent
def _on_update(scene, _depsgraph):
    if scene.render.engine == ENGINE and not bpy.app.background:
        _prepare_soon()


@persistent
def _on_load(*_):
    viewport.clear()
    prepared.forget()
    textures.forget()


HANDLERS = {"render_init": _on_render, "depsgraph_update_post": _on_update, "load_pre": _on_load}


def register() -> None:
    bpy.utils.register_class(LIGHTPANES_render_engine)
    handlers.add(HANDLERS)


def unregister() -> None:
    handlers.remove(HANDLERS)
    _on_load()
    bpy.utils.unregister_class(LIGHTPANES_render_engine)
