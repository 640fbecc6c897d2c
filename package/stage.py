"""A clean copy of the extension, with its wheels, for Blender's own tool to zip."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

MANIFEST = "blender_manifest.toml"
FILES = ("__init__.py", "LICENSE", "README.md")
FOLDERS = ("addon", "core", "docs")


def stage(target: Path, platforms: list[str], wheels: list[Path]) -> None:
    """Put into the empty folder `target` what users get, and a manifest that lists these platforms and wheels."""
    for name in FILES:
        shutil.copy(ROOT / name, target / name)
    for name in FOLDERS:
        shutil.copytree(ROOT / name, target / name, ignore=shutil.ignore_patterns("__pycache__", ".*"))
    (target / "wheels").mkdir()
    listed = []
    for wheel in wheels:
        shutil.copy(wheel, target / "wheels")
        listed.append(f"./wheels/{wheel.name}")
    text = (ROOT / MANIFEST).read_text("utf-8")
    (target / MANIFEST).write_text(complete(text, platforms, listed), "utf-8")


def complete(manifest: str, platforms: list[str], wheels: list[str]) -> str:
    """The manifest with `platforms` and `wheels`, which must stand above its first table."""
    head, table, rest = manifest.partition("\n[")
    # a list of strings is the same in JSON and in TOML
    lists = f"platforms = {json.dumps(platforms)}\nwheels = {json.dumps(wheels, indent=2)}\n"
    return f"{head}{lists}{table}{rest}"
