"""The points that hold the light, drawn over the 3D viewports: `scene.lightpanes.show_points`.

The batch of points is kept until the bake, the lamps or the points' places change.
"""

from __future__ import annotations

import bpy
import numpy as np

from ..core.scene import SceneError
from . import colours, points, store

SIZE = 4.0
"""Of a point, px of the interface's scale."""

LIFT = 0.05
"""Part of its radius by which a point is drawn off its surface, which would hide half of it."""

_handler = None
# Scene's session_uid → (key, batch) of what was drawn last.
_batches: dict[int, tuple] = {}


def arrays(scene: bpy.types.Scene, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Where points are drawn (n, 3) and their colours (n, 4), sRGB, float32. Raises SceneError without points."""
    values, scale = colours.read(scene, kind)
    position, normal, radius = (points.read(scene, name) for name in ("position", "normal", "radius"))
    colour = np.ones((len(values), 4), np.float32)
    colour[:, :3] = scale.colours(values)
    return position + np.float32(LIFT) * radius[:, None] * normal, colour


def _key(scene, kind) -> tuple:
    from . import sessions

    current = sessions.of(scene)
    return kind, current.key, current.shown if kind == "IRRADIANCE" else "", current.followed


def _draw() -> None:
    scene = bpy.context.scene
    kind = scene.lightpanes.show_points
    if kind == "NONE" or store.find_points(scene) is None or not bpy.context.space_data.overlay.show_overlays:
        return
    import gpu

    key, (held, batch) = _key(scene, kind), _batches.get(scene.session_uid, (None, None))
    if held != key:
        batch = _make_batch(scene, kind)
        _batches[scene.session_uid] = key, batch
    if batch is None:
        return
    shader = _shader()
    shader.bind()
    gpu.state.point_size_set(SIZE * bpy.context.preferences.system.ui_scale)
    gpu.state.depth_test_set("LESS_EQUAL")
    batch.draw(shader)
    gpu.state.depth_test_set("NONE")


def _shader():
    import gpu

    # before 4.5 the one shader did points, too
    name = "POINT_FLAT_COLOR" if bpy.app.version >= (4, 5) else "FLAT_COLOR"
    return gpu.shader.from_builtin(name)


def _make_batch(scene, kind):
    from gpu_extras.batch import batch_for_shader

    try:
        place, colour = arrays(scene, kind.lower())
    except SceneError:
        return None  # the panel says what is wrong with the bake
    return batch_for_shader(_shader(), "POINTS", {"pos": place, "color": colour})


def register() -> None:
    global _handler
    # without a window there is nothing to draw on, and touching gpu raises
    if not bpy.app.background:
        _handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")


def unregister() -> None:
    global _handler
    _batches.clear()
    if _handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handler, "WINDOW")
        _handler = None
