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

OUT = Path(os.environ["LIGHTPANES_OUT"])
FILE = os.environ["LIGHTPANES_FILE"]
RESOLUTION = int(os.environ["LIGHTPANES_RESOLUTION"])
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


def steps():
    job, store = module("addon.job"), module("addon.store")
    scene = bpy.context.scene
    panel, view = area("PROPERTIES"), area("VIEW_3D")
    panel.spaces[0].context = "RENDER"
    panel.spaces[0].search_filter = "Lightpanes"
    scene.lightpanes.resolution = RESOLUTION
    space = view.spaces[0]
    space.region_3d.view_perspective = "CAMERA"
    space.overlay.show_overlays = False
    bpy.ops.ed.undo_push(message="Set up")
    yield 0.5
    yield from still("no bake")
    shot("start")

    watch = Watch("bake")
    bpy.app.timers.register(watch)
    yield from press_bake()
    yield from until(lambda: job.current().ended or job.current().progress.fraction > 0.2)
    assert not job.current().error, job.current().error
    shot("progress")
    yield from until(lambda: not job.running(), 300)
    bpy.app.timers.unregister(watch)
    found["report"] = {k: v for k, v in job.current().report.items() if isinstance(v, (int, float, str))}
    yield 0.5
    shot("baked")

    space.shading.type = "RENDERED"
    scene.render.engine = "BLENDER_EEVEE" if bpy.app.version >= (5, 0) else "BLENDER_EEVEE_NEXT"
    yield 25.0
    shot("before")
    lamp = next(item for item in scene.objects if item.type == "LIGHT")
    bpy.ops.object.select_all(action="DESELECT")
    lamp.select_set(True)
    bpy.context.view_layer.objects.active = lamp
    pixels = store.find_image(scene, store.IRRADIANCE).pixels[:]
    where = tuple(lamp.matrix_world.translation)
    middle = point(view, region(view).width * 0.5, region(view).height * 0.5)
    xdotool("mousemove", *middle, "sleep", 0.3, "key", "g", "sleep", 0.5)
    yield 1.5
    for k in range(1, 9):
        xdotool("mousemove", middle[0] - 12 * k, middle[1] + 4 * k)
        yield 0.4
    xdotool("click", 1)
    yield 8.0
    shot("after")
    found["moved"] = (lamp.matrix_world.translation - __import__("mathutils").Vector(where)).length
    found["relit"] = store.find_image(scene, store.IRRADIANCE).pixels[:] != pixels
    found["relight_ms"] = module("addon.relight").session(scene).milliseconds
    box = region(view)
    height = bpy.context.window_manager.windows[0].height
    found["view"] = [box.x, height - box.y - box.height, box.width, box.height]

    space.shading.type = "SOLID"
    # whose panels leave ours on the screen
    scene.render.engine = "CYCLES"
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

    view.type = "PROPERTIES"
    view.spaces[0].context = "RENDER"
    view.spaces[0].search_filter = "Lightpanes"
    yield 2.0
    shot("panel")
    view.type = "VIEW_3D"
    yield 1.0


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
