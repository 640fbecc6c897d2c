"""Runs inside Blender's window: a person's session with mouse and keyboard, and what came of it as JSON.

The variable LIGHTPANES_OUT names the folder for pictures and `session.json`, LIGHTPANES_FILE the .blend to open,
LIGHTPANES_RESOLUTION that of the atlas. Mouse and keys come from xdotool, pictures from ImageMagick's import: both see
what a person at the screen does.
"""

import json
import os
import subprocess
import time
import traceback
from pathlib import Path

import bpy
import numpy as np
from bpy_extras import view3d_utils

OUT = Path(os.environ["LIGHTPANES_OUT"])
FILE = os.environ["LIGHTPANES_FILE"]
RESOLUTION = int(os.environ["LIGHTPANES_RESOLUTION"])
PLACES = {"cornell": (0.4, -0.9, 2.2)}
"""Where the lamp begins, in samples where the pictures of the manual are made."""
WIDER, HIGHER = 170, 150
"""Pixels by which the Properties editor grows, so that all its words fit."""
TICK = 0.01
"""Seconds between two looks at the main thread, whose gaps are what a person feels as a stall."""
HEADER = 71, 114, 179
"""Colour of a panel's header that a search in the Properties editor has found."""

found: dict = {"stalls": {}, "ends": []}


def module(name):
    import importlib

    return importlib.import_module(f"bl_ext.user_default.lightpanes.{name}")


def area(kind):
    return next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == kind)


def region(of):
    return next(r for r in of.regions if r.type == "WINDOW")


def point(of, right, down):
    """Screen pixels of a place in an area's main region, in pixels from its upper left corner."""
    inside = region(of)
    height = bpy.context.window_manager.windows[0].height
    return round(inside.x + right), round(height - inside.y - inside.height + down)


def xdotool(*words):
    subprocess.Popen(["xdotool", *map(str, words)])


def shot(name):
    subprocess.run(["import", "-window", "root", str(OUT / f"{name}.png")], check=True)


class Watch:
    """Gaps of the main thread by the stage of the bake that runs meanwhile."""

    def __init__(self, name):
        self.job, self.worst = module("addon.job"), found["stalls"].setdefault(name, {})
        self.last, self.stage = time.perf_counter(), ""

    def __call__(self):
        now = time.perf_counter()
        self.worst[self.stage] = max(self.worst.get(self.stage, 0.0), now - self.last - TICK)
        running = self.job.running()
        current = self.job.current()
        worker = running and current.thread is not None
        self.stage = f"{'worker' if worker else 'main'}: {current.progress.stage}" if running else ""
        self.last = time.perf_counter()
        return TICK


def still(name):
    """Gaps without a bake, while the same parts of the screen are drawn again: what is Blender's own."""
    watch = Watch(name)
    bpy.app.timers.register(watch)
    for _ in range(60):
        area("PROPERTIES").tag_redraw()
        yield 0.05
    bpy.app.timers.unregister(watch)


def until(condition, seconds=120.0):
    """Yields until the condition holds; raises TimeoutError when it never does."""
    end = time.perf_counter() + seconds
    while not condition():
        if time.perf_counter() > end:
            raise TimeoutError(condition.__name__)
        yield 0.02


def screen():
    """(H, W, 3) uint8 of what the display shows."""
    data = subprocess.run(["import", "-window", "root", "-depth", "8", "ppm:-"], check=True, capture_output=True).stdout
    _, size, _, pixels = data.split(b"\n", 3)
    width, height = map(int, size.split())
    return np.frombuffer(pixels, np.uint8).reshape(height, width, 3)


def bake_button():
    """Screen pixels of the panel's first button: it is below the header, which the search paints in its blue."""
    inside = region(area("PROPERTIES"))
    part = screen()[:, inside.x : inside.x + inside.width].astype(int)
    header = np.flatnonzero((np.abs(part - HEADER).max(axis=2) < 12).mean(axis=1) > 0.6)
    return inside.x + round(0.4 * inside.width), int(header.max()) + 22


def press_bake():
    job = module("addon.job")
    xdotool("mousemove", *bake_button(), "sleep", 0.2, "click", 1)
    yield from until(job.running, 20)


def box_of(part):
    """Left, top, width and height on the screen of an area or region."""
    return [part.x, bpy.context.window_manager.windows[0].height - part.y - part.height, part.width, part.height]


def drag_border(x, y, right, up):
    """Take the border between two areas that is at this place, in Blender's pixels, and move it."""
    down = bpy.context.window_manager.windows[0].height - y
    xdotool(
        *("mousemove", x, down, "sleep", 0.4, "mousedown", 1, "sleep", 0.3),
        *("mousemove", x + right // 2, down - up // 2, "sleep", 0.3),
        *("mousemove", x + right, down - up, "sleep", 0.3, "mouseup", 1),
    )
    yield 2.5


def hide_other_panels():
    """Leave our panels and the choice of the engine in Properties > Render: the others are longer than the screen."""
    classes = [cls for cls in bpy.types.Panel.__subclasses__() if getattr(cls, "bl_context", "") == "render"]
    others = [cls for cls in classes if not cls.__name__.startswith(("LIGHTPANES", "RENDER_PT_context"))]
    while others:
        parents = {getattr(cls, "bl_parent_id", "") for cls in others}
        leaves = [cls for cls in others if getattr(cls, "bl_idname", cls.__name__) not in parents]
        for cls in leaves:
            bpy.utils.unregister_class(cls)
        others = [cls for cls in others if cls not in leaves]


def clean(space):
    """Show the render and the lamp in a viewport, and nothing else."""
    for name in ("header", "tool_header", "toolbar", "ui", "hud"):
        setattr(space, f"show_region_{name}", False)
    space.show_gizmo = False
    overlay = space.overlay
    for name in ("floor", "ortho_grid", "axis_x", "axis_y", "cursor", "text", "stats", "relationship_lines"):
        setattr(overlay, f"show_{name}", False)
    space.region_3d.view_perspective = "CAMERA"


def frame_of(view):
    """Left, top, width and height on the screen of what the camera sees, in a viewport that looks through it."""
    scene, inside = bpy.context.scene, region(view)
    camera = scene.camera
    corners = [
        view3d_utils.location_3d_to_region_2d(inside, view.spaces[0].region_3d, camera.matrix_world @ corner)
        for corner in camera.data.view_frame(scene=scene)
    ]
    left, right = (round(pick(c.x for c in corners)) for pick in (min, max))
    low, high = (round(pick(c.y for c in corners)) for pick in (min, max))
    left, low = max(left, 0), max(low, 0)
    right, high = min(right, inside.width), min(high, inside.height)
    x, y, _, height = box_of(inside)
    return [x + left, y + height - high, right - left, high - low]


class obstacles:
    """While it lasts the scene has what stands in the way of many a bake."""

    def __init__(self, scene):
        self.scene = scene

    def __enter__(self):
        self.scene.eevee.use_raytracing = True
        self.former, self.scene.world = self.scene.world, bpy.data.worlds.new("Grey Sky")
        curve = bpy.data.curves.new("Cable", "CURVE")
        curve.bevel_depth = 0.02
        spline = curve.splines.new("POLY")
        spline.points.add(1)
        spline.points[1].co = (0, 0, 1, 1)
        self.cable = bpy.data.objects.new("Cable", curve)
        self.scene.collection.objects.link(self.cable)

    def __exit__(self, *_):
        bpy.data.objects.remove(self.cable)
        bpy.data.worlds.remove(self.scene.world)
        self.scene.world = self.former
        self.scene.eevee.use_raytracing = False


def panel_shot(name, end=False):
    """A picture of the panel as it is without a search. end: of its lower end."""
    space, inside = area("PROPERTIES").spaces[0], region(area("PROPERTIES"))
    space.search_filter = ""
    yield 1.5
    x, y, width, height = box_of(inside)
    wheel = ["mousemove", x + width // 2, y + height // 2, *["click", 5] * 20, "sleep", 0.5]
    if end:
        xdotool(*wheel)
        yield 1.5
    shot(name)
    if end:
        # away again, so that no tooltip shows
        xdotool(*(4 if word == 5 else word for word in wheel), "mousemove", x + width // 2, 5)
        yield 1.5
    space.search_filter = "Lightpanes"
    yield 1.0


def steps():
    job, store = module("addon.job"), module("addon.store")
    scene = bpy.context.scene
    panel, view = area("PROPERTIES"), area("VIEW_3D")
    hide_other_panels()
    yield from drag_border(panel.x - 1, panel.y + panel.height // 2, -WIDER, 0)
    yield from drag_border(panel.x + panel.width // 2, panel.y + panel.height, 0, HIGHER)
    panel.spaces[0].context = "RENDER"
    panel.spaces[0].search_filter = "Lightpanes"
    scene.lightpanes.resolution = RESOLUTION
    scene.render.engine = "BLENDER_EEVEE" if bpy.app.version >= (5, 0) else "BLENDER_EEVEE_NEXT"
    scene.view_settings.exposure -= 0.4
    lamp = next(item for item in scene.objects if item.type == "LIGHT")
    if place := PLACES.get(Path(FILE).stem):
        lamp.animation_data_clear()
        lamp.location = place
    space = view.spaces[0]
    clean(space)
    bpy.ops.object.select_all(action="DESELECT")
    lamp.select_set(True)
    bpy.context.view_layer.objects.active = lamp
    bpy.ops.ed.undo_push(message="Set up")
    yield 1.0
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=view, region=region(view)):
        bpy.ops.view3d.view_center_camera()
    yield 0.5
    found["panel"], found["view"] = box_of(panel), frame_of(view)
    with obstacles(scene):
        yield from panel_shot("preflight")
    bpy.ops.ed.undo_push(message="Set up")
    yield 1.0
    yield from still("no bake")

    watch = Watch("bake")
    bpy.app.timers.register(watch)
    yield from press_bake()
    panel.spaces[0].search_filter = ""
    yield from until(lambda: job.current().ended or job.current().progress.fraction > 0.5)
    assert not job.current().error, job.current().error
    shot("progress")
    panel.spaces[0].search_filter = "Lightpanes"
    # some systems' own Blender has a numpy whose matrix products take ten times as long
    yield from until(lambda: not job.running(), 900)
    bpy.app.timers.unregister(watch)
    found["report"] = {k: v for k, v in job.current().report.items() if isinstance(v, (int, float, str))}
    yield 0.5
    yield from panel_shot("baked", end=True)

    space.shading.type = "RENDERED"
    yield 45.0
    shot("before")
    pixels = store.find_image(scene, store.IRRADIANCE).pixels[:]
    where = tuple(lamp.matrix_world.translation)
    middle = point(view, region(view).width * 0.5, region(view).height * 0.5)
    xdotool("mousemove", *middle, "sleep", 0.3, "key", "g", "sleep", 0.5)
    yield 1.5
    for k in range(1, 9):
        xdotool("mousemove", middle[0] - 30 * k, middle[1] + 15 * k)
        yield 0.4
    xdotool("click", 1)
    yield 25.0
    shot("after")
    found["moved"] = (lamp.matrix_world.translation - __import__("mathutils").Vector(where)).length
    found["relit"] = store.find_image(scene, store.IRRADIANCE).pixels[:] != pixels
    found["relight_ms"] = module("addon.sessions").of(scene).milliseconds

    space.shading.type = "SOLID"
    scene.lightpanes.seed = 3
    yield 1.0
    for stage in ("Transport", "Exits"):
        key = store.bake_key(scene)
        watch = Watch(f"cancelled at {stage}")
        bpy.app.timers.register(watch)
        yield from press_bake()
        yield from until(lambda stage=stage: job.current().ended or job.current().progress.stage == stage, 200)
        begin = time.perf_counter()
        xdotool("key", "Escape")
        yield from until(lambda: not job.running(), 20)
        found["ends"].append(time.perf_counter() - begin)
        bpy.app.timers.unregister(watch)
        assert store.bake_key(scene) == key and job.current().report is None
        yield 0.5
    shot("cancelled")


def drive(generator):
    """Run the steps from a timer; then say how it ended, and quit."""
    running = generator()

    def tick():
        try:
            return next(running)
        except StopIteration:
            found["error"] = ""
        except BaseException:
            found["error"] = traceback.format_exc()
            shot("error")
        (OUT / "session.json").write_text(json.dumps(found, indent=1))
        os._exit(0)

    bpy.app.timers.register(tick, first_interval=2.0, persistent=True)


bpy.context.preferences.view.show_splash = False
bpy.ops.extensions.package_install_files(
    filepath=os.environ["LIGHTPANES_ZIP"], repo="user_default", enable_on_install=True
)
bpy.ops.wm.open_mainfile(filepath=FILE)
drive(steps)
