"""What the command line writes where: progress, reports, and the lines that Blender itself writes, from C."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import tempfile
import time
from collections.abc import Iterator

STDOUT, STDERR = 1, 2


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Nothing reaches stdout: Blender writes a line there for each of its bakes."""
    with open(os.devnull, "w") as nowhere, _pointed(nowhere.fileno(), STDOUT):
        yield


@contextlib.contextmanager
def aside() -> Iterator[None]:
    """What anybody writes to stdout goes to stderr."""
    with _pointed(STDERR, STDOUT), contextlib.redirect_stdout(sys.stderr):
        yield


@contextlib.contextmanager
def unless_it_fails() -> Iterator[None]:
    """What Blender writes appears afterwards, on stdout, and where it raises an exception, which says the same, not at
    all."""
    with tempfile.TemporaryFile() as kept:
        with _pointed(kept.fileno(), STDOUT, STDERR):
            yield
        kept.seek(0)
        # as bytes, whatever a console can write
        with contextlib.suppress(OSError), open(STDOUT, "wb", closefd=False) as stream:
            stream.write(kept.read())


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Blender writes nothing: an exception of its says the same as its lines."""
    with open(os.devnull, "w") as nowhere, _pointed(nowhere.fileno(), STDOUT, STDERR):
        yield


@contextlib.contextmanager
def _pointed(file: int, *streams: int) -> Iterator[None]:
    """File descriptors `streams` lead where `file` does."""
    _flush()
    try:
        kept = [os.dup(stream) for stream in streams]
    except OSError:
        # no console at all
        yield
        return
    for stream in streams:
        os.dup2(file, stream)
    try:
        yield
    finally:
        _flush()
        for stream, place in zip(streams, kept, strict=True):
            os.dup2(place, stream)
            os.close(place)


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    # Blender's lines wait in C's own buffers
    with contextlib.suppress(AttributeError, OSError):
        (ctypes.CDLL(None) if os.name == "posix" else ctypes.cdll.ucrtbase).fflush(None)


class Bar:
    """Progress on stderr: a bar that redraws itself on a terminal, plain lines elsewhere.

    Call it with a `core.bake.Progress`.
    """

    WIDTH = 30

    def __init__(self, stream=None):
        self.stream = stream or sys.stderr
        self.terminal = self.stream.isatty()
        self.start = time.monotonic()
        self.stage, self.tenth, self.drawn = "", -1, 0.0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.terminal and self.stage:
            self.stream.write("\n")
            self.stream.flush()

    def __call__(self, progress) -> None:
        now, tenth = time.monotonic(), int(10 * progress.fraction)
        fresh = progress.stage != self.stage
        seconds = now - self.start
        if self.terminal:
            if fresh or now - self.drawn > 0.1 or progress.fraction >= 1:
                done = round(self.WIDTH * min(1.0, progress.fraction))
                bar = "█" * done + "·" * (self.WIDTH - done)
                self.stream.write(f"\r\x1b[K{bar} {100 * progress.fraction:3.0f} %  {seconds:5.1f} s  {progress.stage}")
                self.stream.flush()
                self.drawn = now
        elif fresh or tenth != self.tenth:
            self.stream.write(f"{100 * progress.fraction:3.0f} %  {seconds:5.1f} s  {progress.stage}\n")
            self.stream.flush()
        self.stage, self.tenth = progress.stage, tenth
