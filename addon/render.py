"""The render engine LIGHTPANES: F12, the command line and the viewport, by `core.preview`."""

from __future__ import annotations

import threading
import time

import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from gpu_extras.presets import draw_texture_2d

from ..core.preview import Preview, Settings, background
from ..core.rays import EngineError
from ..core.scene import SceneError
from . import engine, handlers, prepared, relight, shown, textures, view

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

SHOW_EVERY = 1.0
"""Seconds between the images that a render shows while it goes on."""

FRAME = 0.15
"""Seconds that a viewport's frame may take: more than five a second with what else there is to do."""

COARSEST = 8
"""A viewport's pixel is at most so many of the screen's wide."""


def passes_of(layer: bpy.types.ViewLayer) -> dict[str, str]:
    """The passes that a view layer asks for, beside Combined, and their names in Blender."""
    new = bpy.app.version >= (5, 0)
    return {name: long if new else short for name, (flag, long, short, *_) in PASSES.items() if getattr(layer, flag)}


def settings_of(scene: bpy.types.Scene, **more) -> Settings:
    """The preview's settings for a scene."""
    mine = scene.lightpanes
    world = scene.world
    return Settings(
        bounces=mine.bounces,
        filter_width=scene.render.filter_size,
        ao_distance=world.light_settings.distance if world is not None else 10.0,
        transparent=scene.render.film_transparent,
        seed=mine.seed,
        **more,
    )


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
                settings = settings_of(scene, places=max(1, scene.lightpanes.samples), split=bool(names))
                preview = Preview(surfaces, eye, lighting.lights, lighting.sky, settings, lighting.baked)
                self._sample(preview, result, names, scene.lightpanes.samples)
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
        state = _state(self)
        if engine.unusable():
            return
        state.read(depsgraph)
        _prepare_soon()

    def view_draw(self, context, depsgraph):
        state, region = _state(self), context.region
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


class _Viewport:
    """What one viewport shows, and how far it has got."""

    def __init__(self):
        self.surfaces = self.lighting = self.preview = self.texture = None
        self.message = ""
        self.coarseness, self.eye = 1, b""
        self._read = False
        self._asked = ()

    def read(self, depsgraph) -> None:
        """Take up what changed."""
        surfaces, lighting = not self._read or _changes_surfaces(depsgraph), None
        warnings: list[str] = []
        try:
            if surfaces:
                self.surfaces, self.preview = shown.read_surfaces(depsgraph, warnings), None
            lighting = shown.read_lighting(depsgraph, warnings)
        except (SceneError, EngineError) as error:
            self.message, self.surfaces, self.preview = str(error), None, None
            self._read = True
            return
        self.message = ""
        if self.preview is not None and (self.lighting is None or lighting.key != self.lighting.key):
            self.preview.light(lighting.lights, lighting.sky, lighting.baked)
        self.lighting, self._read = lighting, True

    def advance(self, depsgraph, region_data, width, height, pixels) -> bool:
        """Trace one more frame where one is due, and keep the image as a texture; whether more are to come."""
        if not self._read:
            self.read(depsgraph)
        if self.lighting is None:
            return False
        scene = depsgraph.scene
        settings = settings_of(scene, split=False)
        moved = (np.array(region_data.perspective_matrix).tobytes(), width, height, pixels)
        if self.preview is not None and settings != self.preview.settings:
            self.preview = None
        size = (-(-width // (pixels * self.coarseness)), -(-height // (pixels * self.coarseness)))
        eye = view.through_region(region_data, *size)
        if self.surfaces is None:
            self._show(background(eye, self.lighting.sky, settings.transparent))
            return False
        if self.preview is None:
            lighting = self.lighting
            self.preview = Preview(self.surfaces, eye, lighting.lights, lighting.sky, settings, lighting.baked)
        elif moved != self.eye or size != self.preview.camera.size:
            self.preview.look(eye)
        self.eye = moved
        if self.preview.frames >= scene.lightpanes.viewport_samples:
            return False
        started = time.perf_counter()
        self.preview.frame()
        self._show(self.preview.image())
        self._pace(time.perf_counter() - started)
        self.message = f"Sample {self.preview.frames}/{scene.lightpanes.viewport_samples}"
        return True

    def _pace(self, seconds) -> None:
        """Take larger pixels where a frame takes long, smaller ones where it is quick."""
        if seconds > FRAME and self.coarseness < COARSEST:
            self.coarseness = min(COARSEST, self.coarseness + (2 if seconds > 3 * FRAME else 1))
        elif self.coarseness > 1 and self.preview.frames >= 3:
            finer = self.coarseness - 1
            if seconds * (self.coarseness / finer) ** 2 < 0.7 * FRAME:
                self.coarseness = finer

    def _show(self, image) -> None:
        height, width = image.shape[:2]
        data = gpu.types.Buffer("FLOAT", image.size, np.ascontiguousarray(image, np.float32).ravel())
        self.texture = gpu.types.GPUTexture((width, height), format="RGBA16F", data=data)


_viewports: dict[int, _Viewport] = {}


def _state(owner) -> _Viewport:
    """A viewport's state; kept beside the engine, which Blender makes and frees."""
    key = owner.as_pointer()
    if key not in _viewports:
        _viewports[key] = _Viewport()
    return _viewports[key]


def _changes_surfaces(depsgraph) -> bool:
    """Whether what changed can change a surface; lamps, cameras and the world change none."""
    for change in depsgraph.updates:
        item = change.id
        if isinstance(item, bpy.types.Object):
            if item.type not in {"LIGHT", "CAMERA", "SPEAKER", "LIGHT_PROBE"} and (
                change.is_updated_transform or change.is_updated_geometry or change.is_updated_shading
            ):
                return True
        elif isinstance(
            item, bpy.types.Mesh | bpy.types.Curve | bpy.types.Material | bpy.types.Image | bpy.types.Collection
        ):
            return True
    return False


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
        for item in _viewports.values():
            item._read = False
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
    _viewports.clear()
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
