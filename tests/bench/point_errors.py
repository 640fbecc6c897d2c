"""How far interpolation between points is off: every guide and every interpolation, against fresh gathers.

The light is that of lamps in the open air, half a metre from everything at least, which no guide knows. Noise is removed
twice over: the reference and the points are gathered with two seeds each, and only what both pairs agree on counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from lightpanes.core.bake import Settings
from lightpanes.core.bake.steps import Prepared, prepare
from lightpanes.core.panes.exits import gather_panes
from lightpanes.core.panes.training import free_air, illuminate, point_lamps, room_around
from lightpanes.core.point_cache import (
    Ground,
    Interpolator,
    PointSet,
    gather_gradients,
    lamp_radius,
    make_points,
    serve,
    survey,
)
from lightpanes.core.point_cache import guides as steer
from lightpanes.core.surface import SurfaceSamples
from lightpanes.core.transfer.entries import PLACES

from . import scenes

CLEAR = 0.5
"""m: least distance of a test lamp from anything."""

LAMPS = 16
PLACES_TESTED = 4000
REFERENCE_RAYS = 2048
POINT_RAYS = 512
RESOLUTION = {"atrium": 512}
INTERPOLATIONS = (
    "bare linear", "nearest", "linear", "quadratic", "cubic", "ward", "affine", "ward + gradients",
)  # fmt: skip
GUIDES = ("uniform", "occlusion", "occlusion gradient", "harmonic", "lamps")
PLAIN = "plain"
"""Uniform points that nothing was added to, Shepard's linear weights of those that face alike and are in sight, and of
the nearest where none are."""


@dataclass
class Setup:
    """A sample ready for point sets of any kind, and the truth at some of its texels."""

    made: Prepared
    ground: Ground
    table: np.ndarray
    places: SurfaceSamples
    truth: tuple[np.ndarray, np.ndarray]


def open_setup(name: str, points: int) -> Setup:
    """points: the largest set that will be made."""
    scene = scenes.open_sample(name, RESOLUTION.get(name, 256))
    made = prepare(scene, Settings(resolution=RESOLUTION.get(name, 256), lamps=400, regions=64, exits="points"))
    made.exits = made.exits.keep(~made.is_buried(made.exits.samples))
    rng = np.random.default_rng(3)
    air = free_air(made.places.take(rng.integers(0, len(made.places), 80 * LAMPS)), made.bvh, scene.extent, 7)
    lamps = point_lamps(air[room_around(air, made.gatherer) > CLEAR][: 2 * LAMPS])
    direct = illuminate(lamps, made.places, PLACES, made.tracer, 3)
    albedo = made.entries.albedo.mean(axis=1, keepdims=True)
    radiosity = made.transport.solve(albedo, albedo * direct)
    table = np.zeros((1, made.gatherer.size, radiosity.shape[1]), np.float32)
    table[0, : len(made.entries)] = radiosity
    some = made.exits.samples.take(np.sort(rng.permutation(len(made.exits))[:PLACES_TESTED]))
    whole = np.array([0, len(some)])
    truth = [gather_panes(made.gatherer, some, whole, table, REFERENCE_RAYS, seed) for seed in (1, 2)]
    # a lamp above a vault or within a wall lights next to nothing that anybody sees
    mean = truth[0].mean(axis=0)
    lamps = np.flatnonzero(mean > 0.25 * np.median(mean))[:LAMPS]
    table, truth = table[:, :, lamps], tuple(t[:, lamps] for t in truth)
    ground = survey(scene, made.patches, made.bvh, made.tracer.offset, seen=made.places, count=points)
    return Setup(made, ground, table, some, truth)


def radius_of(setup: Setup, guide: str) -> np.ndarray:
    ground = setup.ground
    if guide == "uniform":
        return steer.uniform(ground.coarse)
    if guide == "occlusion":
        return steer.by_occlusion(ground.ao)
    if guide == "occlusion gradient":
        return steer.by_occlusion_gradient(ground.ao, ground.coarse, 2 * ground.size)
    if guide == "harmonic":
        return ground.harmonic
    return lamp_radius(ground, setup.made.gatherer, setup.made.guide)


def error(setup: Setup, found: tuple[np.ndarray, np.ndarray]) -> tuple[float, float]:
    """Relative RMSE at single texels, mean over the lamps, and without the worst 1 % of the texels."""
    square = (found[0] - setup.truth[0]) * (found[1] - setup.truth[1])
    order = np.argsort(np.abs(square), axis=0)[: int(0.99 * len(square))]
    mean = setup.truth[0].mean(axis=0)
    both = (square, np.take_along_axis(square, order, 0))
    return tuple(float(np.mean(np.sqrt(np.maximum(s.mean(axis=0), 0)) / mean)) for s in both)


def worst(setup: Setup, found: tuple[np.ndarray, np.ndarray]) -> float:
    """99.9 % of the texels err by less, over the mean; the noise that is left included."""
    off = np.abs(0.5 * (found[0] + found[1]) - 0.5 * (setup.truth[0] + setup.truth[1])) / setup.truth[0].mean(axis=0)
    return float(np.quantile(off, 0.999))


def measure(setup: Setup, guide: str, count: int) -> tuple[int, dict[str, tuple[float, float, float]]]:
    """Points that were gathered, those that gaps were given included, and error, trimmed error and worst by
    interpolation."""
    return measure_points(setup, make_points(setup.ground, radius_of(setup, guide), count))


def measure_points(
    setup: Setup, points: PointSet, interpolations: tuple[str, ...] = INTERPOLATIONS
) -> tuple[int, dict[str, tuple[float, float, float]]]:
    """As `measure`, of a set that is there."""
    points, _ = serve(points, setup.made.exits.samples, setup.ground)
    rows = gathered(setup, points)
    interpolator = Interpolator(points, setup.made.bvh, setup.made.tracer.offset)
    result = {}
    for name in interpolations:
        weights = interpolator.weights(setup.places, name.removesuffix(" + gradients"))
        if name.endswith("gradients"):
            found = tuple(weights.carry(r, points, setup.places) for r in rows)
        else:
            found = tuple(weights.apply(r[:, 0]) for r in rows)
        result[name] = (*error(setup, found), worst(setup, found))
    return len(points), result


def measure_plain(setup: Setup, count: int) -> tuple[int, tuple[float, float, float]]:
    """PLAIN: points, and its errors as by `measure`."""
    points = make_points(setup.ground, steer.uniform(setup.ground.coarse), count)
    rows = gathered(setup, points)
    interpolator = Interpolator(points, setup.made.bvh, setup.made.tracer.offset)
    guarded, bare = (interpolator.weights(setup.places, k) for k in ("linear", "bare linear"))
    lost = guarded.orphan[:, None]
    found = tuple(np.where(lost, bare.apply(r[:, 0]), guarded.apply(r[:, 0])) for r in rows)
    return len(points), (*error(setup, found), worst(setup, found))


def gathered(setup: Setup, points: PointSet) -> list[np.ndarray]:
    made = setup.made
    return [
        gather_gradients(made.gatherer, points.samples, points.radius, setup.table, POINT_RAYS, seed)
        for seed in (11, 12)
    ]


def at_count(found: list[tuple[int, float]], count: float) -> float:
    """Error at a number of points, from those measured at some others, on a line in logarithms."""
    counts, errors = np.log(np.array(found, float)).T
    slope, level = np.polyfit(counts, errors, 1) if len(found) > 1 else (-0.5, errors[0] + 0.5 * counts[0])
    return float(np.exp(level + slope * np.log(count)))
