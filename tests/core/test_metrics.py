"""Metrics against the noise that was put in, and SSIM against scikit-image."""

import numpy as np
import pytest
from lightpanes.core import metrics


def field(height=128, width=128):
    """A smooth positive image (H, W, 3) with mean near 2."""
    y, x = np.mgrid[:height, :width] / height
    return np.stack([2 + np.sin(5 * x), 2 + np.cos(4 * y), 2 + np.sin(3 * (x + y))], axis=-1)


def noisy(image, deviation, seed):
    return image + np.random.default_rng(seed).normal(0, deviation, image.shape)


def test_relative_rmse_of_a_known_difference():
    truth = field()
    assert metrics.relative_rmse(truth + 0.1 * truth.mean(), truth) == pytest.approx(0.1, rel=1e-9)
    assert metrics.mean_bias(truth * 0.98, truth) == pytest.approx(-0.02, rel=1e-9)


def test_block_average_honours_the_mask_and_the_border():
    image = np.arange(7 * 5, dtype=float).reshape(7, 5)
    mask = np.ones((7, 5), bool)
    mask[0, 0] = False
    spoiled = image.copy()
    spoiled[0, 0] = np.nan
    means, counts = metrics.block_average(spoiled, mask, 4)
    assert means.shape == (2, 2, 1)
    assert counts.tolist() == [[15, 4], [12, 3]]
    assert means[0, 0, 0] == pytest.approx(image[:4, :4].ravel()[1:].mean())
    assert means[1, 1, 0] == pytest.approx(image[4:, 4:].mean())


def test_block_without_valid_texels_counts_for_nothing():
    truth = field(16, 16)
    mask = np.ones((16, 16), bool)
    mask[:4, :4] = False
    image = np.where(mask[..., None], truth * 1.05, np.nan)
    result = metrics.compare(image, truth, mask)
    assert result.bias == pytest.approx(0.05, rel=1e-9)
    assert np.isfinite(result.error)


@pytest.mark.parametrize("error", [0.0, 0.02, 0.1])
def test_noise_of_the_reference_is_subtracted(error):
    truth = field()
    wave = np.sin(np.arange(128) / 9.0)[:, None, None] * np.ones_like(truth)
    wave -= wave.mean()
    image = truth + error * truth.mean() * wave / np.sqrt((wave**2).mean())
    # 20 % noise a texel is 5 % on blocks of 16, well above the error that is looked for
    halves = noisy(truth, 0.2 * truth.mean(), 1), noisy(truth, 0.2 * truth.mean(), 2)
    result = metrics.compare(image, (halves[0] + halves[1]) / 2, reference_halves=halves)
    assert result.noise == pytest.approx(0.2 / 4 / np.sqrt(2), rel=0.05)
    assert result.error == pytest.approx(error, abs=0.007)
    assert abs(result.bias) < 0.005


def test_noise_of_both_sides_is_subtracted():
    truth = field()
    reference = noisy(truth, 0.3, 1), noisy(truth, 0.3, 2)
    image = noisy(truth * 1.03, 0.4, 3), noisy(truth * 1.03, 0.4, 4)
    result = metrics.compare(
        (image[0] + image[1]) / 2, (reference[0] + reference[1]) / 2, reference_halves=reference, image_halves=image
    )
    expected = metrics.relative_rmse(truth * 1.03, truth, block=4)
    assert result.error == pytest.approx(expected, abs=0.006)


def test_error_of_a_bake_is_the_mean_over_lamps():
    truth = field()
    pair = [metrics.compare(truth * (1 + s), truth) for s in (0.01, 0.03)]
    assert metrics.mean_error(pair) == pytest.approx((pair[0].error + pair[1].error) / 2)


def test_psnr():
    truth = field() / 4
    assert metrics.psnr(truth + 0.01, truth) == pytest.approx(40.0, abs=1e-6)
    assert metrics.psnr(truth, truth) == np.inf


def test_ssim_matches_scikit_image():
    structural_similarity = pytest.importorskip("skimage.metrics").structural_similarity
    truth = field() / 4
    for deviation in (0.01, 0.1):
        image = noisy(truth, deviation, 5)
        theirs = structural_similarity(
            image, truth, data_range=1.0, channel_axis=2, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
        )
        # theirs averages over a crop of 5 texels, as ours does
        assert metrics.ssim(image, truth) == pytest.approx(theirs, abs=1e-6)
    assert metrics.ssim(truth, truth) == pytest.approx(1.0)


def test_flicker_of_white_noise_is_its_deviation():
    frames = np.repeat(field(32, 32)[None], 40, axis=0)
    spoiled = noisy(frames, 0.05 * frames.mean(), 6)
    assert metrics.flicker(spoiled) == pytest.approx(0.05, rel=0.02)
    assert metrics.flicker(spoiled, frames) == pytest.approx(0.05, rel=0.02)


def test_flicker_forgives_smooth_motion():
    ramp = field(16, 16)[None] * np.linspace(1, 2, 30)[:, None, None, None]
    assert metrics.flicker(ramp) < 1e-12
    assert metrics.flicker(ramp * 1.1, ramp) < 0.005


def test_bad_input_is_named():
    truth = field(16, 16)
    with pytest.raises(ValueError, match="black"):
        metrics.compare(truth, truth * 0)
    with pytest.raises(ValueError, match="No texel"):
        metrics.compare(truth, truth, np.zeros((16, 16), bool))
    with pytest.raises(ValueError, match="the reference"):
        metrics.compare(truth, truth[:8])
    with pytest.raises(ValueError, match="mask"):
        metrics.compare(truth, truth, np.ones((8, 8), bool))
