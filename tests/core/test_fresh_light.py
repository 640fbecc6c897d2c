"""Light by which a bake is judged, against the solved system of equations."""

import numpy as np
import pytest
from lightpanes.core.bake.fresh_light import entry_fields
from lightpanes.core.bake.steps import prepare
from lightpanes.core.scene import Material

from .shapes import lamp, quick, room_parts, scene

pytestmark = pytest.mark.thorough


@pytest.mark.parametrize("white", [0.0, 0.3, 0.9, 0.98])
def test_all_bounces_are_there_however_white_a_room_is(white):
    """The panes that it starts from lack a twelfth of the light where 0.98 of it is reflected."""
    paint = Material("Paint", (white, white, white))
    made = scene(*room_parts(), materials=[paint, paint], lights=[lamp((3, 1.5, 2))])
    ready = prepare(made, quick(lamps=60, regions=8, panes=8))
    fields, count = entry_fields(ready), len(ready.entries)
    albedo = ready.entries.albedo[:, :1].astype(np.float64)
    system = np.eye(count) - albedo * ready.transport.between.astype(np.float64)
    expected = np.linalg.solve(system, albedo * ready.test_direct)
    found = fields.radiosity[:count]
    assert np.array_equal(found[..., 0], found[..., 1])
    level = (ready.entries.area @ expected) / ready.entries.area.sum()
    assert (np.abs(found[..., 0] - expected).mean(axis=0) <= 2e-3 * level).all()
    # what arrives is what is then reflected
    reflected = ready.entries.albedo[:, None] * (ready.test_direct[..., None] + fields.arriving)
    assert np.allclose(reflected, found, rtol=1e-5)
