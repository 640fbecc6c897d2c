"""OpenEXR pictures, written with numpy and zlib alone.

Blender's own writer takes four times the space and can't be interrupted. The layout is that of openexr.com,
"OpenEXR File Layout": one part of scanlines, red, green and blue, ZIP compressed, linear Rec.709 as is the default.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .threads import in_threads

LINES = 16
"""Scanlines that are compressed together; the format says so."""

STEP = 2 << 20
"""Bytes that are compressed between two chances to stop: a twentieth of a second."""

LEVEL = 4
"""Of zlib; higher ones win less than they cost."""

BRIGHTEST, DIMMEST = 65504.0, 1e-3
"""Half floats hold pictures whose largest value lies between these to 0.05 % of each value or 0.003 % of the largest."""


def writing(path: Path, picture: np.ndarray, exact: bool = False) -> Iterator[float]:
    """Write (H, W, 3) float32, its first row at the bottom, to `path`; yields the fraction done every two megabytes.

    Values are half floats where those hold them (see BRIGHTEST) and need not be exact, and as they are elsewhere. Raises
    OSError.
    """
    height, width = picture.shape[:2]
    half = not exact and fits_half(picture)
    rows = picture[::-1]
    starts = range(0, height, LINES)
    each = max(1, STEP // (LINES * width * 3 * (2 if half else 4)))
    offsets: list[int] = []
    with open(path, "wb") as file:
        file.write(_header(width, height, half))
        table = file.tell()
        file.write(bytes(8 * len(starts)))
        for first in range(0, len(starts), each):
            batch = starts[first : first + each]
            packed = in_threads(lambda y: _packed(rows[y : y + LINES], half), batch)
            for y, data in zip(batch, packed, strict=True):
                offsets.append(file.tell())
                file.write(struct.pack("<ii", y, len(data)) + data)
            yield len(offsets) / len(starts)
        file.seek(table)
        file.write(struct.pack(f"<{len(offsets)}Q", *offsets))


def fits_half(picture: np.ndarray) -> bool:
    """Whether half floats hold a picture: nothing overflows, and nothing that is seen beside its brightest is lost."""
    largest = max(float(picture.max()), -float(picture.min()))
    return largest == 0 or DIMMEST <= largest <= BRIGHTEST


def _header(width: int, height: int, half: bool) -> bytes:
    # kind (1: half, 2: float), not perceptually linear, every pixel of every line
    channels = b"".join(name + struct.pack("<iB3xii", 1 if half else 2, 0, 1, 1) for name in (b"B\0", b"G\0", b"R\0"))
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    attributes = (
        (b"channels", b"chlist", channels + b"\0"),
        (b"compression", b"compression", b"\3"),
        (b"dataWindow", b"box2i", window),
        (b"displayWindow", b"box2i", window),
        (b"lineOrder", b"lineOrder", b"\0"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", 1)),
        (b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0)),
        (b"screenWindowWidth", b"float", struct.pack("<f", 1)),
    )
    parts = [name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value for name, kind, value in attributes]
    return struct.pack("<ii", 20000630, 2) + b"".join(parts) + b"\0"


def _packed(lines: np.ndarray, half: bool) -> bytes:
    """A block of scanlines: of each line all blue, all green, all red; compressed where that makes it smaller."""
    raw = np.ascontiguousarray(lines[:, :, ::-1].transpose(0, 2, 1).astype("<f2" if half else "<f4")).view(np.uint8)
    raw = raw.reshape(-1)
    # low and high bytes apart, then their differences: what the format's ZIP asks for
    split = np.concatenate([raw[0::2], raw[1::2]])
    steps = split.copy()
    steps[1:] -= split[:-1]
    steps[1:] += 128
    packed = zlib.compress(steps.data, LEVEL)
    return packed if len(packed) < len(raw) else raw.tobytes()
