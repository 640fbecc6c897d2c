"""`make package`: the extension as zips, one a platform, with the wheels it needs, built and validated by Blender's tool."""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

from .stage import ROOT, stage
from .tool import ToolError, build, validate
from .wheels import PLATFORMS, PYTHONS, WheelError, download


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m package", description="Build the zips that Blender installs.")
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "package", metavar="DIR", help="out/package")
    parser.add_argument("--platform", action="append", choices=PLATFORMS, help="only this one; may be repeated")
    parser.add_argument("--python", action="append", choices=PYTHONS, help="only for this one; may be repeated")
    options = parser.parse_args()
    try:
        package(options.output, options.platform or list(PLATFORMS), options.python or list(PYTHONS))
    except (WheelError, ToolError) as error:
        print(f"package: {error}", file=sys.stderr)
        return 1
    return 0


def package(output: Path, platforms: list[str], pythons: list[str]) -> None:
    """Leave in `output` a valid zip for each platform, with the wheels for all these Pythons.

    Nothing is replaced there before all of them are valid. Raises WheelError and ToolError.
    """
    with tempfile.TemporaryDirectory() as name:
        downloads, staged, zips = (Path(name, part) for part in ("downloads", "staged", "zips"))
        for folder in (downloads, staged, zips):
            folder.mkdir()
        wheels = [download(downloads, platform, python) for platform in platforms for python in pythons]
        stage(staged, platforms, wheels)
        archives = build(staged, zips)
        for archive in archives:
            validate(archive)
        output.mkdir(parents=True, exist_ok=True)
        for archive in archives:
            made = Path(shutil.move(archive, output / archive.name))
            print(f"{made}  {made.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    sys.exit(main())
