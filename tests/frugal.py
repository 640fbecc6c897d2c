"""Bakes that find their entries and guide their points with few rays, for tests of all but the light itself."""

import pytest
from lightpanes.core.bake import live, verdict
from lightpanes.core.point_cache import build
from lightpanes.core.transfer import entries, reach


def judge_lightly(patch: pytest.MonkeyPatch) -> None:
    """Bakes measure their error by few lamps, chosen among few, for as long as the patch lasts."""
    _look_less(patch)
    patch.setattr(live, "CANDIDATES", 6)


def seek_lightly(patch: pytest.MonkeyPatch) -> None:
    """Bakes seek their entries from fewer places, as in a trial, for as long as the patch lasts."""
    patch.setattr(reach, "PARTICLES", 8192)
    patch.setattr(entries, "SCOUTS", 3000)


def _look_less(patch):
    patch.setattr(live, "TEST_LAMPS", 3)
    patch.setattr(verdict, "BLOCKS", 32)
    patch.setattr(verdict, "EVEN_RAYS", 16)
    patch.setattr(verdict, "PATHS", 2)


def save_rays(patch: pytest.MonkeyPatch, judge: bool = False) -> None:
    """What a bake of a small room spends most of its time on, for as long as the patch lasts. judge: whether bakes measure
    their error as well as ever."""
    if not judge:
        _look_less(patch)
    patch.setattr(reach, "PARTICLES", 4096)
    patch.setattr(entries, "SCOUTS", 1500)
    patch.setattr(build, "COARSE", (1000, build.COARSE[1]))
    patch.setattr(build, "LOOKS", 300)
