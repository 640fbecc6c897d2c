"""Lines or rays: which is faster for a cluster of receivers, learnt while casting. Either way gives the same masks."""

from __future__ import annotations

import threading

import numpy as np

from .receivers import CLUSTER

LEAST_RELATIONS = 1 << 20
MANY_SAMPLES = 256
LEAST_SAMPLES = 64
"""Below these, preparing the lamp costs more than it saves. With fewer samples than many it takes more relations, in
proportion: a line stands for fewer rays."""

RAY = 1.2e-7
"""Seconds of a shadow ray on one thread, before any was measured."""

CANDIDATE = 6e-7
"""Seconds to tell whether a candidate polygon matters to a cluster and which lines it draws, before any was measured."""

LINE = 1e-6
LINE_BIT = 4e-9
"""Seconds of a line for a cluster, and more for each sample, with the rays that lines leave open, before any was measured."""

KEPT = 2.0
"""Lines of a candidate, most of which turn out not to matter, before any was counted."""

LOOSE = 4.0
"""Polygons that blocks' boxes leave to a cluster, for one that its own box leaves."""

WAITING = 1.3
"""Times that numpy's work takes longer on several threads, which wait for each other's Python; rays don't."""

CALLS = 5e-4
"""Seconds that numpy's calls themselves take for some clusters' candidates or lines, however few."""

SHAFT = 4e-5
"""Seconds to find a cluster's candidates, few or many."""

POLYGON = 3e-7
"""Seconds to prepare a polygon for a lamp, on one thread while the others wait."""


LEAST_SAVED = 0.25
"""Part of the rays' time that a few clusters must promise to save: less is lost in what they don't tell."""


class Cost:
    """The one place that decides. samples: of the lamp. always: "lines" or "rays" for tests and charts."""

    def __init__(self, samples: int, always: str = ""):
        self.samples, self.always = samples, always
        # (seconds or lines, how many), begun with a guess that soon weighs little
        self._rays = np.array([RAY * 200, 200])
        self._candidates = np.array([CANDIDATE * 200, 200])
        self._kept = np.array([KEPT * 200, 200])
        self._lines = np.array([(LINE + LINE_BIT * samples) * 200, 200])
        self._lock = threading.Lock()

    def worth(self, receivers: int) -> bool:
        """Whether there is enough to do for anything but rays."""
        if self.always:
            return self.always == "lines"
        relations = receivers * self.samples * min(1, self.samples / MANY_SAMPLES)
        return relations >= LEAST_RELATIONS and self.samples >= LEAST_SAMPLES

    def worth_preparing(self, blocks: np.ndarray, clusters: int, polygons: int, threads: int) -> bool:
        """Whether to look at a lamp's occluders at all.

        blocks: (c,) int polygons in the blocks that some of the clusters meet. polygons: in the scene.
        """
        if self.always == "lines":
            return True
        rays, candidate, _ = self._seconds()
        saved = np.maximum(rays - blocks * (candidate / LOOSE), 0).mean() * clusters
        return bool(saved > threads * POLYGON * polygons + clusters * (SHAFT + LEAST_SAVED * rays))

    def most_candidates(self) -> float:
        """Polygons that boxes leave to a cluster at which it is left to rays."""
        if self.always == "lines":
            return np.inf
        rays, candidate, _ = self._seconds()
        return rays / candidate

    def most_in_blocks(self) -> float:
        """The same of polygons in the blocks whose boxes are left to it."""
        return LOOSE * self.most_candidates()

    def prefers_rays(self, lines: np.ndarray) -> np.ndarray:
        """(c,) bool for clusters with so many lines."""
        if self.always == "lines":
            return np.zeros(len(lines), bool)
        rays, _, line = self._seconds()
        return lines * line > rays

    def _seconds(self):
        """Of a cluster's rays, of a candidate of a cluster with all that follows from it, and of a line."""
        with self._lock:
            ray, candidate, kept, line = (a / b for a, b in (self._rays, self._candidates, self._kept, self._lines))
        return CLUSTER * self.samples * ray, WAITING * (candidate + kept * line), WAITING * line

    def learn_rays(self, rays: int, seconds: float) -> None:
        """seconds: of one thread, as below."""
        with self._lock:
            self._rays += seconds, rays

    def learn_candidates(self, candidates: int, lines: int, seconds: float) -> None:
        """Of candidates, and the lines that were left of them."""
        with self._lock:
            self._candidates += max(seconds - CALLS, 0), candidates
            self._kept += lines, candidates

    def learn_lines(self, lines: int, seconds: float) -> None:
        """Of lines, with the rays that they left open."""
        with self._lock:
            self._lines += max(seconds - CALLS, 0), lines
