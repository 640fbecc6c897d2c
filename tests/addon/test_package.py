"""What users install: the zip's contents, an installation that bakes, and Blender where rays can't be traced."""

import ast
import os
import platform
import re
import subprocess
import sys
import textwrap
import tomllib
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")

import lightpanes  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
PYTHON = ".".join(map(str, sys.version_info[:2]))
PLATFORM = {
    ("Linux", "x86_64"): "linux-x64",
    ("Windows", "AMD64"): "windows-x64",
    ("Darwin", "arm64"): "macos-arm64",
}.get((platform.system(), platform.machine()))

# With these a Python program reaches a network, another program, or pip.
OUTSIDE = {
    "aiohttp",
    "asyncio",
    "ensurepip",
    "ftplib",
    "http",
    "httpx",
    "multiprocessing",
    "pip",
    "requests",
    "smtplib",
}
OUTSIDE |= {"socket", "socketserver", "ssl", "subprocess", "urllib", "urllib3", "webbrowser", "xmlrpc"}

# Before anything else in a Blender of its own: no module embreex but one installed under the folder BLENDER_USER_RESOURCES.
ONLY_INSTALLED = """
import importlib.machinery, os, sys

class Installed:
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] != "embreex":
            return None
        inside = [place for place in path or sys.path if place.startswith(os.environ["BLENDER_USER_RESOURCES"])]
        spec = importlib.machinery.PathFinder.find_spec(name, inside)
        if spec is None:
            raise ModuleNotFoundError(f"No module named {name!r}")
        return spec

sys.meta_path.insert(0, Installed)
import bpy
"""


def run_package(*arguments):
    command = [sys.executable, "-m", "package", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)


def run_blender(script, folder, timeout=180):
    """What a script prints in a Blender of its own, whose user resources are in `folder`."""
    (folder / "user").mkdir(exist_ok=True)
    path = folder / "script.py"
    path.write_text(ONLY_INSTALLED + textwrap.dedent(script), "utf-8")
    # Blender 4.5 takes relative paths to start from PWD
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(folder / "user"), "PYTHONPATH": "", "PWD": str(folder)}
    command = [sys.executable, str(path)]
    run = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=timeout)
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout + run.stderr


def pip_finds(requirement, folder):
    probe = [sys.executable, "-m", "pip", "--timeout", "10", "--retries", "1", "download", "--no-deps", requirement]
    try:
        return not subprocess.run([*probe, "--dest", folder / "probe"], capture_output=True, timeout=90).returncode
    except subprocess.TimeoutExpired:
        return False


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """The zip for this machine, for this Python alone."""
    if PLATFORM is None:
        pytest.skip("Lightpanes is not packaged for this system")
    folder = tmp_path_factory.mktemp("package")
    # not embreex, and no version by what is tested here: where pip finds anything, packaging has to work
    if not pip_finds("pluggy", folder):
        pytest.skip("pip reaches no index, so there are no wheels to package")
    run = run_package("--platform", PLATFORM, "--python", PYTHON, "--output", folder)
    assert run.returncode == 0, run.stdout + run.stderr
    [made] = folder.glob("*.zip")
    return made


def read(archive, name):
    with zipfile.ZipFile(archive) as opened:
        return opened.read(name).decode()


def names(archive):
    with zipfile.ZipFile(archive) as opened:
        return {name for name in opened.namelist() if not name.endswith("/")}


def test_the_zip_holds_what_belongs(archive):
    assert archive.name == f"lightpanes-{lightpanes.__version__}-{PLATFORM.replace('-', '_')}.zip"
    sources = {path.relative_to(ROOT).as_posix() for part in ("addon", "core") for path in (ROOT / part).rglob("*.py")}
    sources |= {path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*") if path.is_file()}
    [wheel] = {name for name in names(archive) if name.endswith(".whl")}
    assert names(archive) == sources | {"__init__.py", "blender_manifest.toml", "LICENSE", "README.md", wheel}
    assert wheel.startswith("wheels/embreex-") and f"-cp{PYTHON.replace('.', '')}-" in wheel


def test_every_folder_of_the_core_is_installed():
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    folders = {ROOT / part for part in ("addon", "core")} | {
        path.parent for path in (ROOT / "core").rglob("__init__.py")
    }
    assert listed == {"lightpanes"} | {f"lightpanes.{'.'.join(path.relative_to(ROOT).parts)}" for path in folders}


def test_links_of_readme_and_manual_lead_to_files_in_the_zip(archive):
    for page in ("README.md", "docs/manual.md"):
        links = re.findall(r"\]\((?!https?:)([^)#]+)\)", read(archive, page))
        assert links
        for link in links:
            assert (Path(page).parent / link).as_posix() in names(archive), f"{page}: {link}"


def test_the_wheel_is_unmodified(archive, tmp_path):
    [wheel] = {name for name in names(archive) if name.endswith(".whl")}
    assert pip_finds(f"embreex=={version('embreex')}", tmp_path)
    with zipfile.ZipFile(archive) as opened:
        assert opened.read(wheel) == (tmp_path / "probe" / Path(wheel).name).read_bytes()


def test_the_manifest(archive):
    manifest = tomllib.loads(read(archive, "blender_manifest.toml"))
    assert manifest["platforms"] == [PLATFORM]
    assert {Path(wheel).as_posix() for wheel in manifest["wheels"]} == {n for n in names(archive) if ".whl" in n}
    assert list(manifest["permissions"]) == ["files"]


def test_one_version_everywhere():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert manifest["version"] == project["version"] == lightpanes.__version__
    assert "wheels" not in manifest and list(manifest["permissions"]) == ["files"]


def test_no_source_reaches_outside():
    """No network, no other program, no pip; imports of our own are relative, and sys.path stays as it is."""
    files = [ROOT / "__init__.py", *(ROOT / "addon").rglob("*.py"), *(ROOT / "core").rglob("*.py")]
    for path in files:
        text = path.read_text("utf-8")
        imported = set()
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                imported.add(node.module.partition(".")[0])
        assert not imported & (OUTSIDE | {"lightpanes"}), path
        assert "sys.path" not in text, path


def test_installed_it_bakes_and_stays_offline(archive, tmp_path):
    said = run_blender(
        f"""
        reached = []
        sys.addaudithook(lambda event, _: event.startswith("socket.") and reached.append(event))
        done = bpy.ops.extensions.package_install_files(
            filepath={str(archive)!r}, repo="user_default", enable_on_install=True
        )
        assert done == {{"FINISHED"}}, done
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
        bpy.ops.mesh.primitive_cube_add(size=2)
        bpy.context.object.data.flip_normals()
        bpy.ops.object.light_add(type="POINT", location=(0.3, 0.2, 0.4))
        scene = bpy.context.scene
        scene.lightpanes.resolution, scene.lightpanes.error_target = 32, 0.3
        assert bpy.ops.lightpanes.bake() == {{"FINISHED"}}
        pixels = bpy.data.images["Lightpanes Irradiance"].pixels[:]
        assert max(pixels[::4]) > 0
        import embreex
        print("embreex:", embreex.__path__[0])
        print("module:", sys.modules["bl_ext.user_default.lightpanes"].__file__)
        assert "lightpanes" not in sys.modules
        assert not reached, reached
        import addon_utils
        addon_utils.disable("bl_ext.user_default.lightpanes")
        assert not hasattr(bpy.types.Scene, "lightpanes")
        print("baked")
        """,
        tmp_path,
    )
    assert "baked" in said.splitlines()
    for line in said.splitlines():
        if line.startswith(("embreex:", "module:")):
            assert str(tmp_path / "user") in line


NO_RAYS = f"""
    import importlib.util
    spec = importlib.util.spec_from_file_location(
        "lightpanes", {str(ROOT / "__init__.py")!r}, submodule_search_locations=[{str(ROOT)!r}]
    )
    lightpanes = sys.modules["lightpanes"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(lightpanes)
    lightpanes.register()
"""


def test_without_embreex_it_explains_itself(tmp_path):
    said = run_blender(
        NO_RAYS
        + """
    from types import SimpleNamespace
    from unittest.mock import MagicMock
    from lightpanes.addon import commands, engine, panel

    reason = engine.unusable()
    assert "embreex" in reason and reason.count(". ") == 0 and reason.endswith(".")
    assert not bpy.ops.lightpanes.bake.poll()
    try:
        bpy.ops.lightpanes.bake()
    except RuntimeError as error:
        assert reason in str(error), error
    else:
        raise AssertionError("it baked")

    layout = MagicMock()
    window = {"region": SimpleNamespace(width=600), "preferences": SimpleNamespace(system=SimpleNamespace(ui_scale=1))}
    here = {name: getattr(bpy.context, name) for name in ("scene", "view_layer", "mode", "screen", "object")}
    context = SimpleNamespace(**here, **window)
    panel.LIGHTPANES_PT_render.draw(SimpleNamespace(begin=lambda: layout), context)
    labels = [call.kwargs["text"] for call in layout.mock_calls if call[0].endswith("label")]
    assert reason in " ".join(labels), labels

    bpy.ops.wm.save_as_mainfile(filepath="scene.blend")
    assert commands.main(["bake", "scene.blend"]) == 2
    print("explained")
    """,
        tmp_path,
    )
    assert "explained" in said.splitlines() and "Traceback" not in said
    assert any(line.startswith("lightpanes:") and "embreex" in line for line in said.splitlines())
    assert (tmp_path / "scene.blend").exists() and not (tmp_path / "scene_lightpanes.blend").exists()


def test_without_embreex_handlers_say_it_once(room, quick, tmp_path):
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    path = tmp_path / "baked.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    said = run_blender(
        NO_RAYS
        + f"""
    from lightpanes.addon import engine, relight
    from lightpanes.core.scene import SceneError

    for _ in range(2):
        bpy.ops.wm.open_mainfile(filepath={str(path)!r})
        before = bpy.data.images["Lightpanes Irradiance"].pixels[:]
        for x in (0.1, 0.2, 0.3):
            bpy.data.objects["Lamp"].location.x = x
            bpy.context.view_layer.update()
            bpy.context.scene.frame_set(int(10 * x))
        assert bpy.data.images["Lightpanes Irradiance"].pixels[:] == before
    try:
        relight.relight(bpy.context)
    except SceneError as error:
        assert str(error) == engine.unusable()
    else:
        raise AssertionError("it relit")
    print("kept")
    """,
        tmp_path,
    )
    assert "kept" in said.splitlines()
    assert said.count("embreex does not load") == 1 and "Traceback" not in said


def test_a_wheel_that_does_not_exist_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    run = run_package("--platform", "windows-x64", "--python", "3.14", "--output", tmp_path / "zips")
    assert run.returncode == 1 and not (tmp_path / "zips").exists()
    [line] = run.stderr.splitlines()
    assert "embreex==" in line and "windows-x64" in line and "Python 3.14" in line
