"""Starts Blender with a window, lets `session.py` act in it like a person, and returns what came of it.

The variable BLENDER_WINDOW names a command that takes SCRIPT PICTURE SECONDS and runs the script in a Blender window on
some display. Without it the Blender that BLENDER names, or `blender` on PATH, opens on the display that is there. The
display needs xdotool and ImageMagick's import beside it.
"""

import json
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SESSION = Path(__file__).with_name("session.py")
SECONDS = 1500


def blender() -> str | None:
    """The Blender to test with."""
    return os.environ.get("BLENDER") or shutil.which("blender")


def missing() -> str:
    """Why there can be no window here; empty where there can."""
    if os.environ.get("BLENDER_WINDOW"):
        return ""
    if not blender():
        return "no Blender: put it on PATH, or name it in the variable BLENDER"
    if not os.environ.get("DISPLAY"):
        return "no display"
    gone = [tool for tool in ("xdotool", "import") if not shutil.which(tool)]
    return f"no {gone[0]}" if gone else ""


def session(folder: Path, archive: Path, sample: str = "cornell", resolution: int = 128) -> dict:
    """What `session.py` found in this sample; its pictures are in the folder. archive: the extension's zip."""
    for file in (SESSION, archive, ROOT / "sample_blends" / f"{sample}.blend"):
        if file.parent != folder:
            shutil.copy(file, folder)
    script, picture = folder / SESSION.name, folder / "end.png"
    if command := os.environ.get("BLENDER_WINDOW"):
        words = [*shlex.split(command), script, picture, SECONDS]
    else:
        words = [blender(), "--factory-startup", "--window-geometry", "0", "0", "1280", "800", "-P", script]
    environment = {
        **os.environ,
        "LIGHTPANES_OUT": str(folder),
        "LIGHTPANES_ZIP": str(folder / archive.name),
        "LIGHTPANES_FILE": str(folder / f"{sample}.blend"),
        "LIGHTPANES_RESOLUTION": str(resolution),
    }
    done = subprocess.run(
        [str(word) for word in words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=SECONDS + 120,
    )
    said = folder / "session.json"
    if not said.exists():
        raise RuntimeError(f"the session left no word:\n{done.stdout[-4000:]}{done.stderr[-4000:]}")
    found = json.loads(said.read_text())
    if found["error"]:
        raise RuntimeError(f"{found['error']}\n{done.stdout[-4000:]}")
    return found


def python_of_blender(folder: Path) -> str:
    """The Python version that this Blender brings, "3.13"; PYTHON_OF_BLENDER says it where Blender can't be asked."""
    if said := os.environ.get("PYTHON_OF_BLENDER"):
        return said
    asked = "import sys; print('python', *sys.version_info[:2], sep='.')"
    command = [blender(), "--background", "--factory-startup", "--python-expr", asked]
    told = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=True).stdout
    return next(line.removeprefix("python.") for line in told.splitlines() if line.startswith("python."))


def build(folder: Path, python: str) -> Path:
    """The extension's zip for this system and a Blender of this Python."""
    system = {"linux": "linux-x64", "win32": "windows-x64", "darwin": "macos-arm64"}[sys.platform]
    command = [sys.executable, "-m", "package", "--platform", system, "--python", python, "--output", folder]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    if built.returncode:
        raise RuntimeError(built.stdout + built.stderr)
    [made] = folder.glob("*.zip")
    return made


def cut_pictures(folder: Path, found: dict, target: Path) -> None:
    """What README and manual show: the viewport before and after, and the panel at three moments."""
    import matplotlib.pyplot as plt
    import numpy as np

    def cut(name, box):
        x, y, width, height = box
        return plt.imread(folder / f"{name}.png")[y : y + height, x : x + width, :3]

    x, y, width, height = found["view"]
    views = {name: cut(name, (x + 3, y + 3, width - 6, height - 6)) for name in ("before", "after")}
    # without the black beside the room
    seen = np.flatnonzero(np.median(views["before"].max(axis=2), axis=0) > 0.05)
    for name, view in views.items():
        plt.imsave(target / f"{name}.png", view[:, seen[0] : seen[-1] + 1])
    for name in ("preflight", "progress", "baked"):
        part = cut(name, found["panel"])
        # down to where the editor is empty
        filled = np.flatnonzero(np.ptp(part[:-8, 60:-20], axis=1).max(axis=1) > 0.05)
        plt.imsave(target / f"{name}.png", part[: filled.max() + 12])
