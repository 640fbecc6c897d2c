"""What a smooth surface does to a ray: Fresnel's and Schlick's weights, reflection, Snell's law.

Vectors are (3, n) float32 arrays, so that each component is contiguous.
"""

from __future__ import annotations

import numpy as np

from .vectors import dot

_F = np.float32


def fresnel(cosine: np.ndarray, relative: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance of a dielectric for unpolarised light, and the cosine of the refracted ray, two (n,) float32.

    cosine: (n,) of the incoming ray to the normal, ≥ 0. relative: (n,) refractive index before the surface over that
    behind it. Where reflection is total they are 1 and 0.
    """
    inner2 = 1 - relative * relative * (1 - cosine * cosine)
    inner = np.sqrt(np.maximum(inner2, 0))
    across = (relative * cosine - inner) / np.maximum(relative * cosine + inner, _F(1e-20))
    along = (cosine - relative * inner) / np.maximum(cosine + relative * inner, _F(1e-20))
    reflectance = (across * across + along * along) * _F(0.5)
    return np.where(inner2 <= 0, _F(1), reflectance), inner


def schlick(facing: np.ndarray, edge: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """(c, n) reflectance of a metal between `facing` and `edge`, (c, n) each."""
    rest = 1 - np.clip(cosine, 0, 1)
    square = rest * rest
    return facing + (edge - facing) * (square * square * rest)


def reflect(direction: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(3, n) mirrored directions."""
    return direction - normal * (2 * dot(direction, normal))


def refract(direction: np.ndarray, normal: np.ndarray, cosine, inner, relative) -> np.ndarray:
    """(3, n) refracted directions (Snell). normal: against the ray. cosine, inner, relative: as in `fresnel`."""
    return direction * relative + normal * (relative * cosine - inner)
