"""Bakes on disk, and that a bake is the same whenever and however it is made."""

import json
import os
import pickle
import subprocess
import sys
import zipfile
from pathlib import Path

import lightpanes
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from lightpanes.core import threads as workers
from lightpanes.core.bake import Bake, BakeError, Progress, bake
from lightpanes.core.scene import Material, SceneError, Sky

from .shapes import baked_room, box, lamp, quad, quick, relighter, room, scene


def same(a: Bake, b: Bake) -> None:
    for name in ("images", "entries"):
        first, second = getattr(a, name), getattr(b, name)
        assert first.keys() == second.keys()
        for key, values in first.items():
            assert values.dtype == second[key].dtype and np.array_equal(values, second[key]), key
    assert (a.direct is None) == (b.direct is None)
    assert a.direct is None or np.array_equal(a.direct, b.direct)


def small() -> Bake:
    """A sunlit room with a glowing block, so that every part of a bake is there."""
    return bake(glowing_room(), quick(entries=200, resolution=24, lamps=60, regions=8))


def glowing_room():
    glow = Material("Glow", (0.5, 0.4, 0.3), emission=(1.0, 0.5, 0.2))
    return scene(
        (*box((0, 0, 0), (2, 2, 2), True), 0),
        (*box((0.5, 0.5, 0.2), (1, 1, 0.7)), 1),
        materials=(Material("Wall"), glow),
    )


# ---- round trip ----


def test_a_saved_bake_comes_back(tmp_path):
    for baked in (baked_room()[1], small()):
        baked.save(tmp_path / "bake.npz")
        again = Bake.load(tmp_path / "bake.npz")
        same(baked, again)
        assert again.meta == json.loads(json.dumps(baked.meta))
        assert again.resolution == baked.resolution
        assert again.bytes == baked.bytes > 0
    assert os.listdir(tmp_path) == ["bake.npz"]


@given(
    arrays(np.float32, array_shapes(max_dims=3, max_side=5), elements=st.floats(width=32)),
    st.dictionaries(st.text(max_size=8), st.floats(allow_nan=False) | st.text(max_size=20) | st.none(), max_size=4),
)
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_images_and_reports_keep_every_bit(tmp_path, values, report):
    baked = baked_room()[1]
    images = baked.images | {"Lightpanes Extra": values}
    Bake(baked.resolution, images, baked.entries, values, baked.meta | {"report": report}).save(tmp_path / "b.npz")
    again = Bake.load(tmp_path / "b.npz")
    # NaNs and signed zeros too
    assert again.images["Lightpanes Extra"].tobytes() == values.tobytes()
    assert again.direct.tobytes() == values.tobytes() and again.direct.shape == values.shape
    assert again.report == report


# ---- files that are not bakes ----


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("bake") / "small.npz"
    small().save(path)
    return path.read_bytes()


@given(st.floats(0, 1, exclude_max=True))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_truncated_file_is_refused(tmp_path, written, part):
    path = tmp_path / "cut.npz"
    path.write_bytes(written[: int(part * len(written))])
    with pytest.raises(BakeError, match="bake again") as caught:
        Bake.load(path)
    assert "cut.npz" in str(caught.value)


@given(st.data())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_damaged_file_is_refused_or_reads_alike(tmp_path, written, data):
    damaged = bytearray(written)
    # headers sit at the ends of the file and before each array: hit those as often as the bulk
    for _ in range(data.draw(st.integers(1, 6))):
        near_end = data.draw(st.booleans())
        at = (
            data.draw(st.integers(0, min(3000, len(written) - 1)))
            if near_end
            else data.draw(st.integers(0, len(written) - 1))
        )
        damaged[-1 - at] = data.draw(st.integers(0, 255))
    path = tmp_path / "damaged.npz"
    path.write_bytes(damaged)
    try:
        Bake.load(path)
    except BakeError as error:
        assert "bake again" in str(error)


class Trap:
    """Unpickling it would write a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


def test_nothing_is_ever_unpickled(tmp_path, written):
    sprung = tmp_path / "sprung"
    plain = tmp_path / "plain.npz"
    plain.write_bytes(pickle.dumps(Trap(sprung)))
    array = tmp_path / "array.npy"
    np.save(array, np.array([Trap(sprung)], object), allow_pickle=True)
    inside = tmp_path / "inside.npz"
    inside.write_bytes(written)
    with zipfile.ZipFile(inside, "a") as archive:
        archive.write(array, "image:Lightpanes Trap.npy")
    raw = tmp_path / "raw.npz"
    raw.write_bytes(written)
    with zipfile.ZipFile(raw, "a") as archive:
        archive.writestr("image:Lightpanes Trap", pickle.dumps(Trap(sprung)))
    for path in (plain, array, inside, raw):
        with pytest.raises(BakeError):
            Bake.load(path)
        assert not sprung.exists()


def rewrite(path: Path, change) -> Path:
    with np.load(path) as data:
        arrays_of = dict(data)
    meta = json.loads(bytes(arrays_of["meta"]))
    meta = change(arrays_of, meta) or meta
    arrays_of["meta"] = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    np.savez(path, **arrays_of)
    return path


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda arrays, meta: meta.update(format=999), "another version of Lightpanes"),
        (lambda arrays, meta: meta.pop("format") and None, "not a bake of Lightpanes"),
        (lambda arrays, meta: meta.pop("resolution") and None, "bake again"),
        (lambda arrays, meta: meta.update(resolution="big"), "bake again"),
        (lambda arrays, meta: meta.update(resolution=7), "incomplete"),
        (lambda arrays, meta: meta.pop("shapes") and None, "incomplete"),
        (lambda arrays, meta: meta.update(each=0), "incomplete"),
        (lambda arrays, meta: ["a", "list"], "not a bake of Lightpanes"),
        (lambda arrays, meta: arrays.pop("image:Lightpanes Panes") is None, "incomplete"),
        (lambda arrays, meta: arrays.pop("image:Lightpanes Weights") is None, "incomplete"),
        (lambda arrays, meta: arrays.pop("entry:position") is None, "incomplete"),
        (lambda arrays, meta: arrays.update({"image:Lightpanes Weights": np.zeros(5, np.float32)}), "incomplete"),
    ],
)
def test_a_bake_with_something_missing_is_refused(tmp_path, written, change, message):
    path = tmp_path / "odd.npz"
    path.write_bytes(written)
    with pytest.raises(BakeError, match=message):
        Bake.load(rewrite(path, change))


def test_foreign_files_are_refused(tmp_path):
    with pytest.raises(BakeError, match=r"There is no bake file .*gone\.npz"):
        Bake.load(tmp_path / "gone.npz")
    foreign = tmp_path / "foreign.npz"
    for content in (b"", b"\x89PNG\r\n\x1a\n" + bytes(100), b"PK\x03\x04", b"hello\n" * 50):
        foreign.write_bytes(content)
        with pytest.raises(BakeError, match="not a bake of Lightpanes"):
            Bake.load(foreign)
    np.savez(foreign, weights=np.zeros(3))
    with pytest.raises(BakeError, match="not a bake of Lightpanes"):
        Bake.load(foreign)
    np.save(tmp_path / "array.npy", np.zeros(3))
    with pytest.raises(BakeError, match="not a bake of Lightpanes"):
        Bake.load(tmp_path / "array.npy")
    with pytest.raises(BakeError):
        Bake.load(tmp_path)


# ---- saving that fails ----


def test_a_failed_save_leaves_the_previous_file(tmp_path, monkeypatch):
    path = tmp_path / "bake.npz"
    baked_room()[1].save(path)
    before = path.read_bytes()

    def half(file, **arrays_of):
        file.write(b"half a bake")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", half)
    with pytest.raises(OSError, match="No space left"):
        small().save(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["bake.npz"]


def test_saving_into_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(OSError, match="gone"):
        baked_room()[1].save(tmp_path / "gone" / "bake.npz")


# ---- the same bake, whenever and however ----


def test_same_seed_same_bake():
    made = glowing_room()
    given_settings = quick(entries=200, resolution=24, lamps=60, regions=8)
    first, again = bake(made, given_settings), bake(made, given_settings)
    same(first, again)
    other = bake(made, quick(entries=200, resolution=24, lamps=60, regions=8, seed=1))
    assert not np.array_equal(first.images["Lightpanes Panes"], other.images["Lightpanes Panes"])


def test_as_many_threads_as_you_like(monkeypatch):
    made = room(lights=[lamp((3, 1.5, 2))])
    bakes = []
    for threads in (1, 2, 5):
        monkeypatch.setattr(workers, "thread_count", lambda threads=threads: threads)
        bakes.append(bake(made, quick(resolution=100, entry_rays=64, exit_rays=48)))
    same(bakes[0], bakes[1])
    same(bakes[0], bakes[2])


SCRIPT = """
import sys, zlib
import numpy as np
from lightpanes.core.bake import Settings, bake
from lightpanes.core.scene import Scene
points = np.array([[x, y, z] for x in (0, 2) for y in (0, 3) for z in (0, 2.5)], float)
faces = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * 0.9 + 0.05
uv = (uv[None] + np.array([[k % 3, k // 3] for k in range(6)])[:, None]) / [3, 2]
triangles = np.concatenate([faces[:, [2, 1, 0]], faces[:, [3, 2, 0]]])
atlas = np.concatenate([uv[:, [2, 1, 0]], uv[:, [3, 2, 0]]])
baked = bake(Scene(points, triangles, atlas_uv=atlas), Settings(resolution=32, entries=300, lamps=80, regions=8))
print(zlib.crc32(b"".join(v.tobytes() for v in baked.images.values())))
from lightpanes.core.panes import Relighter
from lightpanes.core.rays import Tracer
from lightpanes.core.scene import Light
matrix = np.eye(4)
matrix[:3, 3] = 1, 1.2, 1.9
scene = Scene(points, triangles, atlas_uv=atlas)
print(Relighter(baked.panes(), Tracer(scene)).texels([Light("Lamp", "POINT", matrix, np.ones(3))]).tolist())
"""


def test_a_fresh_process_makes_the_same_bake():
    # hash randomisation plays no part, bit for bit; BLAS may sum in another order on other numbers of its threads,
    # over which numpy has no say: what is seen then agrees to a tenth of the error that was asked for
    path = os.pathsep.join([str(Path(lightpanes.__file__).parent.parent), os.environ.get("PYTHONPATH", "")])
    sums, lit = [], []
    for seed, threads in (("1", "1"), ("2", "1"), ("3", "2")):
        environment = os.environ | {"PYTHONHASHSEED": seed, "OPENBLAS_NUM_THREADS": threads, "PYTHONPATH": path}
        run = subprocess.run(
            [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, timeout=120, check=True
        )
        digest, texels = run.stdout.strip().splitlines()
        sums.append(digest)
        lit.append(np.array(json.loads(texels)))
    assert sums[0] == sums[1]
    assert np.sqrt(((lit[2] - lit[0]) ** 2).mean()) < 0.1 * 0.05 * lit[0].mean()


# ---- progress, cancelling, bad scenes ----


def test_progress_rises_to_one():
    steps: list[Progress] = []
    bake(room(), quick(entries=150, resolution=24, lamps=60, regions=8), steps.append)
    fractions = np.array([step.fraction for step in steps])
    assert (np.diff(fractions) >= 0).all() and fractions[0] >= 0 and fractions[-1] == 1
    assert (np.diff([step.rays for step in steps]) >= 0).all() and steps[-1].rays > 0
    assert steps[-1].stage == "Done"


@pytest.mark.parametrize("after", [0.0, 0.3, 0.6, 0.9])
def test_an_exception_in_progress_cancels(after):
    class Cancelled(Exception):
        pass

    def stop(step):
        if step.fraction >= after:
            raise Cancelled

    with pytest.raises(Cancelled):
        bake(room(), quick(entries=150, resolution=24, lamps=60, regions=8), stop)


def test_a_scene_without_an_atlas_cannot_be_baked():
    made = room()
    made.atlas_uv[:] = np.nan
    with pytest.raises(SceneError, match="No object has a place in the atlas"):
        bake(made, quick())


def test_everything_buried_is_said_and_baked():
    # a box seen from outside only, with a lamp within: every texel is inside nothing, or all are
    inner = scene(
        (*box((0.4, 0.4, 0.4), (0.6, 0.6, 0.6)), 0), (*box((0, 0, 0), (1, 1, 1)), 0), lights=[lamp((3, 3, 3))]
    )
    # only the buried box has a place in the atlas
    inner.atlas_uv[12:] = np.nan
    baked = bake(inner, quick(entries=200, resolution=24))
    assert any("inside a closed object" in warning for warning in baked.report["warnings"])
    image = relighter(inner, baked).relight(inner.lights)
    assert np.isfinite(image).all() and image[..., :3].max() < 1e-3


def test_a_lone_face_bakes_to_black():
    made = scene((*quad((0, 0, 0), (1, 0, 0), (0, 1, 0)), 0), lights=[lamp((0.5, 0.5, 1))])
    baked = bake(made, quick(entries=50, resolution=24))
    image = relighter(made, baked).relight(made.lights)
    assert np.isfinite(image).all() and image[..., :3].max() < 1e-4


def test_one_triangle_far_from_square():
    made = scene(
        (
            np.array([[0, 0, 0], [100, 0, 0], [0, 0.01, 0]]),
            np.array([[0, 1, 2]]),
            quad((0, 0, 0), (1, 0, 0), (0, 1, 0))[2][:1],
            0,
        )
    )
    image = relighter(made, bake(made, quick(entries=50, resolution=24))).relight([lamp((1, 1, 1))])
    assert np.isfinite(image).all()


def test_a_sky_is_part_of_the_bake():
    made = scene((*quad((0, 0, 0), (1, 0, 0), (0, 1, 0)), 0), sky=Sky(np.full((1, 1, 3), (1.0, 2.0, 3.0))))
    baked = bake(made, quick(entries=50, resolution=24))
    shown = baked.panes().fill >= 0
    assert np.allclose(baked.direct.reshape(-1, 3)[shown], np.pi * np.array([1, 2, 3]), rtol=1e-3)
    assert not baked.direct.reshape(-1, 3)[~shown].any()
