"""Bakes that find their entries and guide their points with few rays, for tests of all but the light itself."""

import pytest
from lightpanes.core.bake import live, verdict
from lightpanes.core.point_cache import build
from lightpanes.core.transfer import entries, reach


def save_rays(patch: pytest.MonkeyPatch, judge: bool = False) -> None:
    """What a bake of a small room spends most of its time on, for as long as the patch lasts. judge: whether bakes measure
    their error as well as ever."""
    if not judge:
        patch.setattr(live, "TEST_LAMPS", 6)
        patch.setattr(verdict, "BLOCKS", 64)
        patch.setattr(verdict, "EVEN_RAYS", 32)
        patch.setattr(verdict, "PATHS", 4)
    patch.setattr(reach, "PARTICLES", 4096)
    patch.setattr(entries, "SCOUTS", 1500)
    patch.setattr(build, "COARSE", (1000, build.COARSE[1]))
    patch.setattr(build, "LOOKS", 300)
