"""What panes learn from: how much each training lamp counts, and that places between things come out right by it."""

from types import SimpleNamespace

import numpy as np
import pytest
from lightpanes.core.bake.steps import prepare
from lightpanes.core.bake.verdict import judge
from lightpanes.core.panes.modes import LIT, training_fields

from .shapes import COLOURS, box, lamp, quick, room_parts, scene

pytestmark = pytest.mark.thorough


def test_lamps_count_by_the_entries_that_share_their_light():
    """One that lights a single entry counts as a hundredth, one that lights many in full, whatever their power."""
    count = 400
    area = np.random.default_rng(1).uniform(0.5, 2, count).astype(np.float32)
    share = area / area.sum()
    entries = SimpleNamespace(area=area, albedo=np.full((count, 3), 0.5, np.float32))
    # within a sphere every entry gets the mean of what all give
    sphere = SimpleNamespace(arriving=lambda given: np.broadcast_to(share @ given, given.shape).astype(np.float32))
    lit = np.array([1, 10, count // 2, count])
    # evenly bright ones share light by their areas
    direct = ((np.arange(count)[:, None] < lit) / area[:, None] * [3, 70, 0.2, 5]).astype(np.float32)
    radiosity, field = training_fields(entries, sphere, direct)
    counted = np.minimum(lit / LIT, 1)
    assert np.allclose(share @ field[:, :4], counted, rtol=1e-3)
    assert np.allclose(share @ radiosity[:, :4], counted, rtol=1e-3)
    assert np.allclose(share @ field[:, 4:], 1, rtol=1e-3)


def test_places_between_things_are_as_right_as_others():
    """Boxes 3 cm over the floor and 2 cm apart: a training lamp that stands between them makes a single entry a thousand times
    as bright as others are, and what sees it must not be told by that one alone. Light through panes against the same without."""
    boxes = (*box((2, 1, 0.03), (3, 2, 0.8)), 1), (*box((3.02, 1, 0.03), (3.8, 2, 0.5)), 1)
    names = ["Room", "Block", "Left", "Right"]
    made = scene(*room_parts(), *boxes, materials=COLOURS, names=names, lights=[lamp((3, 0.5, 2))])
    verdict = judge(prepare(made, quick(resolution=96, entries=900, lamps=500, regions=40, exits="texels")), 0)
    assert verdict.panes < 0.05
