"""What tests of core share."""

import pytest
from lightpanes.tests.frugal import save_rays


@pytest.fixture(scope="module")
def frugal():
    """All bakes of a module save rays; for modules whose claims hold for any bake."""
    with pytest.MonkeyPatch.context() as patch:
        save_rays(patch)
        yield
