"""How far an image is from the truth, when the truth is a noisy reference.

The error of a bake is `compare(...).error`: RMSE over RGB divided by the mean of the reference, on
4×4-texel blocks of all valid texels, with the reference's own noise subtracted; over several
lamps, the mean of those (`mean_error`).

Images are (H, W, 3) or (H, W) float arrays, linear; masks are (H, W) bool, True where a texel
counts. Texels that don't count may hold anything, NaN included.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

BLOCK = 4


@dataclass(frozen=True)
class Comparison:
    """An image against a reference.

    error: relative RMSE, noise subtracted, 0 where the difference is all noise.
    bias: (mean of the image − mean of the reference) / mean of the reference.
    noise: relative RMSE that the noise alone would make; `error` is trustworthy where it is not
        much smaller than this.
    mean: mean of the reference over all valid texels and channels.
    """

    error: float
    bias: float
    noise: float
    mean: float


def compare(
    image: np.ndarray,
    reference: np.ndarray,
    mask: np.ndarray | None = None,
    *,
    reference_halves: tuple[np.ndarray, np.ndarray] | None = None,
    image_halves: tuple[np.ndarray, np.ndarray] | None = None,
    block: int = BLOCK,
) -> Comparison:
    """The error of an image, on blocks of block² texels, every valid texel weighing the same.

    reference_halves: two estimates of the truth with independent noise, whose mean is the
        reference. A mean of two has the expected squared error E[(a − b)²] / 4, which is what is
        subtracted from the mean squared difference. image_halves: the same for the image.

    Raises ValueError where shapes differ, no texel is valid or the reference is black.
    """
    difference, level, weights = _difference(image, reference, mask, block)
    level = _checked_level(level)
    squared = _weighted_mean(difference**2, weights)
    variance = 0.0
    for halves in (reference_halves, image_halves):
        if halves is not None:
            variance += _weighted_mean(_difference(*halves, mask, block)[0] ** 2, weights) / 4
    return Comparison(
        error=float(np.sqrt(max(squared - variance, 0.0)) / level),
        bias=float(_weighted_mean(difference, weights) / level),
        noise=float(np.sqrt(variance) / level),
        mean=level,
    )


def mean_error(comparisons: Iterable[Comparison]) -> float:
    """The error of a bake: the mean over held-out lamps."""
    return float(np.mean([comparison.error for comparison in comparisons]))


def relative_rmse(image: np.ndarray, reference: np.ndarray, mask: np.ndarray | None = None, block: int = 1) -> float:
    """RMSE over RGB divided by the mean of the reference; nothing subtracted."""
    return compare(image, reference, mask, block=block).error


def mean_bias(image: np.ndarray, reference: np.ndarray, mask: np.ndarray | None = None) -> float:
    """(mean of the image − mean of the reference) / mean of the reference."""
    return compare(image, reference, mask, block=1).bias


def block_average(
    image: np.ndarray, mask: np.ndarray | None = None, block: int = BLOCK
) -> tuple[np.ndarray, np.ndarray]:
    """Means over the valid texels of block × block tiles.

    Returns (⌈H/block⌉, ⌈W/block⌉, C) float64 means, 0 where no texel is valid, and the
    (⌈H/block⌉, ⌈W/block⌉) number of valid texels. The last tiles may be cut by the border.
    """
    image = np.asarray(image)
    if image.ndim == 2:
        image = image[..., None]
    height, width, channels = image.shape
    valid = _mask(mask, (height, width))
    rows, columns = -(-height // block), -(-width // block)
    padded = np.zeros((rows * block, columns * block, channels + 1))
    padded[:height, :width, :channels] = np.where(valid[..., None], image, 0)
    padded[:height, :width, channels] = valid
    sums = padded.reshape(rows, block, columns, block, channels + 1).sum(axis=(1, 3))
    counts = sums[..., channels]
    return sums[..., :channels] / np.maximum(counts, 1)[..., None], counts


def psnr(image: np.ndarray, reference: np.ndarray, peak: float = 1.0, mask: np.ndarray | None = None) -> float:
    """Peak signal-to-noise ratio, dB; infinite for equal images."""
    difference, _, weights = _difference(image, reference, mask, 1)
    squared = _weighted_mean(difference**2, weights)
    return float(np.inf if squared == 0 else 10 * np.log10(peak**2 / squared))


def ssim(image: np.ndarray, reference: np.ndarray, peak: float = 1.0) -> float:
    """Mean structural similarity over channels, with Gaussian windows of σ = 1.5 texels.

    Wang, Bovik, Sheikh, Simoncelli, Image Quality Assessment: From Error Visibility to Structural
    Similarity, 2004. Only windows that lie inside the image count (11 × 11).
    """
    image, reference = _pair(image, reference)
    if min(image.shape[:2]) < 11:
        raise ValueError(f"SSIM needs images of at least 11 × 11 texels, not {image.shape[1]} × {image.shape[0]}.")
    mean_a, mean_b = _gaussian(image), _gaussian(reference)
    variance_a = _gaussian(image * image) - mean_a**2
    variance_b = _gaussian(reference * reference) - mean_b**2
    covariance = _gaussian(image * reference) - mean_a * mean_b
    c1, c2 = (0.01 * peak) ** 2, (0.03 * peak) ** 2
    value = (2 * mean_a * mean_b + c1) * (2 * covariance + c2)
    value /= (mean_a**2 + mean_b**2 + c1) * (variance_a + variance_b + c2)
    return float(value.mean())


def flicker(frames: np.ndarray, reference: np.ndarray | None = None, mask: np.ndarray | None = None) -> float:
    """How much a sequence jumps from frame to frame beyond what the light does.

    frames, reference: (T, H, W, C), T ≥ 3 (2 with a reference). With a reference, the RMS change of the
    error between neighbouring frames; without, the RMS second difference, which smooth motion leaves
    near 0. Either is scaled so that white noise of standard deviation s × mean in the frames gives s.
    """
    frames = np.asarray(frames, np.float64)
    valid = _mask(mask, frames.shape[1:3])
    base = frames if reference is None else np.asarray(reference, np.float64)
    if base.shape != frames.shape:
        raise ValueError(f"The frames are {frames.shape}, their reference {base.shape}.")
    if len(frames) < (3 if reference is None else 2):
        raise ValueError("Flicker needs at least three frames, or two and a reference.")
    level = _checked_level(base[:, valid].mean())
    if reference is None:
        change, gain = np.diff(frames[:, valid], n=2, axis=0), 6.0
    else:
        change, gain = np.diff(frames[:, valid] - base[:, valid], axis=0), 2.0
    return float(np.sqrt((change**2).mean() / gain) / level)


def _pair(image, reference):
    image, reference = np.asarray(image, np.float64), np.asarray(reference, np.float64)
    if image.shape != reference.shape:
        raise ValueError(f"The image is {image.shape}, the reference {reference.shape}.")
    return (image[..., None], reference[..., None]) if image.ndim == 2 else (image, reference)


def _mask(mask, shape):
    if mask is None:
        return np.ones(shape, bool)
    mask = np.asarray(mask, bool)
    if mask.shape != tuple(shape):
        raise ValueError(f"The mask is {mask.shape}, the image {tuple(shape)}.")
    if not mask.any():
        raise ValueError("No texel is valid, so there is nothing to compare.")
    return mask


def _difference(image, reference, mask, block):
    """Block means of image − reference (h, w, C), mean of the reference, valid texels a block (h, w)."""
    image, reference = _pair(image, reference)
    valid = _mask(mask, image.shape[:2])
    means, counts = block_average(image - reference, valid, block)
    return means, reference[valid].mean(), counts


def _weighted_mean(values, weights):
    return float((values * weights[..., None]).sum() / (weights.sum() * values.shape[-1]))


def _checked_level(level):
    if not level > 0:
        raise ValueError("The reference is black (or not a number), so no relative error exists.")
    return float(level)


def _gaussian(image):
    """Separable 11-tap window of σ = 1.5, valid part only: (H − 10, W − 10, C)."""
    taps = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    taps /= taps.sum()
    height, width = image.shape[0] - 10, image.shape[1] - 10
    rows = sum(tap * image[k : k + height] for k, tap in enumerate(taps))
    return sum(tap * rows[:, k : k + width] for k, tap in enumerate(taps))
