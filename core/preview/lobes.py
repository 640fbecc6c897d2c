"""What surfaces do with light that are not diffuse alone: mirrors, glass, what lets light straight through."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..optics import fresnel, reflect, refract, schlick
from ..sampling import frame
from ..scene import Material, Optics

DIFFUSE, STRAIGHT, MIRROR, GLASS = range(4)

_F = np.float32


class OpticsTable:
    """Optics of materials, a row each. values: by name of the field; shiny: (n,) bool, which mirror or refract at all."""

    def __init__(self, materials: Sequence[Material]):
        plain = Optics()
        each = [m.optics or plain for m in materials]
        names = Optics.__dataclass_fields__
        self.values = {name: np.array([getattr(o, name) for o in each], np.float32) for name in names}
        self.shiny = np.array([m.optics is not None for m in materials], bool)
        self.shiny &= np.any(
            [self.values[name].any(axis=1) for name in ("mirror", "mirror_edge", "glass", "gloss")], axis=0
        )


def choose(surfaces, rows, triangle, u, v, albedo, way, normal, chance, a, b):
    """One of the things that surfaces at `rows` do with light, in proportion to how much of it they do.

    Returns for each row the lobe, (k, 3) the factor that the light gets, (k, 3) where the ray goes on, and (k, 3)
    absorption beyond, 1/m.
    """
    triangle, way, normal = triangle[rows], way[rows], normal[rows]
    material = surfaces.scene.triangle_material[triangle]
    straight = np.zeros((len(rows), 3), np.float32)
    clear = np.flatnonzero(surfaces.see_through[triangle])
    straight[clear] = surfaces.transmission.at(triangle[clear], u[rows[clear]], v[rows[clear]])
    get = {name: values[material] for name, values in surfaces.optics.values.items()}
    glassy = get["glass"].any(axis=1)
    # the rest is bent instead
    straight[glassy] = get["clear"][glassy]
    # rough lobes look along a facet's normal (GGX)
    alpha2 = np.minimum(get["roughness"] ** 4, 1)
    steep = alpha2 * a / np.maximum(1 - a, 1e-6)
    z, angle = 1 / np.sqrt(1 + steep), b * _F(2 * np.pi)
    wide = np.sqrt(np.maximum(1 - z * z, 0))
    tangent, bitangent = frame(normal)
    facet = (
        (wide * np.cos(angle))[:, None] * tangent + (wide * np.sin(angle))[:, None] * bitangent + z[:, None] * normal
    )
    cosine = -np.einsum("nd,nd->n", way, facet)
    facet = np.where(cosine[:, None] > 0, facet, normal)
    cosine = np.clip(-np.einsum("nd,nd->n", way, facet), 0, 1)
    # which side of the surface the ray comes from: normals of the winding point outside
    outside = np.einsum("nd,nd->n", way, surfaces.flat[triangle]) < 0
    eta = np.where(outside, 1 / get["ior"], get["ior"])
    reflectance, beyond = fresnel(cosine, eta)
    mirror = schlick(get["mirror"], get["mirror_edge"], cosine[:, None]) + get["gloss"] * reflectance[:, None]
    glass = get["glass"] * (1 - reflectance)[:, None]
    lobes = np.stack([albedo[rows], straight, mirror, glass])
    size = lobes.max(axis=2)
    whole = size.sum(axis=0)
    upto = np.cumsum(size, axis=0)
    lobe = np.minimum((chance * whole >= upto).sum(axis=0), 3)
    k = np.arange(len(rows))
    share = size[lobe, k] / np.maximum(whole, 1e-20)
    bounced = reflect(way.T, facet.T).T
    bent = refract(way.T, facet.T, cosine, beyond, eta).T
    onward = np.select([lobe[:, None] == MIRROR, lobe[:, None] == GLASS], [bounced, bent], way)
    onward /= np.maximum(np.linalg.norm(onward, axis=1, keepdims=True), 1e-20)
    swallowed = np.where(outside[:, None], get["absorption"], 0)
    diffuse = lobe == DIFFUSE
    # the diffuse lobe's colour is counted by the caller
    factor = np.where(diffuse[:, None], 1, lobes[lobe, k]) / np.maximum(share, 1e-20)[:, None]
    factor[whole <= 0] = 0
    return lobe, factor.astype(np.float32), onward.astype(np.float32), swallowed.astype(np.float32)
