"""How far a picture of openness is from its reference, and at which sizes of detail."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from lightpanes.core.metrics import psnr, ssim

from .flip import flip

PIXELS_A_DEGREE = 40.0
"""Of vision: a picture of 480 pixels spans 12°, a quarter of a screen at arm's length."""


@dataclass(frozen=True)
class Score:
    """mse, psnr (dB), ssim as the thesis has them; flip: see flip.py; seen: RMS error as an eye weighs its frequencies."""

    mse: float
    psnr: float
    ssim: float
    flip: float
    seen: float

    def as_dict(self) -> dict[str, float]:
        return asdict(self)


def score(image: np.ndarray, reference: np.ndarray) -> Score:
    """Of two (H, W) pictures in [0, 1]."""
    error = image.astype(np.float64) - reference
    return Score(
        float((error**2).mean()), psnr(image, reference), ssim(image, reference), flip(image, reference), seen(error)
    )


def contrast_sensitivity(frequency: np.ndarray) -> np.ndarray:
    """In [0, 1], of cycles per degree (Mannos and Sakrison 1974), level below its peak: plain shifts are seen, too."""
    peak = 8.0
    f = np.maximum(frequency, peak)
    return 2.6 * (0.0192 + 0.114 * f) * np.exp(-((0.114 * f) ** 1.1)) / 0.981


def _power(error):
    """Power of each frequency, and the frequencies in cycles a pixel; a window keeps borders out."""
    height, width = error.shape
    window = np.hanning(height)[:, None] * np.hanning(width)
    window /= np.sqrt((window**2).mean())
    power = np.abs(np.fft.rfft2(error * window)) ** 2 / error.size**2
    power[:, 1 : (width + 1) // 2] *= 2
    return power, np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))


def seen(error: np.ndarray) -> float:
    """RMS of an (H, W) error as the eye weighs it."""
    power, frequency = _power(error)
    return float(np.sqrt((power * contrast_sensitivity(frequency * PIXELS_A_DEGREE) ** 2).sum()))


def spectrum(error: np.ndarray, bands: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Middles of bands, cycles a pixel, and the RMS error in each octave around; bands are even in logarithm."""
    power, frequency = _power(error)
    edges = np.geomspace(1 / 120, 0.5, bands + 1)
    band = np.digitize(frequency.reshape(-1), edges)
    total = np.bincount(band, power.reshape(-1), minlength=bands + 2)[1:-1]
    octaves = np.log2(edges[1] / edges[0])
    return np.sqrt(edges[1:] * edges[:-1]), np.sqrt(total / octaves)
