"""Where caches of world space fail: noise is cached on a floor, and what is read is held against what is true."""

from __future__ import annotations

import numpy as np
from lightpanes.core.implicit_cache import Cache
from lightpanes.core.implicit_cache import keys as key_module

from ..core.test_implicit_failures import floor, noisy, settle, wall
from .entry import Curves, Found, Images, entry


def wave(position, height: float = 0.4) -> np.ndarray:
    """(n,) float32 light that varies along x."""
    return (0.5 + height * np.sin(8 * position[:, 0])).astype(np.float32)


def rms(found, truth) -> float:
    return float(np.sqrt(((found - truth) ** 2).mean()))


def pictures(truth, side=64, high=1.0, **found) -> Images:
    """Images of (side²,) floors."""
    shown = {"truth": truth} | {name.replace("_", " "): values for name, values in found.items()}
    return Images({name: values.reshape(side, side) for name, values in shown.items()}, high=high)


@entry(
    "Implicit cache",
    "surfaces aligned with the grid",
    """Rounding puts a floor at the border of cells now on one side, now on the other. Values live at the lattice's corners
    and are blended, so both sides read the same.""",
    "RMSE after 32 frames of noise, a floor exactly between cells",
    0.025,
    "core/test_implicit_failures.py::test_a_floor_on_the_grid_is_as_good_as_one_off_it",
)
def aligned() -> Found:
    position, normal = floor(0.0)
    position[:, 2] += np.random.default_rng(0).uniform(-1e-7, 1e-7, len(position)).astype(np.float32)
    truth = wave(position)
    found = settle(Cache(slots=1 << 15), position, normal, truth)
    return Found(rms(found, truth), pictures(truth, one_frame=noisy(truth, 0), read=found))


@entry(
    "Implicit cache",
    "thin walls",
    """The two sides of a wall are a millimetre apart, nearer than any cell is wide. The direction of the normal is part of
    an entry's key, so they never share one. A floor that goes on below a thin wall does: unless the rooms have floors of
    their own, light leaks as far as a coarse cell reaches at first, and less with each frame.""",
    "most that leaks through a wall of 1 mm, lit side 1",
    1e-4,
    """core/test_implicit_failures.py::test_light_does_not_pass_a_wall_of_a_millimetre
    core/test_implicit_failures.py::test_objects_keep_their_light_apart""",
)
def thin_wall_cached() -> Found:
    position, normal, truth = wall()
    found = Cache(slots=1 << 15).frame(position, normal, None, 0.01, truth)[:, 0]
    without = Cache(slots=1 << 15, by_normal=False).frame(position, normal, None, 0.01, truth)[:, 0]
    dark = truth < 0.5
    shown = pictures(truth[dark], with_the_normal=found[dark], without=without[dark])
    return Found(float(np.abs(found - truth).max()), shown, f"without the normal in the key {without[dark].mean():.2f}")


@entry(
    "Implicit cache",
    "far from the origin",
    """The paper's fixed point of 32 bits overflows after 2 km. Keys have 64 bits; what is lost far away is what float32
    positions lose, a millimetre at 10 km.""",
    "RMSE at 10 km over that at the origin, added",
    0.03,
    """core/test_implicit_failures.py::test_ten_kilometres_from_the_origin
    core/test_implicit_failures.py::test_the_thesis_s_words_overflow_and_say_so
    core/test_implicit_failures.py::test_places_far_apart_share_no_entries""",
)
def far_away() -> Found:
    near, normal = floor()
    truth = wave(near)
    away = np.array([0.0, 1e3, 1e4, 1e5])
    errors = {}
    for name, dtype, places in (("float32 positions", np.float32, away[:3]), ("float64 positions", np.float64, away)):
        found = [settle(Cache(slots=1 << 15), floor(origin=(a, -a), dtype=dtype)[0], normal, truth) for a in places]
        errors[name] = np.array([rms(values, truth) for values in found])
    curves = {name: (np.maximum(away[: len(v)], 1), v) for name, v in errors.items()}
    plain = errors["float32 positions"]
    return Found(float(plain[2] - plain[0]), Curves(curves, "m from the origin", "RMSE", "x"))


@entry(
    "Implicit cache",
    "a full hash table",
    """A table has half its slots filled at most; then it forgets what was not seen for longest. With fewer entries than the
    picture wants, coarse ones stand in; a place that has none shows its own sample, no hole.""",
    "RMSE over that of a roomy table, a table a third as large as the picture wants",
    4.0,
    """core/test_implicit_failures.py::test_a_table_too_small_for_the_picture
    core/test_implicit_failures.py::test_a_full_table_forgets_where_the_camera_was""",
)
def full_table() -> Found:
    position, normal = floor(side=96)
    truth = wave(position)
    roomy = Cache(slots=1 << 16)
    good = settle(roomy, position, normal, truth)
    small = Cache(slots=1 << int(np.log2(roomy.entries)))
    found = settle(small, position, normal, truth)
    shown = pictures(truth, 96, roomy=good, too_small=found)
    return Found(rms(found, truth) / rms(good, truth), shown, f"{small.occupancy:.2f} of the slots are filled")


@entry(
    "Implicit cache",
    "key collisions",
    """Two places that share an entry would show each other's light. Keys have 64 bits and a tag of 32 is compared, so
    that chance makes one in billions of pairs.""",
    "pairs among 40,000 neighbouring cells with one key",
    0,
    """core/test_implicit_failures.py::test_keys_of_neighbours_differ
    core/test_implicit_failures.py::test_a_hash_that_always_collides_only_costs_time""",
)
def collisions() -> Found:
    x, y, z = (v.ravel() for v in np.meshgrid(np.arange(200), np.arange(200), [0], indexing="ij"))
    level, surface = np.zeros(len(x), np.int64), np.zeros(len(x), np.uint64)
    keys = key_module.mix(key_module.lattice_keys(np.stack([x, y, z]), level, surface))
    slots = ((keys >> np.uint64(32)).astype(np.int64) & 1023).reshape(200, 200)
    return Found(float(len(keys) - len(np.unique(keys))), Images({"slot of each cell": slots}, "slot", high=1023))


@entry(
    "Implicit cache",
    "changing level of detail",
    """Cells grow with the distance to the camera. Coming nearer asks for finer ones, which begin from what the coarse ones
    know.""",
    "RMSE of the first frame after coming nearer by half",
    0.05,
    """core/test_implicit_failures.py::test_coming_nearer_does_not_begin_anew
    core/test_implicit_failures.py::test_going_away_does_not_begin_anew
    core/test_implicit_failures.py::test_levels_side_by_side_show_no_edge""",
)
def nearer() -> Found:
    position, normal = floor()
    truth = wave(position, 0.3)
    cache = Cache(slots=1 << 16)
    settle(cache, position, normal, truth, 64, footprint=0.02)
    near = cache.frame(position, normal, None, 0.01, noisy(truth, 1))[:, 0]
    fresh = Cache(slots=1 << 16).frame(position, normal, None, 0.01, noisy(truth, 1))[:, 0]
    return Found(
        rms(near, truth), pictures(truth, came_nearer=near, begun_anew=fresh), f"begun anew {rms(fresh, truth):.3f}"
    )
