"""From the error that the user accepts to budgets of entries, rays and panes. Runs nothing itself."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np

from .memory import DEFAULT, LEAST_MEMORY
from .scene import Scene, SceneError

EXITS = ("auto", "points", "texels", "atlas")

LEAST = {
    "entries": 600,
    "entry_rays": 256,
    "exit_rays": 16,
    "regions": 28,
    "lamps": 350,
    "points": 1000,
    "point_rays": 64,
}
"""What a time budget cuts budgets to at most, and what a planner tries first: with less, a bake takes hardly
less time."""

FEWEST_POINTS = 300
"""With fewer, small things have one or none."""

MOST_ENTRIES, MOST_POINTS = 10_000, 60_000
"""Their transport, and their weights, take time and memory with the square of the entries."""

IN_REGION = 22
"""Entries of a region: its panes are then about two thirds of what would hold any light."""

SURE = 0.9
"""Part of the error target that a bake's own error must not exceed: under other lamps than those that it judges itself by
the error is another, by a tenth or so."""

GOAL = 0.95
"""Part of that which a larger budget aims at: no step hits what it aims at."""

OF_NOISE, OF_POINTS = 0.4, 0.6
"""Parts of the target that the gather's noise, and points, may take; they add up as squares."""

LEAST_NOISE = 0.15
"""The same where that saves another trial: rays at exits cost less than anything else."""

OF_REST = 0.5
"""What comes from between points, over the rest of an error, below which more points change that by a tenth or less."""

FALL, FALL_SPREAD = 0.72, 0.15
"""Power of the entries' number with which their error falls, and how far that of a scene is from it."""

STEEPEST = 0.9
"""The largest power that is believed."""

HOPELESS = 3.0
"""Entries that an error asks for, over the most, from which on no freak of one trial explains it."""

FREAK = 0.15
"""How far one trial's error is from where others say that it should be, as a part of it: where regions end is chance."""

EXITS_PAY = 0.5
"""Rays of all exits, over those of entries and training lamps, up to which more of them cost less time than they take of the
error: single texels in the shade, too dark to count in it, show their noise."""

RAYS_FALL = 0.75
"""Power of the rays' number with which the noise of a gather falls: they are stratified."""

MOST_EXIT_RAYS = 2048
"""Of a texel; more of them change nothing that anyone would see."""

MOST_RAYS = {"exit_rays": 8192, "point_rays": 8192}
"""Of an exit, where time is left for them that was asked for and that nothing else would fill."""

USUAL = 3750
"""Entries that an error of 0.05 takes."""

PILOT = (500, 1600)
"""Least and most entries of the bake that is tried first, a quarter or so of what the target usually takes."""

POINT_RAYS = 130
"""Rays that take as long as to find a point and place it."""

POINTS_PAY = 4
"""Rays of texels over those of points at which points begin to be the cheaper exits."""


@dataclass(frozen=True)
class Settings:
    """What the user states.

    error_target: accepted relative error of indirect irradiance (design, "The error of a bake").
    time_budget: s for the whole bake, 0 for none. resolution: of the atlas, texels a side. seed: of all
    random numbers. entries, entry_rays, exit_rays, regions, panes, lamps, points, point_rays: budgets to use instead of
    the planner's; None leaves them to it. exits: where light is gathered, "points" or "texels"; "auto" takes points
    where they are cheaper; "atlas" gathers at points and spreads their panes to all texels, for engines. photons: of each
    lamp that is not live, for its caustics. memory: GiB that the bake may take beside what was there before it.

    Raises SceneError for values that make no sense.
    """

    error_target: float = 0.05
    time_budget: float = 0.0
    resolution: int = 256
    seed: int = 0
    entries: int | None = None
    entry_rays: int | None = None
    exit_rays: int | None = None
    regions: int | None = None
    panes: int | None = None
    lamps: int | None = None
    points: int | None = None
    point_rays: int | None = None
    exits: str = "auto"
    photons: int = 40_000
    memory: float = DEFAULT

    def __post_init__(self):
        if not 1e-3 <= self.error_target <= 1:
            raise SceneError(f"The error target is {self.error_target}; use a number from 0.001 to 1.")
        if not 0 <= self.time_budget < 1e9:
            raise SceneError(f"The time budget is {self.time_budget} s; use 0 for none, or a positive number.")
        if not 16 <= self.resolution <= 8192:
            raise SceneError(f"The resolution is {self.resolution}; use 16 to 8192 texels.")
        if not LEAST_MEMORY <= self.memory < 1e6:
            raise SceneError(f"The memory is {self.memory} GiB; use {LEAST_MEMORY} or more.")
        if self.photons < 1:
            raise SceneError(f"Caustics have {self.photons} photons a lamp; use a positive number.")
        if self.exits not in EXITS:
            raise SceneError(f"Exits are at {self.exits!r}; use one of {', '.join(EXITS)}.")
        for name in Budget.__dataclass_fields__:
            value = getattr(self, name)
            if value is not None and value < 1:
                raise SceneError(f"The budget {name} is {value}; use a positive number, or None for the planner's.")


@dataclass(frozen=True)
class Budget:
    """entries: patches' sides. entry_rays, exit_rays, point_rays: cosine rays of each. regions, panes: regions and
    scalar panes of each. lamps: training lamps, two thirds of them near surfaces. points: gathered points."""

    entries: int
    entry_rays: int
    exit_rays: int
    regions: int
    panes: int
    lamps: int
    points: int
    point_rays: int


def plan(scene: Scene, settings: Settings) -> Budget:
    """Budgets for an error target, scaled from those measured at 0.05.

    The error of the entries' size falls with their number, that of the gather with the root of the rays. Where no lamp
    is live the first bounce is known more finely than by entries, so fewer do.
    """
    finer = 0.05 / settings.error_target
    live = needs_panes(scene)
    budget = Budget(
        entries=_clamp((4400 if live else 3000) * finer**0.6, 800, 10_000),
        entry_rays=_clamp((512 if live else 256) * finer, 256, 4096),
        exit_rays=_clamp(192 * finer, 32, MOST_EXIT_RAYS),
        regions=_clamp(192 * finer**0.3, 48, 256),
        panes=16 if finer <= 2 else 24,
        lamps=_clamp(1400 * finer**0.5, 400, 4000),
        # the triangles of a detailed mesh face every way, so one point serves no more than a few of them
        points=_clamp(max(12_000, len(scene.triangles) / 4) * finer, 1000, 60_000),
        point_rays=_clamp(1024 * finer**0.5, 128, 4096),
    )
    return _as_given(budget, settings)


def _as_given(budget: Budget, settings: Settings) -> Budget:
    given = {name: value for name in Budget.__dataclass_fields__ if (value := getattr(settings, name)) is not None}
    return replace(budget, **given)


def part_of(budget: Budget, settings: Settings, part: float) -> Budget:
    """Budgets that take about `part` of the time, in [0, 1], of `budget`, down to the least that are of use; those that
    the settings give stay."""
    root = part**0.5
    scales = {"entries": root, "lamps": root, "regions": root**0.5, "panes": 1.0}
    cut = {
        name: _clamp(most * scales.get(name, part), min(LEAST.get(name, most), most), most)
        for name, most in asdict(budget).items()
    }
    return _as_given(Budget(**cut), settings)


@dataclass(frozen=True)
class Judged:
    """A bake up to its panes, as it was found to be. error: relative, with `budget.exit_rays` rays at each exit; noise: the
    part of it that falls with those rays."""

    budget: Budget
    error: float
    noise: float


def sized(budget: Budget, entries: int, settings: Settings) -> Budget:
    """The budget with so many entries, and with the regions, training lamps and rays that go with them."""
    times = entries / 4400
    changed = replace(
        budget,
        entries=entries,
        entry_rays=_clamp(512 * times**0.5, LEAST["entry_rays"], 1024),
        regions=_clamp(entries / IN_REGION, LEAST["regions"], 400),
        lamps=_clamp(1400 * times**0.7, LEAST["lamps"], 3000),
    )
    return _as_given(changed, settings)


def usual(settings: Settings, budget: Budget) -> Budget:
    """What trials usually lead to: `budget` with other entries, and what goes with them."""
    entries = USUAL * (0.05 / settings.error_target) ** (1 / FALL)
    return sized(budget, _clamp(entries, LEAST["entries"], MOST_ENTRIES), settings)


def first_try(settings: Settings, budget: Budget) -> Budget:
    """What a bake that is but looked at takes, to tell from it what `budget` takes for the target."""
    small = sized(budget, _clamp(usual(settings, budget).entries / 3.5, *PILOT), settings)
    return _as_given(replace(small, points=max(budget.points // 2, 1)), settings)


def refine(settings: Settings, judged: list[Judged], at_points: bool, whole: bool = True) -> Budget:
    """What to try next, or the last budget with other rays at its exits where its entries are enough, or the most.

    judged: all that were tried. whole: whether the last of them can be the bake; otherwise what is tried next may be smaller
    as well. Most of what is asked for may come from the entries' size, with which all but the gather's noise falls.
    """
    last = judged[-1]
    target = SURE * settings.error_target
    size = beyond_noise(last)
    noise = OF_POINTS * target if at_points else OF_NOISE * target
    enough = size**2 + noise**2 <= target**2
    if not at_points and not enough and size**2 + (LEAST_NOISE * target) ** 2 <= target**2:
        noise, enough = (target**2 - size**2) ** 0.5, True
    allowed = OF_NOISE * target if at_points else noise
    wanted = np.ceil(last.budget.exit_rays * (last.noise / allowed) ** (1 / RAYS_FALL))
    rays = _clamp(wanted, LEAST["exit_rays"], MOST_EXIT_RAYS)
    fine = replace(last.budget, exit_rays=rays)
    if whole and (enough or last.budget.entries >= MOST_ENTRIES):
        return _as_given(fine, settings)
    goal = max((GOAL * target) ** 2 - noise**2, (0.3 * target) ** 2) ** 0.5
    # a step too far costs more than one more step
    most = 6.0 if len(judged) == 1 else 2.5
    if last.budget.entries * (size / goal) ** (1 / STEEPEST) > HOPELESS * MOST_ENTRIES:
        # but where all steps lead to the most, those between are for nothing
        most = np.inf
    times = np.clip(_asked(judged, goal) / last.budget.entries, 1.25 if whole else 0.0, most)
    entries = _clamp(last.budget.entries * times, LEAST["entries"], MOST_ENTRIES)
    return _as_given(sized(fine, entries, settings), settings)


def cheap_rays(settings: Settings, budget: Budget, exits: int) -> Budget:
    """The budget with as many rays at each of its exits, texels, as hardly take time beside all that came before."""
    before = budget.entries * (budget.entry_rays + budget.lamps)
    rays = _clamp(EXITS_PAY * before / max(exits, 1), budget.exit_rays, MOST_EXIT_RAYS)
    return _as_given(replace(budget, exit_rays=rays), settings)


def _asked(judged, goal):
    """Entries whose error is the goal, by all that was tried: a line through logarithms, whose slope is FALL as far as
    nothing is known."""
    entries = np.log([j.budget.entries for j in judged])
    size = np.log([beyond_noise(j) for j in judged])
    away = entries - entries.mean()
    known = (FREAK / FALL_SPREAD) ** 2
    fall = np.clip((known * FALL - away @ size) / (known + away @ away), 0.4, STEEPEST)
    return float(np.exp((size.mean() + fall * entries.mean() - np.log(goal)) / fall))


def beyond_noise(judged: Judged) -> float:
    """The part of the error that more rays leave."""
    return max(judged.error**2 - judged.noise**2, (0.3 * judged.error) ** 2) ** 0.5


def more_points(settings: Settings, budget: Budget, error: float, points: float) -> Budget | None:
    """The budget with the points that the error asks for; None where there are enough, or as many as can be, or where more
    of them change little. points: the part of `error` that comes from between them."""
    if error <= SURE * settings.error_target or budget.points >= MOST_POINTS or settings.points is not None:
        return None
    times = _times_points(settings, error, points)
    if times <= 1:
        return None
    times = min(max(times, 1.3), 3.0)
    return replace(budget, points=_clamp(budget.points * times, 1, MOST_POINTS))


def few_points(budget: Budget) -> Budget:
    """The budget with so few points that they are hardly ever enough: what is tried first."""
    return replace(budget, points=max(budget.points // 2, min(FEWEST_POINTS, budget.points)))


def no_more_points(settings: Settings, budget: Budget, error: float, points: float) -> Budget:
    """The budget with the points that the error asks for, where there are more than that."""
    times = min(max(_times_points(settings, error, points), 0.4), 1.0)
    return replace(budget, points=_clamp(budget.points * times, min(FEWEST_POINTS, budget.points), budget.points))


def _times_points(settings, error, points):
    """Points that an error asks for, over those that there are."""
    goal, rest = GOAL * SURE * settings.error_target, max(error**2 - points**2, 0.0)
    # what is small beside the rest is hardly seen
    return (points / max(goal**2 - rest, OF_REST**2 * rest) ** 0.5) ** 2


@dataclass(frozen=True)
class Took:
    """What a bake's stages took with a budget, s, and what its transport traced, rays. check: what measuring its error
    took, which is done once more at the end."""

    budget: Budget
    entries: float
    transport: float
    lamps: float
    panes: float
    rays: int
    check: float = 0.0

    def foresee(self, budget: Budget, places: int) -> float:
        """s that the same stages, and the gather from exits, take with another budget. places: texels that are exits, 0
        where points are."""
        was = self.budget
        more = budget.entries / was.entries
        near = was.entries * was.entry_rays
        pairs = max(self.rays - near, 0)
        traced = budget.entries * budget.entry_rays + pairs * more**2
        gathered = places * budget.exit_rays or budget.points * (budget.point_rays + POINT_RAYS)
        modes = budget.regions * budget.panes / (was.regions * was.panes) * budget.lamps / was.lamps
        return (
            self.entries
            + self.transport * (traced + 1.1 * gathered) / max(self.rays, 1)
            + self.lamps * more * budget.lamps / was.lamps
            + self.panes * more * max(more, modes)
            # its places stay the same, and the last time most of it is remembered
            + self.check * (1.4 + 0.1 * more)
        )


def fit(budget: Budget, settings: Settings, took: Took, places: int, left: float) -> Budget | None:
    """The largest part of `budget` that fits into `left` seconds, by what a small one took; None where that is hardly
    larger than the small one."""
    for part in np.geomspace(1, 0.01, 60):
        smaller = part_of(budget, settings, part)
        if took.foresee(smaller, places) <= left:
            return smaller if smaller.entries > 1.2 * took.budget.entries else None
    return None


def needs_panes(scene: Scene) -> bool:
    """Whether any lamp may change. A scene without lamps gets panes for those that may come."""
    return not scene.lights or any(light.live for light in scene.lights)


def uses_points(settings: Settings, budget: Budget, texels: int, vertices: int) -> bool:
    """Whether exits are points: where objects are lit at their vertices, and where points need fewer rays, those that
    find and place them included."""
    if settings.exits == "auto":
        return vertices > 0 or texels * budget.exit_rays > POINTS_PAY * budget.points * budget.point_rays
    if settings.exits == "atlas" and vertices:
        raise SceneError("Objects that are lit at their vertices need points as exits; an atlas has no place for them.")
    return vertices > 0 or settings.exits != "texels"


def _clamp(value: float, low: int, high: int) -> int:
    return int(min(max(round(value), low), high))
