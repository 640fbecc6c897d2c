"""What caustics bring to the entries is found anew where light falls elsewhere."""

from dataclasses import replace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import focus  # noqa: E402
from lightpanes.addon.caustics import Landed  # noqa: E402
from lightpanes.core.caustics import Landings  # noqa: E402
from lightpanes.core.scene import Light  # noqa: E402


@pytest.mark.parametrize("name", ["position", "normal", "power"])
def test_light_that_falls_elsewhere_is_taken_up(name, monkeypatch):
    """A flat mirror slid along under the sun sends as much, to another place."""
    asked = []

    class Counting:
        def __init__(self, surface, landings, offset):
            self.landings = landings

        def unit(self, light):
            asked.append(self.landings(light))
            return np.ones((1, 3), np.float32)

    monkeypatch.setattr(focus, "CausticLight", Counting)
    sun = Light("Sun", "SUN", np.eye(4), np.ones(3))
    rows = np.random.default_rng(1).random((3, 5, 3)).astype(np.float32)
    first = Landings(*rows)
    found = focus.Focus(None, 0.0)
    for landings in (first, first, replace(first, **{name: getattr(first, name) + np.float32(0.5)})):
        found.take(Landed([(sun, landings)]))
    assert len(asked) == 2 and asked[0] is not asked[1]
