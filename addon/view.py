"""Blender's cameras and viewports as the preview's cameras."""

from __future__ import annotations

import bpy
import numpy as np

from ..core.preview import Camera


def through_camera(
    camera: bpy.types.Object, render: bpy.types.RenderSettings, width: int, height: int, warnings: list[str]
) -> Camera:
    """The evaluated camera's view on an image of so many pixels. Panoramas are seen in perspective, with a warning."""
    data = camera.data
    if data.type not in {"PERSP", "ORTHO"}:
        warnings.append(f"Camera '{camera.name}' is panoramic, which is not honoured: it is taken as perspective.")
    if data.dof.use_dof:
        warnings.append(f"Camera '{camera.name}' has depth of field, which is not honoured: everything is sharp.")
    return Camera.from_lens(
        np.array(camera.matrix_world),
        width,
        height,
        orthographic=data.type == "ORTHO",
        lens=data.lens,
        scale=data.ortho_scale,
        sensor=(data.sensor_width, data.sensor_height),
        fit=data.sensor_fit,
        shift=(data.shift_x, data.shift_y),
        clip=(data.clip_start, data.clip_end),
        aspect=(render.pixel_aspect_x, render.pixel_aspect_y),
    )


def through_region(region_data: bpy.types.RegionView3D, width: int, height: int) -> Camera:
    """A viewport's view, on an image of so many pixels."""
    return Camera(np.array(region_data.view_matrix), np.array(region_data.window_matrix), width, height)


def border(render: bpy.types.RenderSettings, width: int, height: int) -> tuple[int, int, int, int] | None:
    """(left, bottom, right, top) px of the part that is rendered, None for all."""
    if not render.use_border:
        return None
    left, right = int(render.border_min_x * width), int(render.border_max_x * width)
    bottom, top = int(render.border_min_y * height), int(render.border_max_y * height)
    if right <= left or top <= bottom:
        return None
    return left, bottom, right, top
