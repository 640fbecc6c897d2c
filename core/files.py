"""Files that appear whole or not at all, in place of what was there."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A name beside `path`, of the same ending, to write to; what was written there then takes its place.

    Whatever goes wrong, `path` stays as it was and nothing is left beside it. Raises OSError.
    """
    temporary = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


@contextmanager
def filling(folder: Path, last: str = "") -> Iterator[Path]:
    """An empty folder inside `folder`, which is made if missing; all files written there then move into `folder`.

    last: the name of that which moves after the others. Whatever goes wrong, all files in `folder` stay as they were, or
    are put back, and a folder that was made goes again. Raises OSError.
    """
    made = not folder.exists()
    stage = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        stage = Path(tempfile.mkdtemp(prefix=".lightpanes_", dir=folder))
        yield stage
        _move_all(stage, folder, last)
    finally:
        if stage is not None:
            shutil.rmtree(stage, ignore_errors=True)
        if made:
            with contextlib.suppress(OSError):  # it holds what was written
                folder.rmdir()


def _move_all(stage: Path, folder: Path, last: str) -> None:
    names = sorted((path.name for path in stage.iterdir()), key=lambda name: (name == last, name))
    aside = Path(tempfile.mkdtemp(prefix=".lightpanes_", dir=folder))
    moved: list[tuple[Path, Path]] = []

    def move(source: Path, target: Path) -> None:
        os.replace(source, target)
        moved.append((source, target))

    try:
        for name in names:
            # what is no file is the user's, and stops everything
            if (folder / name).is_file():
                move(folder / name, aside / name)
            move(stage / name, folder / name)
    except BaseException:
        for source, target in reversed(moved):
            with contextlib.suppress(OSError):
                os.replace(target, source)
        # not empty where one could not be put back
        with contextlib.suppress(OSError):
            aside.rmdir()
        raise
    shutil.rmtree(aside, ignore_errors=True)
