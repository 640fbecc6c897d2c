"""A bake keeps to the memory that it may take, is the same with little as with much, and says before it starts where it
can't be made."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lightpanes.core.bake import bake
from lightpanes.core.footprint import balanced, crowded, footprint, takes_points, within
from lightpanes.core.memory import GIB, allowing, most_threads, slices
from lightpanes.core.planner import Budget, Settings, plan
from lightpanes.core.scene import SceneError
from lightpanes.core.surface import make_patches

from . import shapes
from .shapes import lamp, quick, room

ROOT = Path(__file__).resolve().parents[2]
PLACE = (3.0, 1.5, 2.0)

MEMORY = """
import json
from pathlib import Path
from lightpanes.core.bake import bake
from lightpanes.tests.core.shapes import lamp, quick, room

def held(kind):
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(kind))
    return int(line.split()[1]) / 1024

made = room(lights=[lamp((3, 1.5, 2))])
bake(made, quick())
before = held("VmRSS")
found = bake(made, quick(resolution=512, exits="points", points=1500, point_rays=64, entries=6000, regions=24, memory=0.35))
print(json.dumps([held("VmHWM") - before, found.report["entries"]]))
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="this system does not tell what a process holds")
def test_a_large_bake_keeps_to_its_memory():
    """512² texels and 6,000 entries, between which a matrix takes 429 MiB while it is made."""
    done = subprocess.run([sys.executable, "-c", MEMORY], capture_output=True, text=True, cwd=ROOT, check=True)
    most, entries = json.loads(done.stdout.splitlines()[-1])
    assert entries == pytest.approx(6000, rel=0.2)
    assert most < 0.35 * 1024


@pytest.mark.usefixtures("frugal")
@pytest.mark.parametrize("exits", ["texels", "points"])
def test_little_memory_gives_the_same_bake(exits):
    made = room(lights=[lamp(PLACE)])
    given = quick(resolution=256, exits=exits, points=1500, point_rays=64, exit_rays=16, memory=64.0)
    one, other = bake(made, given), bake(made, replace(given, memory=0.25))
    assert one.images.keys() == other.images.keys()
    for name, array in one.images.items():
        assert np.array_equal(array, other.images[name]), name


def test_chunks_and_threads_grow_with_memory():
    sizes, threads = [], []
    for gib in (0.25, 1.0, 4.0):
        with allowing(gib):
            pieces = slices(10_000_000, 300)
            assert [s.stop for s in pieces[:-1]] == [s.start for s in pieces[1:]] and pieces[-1].stop == 10_000_000
            sizes.append(pieces[0].stop * 300 / GIB / gib)
            threads.append(most_threads())
    assert max(sizes) <= 1 / 64 and threads == sorted(threads) and threads[0] == 1 < threads[-1]


def test_budgets_and_forms_that_fit():
    made, fine = room(), Settings(error_target=0.01, resolution=512)
    full = plan(made, fine)
    held = []
    for gib in (0.35, 1.0, 4.0, 64.0):
        settings = replace(fine, memory=gib)
        budget = within(full, settings, len(made.triangles), True)
        assert footprint(budget, settings, len(made.triangles), True).whole <= gib * GIB
        held.append(budget.entries)
    assert held == sorted(held) and held[0] < 0.3 * held[-1] == 0.3 * full.entries
    # those that are given stay
    assert within(replace(full, entries=9999), replace(fine, entries=9999, memory=0.35), 100, True).entries == 9999
    # a matrix between all of them, or one between fewer
    assert balanced(4400, 4.0) == 4400 and balanced(65_536, 4.0) < 8192
    assert balanced(4400, 0.25) < 4400
    # a row for every texel, or for points alone
    wide = Settings(resolution=4096, exit_rays=1)
    assert takes_points(wide, plan(made, wide), 100, 4096**2, 0)
    assert not takes_points(replace(wide, memory=64.0), plan(made, wide), 100, 4096**2, 0)


@pytest.mark.usefixtures("frugal")
def test_memory_ends_the_trials():
    made = room(lights=[lamp(PLACE)])
    given = {"resolution": 48, "exit_rays": 16, "entry_rays": 256, "panes": 24, "error_target": 0.001}
    report = bake(made, Settings(**given, memory=0.25)).report
    assert report["bound"] == "memory" and report["error"] > 0.001
    settings = Settings(**given, memory=0.25)
    assert footprint(Budget(**report["budget"]), settings, len(made.triangles), False).whole <= 0.25 * GIB


@pytest.mark.parametrize(
    ("given", "remedy"),
    [
        ({"resolution": 8192}, "lower Resolution to 4096"),
        ({"resolution": 4096, "exits": "texels"}, "set Light At to Automatic"),
        ({"entries": 60_000, "memory": 1.0}, "ask for fewer entries"),
    ],
)
def test_what_does_not_fit_is_said_before_it_starts(given, remedy):
    seen = []
    with pytest.raises(SceneError, match=r"GiB of memory, and .* GiB are allowed: raise Memory to") as told:
        bake(room(lights=[lamp(PLACE)]), Settings(**given), seen.append)
    assert remedy in str(told.value) and not seen


def test_thousands_of_small_objects_share_patches():
    boxes = [(*shapes.box((k % 20, k // 20, 0.1), (k % 20 + 0.4, k // 20 + 0.4, 0.5)), 0) for k in range(400)]
    made = shapes.scene(*boxes)
    # six faces each
    assert len(make_patches(made, 300)) < 1.5 * 300
    assert 2400 <= len(make_patches(made, 2400)) < 1.5 * 2400
    assert "join small objects" in crowded(60_000, 4.0) and not crowded(10_000, 4.0)


def test_the_object_with_most_triangles_is_named():
    made = room()
    made.triangle_object = made.triangle_object.copy()
    crowd = np.resize(np.flatnonzero(made.triangle_object == 1), 5_000_000)
    for name in ("triangles", "corner_normals", "atlas_uv", "triangle_material", "triangle_object"):
        setattr(made, name, np.broadcast_to(getattr(made, name)[:1], (len(crowd), *getattr(made, name).shape[1:])))
    made.triangle_object = np.ones(len(crowd), np.int32)
    with pytest.raises(SceneError, match=r"simplify 'Block', which has most of the 5,000,000 triangles"):
        bake(made, Settings(memory=2.0))
