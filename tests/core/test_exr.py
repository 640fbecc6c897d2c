"""Pictures as OpenEXR files, read back by a reader written from the format's description."""

import struct
import zlib

import numpy as np
import pytest
from lightpanes.core import exr


def read(path):
    """((H, W, 3) values, the first row at the bottom, and whether they are half floats)."""
    data = path.read_bytes()
    assert struct.unpack_from("<ii", data) == (20000630, 2)
    at, found = 8, {}
    while data[at]:
        name, at = word(data, at)
        _, at = word(data, at)
        (size,) = struct.unpack_from("<i", data, at)
        found[name], at = data[at + 4 : at + 4 + size], at + 4 + size
    left, bottom, right, top = struct.unpack("<4i", found["dataWindow"])
    assert (left, bottom) == (0, 0) and found["compression"] == b"\3" and found["dataWindow"] == found["displayWindow"]
    half = found["channels"][2] == 1
    kind = np.dtype("<f2" if half else "<f4")
    width, height = right + 1, top + 1
    rows = np.empty((height, 3, width), kind)
    count = -(-height // 16)
    for k, offset in enumerate(struct.unpack_from(f"<{count}Q", data, at + 1)):
        y, size = struct.unpack_from("<ii", data, offset)
        assert y == 16 * k
        lines = min(16, height - y)
        rows[y : y + lines] = block(data[offset + 8 : offset + 8 + size], lines * 3 * width, kind).reshape(
            lines, 3, width
        )
    assert offset + 8 + size == len(data)
    return rows[::-1, ::-1].transpose(0, 2, 1), half


def word(data, at):
    end = data.index(0, at)
    return data[at:end].decode(), end + 1


def block(data, count, kind):
    if len(data) == count * kind.itemsize:
        return np.frombuffer(data, kind)
    steps = np.frombuffer(zlib.decompress(data), np.uint8).astype(np.int64)
    steps[1:] -= 128
    split = steps.cumsum().astype(np.uint8)
    raw = np.empty_like(split)
    middle = (len(split) + 1) // 2
    raw[0::2], raw[1::2] = split[:middle], split[middle:]
    return raw.view(kind)


def picture(height, width, scale=1.0):
    return (np.random.default_rng(3).random((height, width, 3)) * scale).astype(np.float32)


def write(path, values):
    return list(exr.writing(path, values))


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (17, 5), (64, 64), (100, 3)])
@pytest.mark.parametrize("scale", [1.0, 1e-6])
def test_what_is_written_is_read(tmp_path, size, scale):
    values = picture(*size, scale)
    write(tmp_path / "a.exr", values)
    found, half = read(tmp_path / "a.exr")
    assert half == (scale == 1)
    assert np.array_equal(found, values.astype(found.dtype))


@pytest.mark.parametrize(
    ("values", "half"),
    [
        (np.zeros((4, 4, 3), np.float32), True),
        (np.full((4, 4, 3), 65504, np.float32), True),
        (np.full((4, 4, 3), 65505, np.float32), False),
        (np.full((4, 4, 3), -1e5, np.float32), False),
        (np.full((4, 4, 3), 5e-4, np.float32), False),
        (np.full((4, 4, 3), np.nan, np.float32), False),
        (np.full((4, 4, 3), np.inf, np.float32), False),
    ],
)
def test_half_floats_only_where_they_hold_the_values(tmp_path, values, half):
    write(tmp_path / "a.exr", values)
    found, was = read(tmp_path / "a.exr")
    assert was == half and np.array_equal(found, values, equal_nan=True)


def test_even_surfaces_take_little_space(tmp_path):
    write(tmp_path / "a.exr", np.full((256, 256, 3), 0.37, np.float32))
    assert (tmp_path / "a.exr").stat().st_size < 256 * 256 * 3 * 2 / 50


def test_it_stops_between_steps(tmp_path, monkeypatch):
    monkeypatch.setattr(exr, "STEP", 1)
    done = write(tmp_path / "a.exr", picture(40, 8))
    assert done == pytest.approx([1 / 3, 2 / 3, 1])
    steps = exr.writing(tmp_path / "b.exr", picture(40, 8))
    next(steps)
    steps.close()
    (tmp_path / "b.exr").unlink()
    assert np.array_equal(read(tmp_path / "a.exr")[0], picture(40, 8).astype(np.float16))


def test_exact_values_stay_as_they_are(tmp_path):
    values = picture(20, 7)
    for _ in exr.writing(tmp_path / "a.exr", values, exact=True):
        pass
    found, half = read(tmp_path / "a.exr")
    assert not half and np.array_equal(found, values)
