"""Blender's own `extension` command, as it comes with the pip bpy."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

SCRIPT = "*/scripts/addons_core/bl_pkg/cli/blender_ext.py"


class ToolError(Exception):
    """The tool is missing, or refused; the message says what it said."""


def build(source: Path, target: Path) -> list[Path]:
    """Zip the extension in `source` into the empty folder `target`, a zip a platform. Raises ToolError."""
    _run("build", "--split-platforms", "--source-dir", str(source), "--output-dir", str(target))
    return sorted(target.glob("*.zip"))


def validate(archive: Path) -> None:
    """Raises ToolError unless Blender finds the zip to be a valid extension."""
    _run("validate", str(archive))


def _run(*arguments: str) -> None:
    run = subprocess.run([sys.executable, str(_script()), *arguments], capture_output=True, text=True)
    if run.returncode:
        raise ToolError(f"Blender's `extension {arguments[0]}` refused:\n{run.stdout}{run.stderr}".rstrip())


def _script() -> Path:
    # found, not imported: importing bpy starts a Blender
    found = importlib.util.find_spec("bpy")
    places = found.submodule_search_locations if found is not None else None
    for place in places or ():
        for script in Path(place).glob(SCRIPT):
            return script
    raise ToolError("This Python has no bpy, with which Blender's tool for extensions comes; install it.")
