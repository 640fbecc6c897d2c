"""Embreex's wheels, as pip finds them: one for each system and Python that Lightpanes is packaged for, unmodified."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from .stage import ROOT

# Blender's name of a system → the newest wheel tags that its users can be expected to load.
PLATFORMS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux_2_17_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_13_0_arm64",),
}
PYTHONS = ("3.11", "3.13", "3.14")


class WheelError(Exception):
    """A wheel can't be had; the message says which one and why."""


def pinned() -> str:
    """`embreex==version` as in requirements/, where all locks must agree. Raises WheelError where they don't."""
    locks = sorted((ROOT / "requirements").glob("*.lock"))
    lines = {line.strip() for lock in locks for line in lock.read_text("utf-8").splitlines()}
    found = sorted(line for line in lines if line.startswith("embreex=="))
    if len(found) != 1:
        raise WheelError(f"requirements/ must pin one version of embreex, and pins {', '.join(found) or 'none'}.")
    return found[0]


def download(folder: Path, platform: str, python: str) -> Path:
    """The wheel for a key of PLATFORMS and a Python such as "3.13", put into a folder of its own in `folder`.

    Raises WheelError.
    """
    requirement, place = pinned(), folder / f"{platform}-{python}"
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:"]
    command += ["--dest", str(place), "--python-version", python]
    for tag in PLATFORMS[platform]:
        command += ["--platform", tag]
    run = subprocess.run([*command, requirement], capture_output=True, text=True)
    wheels = sorted(place.glob("*.whl"))
    if run.returncode or len(wheels) != 1:
        lines = [line for line in run.stderr.splitlines() if line.strip()] or ["it downloaded nothing"]
        raise WheelError(f"No wheel of {requirement} for {platform}, Python {python}. Pip says: {lines[-1]}")
    return wheels[0]
