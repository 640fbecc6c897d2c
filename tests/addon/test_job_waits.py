"""A bake waits where it can't touch the scene just now, and loses nothing by it."""

import time

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import baking, job, relight, sessions, store, vertices, waiting  # noqa: E402
from lightpanes.core.scene import SceneError  # noqa: E402

from .test_job import drive, ended, stage  # noqa: E402, F401
from .test_operators import bake_state, everything  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")

EDIT_MODE, RENDER = "Waiting for you to leave Edit Mode", "Waiting for the render"


def edit(name="Block"):
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.objects.active = bpy.data.objects[name]
    bpy.ops.object.mode_set(mode="EDIT")


def leave():
    bpy.ops.object.mode_set(mode="OBJECT")


def is_waiting(_progress):
    return bool(job.current().waiting)


@pytest.fixture
def rendering(monkeypatch):
    """A switch that makes Blender say that a render runs."""
    state = {"on": False}
    monkeypatch.setattr(waiting, "renders", lambda: state["on"])
    return state


@pytest.mark.parametrize("target", ["TEXTURE", "VERTICES"])
def test_edit_mode_when_the_light_is_found(room, target):
    """The bake is what it would have been, the mesh that was being edited included."""
    bpy.data.objects["Block"].lightpanes.target = target
    whole = baking.bake_scene(bpy.context)
    state = bake_state(room)
    running = drive(stage("Transport"))
    edit()
    drive(is_waiting, running)
    assert running.waiting == EDIT_MODE and job.running()
    leave()
    drive(running=running)
    assert running.report["error"] == whole["error"] and not running.waiting
    assert bake_state(room)[:2] == state[:2]
    if target == "VERTICES":
        assert vertices.lit(room) == [bpy.data.objects["Block"]]
    assert not relight.check_stale(bpy.context)


@pytest.mark.parametrize("at", ["Atlas", "Reading the scene"])
def test_edit_mode_while_the_scene_is_read(room, monkeypatch, at):
    monkeypatch.setattr(job, "SLICE", 0.0)
    baking.bake_scene(bpy.context)
    state = bake_state(room)
    running = drive(stage(at))
    edit()
    drive(is_waiting, running)
    assert running.waiting == EDIT_MODE
    leave()
    drive(running=running)
    assert running.report is not None and bake_state(room)[0] == state[0]


@pytest.mark.parametrize("at", ["Atlas", "Reading the scene", "Storing"])
def test_cancelled_in_edit_mode(room, monkeypatch, at):
    monkeypatch.setattr(job, "SLICE", 0.0)
    baking.bake_scene(bpy.context)
    state, names = bake_state(room), everything()
    bpy.data.objects["Block"].lightpanes.weight = 5
    running = drive(stage(at))
    edit()
    drive(is_waiting, running)
    running.cancel()
    assert running.ended and running.report is None and not running.error
    leave()
    assert bake_state(room) == state and everything() == names


def test_cancelled_while_it_waits_it_goes_on_from_there(room):
    whole = baking.bake_scene(bpy.context)
    bpy.ops.lightpanes.clear()
    running = drive(stage("Transport"))
    edit()
    drive(is_waiting, running)
    running.cancel()
    leave()
    seen = []
    again = drive(lambda progress: seen.append(progress.stage))
    assert again.report["error"] == whole["error"] and "Transport" not in seen


def test_another_mesh_in_edit_mode(room):
    """One that only blocks light: its shape is part of the fingerprint."""
    bpy.data.objects["Block"].lightpanes.exclude = True
    running = drive(stage("Transport"))
    edit()
    drive(is_waiting, running)
    leave()
    assert drive(running=running).report is not None
    assert not relight.check_stale(bpy.context)


def test_dynamic_topology(room):
    running = drive(stage("Transport"))
    bpy.context.view_layer.objects.active = bpy.data.objects["Block"]
    bpy.ops.object.mode_set(mode="SCULPT")
    bpy.ops.sculpt.dynamic_topology_toggle()
    drive(is_waiting, running)
    assert running.waiting == "Waiting for you to leave Sculpt Mode"
    bpy.ops.object.mode_set(mode="OBJECT")
    drive(running=running)
    # it wrote the mesh anew, of triangles
    assert "was edited while the bake ran" in running.error


@pytest.mark.parametrize("target", ["TEXTURE", "VERTICES"])
def test_a_mesh_exchanged_meanwhile(room, target):
    bpy.data.objects["Block"].lightpanes.target = target
    running = drive(stage("Transport"))
    block = bpy.data.objects["Block"]
    block.data = bpy.data.objects["Room"].data.copy()
    before = everything()
    drive(running=running)
    assert running.report is None and running.error == "'Block' has another mesh than when the bake began: bake again."
    assert everything() == before


def test_a_render_meanwhile(room, rendering):
    running = drive(stage("Transport"))
    rendering["on"] = True
    drive(is_waiting, running)
    assert running.waiting == RENDER and store.load_bake(room) is None
    assert not bpy.ops.lightpanes.bake.poll()
    rendering["on"] = False
    assert drive(running=running).report is not None


def test_no_bake_begins_while_a_render_runs(room, rendering):
    rendering["on"] = True
    assert not bpy.ops.lightpanes.bake.poll()
    with pytest.raises(SceneError, match="A render is running: wait until it is done"):
        baking.bake_scene(bpy.context)
    rendering["on"] = False
    assert bpy.ops.lightpanes.bake.poll()


@pytest.mark.parametrize("item", ["Room", "Hidden"])
def test_no_bake_begins_in_edit_mode(room, item):
    if item == "Hidden":
        mesh = bpy.data.objects["Block"].copy()
        mesh.data = mesh.data.copy()
        mesh.name, mesh.hide_render = item, True
        room.collection.objects.link(mesh)
        bpy.context.view_layer.update()
    edit(item)
    with pytest.raises(SceneError, match=f"'{item}' is in Edit Mode: leave it"):
        baking.bake_scene(bpy.context)


def test_cancelled_too_late_it_is_finished(room, monkeypatch):
    """From the moment at which the new bake is in place."""
    monkeypatch.setattr(job, "SLICE", 0.0)
    running = drive(lambda _: store.find_entries(room) is not None)
    running.cancel()
    assert running.advance() and running.report is not None and not running.error
    assert sessions.of(room).shown and not relight.check_stale(bpy.context)
    assert np.array(store.find_image(room, store.IRRADIANCE).pixels).max() > 0


def test_the_last_step_is_too_late(room, monkeypatch):
    monkeypatch.setattr(job, "SLICE", 0.0)
    running = drive(stage("Done"))
    running.cancel()
    assert running.ended and running.report is not None and not running.error


def test_a_fault_is_said(room, monkeypatch, capsys):
    def fail(*_):
        raise ZeroDivisionError("of nothing")

    monkeypatch.setattr(baking.points, "remember", fail)
    running = drive()
    assert running.report is None and running.error == "The bake failed (ZeroDivisionError: of nothing)."
    assert "ZeroDivisionError: of nothing" in capsys.readouterr().err


def test_what_is_kept_goes_with_its_file(room, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    drive(stage("Exits")).cancel()
    settle()
    assert job._kept.parts
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    assert not job._kept.parts


@pytest.mark.parametrize("end", ["clear", "bake", "unregister"])
def test_what_is_kept_goes_with_its_use(room, end):
    drive(stage("Exits")).cancel()
    settle()
    assert job._kept.parts
    if end == "clear":
        bpy.ops.lightpanes.clear()
    elif end == "bake":
        bpy.ops.lightpanes.bake()
    else:
        job.unregister()
        job.register()
    assert not job._kept.parts


def test_a_cancelled_bake_lets_its_result_go(room):
    running = drive(stage("Transport"))
    thread = running._thread
    thread.join()
    running.cancel()
    assert thread.result is None and running._thread is None and running._answer is None


def settle():
    while job.current().thread is not None:
        time.sleep(0.01)
