"""Finished parts of bakes in a folder, so that a cancelled bake goes on after the program was closed.

A part is a .npz of plain arrays: nothing in it is ever run. A folder is bounded in size; what was used least recently
goes first. Files that are damaged are deleted and were never there.
"""

from __future__ import annotations

import contextlib
import os
import re
import time
import zipfile
from pathlib import Path

import numpy as np

from ..files import replacing
from ..transfer import Begun, Links, Transport

VERSION = 2
"""Of what the files hold: another number where the same scene and settings lead to other parts."""

_OURS = re.compile(r"lightpanes-[0-9a-f]{32}-[0-9a-f]{32}\.npz")
_TEMPORARY = re.compile(r"\.lightpanes-[0-9a-f]{32}-[0-9a-f]{32}-\d+\.npz")
DAY = 86400  # s


def encode(part: object) -> dict[str, np.ndarray] | None:
    """A part as arrays, None where it is of a kind that is not kept in files (cheap to make, or not data alone)."""
    if isinstance(part, np.ndarray) and part.dtype != object:
        return {"array": part}
    if isinstance(part, float):
        return {"number": np.float64(part)}
    if isinstance(part, Transport):
        return {"between": part.between, "sky": part.sky}
    if isinstance(part, Links):
        return dict(vars(part))
    if isinstance(part, Begun) and part.rows is not None:
        return {"rows": part.rows, "done": np.array(sorted(part.done), np.int64)}
    return None


def decode(arrays: dict[str, np.ndarray]) -> object:
    """What `encode` made arrays of. Raises KeyError or ValueError for other arrays."""
    if "array" in arrays:
        return arrays["array"]
    if "number" in arrays:
        return float(arrays["number"])
    if "between" in arrays:
        between, sky = arrays["between"], arrays["sky"]
        if between.dtype != np.float32 or between.ndim != 2 or len({*between.shape, len(sky)}) != 1:
            raise ValueError("not a transport")
        return Transport(between, sky)
    if "far" in arrays:
        return _links(**arrays)
    rows, done = arrays["rows"], arrays["done"]
    if rows.dtype != np.float32 or done.dtype != np.int64:
        raise ValueError("not a gather")
    return Begun(rows, set(done.tolist()))


def _links(far, factor, starts, near, weight):
    kinds = [np.float32, np.float32, np.int64, np.int32, np.float32]
    held = [far, factor, starts, near, weight]
    if [array.dtype for array in held] != kinds or [array.ndim for array in held] != [2, 1, 1, 1, 1]:
        raise ValueError("not links")
    if len(starts) != len(factor) + 1 or not len(near) == len(weight) == starts[-1] or far.shape[0] != far.shape[1]:
        raise ValueError("not links")
    return Links(*held)


class Cache:
    """Parts in files of `folder`, at most `limit` bytes of them. It never raises OSError: what can't be read was never
    there, and what can't be written is made anew."""

    def __init__(self, folder: Path, limit: int):
        self.folder, self.limit = Path(folder), limit

    def load(self, key: bytes, name: bytes) -> object | None:
        """The part that was saved by this key and name, 16 bytes each, or None."""
        place = self._place(key, name)
        try:
            with np.load(place, allow_pickle=False) as file:
                # reading to its end checks an array's sum
                part = decode({entry: file[entry] for entry in file.files})
        except FileNotFoundError:
            return None
        except (
            OSError,
            EOFError,
            ValueError,
            KeyError,
            TypeError,
            zipfile.BadZipFile,
            NotImplementedError,
            RuntimeError,
        ):
            with contextlib.suppress(OSError):
                place.unlink(missing_ok=True)
            return None
        with contextlib.suppress(OSError):
            os.utime(place)
        return part

    def save(self, key: bytes, name: bytes, part: object) -> bool:
        """Keep a part; False where it is not of a kind to be kept, too large, or can't be written."""
        arrays = encode(part)
        if arrays is None or sum(array.nbytes for array in arrays.values()) > self.limit:
            return False
        place = self._place(key, name)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with replacing(place) as temporary:
                with open(temporary, "wb") as file:
                    np.savez(file, **arrays)
        except OSError:
            return False
        self.trim()
        return True

    def forget(self, key: bytes) -> None:
        """Delete all parts of a key."""
        for place in self._files():
            if place.name.startswith(f"lightpanes-{key.hex()}-"):
                with contextlib.suppress(OSError):
                    place.unlink(missing_ok=True)

    def trim(self) -> None:
        """Delete the least recently used parts until the rest fits, and what a crash left half written."""
        found = []
        for place in self._files():
            with contextlib.suppress(OSError):
                state = place.stat()
                found.append((state.st_mtime_ns, state.st_size, place))
        left = sum(size for _, size, _ in found)
        for _, size, place in sorted(found):
            if left <= self.limit:
                break
            with contextlib.suppress(OSError):
                place.unlink(missing_ok=True)
                left -= size
        for place in self._files(_TEMPORARY):
            with contextlib.suppress(OSError):
                if time.time() - place.stat().st_mtime > DAY:
                    place.unlink(missing_ok=True)

    def _place(self, key: bytes, name: bytes) -> Path:
        return self.folder / f"lightpanes-{key.hex()}-{name.hex()}.npz"

    def _files(self, kind: re.Pattern = _OURS) -> list[Path]:
        try:
            return [place for place in self.folder.iterdir() if kind.fullmatch(place.name)]
        except OSError:
            return []
