"""Caustics: energy, error against very many photons, photons and time for equal error, pictures, memory.

Scenes: caustic_stages.py; references: caustic_references.py. Errors are on blocks of 4 × 4 texels, in parts of the
reference's root mean square (a caustic is dark but for a few bright places; in parts of its mean, errors read three times
as high, and are told beside). Times are on all threads, best of several.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from lightpanes.core import metrics
from lightpanes.core.caustics import CausticAtlas
from lightpanes.core.caustics.deposit import deposit
from lightpanes.core.caustics.lamp import LampCaustics
from lightpanes.core.caustics.quadtree import Forest
from lightpanes.core.caustics.splat import SAMPLES

from . import caustic_charts, caustic_references, harness
from .caustic_stages import STAGES, Stage

RESOLUTION = 256
PHOTONS = 40_000
ERROR = {"sphere": 0.005, "lens": 0.005, "ring": 0.01, "knot": 0.025}
OVER_UNIFORM = {"sphere": 1 / 5, "ring": 1 / 5, "knot": 1 / 4}
OVER_POINTS = 1 / 40
FIRST, REFINED = 0.060, 0.5
MEMORY, MANY = 300e6, 10_000_000
REPEATS = 7

Line = list[tuple[float, float, float]]
"""(photons, seconds, error), from few photons to many."""


@dataclass
class Bench:
    """A stage, its atlas and its reference: two halves of W/m²."""

    name: str
    stage: Stage
    atlas: CausticAtlas
    halves: list[np.ndarray]
    mask: np.ndarray
    lines: dict[str, Line] = field(default_factory=dict)

    @property
    def surfaces(self):
        return self.atlas._surfaces

    @property
    def receivers(self):
        return self.atlas._receivers

    def irradiance(self, power: np.ndarray) -> np.ndarray:
        """(256, 256, 3) W/m² of (256², c) W."""
        lit = self.receivers.irradiance(power)
        return np.broadcast_to(lit, (len(lit), 3)).reshape(RESOLUTION, RESOLUTION, 3)

    def lamp(self, photons: int = PHOTONS) -> LampCaustics:
        """The stage's lamp with so many photons, afresh."""
        self.atlas._lamps = {}
        self.atlas.image([self.stage.lamp], photons)
        return self.atlas._lamps[self.stage.lamp.geometry]

    def errors(self, power: np.ndarray) -> tuple[float, metrics.Comparison]:
        """Error in parts of the reference's root mean square; and the comparison, in parts of its mean."""
        reference = (self.halves[0] + self.halves[1]) / 2
        found = metrics.compare(
            self.irradiance(power), reference, self.mask, reference_halves=(self.halves[0], self.halves[1])
        )
        blocks, texels = metrics.block_average(reference, self.mask)
        level = np.sqrt(np.average(blocks[..., 0] ** 2, weights=texels))
        return found.error * found.mean / level, found


def prepare(name: str) -> Bench:
    stage = STAGES[name]()
    atlas = CausticAtlas(stage.scene, RESOLUTION)
    bench = Bench(name, stage, atlas, [], None)
    power = caustic_references.reference(name, bench.surfaces, bench.receivers, stage.lamp)
    bench.halves = [bench.irradiance(half) for half in power]
    texels = atlas._receivers.texels
    mask = np.zeros(RESOLUTION**2, bool)
    mask[texels.index[texels.centred]] = True
    bench.mask = mask.reshape(RESOLUTION, RESOLUTION)
    return bench


def rows() -> Iterator[dict]:
    benches = {}
    for name in STAGES:
        bench = benches[name] = prepare(name)
        yield from energy_rows(bench)
        yield error_row(bench)
        yield from time_rows(bench)
    for name, bench in benches.items():
        bench.lines = {
            "adaptive beams": adaptive(bench),
            "uniform beams": uniform(bench),
            "jittered points": points(bench),
        }
        if name in OVER_UNIFORM:
            yield from equal_rows(bench)
    caustic_charts.draw({name: bench.lines for name, bench in benches.items()})
    pictures = {name: bench.irradiance(bench.lamp().power())[..., 0] for name, bench in benches.items()}
    caustic_charts.draw_pictures(pictures, {name: sum(b.halves)[..., 0] / 2 for name, b in benches.items()})
    yield memory_row(benches["ring"])
    from . import caustic_cycles

    yield from caustic_cycles.rows()


def energy_rows(bench: Bench) -> Iterator[dict]:
    lamp = bench.stage.lamp
    bench.lamp()
    energy = bench.atlas.energy(lamp)
    parts = energy.landed + energy.absorbed + energy.escaped + energy.missed + energy.untraced
    met = energy.emitted - energy.missed
    detail = (
        f"landed {energy.landed / met:.3f}, absorbed {energy.absorbed / met:.3f}, escaped {energy.escaped / met:.3f}"
    )
    yield harness.row(
        f"caustics, {bench.name}: energy not accounted for", abs(parts / energy.emitted - 1), 0.005, detail=detail
    )
    yield harness.row(
        f"caustics, {bench.name}: energy untraced", energy.untraced / met, 0.02, detail="of what meets the object"
    )


def error_row(bench: Bench) -> dict:
    lamp = bench.lamp()
    error, found = bench.errors(lamp.power())
    detail = f"{lamp.used} photons; of the mean {found.error:.4f}, bias {found.bias:+.4f}, reference's noise {found.noise:.4f}"
    return harness.row(f"caustics, {bench.name}: error with 40K photons", error, ERROR[bench.name], detail=detail)


def time_rows(bench: Bench) -> Iterator[dict]:
    atlas, lamp = bench.atlas, bench.stage.lamp
    first, refined = [], []
    for _ in range(REPEATS):
        atlas._lamps = {}
        began = time.perf_counter()
        progress = next(iter(atlas.refine([lamp], PHOTONS)))
        photons = progress.photons
        assert progress.image.shape == (RESOLUTION, RESOLUTION, 4)
        first.append(time.perf_counter() - began)
        atlas._lamps = {}
        began = time.perf_counter()
        atlas.image([lamp], PHOTONS)
        refined.append(time.perf_counter() - began)
    detail = f"{photons} photons, {len(bench.stage.scene.triangles)} triangles"
    yield harness.row(f"caustics, {bench.name}: first picture", 1e3 * min(first), 1e3 * FIRST, "ms", detail=detail)
    yield harness.row(f"caustics, {bench.name}: refined", 1e3 * min(refined), 1e3 * REFINED, "ms", detail="40K photons")


def adaptive(bench: Bench) -> Line:
    line = []
    for photons in (5_000, 10_000, 20_000, 40_000, 80_000, 160_000):
        began = time.perf_counter()
        lamp = bench.lamp(photons)
        spent = time.perf_counter() - began
        line.append((lamp.used, spent, bench.errors(lamp.power())[0]))
    return line


def uniform(bench: Bench) -> Line:
    """The same beams without refinement."""
    line = []
    for level in (4, 5, 6, 7, 8):
        began = time.perf_counter()
        lamp = LampCaustics(bench.stage.lamp, bench.surfaces, bench.receivers, PHOTONS)
        lamp._plant(1, 100)
        coarser = (lamp._family > 0).astype(np.int64)
        forest = Forest(lamp._photons, level - coarser)
        power = deposit(forest, np.arange(len(forest)), bench.receivers, SAMPLES)
        spent = time.perf_counter() - began
        line.append((len(forest.photons), spent, bench.errors(power)[0]))
    return line


def points(bench: Bench) -> Line:
    """Jittered point photons, each to its own texel."""
    line = []
    for photons in (40_000, 160_000, 640_000, 2_560_000):
        began = time.perf_counter()
        power = caustic_references.points(bench.surfaces, bench.receivers, bench.stage.lamp, photons, 77)
        spent = time.perf_counter() - began
        line.append((photons, spent, bench.errors(power)[0]))
    return line


def photons_for(line: Line, error: float) -> tuple[float, bool]:
    """Photons at which a line reaches an error, by the power law between its points, and whether it does so within it."""
    photons, errors = (np.log([p[k] for p in line]) for k in (0, 2))
    # noise may make one point worse than the one before it
    errors = np.minimum.accumulate(errors)
    target = np.log(error)
    if target >= errors[-1]:
        return float(np.exp(np.interp(-target, -errors, photons))), True
    slope = min((errors[-1] - errors[-3]) / (photons[-1] - photons[-3]), -0.25)
    return float(np.exp(photons[-1] + (target - errors[-1]) / slope)), False


def equal_rows(bench: Bench) -> Iterator[dict]:
    used, _, error = bench.lines["adaptive beams"][3]
    for kind, bar in (("uniform beams", OVER_UNIFORM[bench.name]), ("jittered points", OVER_POINTS)):
        needed, within = photons_for(bench.lines[kind], error)
        detail = f"{used} to {needed:.3g} at error {error:.4f}" + ("" if within else ", extrapolated")
        yield harness.row(f"caustics, {bench.name}: photons over those of {kind}", used / needed, bar, detail=detail)


def memory_row(bench: Bench) -> dict:
    bench.atlas._lamps = {}
    tracemalloc.start()
    used = 0
    for progress in bench.atlas.refine([bench.stage.lamp], MANY):
        used = progress.photons
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    detail = f"{used / 1e6:.1f} M photons used"
    return harness.row("caustics: memory with a budget of 10 M photons", peak / 1e6, MEMORY / 1e6, "MB", detail=detail)
