"""Progress of a bake and the seconds of its stages."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

now = time.perf_counter
"""s; the clock of all bakes."""


@dataclass(frozen=True)
class Progress:
    """stage: what is being done. fraction: of the whole bake, in [0, 1]. rays: traced so far. error: relative, as far as
    it is known by now. seconds_left: s, about."""

    stage: str
    fraction: float
    rays: int
    error: float | None = None
    seconds_left: float | None = None


class Clock:
    """Reports progress and remembers the seconds of each stage, and the rays that it traced.

    progress: called with a Progress; an exception that it raises passes through and cancels the bake. earlier: s that
    cancelled bakes, from which this one goes on, took for `reached`, a fraction of the whole. ahead: s of a time budget
    that were spent before the bake began.
    """

    STAGES = {
        "Surfaces": 0.03,
        "Pilot": 0.05,
        "Entries": 0.10,
        "Transport": 0.40,
        "Lamps": 0.52,
        "Panes": 0.62,
        "Caustics": 0.64,
        "Points": 0.80,
        "Exits": 0.97,
        "Check": 1.0,
    }
    """Where in the whole each stage ends."""

    JUDGING = "Judging"
    """A stage that comes wherever something was tried: it takes no part of the whole."""

    def __init__(
        self,
        progress: Callable[[Progress], None] | None = None,
        earlier: float = 0.0,
        reached: float = 0.0,
        ahead: float = 0.0,
    ):
        self.progress = progress
        self.earlier, self.reached, self.ahead = earlier, reached, ahead
        self.seconds: dict[str, float] = {}
        self.traced: dict[str, int] = {}
        self.rays = 0
        self.error: float | None = None
        self.began = now()
        self._stage, self._stage_began = "", self.began
        self._done, self._total, self._rays_before = 0, 1, 0
        self._shown = 0.0

    @property
    def spent(self) -> float:
        """s since the bake began."""
        return now() - self.began

    def start(self, stage: str, steps: int = 1) -> None:
        """Begin one of STAGES, or JUDGING, which will tick `steps` steps (rays, where it traces)."""
        self.stop()
        self._stage, self._stage_began = stage, now()
        self._done, self._total, self._rays_before = 0, max(steps, 1), self.rays
        self.tick(0)

    def skip(self, steps: int) -> None:
        """Steps that an earlier bake did."""
        self._done += steps

    def pilot(self) -> Clock:
        """For a smaller bake within this stage: its progress is the stage's, its rays are the whole bake's."""
        before = self.rays

        def told(progress):
            self.rays, self._done = before + progress.rays, progress.fraction * self._total
            self.tick(0)

        return Clock(told)

    def stop(self) -> None:
        """End the stage."""
        if self._stage:
            # a planner may come back to a stage
            before = self.seconds.get(self._stage, 0.0)
            self.seconds[self._stage] = round(before + now() - self._stage_began, 4)
            self.traced[self._stage] = self.traced.get(self._stage, 0) + self.rays - self._rays_before
            self._stage = ""

    def pulse(self, _rays: int) -> None:
        """Something goes on, of which nothing is counted; the time to cancel it."""
        self.tick(0, 0)

    def tick(self, steps: int, rays: int | None = None) -> None:
        """Steps done since the last tick; they are rays unless said otherwise."""
        self.rays += steps if rays is None else rays
        self._done += steps
        if self.progress is None:
            return
        # stages come again where a bake is tried more than once
        fraction = self._shown = max(self._shown, self._fraction())
        # what was kept goes by in no time, and its seconds are those of the earlier bakes
        self.reached = max(self.reached, fraction)
        # the first stages are too short to tell
        known = self.reached > self.STAGES["Surfaces"]
        left = (self.earlier + self.spent) * (1 - self.reached) / self.reached if known else None
        self.progress(Progress(self._stage, fraction, self.rays, self.error, left))

    def _fraction(self) -> float:
        if self._stage not in self.STAGES:
            return 0.0
        names = list(self.STAGES)
        at = names.index(self._stage)
        low = self.STAGES[names[at - 1]] if at else 0.0
        return low + (self.STAGES[self._stage] - low) * min(self._done / self._total, 1.0)
