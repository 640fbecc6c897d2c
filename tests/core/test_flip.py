"""The FLIP of our benchmarks against what its authors' own program gives (flip-evaluator 1.7), and by hand."""

import numpy as np
import pytest

from ..bench.flip import flip


def picture():
    y, x = np.mgrid[:90, :120] / 60
    return np.clip(np.stack([0.5 + 0.4 * np.sin(6 * x), 0.5 + 0.4 * np.sin(5 * y + x), 0.3 + 0.2 * x * y / 3], 2), 0, 1)


def test_it_gives_what_its_authors_program_gives():
    reference = picture()
    noise = np.random.default_rng(0).normal(0, 0.1, reference.shape)
    noisy = np.clip(reference + noise, 0, 1)
    for image, wanted in ((noisy, 0.154155), (0.8 * reference, 0.354050), (reference[:, ::-1], 0.785322)):
        assert flip(image, reference) == pytest.approx(wanted, abs=2e-5)


def test_nothing_differs_from_itself_and_green_from_blue_as_much_as_can_be():
    assert flip(picture(), picture()) == 0
    green, blue = np.zeros((2, 40, 40, 3))
    green[..., 1], blue[..., 2] = 1, 1
    assert flip(green, blue) == pytest.approx(1, abs=1e-6)
    # and grey pictures are pictures of three equal colours
    grey = picture()[..., 0]
    assert flip(grey, 0.9 * grey) == pytest.approx(flip(*(np.repeat(g[..., None], 3, 2) for g in (grey, 0.9 * grey))))
