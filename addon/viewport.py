"""What a 3D viewport shows with the render engine LIGHTPANES: a frame at each drawing, better while nothing moves."""

from __future__ import annotations

import time

import bpy
import gpu
import numpy as np

from ..core.preview import Preview, background
from ..core.rays import EngineError
from ..core.scene import SceneError
from . import shown, view

FRAME = 0.15
"""Seconds that a viewport's frame may take: more than five a second with what else there is to do."""

COARSEST = 8
"""A viewport's pixel is at most so many of the screen's wide."""


class Viewport:
    """What one viewport shows, and how far it has got."""

    def __init__(self):
        self.surfaces = self.lighting = self.preview = self.texture = None
        self.message = ""
        self.coarseness, self.too_fine, self.eye = 1, 0, ()
        self._read = False

    def forget(self) -> None:
        """Read everything anew before the next frame."""
        self._read = False

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
        settings = shown.settings_of(scene, passes=())
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
        if moved != self.eye:
            self.too_fine = 0
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
        """Take larger pixels where a frame takes long, smaller ones where it is quick; a camera at rest begins anew for
        neither more often than it must."""
        frames = self.preview.frames
        slow = FRAME if frames == 1 else 2 * FRAME
        if seconds > slow and self.coarseness < COARSEST:
            self.too_fine = self.coarseness
            self.coarseness = min(COARSEST, self.coarseness + (2 if seconds > 3 * FRAME else 1))
        elif self.coarseness > self.too_fine + 1 and frames >= 3:
            finer = self.coarseness - 1
            if seconds * (self.coarseness / finer) ** 2 < 0.7 * FRAME:
                self.coarseness = finer

    def _show(self, image) -> None:
        height, width = image.shape[:2]
        data = gpu.types.Buffer("FLOAT", image.size, np.ascontiguousarray(image, np.float32).ravel())
        self.texture = gpu.types.GPUTexture((width, height), format="RGBA16F", data=data)


_viewports: dict[int, Viewport] = {}


def of(owner: bpy.types.RenderEngine) -> Viewport:
    """A viewport's state; kept beside the engine, which Blender makes and frees."""
    key = owner.as_pointer()
    if key not in _viewports:
        _viewports[key] = Viewport()
    return _viewports[key]


def forget_surfaces() -> None:
    """Let all viewports read the scene anew."""
    for item in _viewports.values():
        item.forget()


def clear() -> None:
    """Drop all, as when another file is opened."""
    _viewports.clear()


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
