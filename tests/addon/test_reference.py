"""What a reference says of its own noise."""

import numpy as np
import pytest

pytest.importorskip("bpy")

from lightpanes.addon.reference import Reference


def test_noise_of_a_reference():
    """Normal noise of .3 a texel and half, averaged over two halves and the sixteen texels of a block."""
    random = np.random.default_rng(3)
    noisy = random.normal(2.0, 0.3, (2, 256, 256, 3)).astype(np.float32)
    mask = np.ones((256, 256), bool)
    found = Reference(noisy, mask, 100, 1.0)
    assert found.noise == pytest.approx(0.3 / 2.0 / np.sqrt(2 * 16), rel=0.02)
    assert found.samples_for(found.noise / 2) == pytest.approx(400, abs=1)
    assert found.samples_for(2 * found.noise) == pytest.approx(25, abs=1)
    assert Reference(np.ones_like(noisy), mask, 100, 1.0).samples_for(0.01) == 0
