"""What a smooth surface does to a ray: Fresnel's and Schlick's weights, reflection, Snell's law.

Vectors are (3, n) float32 arrays, so that each component is contiguous.
"""

from __future__ import annotations

import numpy as np

from .sampling import frame_parts
from .vectors import dot, normalised

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


def visible_facet(view: np.ndarray, normal: np.ndarray, alpha: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(3, n) normals of the facets of a rough surface (GGX), as often as they are seen from `view`, the unit directions from
    which the surface is looked at (Heitz 2018, Sampling the GGX Distribution of Visible Normals).

    alpha: (n,) width, the square of a roughness. a, b: (n,) in [0, 1).
    """
    tangent, bitangent = (np.stack(part) for part in frame_parts(*normal))
    x, y, z = alpha * dot(view, tangent), alpha * dot(view, bitangent), np.maximum(dot(view, normal), 0)
    size = np.sqrt(np.maximum(x * x + y * y + z * z, _F(1e-30)))
    x, y, z = x / size, y / size, z / size
    flat = np.sqrt(x * x + y * y)
    lies = flat > 1e-7
    flat = np.maximum(flat, _F(1e-7))
    first = np.where(lies, -y / flat, _F(1)), np.where(lies, x / flat, _F(0))
    second = -z * first[1], z * first[0], x * first[1] - y * first[0]
    radius, turn = np.sqrt(a), _F(2 * np.pi) * b
    along, across = radius * np.cos(turn), radius * np.sin(turn)
    half = _F(0.5) * (1 + z)
    across = (1 - half) * np.sqrt(np.maximum(1 - along * along, 0)) + half * across
    up = np.sqrt(np.maximum(1 - along * along - across * across, 0))
    x, y, z = (
        along * first[0] + across * second[0] + up * x,
        along * first[1] + across * second[1] + up * y,
        across * second[2] + up * z,
    )
    facet = tangent * (alpha * x) + bitangent * (alpha * y) + normal * np.maximum(z, _F(1e-6))
    return normalised(facet).astype(np.float32)


def unmasked(cosine: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """(n,) part of the facets of a rough surface that nothing hides from a direction at `cosine` to the normal (Smith)."""
    square = np.maximum(cosine * cosine, _F(1e-12))
    return 2 / (1 + np.sqrt(1 + alpha * alpha * (1 - square) / square))
