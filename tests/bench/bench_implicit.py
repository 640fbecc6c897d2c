"""The world-space cache: the thesis's tables and figures on four scenes, our default beside its methods, frame times,
leaks, bytes and stability (Delaere 2021, chapters 4 and 5). Ambient occlusion, 480 × 270."""

from __future__ import annotations

import functools
import hashlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lightpanes.core.files import replacing
from lightpanes.core.implicit_cache import (
    Cache,
    choice,
    fixed_point,
    frame_table,
    implicit_points,
    keys,
    one_point,
    probing,
    reconstruction,
)
from lightpanes.core.metrics import flicker, ssim
from lightpanes.core.rays import Bvh

from . import harness, implicit_charts, implicit_methods
from .implicit_errors import Score, score, spectrum
from .implicit_flight import Flight, fly
from .implicit_methods import PAPERS, Reprojection, paper
from .implicit_scenes import STAGES
from .implicit_views import Footage, camera, footage, look, one_bounce, openness

FRAMES = 64
COUNTS = (1, 2, 4, 8, 16, 32, 64)
CELLS = (0.75, 1.5, 3.0)
"""Spacings of the papers' points, in median footprints of a pixel; the best for each method and scene counts."""

MARGIN = 0.015
THESIS = "implicit + barycentric"
GROWTH = (1, 4, 16, 64)
REPEATS = 10
LAMP = (3.0, 1.8, 2.4)
"""Of the interior, whose light bounces once where frames of colour are timed, m."""


@dataclass
class Run:
    """A method on a stage. pictures: (n,) after so many frames; raw: without reconstruction."""

    pictures: dict[int, np.ndarray]
    raw: np.ndarray | None
    entries: int
    bytes_per_entry: int


@functools.cache
def kept(name: str) -> Footage:
    return footage(name, FRAMES)


def ours(name: str, **settings) -> Run:
    return _run_ours(name, tuple(settings.items()))


@functools.cache
def _run_ours(name, settings):
    film, cache = kept(name), Cache(**dict(settings))
    view = film.view
    places = cache.look_up(view.position, view.normal, view.object_id, view.footprint)
    pictures = {}
    for k in range(FRAMES):
        cache.add(places, film.frame(k))
        if k + 1 in COUNTS:
            pictures[k + 1] = cache.read(places)[:, 0]
    return Run(pictures, None, cache.entries, cache.bytes_per_entry)


@functools.cache
def theirs(name: str, method: str, cell: float, ageing: float = 1.0) -> Run:
    """A paper's method; kept in out/bench, since forty of them take two minutes, until the footage or their code changes."""
    film = kept(name)
    told = hashlib.sha256(repr((name, method, cell, ageing, FRAMES, GROWTH)).encode())
    told.update(film.reference.tobytes() + film.frames[0].tobytes() + _papers_code())
    path = harness.OUT / "implicit" / f"{name}-paper-{told.hexdigest()[:16]}.npz"
    if not path.exists():
        run = _run_theirs(name, method, cell, ageing)
        path.parent.mkdir(parents=True, exist_ok=True)
        pictures = {f"after {count}": picture for count, picture in run.pictures.items()}
        with replacing(path) as part:
            np.savez(part, raw=run.raw, numbers=[run.entries, run.bytes_per_entry], **pictures)
    with np.load(path) as found:
        pictures = {int(key[6:]): found[key] for key in found.files if key.startswith("after ")}
        return Run(pictures, found["raw"], *found["numbers"].tolist())


def _papers_code() -> bytes:
    own = (
        one_point,
        choice,
        frame_table,
        implicit_points,
        fixed_point,
        keys,
        probing,
        reconstruction,
        implicit_methods,
    )
    return b"".join(Path(module.__file__).read_bytes() for module in own)


def _run_theirs(name, method, cell, ageing):
    film, cache = kept(name), paper(method, cell, ageing)
    counts = GROWTH if method == THESIS and ageing == 1 else (FRAMES,)
    view = film.view
    places = cache.look_up(view.position, view.normal, view.object_id, np.median(view.footprint))
    pictures = {}
    for k in range(FRAMES):
        added = cache.add(places, film.frame(k))
        if k + 1 in counts:
            pictures[k + 1] = cache.read(places)[:, 0]
    return Run(pictures, cache.at(added)[:, 0], cache.entries, cache.bytes_per_entry)


def scored(name: str, picture: np.ndarray) -> Score:
    film = kept(name)
    return score(film.view.image(picture), film.view.image(film.reference))


def similar(name: str, picture: np.ndarray) -> float:
    """SSIM."""
    film = kept(name)
    return ssim(film.view.image(picture), film.view.image(film.reference))


@functools.cache
def best_cell(name: str, method: str = THESIS) -> float:
    return max(CELLS, key=lambda cell: similar(name, theirs(name, method, cell).pictures[FRAMES]))


def rows() -> Iterator[dict]:
    for name in STAGES:
        film = kept(name)
        yield harness.row(
            f"{name}: triangles", len(STAGES[name]().corners), detail=f"{film.view.hit.mean():.0%} of pixels hit"
        )
    table = yield from table_rows()
    yield from setting_rows()
    growth = figure_15()
    occupancy = table_2()
    yield from time_rows()
    yield leak_row()
    for channels, bar in ((1, 12), (3, 20)):
        cache = Cache(channels)
        yield harness.row(f"bytes per cached point, {channels} channels", cache.bytes_per_entry, bar, "bytes")
    yield from stability_rows()
    yield from flight_rows()
    implicit_charts.draw(table, growth, occupancy, spectra())
    implicit_charts.pictures({name: crops(name) for name in STAGES})


def table_rows() -> Iterator[dict]:
    """Table 1, and whose SSIM is best by how much."""
    table = {}
    for name in STAGES:
        film = kept(name)
        scores = {"per pixel": scored(name, film.frames.mean(axis=0))}
        for method in PAPERS:
            best = best_cell(name, method)
            raw = max((theirs(name, method, cell).raw for cell in CELLS), key=lambda picture: similar(name, picture))
            scores[f"{method}, raw"] = scored(name, raw)
            scores[f"{method}, filtered"] = scored(name, theirs(name, method, best).pictures[FRAMES])
            if method == THESIS:
                aged = theirs(name, method, best, ageing=0.9)
                scores["the same, s = 0.9"] = scored(name, aged.pictures[FRAMES])
        scores["ours"] = scored(name, ours(name).pictures[FRAMES])
        table[name] = {key: value.as_dict() for key, value in scores.items()}
        mine, thesis = scores["ours"], scores[f"{THESIS}, filtered"]
        others = {key: s.ssim for key, s in scores.items() if key != "ours"}
        rival = max(others, key=others.get)
        for key, s in scores.items():
            yield harness.row(
                f"Table 1: {name}, {key}: SSIM",
                s.ssim,
                detail=f"MSE {s.mse:.5f}, PSNR {s.psnr:.2f} dB, FLIP {s.flip:.4f}, seen error {s.seen:.4f}",
            )
        yield harness.row(
            f"{name}: our SSIM over {THESIS} filtered", mine.ssim - thesis.ssim, MARGIN, at_least=True,
            detail=f"{mine.ssim:.3f} and {thesis.ssim:.3f} at its best level",
        )  # fmt: skip
        yield harness.row(
            f"{name}: our SSIM over the best of all others", mine.ssim - others[rival], 0, at_least=True, detail=rival
        )
        yield harness.row(
            f"{name}: our FLIP over the thesis's",
            mine.flip / thesis.flip,
            unit="×",
            detail=f"{mine.flip:.4f} and {thesis.flip:.4f}",
        )
        yield harness.row(
            f"{name}: our seen error over the thesis's",
            mine.seen / thesis.seen,
            1,
            "×",
            detail="weighed by contrast sensitivity",
        )
    return table


def setting_rows() -> Iterator[dict]:
    """The default at all sample counts, against fixed levels, each of them best somewhere."""
    fixed = {
        "L3": {"fine": 3.0, "coarse": None},
        "L6": {"fine": 6.0, "coarse": None},
        "L12": {"fine": 12.0, "coarse": None},
    }
    worst = []
    for name in STAGES:
        default = [similar(name, ours(name).pictures[count]) for count in COUNTS]
        singles = {
            key: [similar(name, ours(name, **s).pictures[count]) for count in COUNTS] for key, s in fixed.items()
        }
        best = np.max(list(singles.values()), axis=0)
        worst.append(float(np.min(default - best)))
        shown = ", ".join(f"{count}: {value:.3f}" for count, value in zip(COUNTS, default, strict=True))
        yield harness.row(f"{name}: our SSIM after 1 frame", default[0], detail=shown)
    yield harness.row(
        "one setting for all: least SSIM over the best single level at any count", min(worst),
        detail=f"of L3, L6 and L12 for 1 … 64 frames; by scene {', '.join(f'{w:+.3f}' for w in worst)}",
    )  # fmt: skip


def figure_15() -> dict:
    """SSIM over frames by level, of the thesis's method and of ours, in its two scenes."""
    result = {}
    for name in ("interior", "exterior"):
        lines = {}
        for cell in CELLS:
            run = theirs(name, THESIS, cell)
            lines[f"thesis, spacing {cell:g}"] = [(c, similar(name, run.pictures[c])) for c in GROWTH]
        lines["ours"] = [(c, similar(name, ours(name).pictures[c])) for c in COUNTS]
        result[name] = lines
    return result


def table_2() -> dict:
    """Entries by level."""
    result = {}
    for name in STAGES:
        entries = {f"thesis, spacing {cell:g}": theirs(name, THESIS, cell).entries for cell in CELLS}
        entries["ours"] = ours(name).entries
        result[name] = entries
    return result


def spectra() -> dict:
    result = {}
    for name in STAGES:
        film = kept(name)
        best = best_cell(name)
        shown = {
            "per pixel": film.frames.mean(axis=0),
            "fixed + barycentric": theirs(name, "fixed + barycentric", best).pictures[FRAMES],
            THESIS: theirs(name, THESIS, best).pictures[FRAMES],
            "ours": ours(name).pictures[FRAMES],
        }
        error = {key: film.view.image(value) - film.view.image(film.reference) for key, value in shown.items()}
        result[name] = {key: [part.tolist() for part in spectrum(value)] for key, value in error.items()}
    return result


def crops(name: str) -> dict[str, np.ndarray]:
    film = kept(name)
    best = best_cell(name)
    return {
        "reference": film.view.image(film.reference),
        "one frame": film.view.image(film.frame(0)),
        "ours, 1 frame": film.view.image(ours(name).pictures[1]),
        "ours, 64 frames": film.view.image(ours(name).pictures[FRAMES]),
        f"{THESIS}, 64": film.view.image(theirs(name, THESIS, best).pictures[FRAMES]),
        "per pixel, 64": film.view.image(film.frames.mean(axis=0)),
    }


class Watch:
    """Least milliseconds of each stage."""

    def __init__(self):
        self.best = {}

    def run(self, stage: str, function, *arguments):
        began = time.perf_counter()
        result = function(*arguments)
        self.best[stage] = min(self.best.get(stage, np.inf), 1e3 * (time.perf_counter() - began))
        return result

    def told(self) -> str:
        return ", ".join(f"{stage} {value:.0f}" for stage, value in self.best.items())


def time_frames(name: str, colour: bool = False) -> tuple[Watch, Watch]:
    """Stages of frames while the camera moves 1 cm each, and at rest: of occlusion, or of light that bounced once."""
    stage = STAGES[name]()
    bvh, cache = Bvh(stage.corners), Cache(3 if colour else 1)
    eye, target = np.array(stage.eye), np.array(stage.target)
    step = 0.01 * (target - eye) / np.linalg.norm(target - eye)

    def sample(view, k):
        return one_bounce(view, bvh, stage, LAMP, k) if colour else openness(view, bvh, stage.reach, k)

    view = look(stage, bvh, camera(stage))
    # the first frame fills the table
    cache.frame(view.position, view.normal, view.object_id, view.footprint, sample(view, 0))
    moving, still = Watch(), Watch()
    for k in range(1, REPEATS + 1):
        view = moving.run("hits", look, stage, bvh, camera(stage, eye + k * step, target + k * step))
        value = moving.run("rays", sample, view, k)
        places = moving.run("look-up", cache.look_up, view.position, view.normal, view.object_id, view.footprint)
        moving.run("add", cache.add, places, value)
        moving.run("read", cache.read, places)
        for again in range(2):
            value = still.run("rays", sample, view, 100 + again)
            still.run("add", cache.add, places, value)
            still.run("read", cache.read, places)
    return moving, still


def time_rows() -> Iterator[dict]:
    """Frame times as in Table 3, and the cache's part of them."""
    for name, colour in (*((name, False) for name in STAGES), ("interior", True)):
        watches = time_frames(name, colour)
        for watch, state, bar in zip(watches, ("moving", "at rest"), (120, 60), strict=True):
            best = watch.best
            rays = best.get("hits", 0) + best["rays"]
            own = best.get("look-up", 0) + best["add"] + best["read"]
            # the bars are the interior's
            wanted = name == "interior"
            label = f"{name}, {'one bounce of light' if colour else 'occlusion'}, {state}"
            yield harness.row(
                f"Table 3: {label}: frame", rays + own, bar if wanted else None, "ms", detail=watch.told()
            )
            yield harness.row(
                f"{label}: the cache's stages over the frame's rays", own / rays, 1.5 if wanted else None, "×"
            )
    yield from thesis_times()


def thesis_times() -> Iterator[dict]:
    """The thesis's method as written, 216 candidates, and with the 27 octants that hold the same points."""
    film = kept("interior")
    view = film.view
    for neighbourhood in (None, 26):
        cache = paper(THESIS, 3.0, neighbourhood=neighbourhood)
        began = time.perf_counter()
        places = cache.look_up(view.position, view.normal, view.object_id, np.median(view.footprint))
        found = time.perf_counter()
        cache.add(places, film.frame(0))
        added = time.perf_counter()
        cache.read(places)
        end = time.perf_counter()
        yield harness.row(
            f"Table 3: interior, {THESIS}, {'27 octants' if neighbourhood is None else '216 points'}", 1e3 * (end - began), unit="ms",
            detail=f"search {1e3 * (found - began):.0f}, add {1e3 * (added - found):.0f}, reconstruct {1e3 * (end - added):.0f}",
        )  # fmt: skip


def leak_row() -> dict:
    """The dark side of a wall 1 mm thick, lit a hundred times as much on the other."""
    y, x = np.mgrid[:128, :128].reshape(2, -1).astype(np.float32) * np.float32(0.01)
    side = np.stack([x, y, 0 * x], axis=1)
    position = np.concatenate([side + np.float32([0, 0, 0.001]), side])
    normal = np.repeat(np.float32([[0, 0, 1], [0, 0, -1]]), len(side), axis=0)
    light = np.repeat(np.float32([1, 0.01]), len(side))
    cache = Cache()
    for _ in range(FRAMES):
        found = cache.frame(position, normal, None, np.float32(0.01), light)[:, 0]
    leak = float(np.abs(found[len(side) :] - 0.01).max())
    return harness.row("leak through a 1 mm wall, 100:1", 100 * leak, 1, "%", detail="worst pixel, of the bright side")


def stability_rows() -> Iterator[dict]:
    worst, shown = {}, {}
    for name in STAGES:
        film = kept(name)
        view, cache, stage = film.view, Cache(), STAGES[name]()
        places = cache.look_up(view.position, view.normal, view.object_id, view.footprint)
        pictures, bvh = [], Bvh(stage.corners)
        for k in range(FRAMES + 8):
            cache.add(places, film.frame(k) if k < FRAMES else openness(view, bvh, stage.reach, k))
            if k >= FRAMES:
                pictures.append(cache.read(places)[:, 0])
        steps = np.diff(pictures, axis=0)
        worst[name] = 100 * float(np.sqrt((steps**2).mean()) / film.reference.mean())
        # the lamp of a uniform sky goes to four tenths
        before = float(pictures[-1].mean())
        cache.drop()
        for k in range(10):
            cache.add(places, np.float32(0.4) * film.frame(k))
        shown[name] = 100 * (before - float(cache.read(places).mean())) / (0.6 * before)
    detail = "; ".join(f"{name} {value:.2f}" for name, value in worst.items())
    yield harness.row("flicker at rest after 64 frames, worst scene", max(worst.values()), 0.5, "%", detail=detail)
    detail = "; ".join(f"{name} {value:.0f}" for name, value in shown.items())
    yield harness.row(
        "a lamp jumps: change shown after 10 frames, worst scene",
        min(shown.values()),
        80,
        "%",
        at_least=True,
        detail=detail,
    )


def film_of(flight: Flight) -> dict[str, list[np.ndarray]]:
    """Pictures of the measured frames, by the cache and by reprojection."""
    cache, plain = Cache(), Reprojection()
    films = {"ours": [], "reprojection + à-trous": []}
    for k, (view, value) in enumerate(zip(flight.views, flight.frames, strict=True)):
        mine = cache.frame(view.position, view.normal, view.object_id, view.footprint, value)[:, 0]
        other = plain.frame(view, value, functools.partial(flight.project, number=k - 1))
        if k >= flight.first:
            for film, picture in zip(films.values(), (mine, other), strict=True):
                film.append(view.image(picture))
    return films


def flight_rows() -> Iterator[dict]:
    """A camera that moves 1 cm and turns 0.25° a frame."""
    for name in ("interior", "statue"):
        flight = fly(name)
        films = film_of(flight)
        truth = [view.image(value) for view, value in zip(flight.views[flight.first :], flight.references, strict=True)]
        quality, jumps, squares = [], [], []
        for film in films.values():
            quality.append(float(np.mean([ssim(a, b) for a, b in zip(film, truth, strict=True)])))
            squares.append(float(np.mean((np.stack(film) - np.stack(truth)) ** 2)))
            jumps.append(100 * flicker(np.stack(film)[..., None], np.stack(truth)[..., None]))
        yield harness.row(
            f"{name}, moving camera: our SSIM over reprojection and à-trous", quality[0] - quality[1], 0, at_least=True,
            detail=f"{quality[0]:.3f} and {quality[1]:.3f}; MSE {squares[0]:.5f} and {squares[1]:.5f}",
        )  # fmt: skip
        yield harness.row(
            f"{name}, moving camera: our flicker over theirs", jumps[0] / jumps[1], 1, "×",
            detail=f"{jumps[0]:.2f} % and {jumps[1]:.2f} %",
        )  # fmt: skip
        implicit_charts.strip(
            f"{name}-moving", {"reference": truth[-1], **{key: film[-1] for key, film in films.items()}}
        )
