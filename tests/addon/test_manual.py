"""What README and manual print is true: the script runs, the command lines parse, settings have these values."""

import re
import shlex
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import commands, properties, sequence  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
PAGES = ("README.md", "docs/manual.md")


def blocks(page, language):
    text = (ROOT / page).read_text("utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def test_the_script_runs_as_printed(room, quick, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    [code] = blocks("docs/manual.md", "python")
    names = {}
    before, _, after = code.partition("lamp.location.x")
    exec(compile(before, "docs/manual.md", "exec"), names)
    baked = bpy.data.images["Lightpanes Irradiance"].pixels[:]
    exec(compile("lamp.location.x" + after, "docs/manual.md", "exec"), names)
    assert names["light"] != baked and max(names["light"]) > 0
    # plain colours and no sky: neither Albedo nor Direct
    assert [path.name for path in (tmp_path / "light").iterdir()] == ["Lightpanes Irradiance.exr"]
    frames = [f"irradiance_{number:04d}.exr" for number in (1, 2, 3)]
    assert sorted(path.name for path in (tmp_path / "frames").iterdir()) == [*frames, sequence.MANIFEST]


@pytest.mark.parametrize("page", PAGES)
def test_command_lines_parse(page):
    lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
    lines += re.findall(r"`(python -m lightpanes [^`]+)`", (ROOT / page).read_text("utf-8"))
    tried = 0
    for words in (shlex.split(line, comments=True) for line in lines):
        if words[:3] == ["python", "-m", "lightpanes"]:
            commands._parser(False).parse_args(commands._spelled_out(words[3:]))
            tried += 1
        elif words[:1] == ["blender"] and "lightpanes" in words:
            commands._parser(True).parse_args(words[words.index("lightpanes") + 1 :])
            tried += 1
    assert tried >= 3


def test_every_setting_is_in_the_manual(blender):
    manual = (ROOT / "docs/manual.md").read_text("utf-8")
    for name, group in (("scene", "SceneSettings"), ("object", "ObjectSettings"), ("light", "LightSettings")):
        [row] = re.findall(rf"^\| `{name}\.lightpanes` \|(.*)\|$", manual, re.MULTILINE)
        told = set(re.findall(r"`([a-z_]+)`", row))
        shown = {
            rna.identifier
            for rna in getattr(properties, group).bl_rna.properties
            if not (rna.is_hidden or rna.is_readonly or rna.identifier == "name")
        }
        assert told == shown
        for rna in getattr(properties, group).bl_rna.properties:
            if rna.identifier in told and rna.type == "ENUM":
                assert set(rna.enum_items.keys()) <= set(re.findall(r'"([A-Z]+)"', row))
