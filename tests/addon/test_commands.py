"""The command line: exit codes, one clear line for bad input, and what is written where."""

import json

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import commands, store  # noqa: E402
from lightpanes.core.bake import Progress  # noqa: E402

from .files import REFUSES, needs_a_refusing_folder  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def file(room, tmp_path):
    """A saved room; returns its path."""
    path = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def bake_words(*words):
    return ["bake", *map(str, words), "--error", "0.5", "--resolution", "64"]


def complaint(capsys, *words):
    """The one line on stderr of a command that must fail with code 2."""
    assert commands.main([str(word) for word in words]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("lightpanes: ")
    return lines[0].removeprefix("lightpanes: ")


def test_bake_writes_beside_the_input(file, capsys):
    original = file.read_bytes()
    assert commands.main(bake_words(file)) == 0
    assert file.read_bytes() == original
    assert sorted(p.name for p in file.parent.iterdir()) == ["room.blend", "room_lightpanes.blend"]
    bpy.ops.wm.open_mainfile(filepath=str(file.with_name("room_lightpanes.blend")))
    assert store.load_bake(bpy.context.scene) is not None
    assert "Baked in" in capsys.readouterr().out


def test_bake_into_a_folder(file, tmp_path):
    folder, report = tmp_path / "made" / "here", tmp_path / "report.json"
    assert commands.main(bake_words(file, "--output", folder, "--json", report)) == 0
    names = ["room_lightpanes.blend", "room_lightpanes_irradiance.exr", "room_lightpanes_report.json"]
    assert sorted(p.name for p in folder.iterdir()) == names
    said = json.loads(report.read_text())
    assert said == json.loads((folder / names[2]).read_text())
    assert said["settings"]["error_target"] == 0.5 and said["error"] > 0 and said["input"] == str(file)
    picture = bpy.data.images.load(str(folder / names[1]))
    picture.colorspace_settings.name = "Non-Color"
    shown = np.array(picture.pixels, np.float32)
    assert np.array_equal(shown, np.array(store.find_image(bpy.context.scene, store.IRRADIANCE).pixels, np.float32))
    assert shown.max() > 0


def test_report_on_the_terminal_is_json_and_nothing_else(file, capsys):
    assert commands.main(bake_words(file)) == 0
    capsys.readouterr()
    assert commands.main(["info", str(file.with_name("room_lightpanes.blend")), "--json", "-"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["stale"] == [] and said["error"] > 0


def test_report_on_the_terminal_is_apart_from_what_blender_writes(file, capfd):
    """Its lines come from C, past Python's stdout."""
    assert commands.main(bake_words(file, "--json", "-")) == 0
    out, err = capfd.readouterr()
    assert json.loads(out)["error"] > 0
    assert "Read blend" in err and "Baked in" in err


@pytest.mark.parametrize("report", ["-", "report.json"])
def test_info_comes_before_points_that_are_not_there(file, tmp_path, capsys, report):
    assert commands.main(bake_words(file)) == 0
    capsys.readouterr()
    place = report if report == "-" else str(tmp_path / report)
    baked = str(file.with_name("room_lightpanes.blend"))
    assert commands.main(["info", "--points", "radius", baked, "--json", place]) == 2
    said, told = capsys.readouterr()
    assert "has no points" in told
    assert json.loads(said if report == "-" else (tmp_path / report).read_text())["error"] > 0
    assert "triangles: " in (told if report == "-" else said)


def test_relight(file, tmp_path):
    assert commands.main(bake_words(file)) == 0
    baked = file.with_name("room_lightpanes.blend")
    bpy.ops.wm.open_mainfile(filepath=str(baked))
    bpy.context.scene.lightpanes.live = False
    bpy.data.lights["Lamp"].energy = 0.0
    bpy.ops.wm.save_as_mainfile(filepath=str(baked))
    assert commands.main(["relight", str(baked), "--json", str(tmp_path / "r.json")]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(baked.with_name("room_lightpanes_relit.blend")))
    image = store.find_image(bpy.context.scene, store.IRRADIANCE)
    assert np.array(image.pixels).reshape(-1, 4)[:, :3].max() == 0
    assert json.loads((tmp_path / "r.json").read_text())["stale"] == []


def test_the_same_in_blender(file, capsys):
    """`--command lightpanes bake` works on the open file."""
    bpy.ops.wm.open_mainfile(filepath=str(file))
    assert commands.main(["bake", "--error", "0.5", "--resolution", "64"], opened=True) == 0
    assert file.with_name("room_lightpanes.blend").exists()


def test_nothing_open_in_blender(blender, capsys):
    assert commands.main(["bake"], opened=True) == 2
    assert capsys.readouterr().err == "lightpanes: No .blend is open: name an existing file before --command.\n"


def test_missing_file(blender, tmp_path, capsys):
    path = tmp_path / "none.blend"
    assert complaint(capsys, "bake", path) == f"There is no file '{path}'."


def test_a_folder_is_no_file(blender, tmp_path, capsys):
    assert complaint(capsys, "bake", tmp_path) == f"'{tmp_path}' is not a file."


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04"])
def test_not_a_blend(blender, tmp_path, capsys, content):
    path = tmp_path / "x.blend"
    path.write_bytes(content)
    assert complaint(capsys, "bake", path) == "'x.blend' is not a .blend file."


@pytest.mark.parametrize("keep", [0.05, 0.6])
def test_a_truncated_blend(file, capfd, keep):
    content = file.read_bytes()
    path = file.with_name("cut.blend")
    path.write_bytes(content[: int(keep * len(content))])
    assert complaint(capfd, "bake", path).startswith("Blender can't open 'cut.blend': ")


def test_nothing_to_bake(blender, tmp_path, capsys):
    path = tmp_path / "empty.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    message = "There is nothing to bake: scene 'Scene' has no mesh. Add one."
    assert complaint(capsys, "bake", path) == message
    assert [p.name for p in tmp_path.iterdir()] == ["empty.blend"]


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--error", "0", "argument --error: '0' is not a number from 0.002 to 0.5"),
        ("--error", "nan", "argument --error: 'nan' is not a number from 0.002 to 0.5"),
        ("--error", "small", "argument --error: 'small' is not a number from 0.002 to 0.5"),
        ("--time", "-1", "argument --time: '-1' is not a number from 0 to 1000000"),
        ("--resolution", "3.5", "argument --resolution: '3.5' is not a whole number from 16 to 4096"),
        ("--resolution", "100000", "argument --resolution: '100000' is not a whole number from 16 to 4096"),
    ],
)
def test_bad_numbers(file, capsys, option, value, message):
    assert complaint(capsys, "bake", file, option, value) == f"{message} (see python -m lightpanes bake --help)"


def test_bad_words(blender, capsys):
    assert "invalid choice: 'cook'" in complaint(capsys, "cook")
    assert "FILE.blend" in complaint(capsys, "bake")
    assert "unrecognized arguments: --fast" in complaint(capsys, "bake", "x.blend", "--fast")


@needs_a_refusing_folder
def test_a_folder_that_refuses(file, capsys):
    message = complaint(capsys, "bake", file, "--output", f"{REFUSES}/lightpanes")
    assert message.startswith(f"Can't write to folder '{REFUSES}/lightpanes': ")


def test_a_file_where_the_folder_should_be(file, capsys):
    message = complaint(capsys, "bake", file, "--output", file)
    assert message.startswith(f"Can't write to folder '{file}': ")


def test_report_into_a_missing_folder(file, capsys):
    path = file.with_name("none") / "report.json"
    assert (
        complaint(capsys, "bake", file, "--json", path) == f"Can't write the report to '{path}': its folder must exist."
    )


@needs_a_refusing_folder
@pytest.mark.parametrize("word", ["bake", "info", "chart"])
def test_report_into_a_folder_that_refuses(file, capsys, word):
    """Known before anything is baked."""
    path = f"{REFUSES}/report.json"
    assert complaint(capsys, word, file, "--json", path).startswith(f"Can't write the report to '{path}': ")
    assert [p.name for p in file.parent.iterdir()] == ["room.blend"]


def test_report_over_a_folder(file, tmp_path, capsys):
    message = f"Can't write the report to '{tmp_path}': it is a folder; name a file."
    assert complaint(capsys, "bake", file, "--json", tmp_path) == message


def test_report_over_the_input(file, capsys):
    original = file.read_bytes()
    assert complaint(capsys, "bake", file, "--json", file) == "--json names the .blend itself."
    assert file.read_bytes() == original


@pytest.mark.parametrize("word", ["info", "relight", "animate"])
def test_files_without_a_bake(file, capsys, word):
    rest = "makes room_lightpanes.blend, which has one."
    message = f"'room.blend' has no bake in scene 'Scene'. 'python -m lightpanes bake room.blend' {rest}"
    assert complaint(capsys, word, file) == message
    bpy.ops.wm.open_mainfile(filepath=str(file))
    capsys.readouterr()
    assert commands.main([word], opened=True) == 2
    told = capsys.readouterr().err
    assert told.endswith(f"'blender --background FILE.blend --command lightpanes bake' {rest}\n")


def test_a_frame_in_letters(file, capsys):
    message = "argument --frame: 'abc' is not a whole number from -1048574 to 1048574"
    assert complaint(capsys, "relight", file, "--frame", "abc").startswith(message)


def test_help(blender, capsys):
    assert commands.main(["--help"]) == 0
    assert "bake" in capsys.readouterr().out


def test_interrupting_writes_nothing(file, capsys, monkeypatch):
    def stop(self, progress):
        if progress.fraction > 0.3:
            raise KeyboardInterrupt

    monkeypatch.setattr(commands.Bar, "__call__", stop)
    assert commands.main(bake_words(file)) == 130
    assert capsys.readouterr().err.strip() == "lightpanes: cancelled; nothing was written."
    assert [p.name for p in file.parent.iterdir()] == ["room.blend"]


def test_a_failed_write_leaves_the_old_file(file, monkeypatch, capsys):
    assert commands.main(bake_words(file)) == 0
    target = file.with_name("room_lightpanes.blend")
    before = target.read_bytes()

    def fail(source, destination):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(commands.os, "replace", fail)
    capsys.readouterr()
    assert commands.main(bake_words(file, "--seed", "3")) == 2
    assert capsys.readouterr().err.strip().endswith(f"lightpanes: Can't write '{target}': No space left on device.")
    assert target.read_bytes() == before
    assert sorted(p.name for p in file.parent.iterdir()) == ["room.blend", "room_lightpanes.blend"]


class Stream:
    def __init__(self, terminal):
        self.text, self.terminal = "", terminal

    def isatty(self):
        return self.terminal

    def write(self, text):
        self.text += text

    def flush(self):
        self.text += ""


@pytest.mark.parametrize("terminal", [True, False])
def test_progress(terminal):
    stream = Stream(terminal)
    with commands.Bar(stream) as bar:
        for k in range(1001):
            bar(Progress("Gather", k / 1000, k))
    assert "100 %" in stream.text and stream.text.endswith("\n")
    assert ("\r" in stream.text) == terminal
    assert stream.text.count("\n") == (1 if terminal else 11)
