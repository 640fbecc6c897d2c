"""Lines or rays: which is faster for a cluster of receivers, learnt while casting. Either way gives the same masks."""

from __future__ import annotations

import threading

import numpy as np

from .receivers import CLUSTER

LEAST_RELATIONS = 1 << 22
LEAST_SAMPLES = 64
"""Below these, preparing the lamp costs more than it saves."""

RAY = 1.2e-7
"""Seconds of a shadow ray on one thread, before any was measured."""

LINE = 9e-7
LINE_BIT = 2e-9
"""Seconds of a line for a cluster, and more for each sample, before any was measured."""

SHARE = 0.04
"""Part of the relations that lines leave to rays."""


class Cost:
    """The one place that decides. samples: of the lamp. always: "lines" or "rays" for tests and charts."""

    def __init__(self, samples: int, always: str = ""):
        self.samples, self.always = samples, always
        # (seconds, how many), begun with a guess that soon weighs little
        self._rays = np.array([RAY * 2e4, 2e4])
        self._lines = np.array([(LINE + LINE_BIT * samples) * 1e3, 1e3])
        self._lock = threading.Lock()

    @property
    def ray(self) -> float:
        """Seconds of a ray on one thread."""
        return self._rays[0] / self._rays[1]

    @property
    def line(self) -> float:
        """Seconds of a line for a cluster, on one thread."""
        return self._lines[0] / self._lines[1]

    def worth(self, receivers: int) -> bool:
        """Whether there is enough to do for anything but rays."""
        if self.always:
            return self.always == "lines"
        return receivers * self.samples >= LEAST_RELATIONS and self.samples >= LEAST_SAMPLES

    def break_even(self) -> float:
        """Lines of a cluster at which rays are as fast."""
        if self.always == "lines":
            return np.inf
        return (1 - SHARE) * CLUSTER * self.samples * self.ray / self.line

    def most_candidates(self) -> float:
        """Polygons that boxes leave to a cluster at which it is left to rays: telling their lines apart would take as
        long as half of the rays, and most keep two or three lines."""
        return 0.5 * self.break_even()

    def prefers_rays(self, lines: np.ndarray) -> np.ndarray:
        """(c,) bool for clusters with so many lines."""
        return lines > self.break_even()

    def learn_rays(self, rays: int, seconds: float) -> None:
        with self._lock:
            self._rays += seconds, rays

    def learn_lines(self, lines: int, seconds: float) -> None:
        with self._lock:
            self._lines += seconds, lines
