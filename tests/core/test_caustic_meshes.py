"""Glass whose mesh is coarse, against the same ball as fine as it has no more effect."""

import numpy as np
import pytest
from lightpanes.core.caustics import CausticAtlas

from .caustic_scenes import ball, floor, glass, staged
from .shapes import GREY, lamp


def caustic(rings, smooth=True):
    light = lamp((0.1, 0.05, 2.4))
    name, points, triangles, uv, normals, material = ball((0, 0, 0.75), 0.4, rings)
    shape = (name, points, triangles, uv, normals if smooth else None, material)
    scene = staged(floor(), shape, materials=(GREY, glass()), lights=[light])
    return CausticAtlas(scene, 128).image([light])[..., 0].astype(np.float64)


@pytest.fixture(scope="module")
def fine():
    return caustic(128)


@pytest.mark.parametrize(("smooth", "low", "high"), [(True, 0.005, 0.02), (False, 0.2, 0.28)])
def test_a_ball_of_24_rings_focuses_as_the_manual_says(fine, smooth, low, high):
    """1.4 % of the image's root mean square where it is shaded smooth, 24 % in flat faces (docs/manual.md)."""
    coarse = caustic(24, smooth)
    assert low < np.sqrt(((coarse - fine) ** 2).sum() / (fine**2).sum()) < high
    assert np.isclose(coarse.sum(), fine.sum(), rtol=0.04)
