"""The point cache: how fast, how even, how exact at what count, and what exits at points save over exits at texels."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from lightpanes.core import threads as workers
from lightpanes.core.bake import Settings, bake
from lightpanes.core.bake.check import fresh_values, interpolation_error, pane_values
from lightpanes.core.bake.clock import Clock
from lightpanes.core.bake.steps import own_region, prepare
from lightpanes.core.bake.stored import bake_points
from lightpanes.core.lights import irradiance
from lightpanes.core.panes import Relighter
from lightpanes.core.panes.regions import region_of
from lightpanes.core.point_cache import Interpolator, PointSet, make_points, make_points_by_darts, serve, survey
from lightpanes.core.point_cache import guides as steer
from lightpanes.core.point_cache.darts import FLAT, LIKE
from lightpanes.core.point_cache.grid import DiscGrid, LevelGrid, in_chunks
from lightpanes.core.rays import Bvh, Tracer
from lightpanes.core.surface import SurfaceSamples, make_patches

from . import harness, point_charts, point_errors, scenes

PAPER_SECONDS = 240
RUNS = 3
COUNTS = {"pillars": (2000, 4000, 8000), "two_rooms": (2000, 4000, 8000), "atrium": (10_000, 20_000)}
DEFAULT = {"pillars": 0.4, "two_rooms": 0.4, "atrium": 0.55}
TEXELS = {"pillars": (1 / 40, 1 / 10), "atrium": (1 / 8, 1 / 4)}
"""Bars of points over texels as exits: rays, and time of the whole bake."""
BLOCKS = 256


def rows() -> Iterator[dict]:
    yield from make_rows()
    yield leak_row()
    yield from query_rows()
    yield from shadow_rows()
    yield from error_rows()
    yield from by_dart_rows()
    yield from guide_rows()
    for name in TEXELS:
        yield from exit_rows(name)


def make_rows() -> Iterator[dict]:
    """A hundred thousand points on the atrium; then their rules, on a set small enough to check all pairs."""
    scene = scenes.open_sample("atrium", 512)
    best, stages = np.inf, {}
    for _ in range(RUNS):
        marks = [time.perf_counter()]
        patches = make_patches(scene, 4000)
        bvh, offset = Bvh(patches.corners), Tracer(scene).offset
        marks.append(time.perf_counter())
        ground = survey(scene, patches, bvh, offset)
        marks.append(time.perf_counter())
        points = make_points(ground, steer.by_occlusion(ground.ao), 118_000)
        marks.append(time.perf_counter())
        if marks[-1] - marks[0] < best:
            best = marks[-1] - marks[0]
            stages = dict(zip(("scene", "survey", "darts and AO"), np.round(np.diff(marks), 2).tolist(), strict=True))
    detail = (
        f"{len(points)} points, 64 AO rays each, {len(scene.triangles)} triangles; {stages}; paper: 120K in < 4 min"
    )
    yield harness.row("points of the atrium, with ambient occlusion", best, 8, "s", ok=best <= 8 and len(points) >= 100_000, detail=detail)  # fmt: skip
    small = make_points(ground, steer.by_occlusion(ground.ao), 20_000)
    yield harness.row("pairs that break the minimum distance", broken_pairs(small), 0, detail=f"all pairs of {len(small)} points of the atrium")  # fmt: skip
    others = [make_points(ground, steer.by_occlusion(ground.ao), 20_000, batch=batch) for batch in (3000, 1 << 20)]
    with one_thread():
        others.append(make_points(ground, steer.by_occlusion(ground.ao), 20_000))
    differ = sum(not np.array_equal(small.position, other.position) for other in others)
    yield harness.row("sets that other batch sizes or one thread make different", differ, 0, detail="batches of 3,000, 65,536 and 1,048,576 darts")  # fmt: skip
    even = make_points(ground, steer.uniform(ground.coarse), 20_000)
    distance, correlation = pair_correlation(even)
    point_charts.draw_blue_noise(distance, correlation, even)
    close = correlation[distance < 0.98].max()
    yield harness.row("blue noise: pair correlation within the radius", close, 0.01, detail="out/bench/points_blue_noise.png")  # fmt: skip


@contextmanager
def one_thread() -> Iterator[None]:
    was = workers.thread_count
    workers.thread_count = lambda: 1
    try:
        yield
    finally:
        workers.thread_count = was


def broken_pairs(points: PointSet) -> int:
    """Pairs on one surface that face alike and are closer than the smaller radius; all pairs are looked at."""
    position, normal, radius = points.position.astype(np.float64), points.normal, points.radius
    broken = 0
    for start in range(0, len(points), 512):
        own = slice(start, start + 512)
        distance2 = ((position[own, None] - position) ** 2).sum(axis=2)
        i, j = np.nonzero(distance2 < (np.minimum(radius[own, None], radius) * (1 - 1e-5)) ** 2)
        i, j = i[i + start < j], j[i + start < j]
        apart = position[j] - position[own][i]
        alike = np.einsum("nd,nd->n", normal[own][i], normal[j]) > LIKE
        rise = np.abs(np.einsum("nd,nd->n", apart, normal[own][i] + normal[j])) / 2
        broken += int((alike & (rise <= FLAT * np.linalg.norm(apart, axis=1))).sum())
    return broken


def pair_correlation(points: PointSet) -> tuple[np.ndarray, np.ndarray]:
    """Distances in radii and how many neighbours on the same plane there are over those of a random set."""
    edges = np.linspace(0, 4, 81)
    position = points.position.astype(np.float64)
    radius = float(np.median(points.radius))
    # the largest floor, inwards of its border
    flat = np.flatnonzero(points.normal[:, 2] > 0.99)
    level = np.round(position[flat, 2], 3)
    names, counts = np.unique(level, return_counts=True)
    own = position[flat[level == names[counts.argmax()]], :2]
    low, high = np.quantile(own, 0.2, axis=0), np.quantile(own, 0.8, axis=0)
    inner = np.flatnonzero(((own > low) & (own < high)).all(axis=1))
    apart = np.linalg.norm(own[inner, None] - own, axis=2) / radius
    density = len(inner) / float(np.prod(high - low)) * radius**2
    found = np.histogram(apart[apart > 0], edges)[0]
    around = np.pi * (edges[1:] ** 2 - edges[:-1] ** 2) * density * len(inner)
    return 0.5 * (edges[1:] + edges[:-1]), found / around


def leak_row() -> dict:
    """Two rooms whose walls are 1 mm apart, one a hundred times brighter: how much of it points carry across."""
    rng = np.random.default_rng(4)
    count, gap = 4000, 0.001
    side = np.repeat([1.0, -1.0], count // 2)
    place = np.stack([-0.5 * gap * side, *rng.uniform(0, 1, (2, count))], 1).astype(np.float32)
    normal = np.stack([-side, 0 * side, 0 * side], 1).astype(np.float32)
    walls = np.array([[[x, -1, -1], [x, 3, -1], [x, -1, 3]] for x in (-gap / 2, gap / 2)], np.float32)
    samples = SurfaceSamples(place, normal, normal, np.zeros(count, np.int32), np.zeros((count, 3), np.float32))
    points = PointSet(samples, np.full(count, 0.03, np.float32), np.ones(count, np.float32), np.zeros(count, bool))
    values = np.where(side > 0, 100.0, 1.0)[:, None].astype(np.float32)
    asked = samples.take(rng.permutation(count))
    bvh = Bvh(walls)
    apart = Interpolator(points.take(np.arange(0, count, 2)), bvh, 1e-5)
    found = apart.weights(asked).apply(values[::2])[:, 0]
    dark = found[np.round(asked.normal[:, 0]) == 1]
    return harness.row("light that crosses a wall 1 mm thick, 100 : 1", np.abs(dark - 1).max() / 100, 0.01, detail=f"largest of {len(dark)} places")  # fmt: skip


def shadow_rows() -> Iterator[dict]:
    """What else points can hold: ambient occlusion, and an area lamp's direct light with its soft shadows, at the two
    counts that the paper shows."""
    scene = scenes.open_sample("atrium", 512)
    made = prepare(scene, Settings(resolution=512, lamps=400, regions=64, exits="texels"))
    ground = survey(scene, made.patches, made.bvh, made.tracer.offset, seen=made.places)
    lamp = next(light for light in scene.lights if light.kind == "AREA")
    rng = np.random.default_rng(2)
    places = made.exits.samples.take(np.sort(rng.permutation(len(made.exits))[:6000]))

    def looks(samples, looks_each, spp):
        ao = steer.openness(samples, made.bvh, ground.reach, looks_each, made.tracer.offset, 9)
        lifted = samples.position + samples.flat * np.float32(made.tracer.offset)
        light = irradiance(lamp, lifted, samples.normal, made.tracer.visibility, spp, 9)
        return {"ambient occlusion": ao, "soft shadows": light if light.ndim == 1 else light.mean(axis=1)}

    truth = looks(places, 1024, 256)
    found: dict[str, list] = {name: [] for name in truth}
    for count in (30_000, 60_000, 112_000):
        points = make_points(ground, steer.by_occlusion(ground.ao), round(1.1 * count))
        points, weights = serve(points, places, ground, "affine")
        for name, values in looks(points.samples, 64, 64).items():
            # over the root mean square: the lamp lights a corner of the atrium only
            off = weights.apply(values[:, None])[:, 0] - truth[name]
            found[name].append((len(points), float(np.sqrt((off**2).mean() / (truth[name] ** 2).mean()))))
    point_charts.draw_shadows(found)
    for name, values in found.items():
        detail = ", ".join(f"{error:.3f} with {count:,}" for count, error in values)
        yield harness.row(f"{name} in points of the atrium: error with 112K over that with 60K", values[2][1] / values[1][1], detail=detail)  # fmt: skip


def query_rows() -> Iterator[dict]:
    """Look-ups a second, cold and from prepared weights; the paper's grid beside the one without cells of its own."""
    scene = scenes.open_sample("pillars")
    made = prepare(scene, Settings(lamps=400, regions=64, exits="texels"))
    ground = survey(scene, made.patches, made.bvh, made.tracer.offset, seen=made.places)
    points = make_points(ground, steer.uniform(ground.coarse), 20_000)
    places = made.exits.samples
    interpolator = Interpolator(points, made.bvh, made.tracer.offset)
    weights = interpolator.weights(places)
    values = np.random.default_rng(0).uniform(size=(len(points), 3)).astype(np.float32)
    disc = DiscGrid(points.position, points.normal, 2 * points.radius)
    level = LevelGrid(points.position.min(axis=0)).fill(points.position, 2 * points.radius)
    radius = np.full(len(places), 2 * points.radius.max(), np.float32)
    cold, warm, by_disc, by_level = harness.interleaved(
        lambda: interpolator.weights(places),
        lambda: weights.apply(values),
        lambda: in_chunks(lambda s: disc.pairs(places.position[s]), len(places)),
        lambda: in_chunks(lambda s: level.pairs(places.position[s], radius[s]), len(places)),
    )
    detail = f"{len(places)} places, {len(points)} points"
    yield harness.row("interpolated look-ups from prepared weights", len(places) / warm / 1e6, 1, "M/s", at_least=True, detail=detail)  # fmt: skip
    yield harness.row("interpolated look-ups, cold, visibility rays included", len(places) / cold / 1e6, 0.2, "M/s", at_least=True, detail=detail)  # fmt: skip
    yield harness.row("candidates found: grid of oriented discs (the paper's)", len(places) / by_disc / 1e6, unit="M/s", detail=detail)  # fmt: skip
    yield harness.row("candidates found: hash grid by half octaves of radius", len(places) / by_level / 1e6, unit="M/s", detail=detail)  # fmt: skip


def error_rows() -> Iterator[dict]:
    """All guides and interpolations at several counts; error at the middle count over that of plain points."""
    charts = {}
    for name, counts in COUNTS.items():
        setup = point_errors.open_setup(name, max(counts))
        found: dict[tuple[str, str], list] = {}
        for count in counts:
            plain = point_errors.measure_plain(setup, round(1.15 * count))
            found.setdefault(("uniform", point_errors.PLAIN), []).append((plain[0], *plain[1]))
            for guide in point_errors.GUIDES:
                points, errors = point_errors.measure(setup, guide, count)
                for interpolation, (whole, trimmed, worst) in errors.items():
                    found.setdefault((guide, interpolation), []).append((points, whole, trimmed, worst))
        charts[name] = found
        yield from _error_rows(name, counts, found)
    point_charts.draw_errors(charts)


def by_dart_rows() -> Iterator[dict]:
    """Ambient occlusion looked up at each dart, as in the paper, against that of a coarse set."""
    for name, count in (("pillars", 4000), ("atrium", 20_000)):
        setup = point_errors.open_setup(name, count)
        ground = setup.ground
        ways = {
            "coarse set": lambda g=ground, n=count: make_points(g, steer.by_occlusion(g.ao), n),
            "each dart": lambda g=ground, n=count: make_points_by_darts(g, n),
        }
        times = dict(zip(ways, harness.interleaved(*ways.values()), strict=True))
        errors = {way: point_errors.measure_points(setup, make(), ("ward + gradients",)) for way, make in ways.items()}
        detail = ", ".join(
            f"{way} {times[way]:.2f} s, {points} points, error {found['ward + gradients'][0]:.3f}"
            for way, (points, found) in errors.items()
        )
        label = f"ambient occlusion of each dart over that of a coarse set, {name}: time"
        yield harness.row(label, times["each dart"] / times["coarse set"], detail=detail)


def _error_rows(name, counts, found):
    middle = counts[len(counts) // 2]

    def at(guide, interpolation, which=1):
        return point_errors.at_count([(f[0], f[which]) for f in found[guide, interpolation]], middle)

    ours = at("lamps", "ward + gradients")
    plain, uniform = at("uniform", point_errors.PLAIN), at("uniform", "ward + gradients")
    guides = {guide: at(guide, "ward + gradients") for guide in point_errors.GUIDES}
    best = min(guides, key=guides.get)
    others = f"uniform with Shepard as guarded and served as ours {at('uniform', 'linear'):.3f}, with the paper's bare Shepard {at('uniform', 'bare linear'):.3f}"  # fmt: skip
    detail = f"at {middle} points: {ours:.3f} (worst 1 % left out {at('lamps', 'ward + gradients', 2):.3f}, 99.9 % {at('lamps', 'ward + gradients', 3):.2f}) against {plain:.3f}; {others}"  # fmt: skip
    label = f"interpolated irradiance, {name}"
    yield harness.row(f"{label}: default over uniform, plain Shepard", ours / plain, DEFAULT[name], detail=detail)
    detail = f"best: {best}; " + ", ".join(f"{guide} {value:.3f}" for guide, value in guides.items())
    yield harness.row(f"{label}: best guide over uniform", guides[best] / uniform, 0.75, detail=detail)


def guide_rows() -> Iterator[dict]:
    """What the guide is worth in a whole bake, whose test lamps stand near surfaces as well."""
    for name in ("cornell", "pillars"):
        settings = Settings(exits="points")
        made = prepare(scenes.open_sample(name), settings)
        guides = {
            "lamps": None,
            "uniform": lambda ground: steer.uniform(ground.coarse),
            "occlusion": lambda ground: steer.by_occlusion(ground.ao),
            "occlusion gradient": lambda ground: steer.by_occlusion_gradient(ground.ao, ground.coarse, 2 * ground.size),
            "harmonic": lambda ground: ground.harmonic,
        }
        found = {}
        for guide, radius in guides.items():
            stored = bake_points(made, settings, Clock(), radius)
            found[guide] = interpolation_error(made, stored, settings.seed), stored.gathered
        others = {guide: error for guide, (error, _) in found.items() if guide != "lamps"}
        detail = ", ".join(f"{guide} {error:.3f} with {count}" for guide, (error, count) in found.items())
        label = f"a bake's own estimate at points, {name}: lamp guide over the best other"
        yield harness.row(label, found["lamps"][0] / min(others.values()), detail=detail)


def exit_rows(name: str) -> Iterator[dict]:
    """Exits at points against exits at texels, at 1024²."""
    scene = scenes.open_sample(name, 1024)
    results = {}
    for exits in ("texels", "points"):
        result = bake(scene, Settings(resolution=1024, exits=exits))
        relighter = Relighter(result.panes(), Tracer(scene))
        results[exits] = result, relighter
    (texels, by_texel), (points, by_point) = results["texels"], results["points"]
    first, second = texels.report, points.report
    label = f"points over texels as exits, {name}, 1024²"
    off = exit_errors(scene)
    yield harness.row(f"{label}: error of points", off["points"], 0.05, detail=f"texels {off['texels']:.3f}; 4×4 blocks, lamps not trained on, against {off['rays']} rays a texel with the same panes; median lamp {off['median']:.3f}")  # fmt: skip
    fewer, whole = TEXELS[name]
    of_texels = first["texels"] * first["budget"]["exit_rays"]
    of_points = second["gathered_points"] * second["budget"]["point_rays"]
    yield harness.row(f"{label}: rays", of_points / of_texels, fewer, detail=f"{of_points / 1e6:.1f} of {of_texels / 1e6:.1f} M; {second['gathered_points']} gathered, {second['stored_points']} stored, {first['texels']} texels")  # fmt: skip
    stages = f"points {second['stages']}; texels {first['stages']}"
    yield harness.row(f"{label}: time of the whole bake", second["seconds"] / first["seconds"], whole, detail=stages)
    shown = lambda report, *names: sum(report["stages"].get(n, 0) for n in names)  # noqa: E731
    part = shown(second, "Points", "Exits") / shown(first, "Exits")
    yield harness.row(f"{label}: time of the exits alone", part, detail="finding points and weights included")
    held = [sum(b.images[f"Lightpanes {n}"].nbytes for n in ("Panes", "Interpolation", "Static")) for b in (points, texels)]  # fmt: skip
    held[0] += sum(array.nbytes for array in points.points.values())
    yield harness.row(f"{label}: bytes of panes, interpolation and static light", held[0] / held[1], 1 / 3, detail=f"{held[0] / 2**20:.0f} of {held[1] / 2**20:.0f} MiB, the points' own arrays included")  # fmt: skip
    lights = [light for light in scene.lights if light.live]
    weights = [r.pane_weights(lights) for r in (by_texel, by_point)]
    to_texels, to_points, image_texels, image_points = harness.interleaved(
        lambda: by_texel.combine(weights[0]),
        lambda: by_point.combine(weights[1]),
        lambda: by_texel.relight(lights),
        lambda: by_point.relight(lights),
        repeats=9,
    )
    yield harness.row(f"{label}: relight to points", to_points / to_texels, 1 / 4, detail=f"{1000 * to_points:.1f} of {1000 * to_texels:.1f} ms, weights known")  # fmt: skip
    yield harness.row(f"{label}: relight to the image", image_points / image_texels, 1, detail=f"{1000 * image_points:.1f} of {1000 * image_texels:.1f} ms, weights known")  # fmt: skip


def exit_errors(scene) -> dict[str, float]:
    """Relative RMSE of 4×4 blocks of texels, mean over lamps not trained on, of both kinds of exits with one and the
    same panes, against many rays; noise removed by two seeds of the reference."""
    settings = Settings(resolution=1024, exits="points")
    made = prepare(scene, settings)
    stored = bake_points(made, settings, Clock())
    size = made.exits.resolution
    row = np.full(size * size, -1)
    row[made.exits.index] = np.arange(len(made.exits))
    row[made.exits.index[stored.texels.orphan]] = -1
    blocks = row.reshape(size // 4, 4, size // 4, 4).swapaxes(1, 2).reshape(-1, 16)
    blocks = blocks[(blocks >= 0).all(axis=1)]
    rows = np.random.default_rng(0).permutation(blocks)[:BLOCKS].reshape(-1)
    some = made.exits.samples.take(rows)
    region = own_region(made, some)
    order = np.argsort(region, kind="stable")
    back = np.argsort(order)
    many = 1024

    def fresh(count, seed):
        values = fresh_values(made, some.take(order), region[order], count, seed)[back]
        return values.reshape(-1, 16, values.shape[1]).mean(axis=1)

    ours = stored.texels.take(rows).apply(pane_values(made, stored.rows, region_of(stored.starts)))
    ours = ours.reshape(-1, 16, ours.shape[1]).mean(axis=1)
    texels, truth = fresh(made.budget.exit_rays, 5), (fresh(many, 1), fresh(many, 2))
    mean = truth[0].mean(axis=0)
    each = {n: np.sqrt(np.maximum(((v - truth[0]) * (v - truth[1])).mean(axis=0), 0)) / mean for n, v in (("points", ours), ("texels", texels))}  # fmt: skip
    return {n: float(e.mean()) for n, e in each.items()} | {"rays": many, "median": float(np.median(each["points"]))}
