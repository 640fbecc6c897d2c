"""A bake on a thread: the same result, cancelled at any moment, and whatever the user does meanwhile."""

import functools
import time

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import baking, job, relight, sessions, store  # noqa: E402
from lightpanes.core.scene import SceneError  # noqa: E402

from .test_operators import bake_state, everything  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture(autouse=True)
def ended():
    yield
    job.cancel()
    while job.current() is not None and job.current().thread is not None:
        time.sleep(0.01)
    job._kept.clear()


def drive(until=lambda progress: False, running=None):
    """Advance a bake, a new one if none is given, until it has ended or its progress is as asked."""
    running = running or job.start(bpy.context)
    while not running.advance() and not until(running.progress):
        time.sleep(0.002)
    return running


def stage(name):
    return lambda progress: progress.stage == name


STAGES = ["Atlas", "Surfaces", "Transport", "Lamps", "Panes", "Exits", "Storing"]


def test_it_bakes_what_the_blocking_one_does(room):
    baking.bake_scene(bpy.context)
    images = {name: image.tobytes() for name, image in store.load_bake(room).images.items()}
    bpy.ops.lightpanes.clear()
    ended = drive()
    assert ended.report["error"] < 0.5 and not ended.error and not job.running()
    assert {name: image.tobytes() for name, image in store.load_bake(room).images.items()} == images
    assert sessions.of(room).relighter is not None and not relight.check_stale(bpy.context)


def test_progress_never_goes_back_and_tells_time_and_error(room, monkeypatch):
    # an error is known once a bake was tried, and with entries set by hand none is
    quick = baking.Settings
    monkeypatch.setattr(baking, "Settings", functools.partial(quick.func, **(quick.keywords | {"entries": None})))
    room.lightpanes.error_target = 0.3
    seen, told, tell = [], [], job._Thread._told
    # between two looks of the main thread much may go by
    monkeypatch.setattr(job._Thread, "_told", lambda self, progress: (told.append(progress), tell(self, progress)))
    ended = drive(lambda progress: seen.append(progress))
    # what core tells last is not the end
    assert told and "Done" not in {progress.stage for progress in told}
    fractions = [progress.fraction for progress in seen]
    assert fractions == sorted(fractions)
    assert ended.progress.fraction == 1
    assert any(progress.seconds_left is not None for progress in told)
    assert any(progress.error is not None and progress.error > 0 for progress in told)
    assert "M rays" in job.facts(told[-1])


@pytest.mark.parametrize("at", STAGES)
def test_cancelled_at_any_stage_it_leaves_what_was_there(room, monkeypatch, at):
    monkeypatch.setattr(job, "SLICE", 0.0)
    baking.bake_scene(bpy.context)
    state, names = bake_state(room), everything()
    room.lightpanes.seed = 7
    bpy.data.objects["Block"].scale.x *= 1.2
    bpy.context.view_layer.update()
    tell = job._Thread._told

    def tell_slowly(self, progress):
        tell(self, progress)
        # or a short stage is over before the main thread looks
        time.sleep(0.02 * (progress.stage == at))

    monkeypatch.setattr(job._Thread, "_told", tell_slowly)
    running = drive(stage(at))
    assert running.progress.stage == at
    running.cancel()
    assert running.advance() and running.report is None and not running.error
    assert bake_state(room) == state
    assert everything() == names


@pytest.mark.parametrize("part", [0.972, 0.976, 0.98])
def test_cancelled_while_it_stores_it_leaves_what_was_there(room, monkeypatch, part):
    monkeypatch.setattr(job, "SLICE", 0.0)
    baking.bake_scene(bpy.context)
    state, names = bake_state(room), everything()
    room.lightpanes.seed = 7
    counts = [len(bpy.data.images)]

    def until(progress):
        counts.append(len(bpy.data.images))
        return progress.stage == "Storing" and progress.fraction >= part

    running = drive(until)
    assert counts[-1] > counts[0] and max(np.diff(counts)) == 1
    running.cancel()
    assert running.advance() and running.report is None and not running.error
    assert bake_state(room) == state
    assert everything() == names


@pytest.mark.parametrize("part", [0.985, 0.99, 0.995])
def test_cancelled_once_the_new_bake_is_there_it_is_finished(room, monkeypatch, part):
    monkeypatch.setattr(job, "SLICE", 0.0)
    running = drive(lambda progress: progress.stage == "Storing" and progress.fraction >= part)
    bpy.data.objects["Block"].location.x += 0.3
    bpy.context.view_layer.update()
    running.cancel()
    assert running.ended and running.report["error"] < 0.5 and not running.error
    # what moved after the bake had noted where things are is found by looking again
    moved = ("'Block' was moved or edited since the bake; bake again.",)
    assert relight.check_stale(bpy.context) == moved
    assert not store.find_image(room, store.IRRADIANCE).is_dirty


def test_cancelled_at_its_very_end_it_is_finished(room, monkeypatch):
    monkeypatch.setattr(job, "SLICE", 0.0)
    running = drive(lambda progress: progress.stage == "Done" and progress.fraction == 1)
    assert not running.ended
    running.cancel()
    assert running.ended and running.report["error"] < 0.5 and not running.error


def test_a_second_press_goes_on_from_there(room):
    whole = baking.bake_scene(bpy.context)
    images = {name: image.tobytes() for name, image in store.load_bake(room).images.items()}
    bpy.ops.lightpanes.clear()
    drive(stage("Exits")).cancel()
    again = drive()
    assert again.report["rays"] < 0.7 * whole["rays"]
    assert {name: image.tobytes() for name, image in store.load_bake(room).images.items()} == images


def test_one_bake_at_a_time(room):
    running = drive(stage("Lamps"))
    assert not bpy.ops.lightpanes.bake.poll() and not bpy.ops.lightpanes.clear.poll()
    with pytest.raises(SceneError, match="A bake is running"):
        job.start(bpy.context)
    assert bpy.ops.lightpanes.cancel() == {"FINISHED"}
    assert running.ended and not bpy.ops.lightpanes.cancel.poll()
    assert drive().report is not None


def test_an_object_deleted_meanwhile(room):
    running = drive(stage("Transport"))
    bpy.data.objects.remove(bpy.data.objects["Block"])
    drive(running=running)
    assert running.report is not None
    assert relight.check_stale(bpy.context) == ("'Block' was deleted or hidden since the bake; bake again.",)


def test_an_object_deleted_while_it_is_read(room):
    running = job.start(bpy.context)
    while not running.progress.fraction:
        running.advance()
    bpy.data.meshes.remove(bpy.data.objects["Block"].data)
    drive(running=running)
    assert running.report is None and running.error == "The scene changed while it was read: bake again."
    assert not [name for name in everything()["properties"] if "lightpanes" in name[1]]


def test_an_object_moved_meanwhile_is_stale(room):
    running = drive(stage("Transport"))
    bpy.data.objects["Block"].location.x += 0.3
    bpy.context.view_layer.update()
    drive(running=running)
    assert running.report is not None
    assert relight.check_stale(bpy.context) == ("'Block' was moved or edited since the bake; bake again.",)


def test_an_object_added_meanwhile_is_stale(room):
    running = drive(stage("Transport"))
    bpy.ops.mesh.primitive_cube_add(size=0.2, location=(-0.5, 0.5, 0.5))
    bpy.context.object.name = "Late"
    drive(running=running)
    assert running.report is not None
    assert relight.check_stale(bpy.context) == ("'Late' was added since the bake; bake again.",)


def test_a_mesh_edited_meanwhile(room):
    running = drive(stage("Transport"))
    mesh = bpy.data.objects["Block"].data
    mesh.clear_geometry()
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    before = everything()
    drive(running=running)
    assert running.report is None and "was edited while the bake ran" in running.error
    assert everything() == before


def test_renamed_meanwhile(room):
    running = drive(stage("Transport"))
    bpy.data.objects["Block"].name = "Crate"
    room.name = "Set"
    drive(running=running)
    assert running.report is not None and store.load_bake(bpy.context.scene) is not None
    assert "lightpanes_scale" in bpy.data.objects["Crate"]


def test_a_lamp_moved_meanwhile_shows(room):
    running = drive(stage("Transport"))
    lamp = bpy.data.objects["Lamp"]
    lamp.location.x += 0.4
    bpy.context.view_layer.update()
    drive(running=running)
    shown = np.array(store.find_image(room, store.IRRADIANCE).pixels)
    relight.relight(bpy.context)
    assert np.array_equal(shown, np.array(store.find_image(room, store.IRRADIANCE).pixels)) and shown.max() > 0


def test_another_scene_on_the_screen(room):
    running = drive(stage("Transport"))
    bpy.ops.scene.new(type="EMPTY")
    other = bpy.context.scene
    drive(running=running)
    assert running.report is not None
    assert store.load_bake(other) is None and store.load_bake(bpy.data.scenes[room.name]) is not None


def test_the_scene_deleted_meanwhile(room):
    running = drive(stage("Transport"))
    bpy.ops.scene.new(type="EMPTY")
    bpy.data.scenes.remove(room)
    drive(running=running)
    assert running.report is None and running.error == "The scene was deleted while it was baked."


@pytest.mark.parametrize("at", ["Atlas", "Transport"])
def test_another_file_loaded_meanwhile(room, tmp_path, at):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    running = drive(stage(at))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    assert running.ended and running.report is None and not running.error
    assert store.load_bake(bpy.context.scene) is None
    assert drive().report is not None


def test_undo_meanwhile(room):
    bpy.ops.ed.undo_push(message="Before")
    bpy.data.objects["Block"].location.z += 0.2
    bpy.ops.ed.undo_push(message="Moved")
    running = drive(stage("Transport"))
    bpy.ops.ed.undo()
    drive(running=running)
    assert running.report is not None
    assert relight.check_stale(bpy.context) == ("'Block' was moved or edited since the bake; bake again.",)


def test_undo_while_the_scene_is_read_cancels(room):
    bpy.ops.ed.undo_push(message="Before")
    bpy.data.objects["Block"].location.z += 0.2
    bpy.ops.ed.undo_push(message="Moved")
    running = drive(lambda progress: progress.fraction > 0)
    bpy.ops.ed.undo()
    assert running.ended and not running.error
    assert not [name for name in everything()["properties"] if "lightpanes" in name[1]]
