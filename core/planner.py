"""From the error that the user accepts to budgets of entries, rays and panes. Runs nothing itself."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np

from .scene import Scene, SceneError

EXITS = ("auto", "points", "texels", "atlas")

LEAST = {
    "entries": 800,
    "entry_rays": 256,
    "exit_rays": 16,
    "regions": 48,
    "lamps": 400,
    "points": 1000,
    "point_rays": 64,
}
"""What a time budget cuts budgets to at most: with less, a bake takes hardly less time."""

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
    lamp that is not live, for its caustics.

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

    def __post_init__(self):
        if not 1e-3 <= self.error_target <= 1:
            raise SceneError(f"The error target is {self.error_target}; use a number from 0.001 to 1.")
        if not 0 <= self.time_budget < 1e9:
            raise SceneError(f"The time budget is {self.time_budget} s; use 0 for none, or a positive number.")
        if not 16 <= self.resolution <= 8192:
            raise SceneError(f"The resolution is {self.resolution}; use 16 to 8192 texels.")
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
        exit_rays=_clamp(192 * finer, 32, 2048),
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
class Took:
    """What a bake's stages took with a budget, s, and what its transport traced, rays."""

    budget: Budget
    entries: float
    transport: float
    lamps: float
    panes: float
    rays: int

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


def limit_rays(budget: Budget, rays: str, places: int, rate: float, left: float) -> Budget:
    """Budget whose gather fits into `left` seconds at `rate` rays a second. rays: the field that is cut, "exit_rays" or
    "point_rays"; places: from how many they start."""
    return replace(budget, **{rays: _clamp(left * rate / max(places, 1), 16, getattr(budget, rays))})


def _clamp(value: float, low: int, high: int) -> int:
    return int(min(max(round(value), low), high))
