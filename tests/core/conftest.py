"""What tests of core share."""

import pytest
from lightpanes.tests.frugal import judge_lightly, save_rays, seek_lightly


@pytest.fixture(scope="module", autouse=True)
def lightly(request):
    """Bakes hardly look at their own error, which takes as long as all the rest of a small one and changes nothing of its
    light where its budgets are given, and seek their entries from few places, but in modules that are marked as `thorough`."""
    if request.node.get_closest_marker("thorough"):
        yield
        return
    with pytest.MonkeyPatch.context() as patch:
        judge_lightly(patch)
        seek_lightly(patch)
        yield


@pytest.fixture(scope="module")
def frugal():
    """All bakes of a module save rays; for modules whose claims hold for any bake."""
    with pytest.MonkeyPatch.context() as patch:
        save_rays(patch)
        yield
