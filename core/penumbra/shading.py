"""Irradiance from masks: what the samples that a receiver sees would bring, over what all of them would.

As in lights.py, light that nothing blocks is known in closed form, so masks only decide which part of it arrives:
E = E_free · Σ w V / Σ w. The weights w are smooth over a lamp that is not near, so there they are a product of Lagrange
polynomials through a few nodes: Σ w V = Σ_nodes w(node) · Σ ℓ_node V, and the inner sums are one matrix product over
bits, at a fraction of the cost of R × L weights.
"""

from __future__ import annotations

import numpy as np

from ..lights import irradiance
from ..scene import Light
from .lamp import LampSamples
from .masks import LIT, Masks, bits_of
from .receivers import Receivers

NODES = 4
"""Nodes along each side of a lamp."""

FAR = 4.0
"""Times half a lamp's diagonal from which its weights are interpolated: an error of 0.1 % of the free irradiance."""

CHUNK = 1 << 20
"""Weights in memory at a time."""


def shade(light: Light, lamp: LampSamples, receivers: Receivers, masks: Masks) -> np.ndarray:
    """(R,) float32 irradiance at unit power (see lights.irradiance) of receivers whose masks are known.

    receivers need normals. Raises SceneError where lights.irradiance does.
    """
    result = np.zeros(len(masks), np.float32)
    lit = np.flatnonzero((masks.index == LIT) | (masks.index >= 0))
    result[lit] = irradiance(light, receivers.position[lit], receivers.normal[lit], None)
    mixed = np.flatnonzero(masks.index >= 0)
    result[mixed] *= visible_part(light, lamp, receivers.take(mixed), masks.words[masks.index[mixed]])
    return result


def visible_part(light: Light | None, lamp: LampSamples, receivers: Receivers, blocked: np.ndarray) -> np.ndarray:
    """(n,) float32 in [0, 1]: part of a lamp's light that arrives, for masks `blocked` (n, words).

    light: None for an emissive quad, which shines evenly.
    """
    part = np.empty(len(receivers), np.float32)
    smooth = _smooth(light, lamp, receivers)
    for kind, rows in ((_interpolated, np.flatnonzero(smooth)), (_exactly, np.flatnonzero(~smooth))):
        for start in range(0, len(rows), max(1, CHUNK // lamp.count)):
            some = rows[start : start + max(1, CHUNK // lamp.count)]
            seen = 1 - bits_of(blocked[some], lamp.count).astype(np.float32)
            part[some] = kind(light, lamp, receivers.take(some), seen)
    return part


def _smooth(light, lamp, receivers):
    """(n,) bool: receivers that see the lamp whole above their horizon, from afar."""
    if not lamp.planar or (light is not None and light.kind == "AREA" and light.spread < np.pi):
        return np.zeros(len(receivers), bool)
    corners = lamp.corners().astype(np.float32)
    height = receivers.normal @ corners.T
    if lamp.distant:
        return height.min(axis=1) > 0
    height = height.min(axis=1) - np.einsum("nd,nd->n", receivers.position, receivers.normal)
    away = receivers.position - lamp.centre.astype(np.float32)
    near = FAR * np.hypot(*lamp.half[:2])
    return (height > 0) & (np.einsum("nd,nd->n", away, away) > near * near)


def weights(light: Light | None, lamp: LampSamples, receivers: Receivers, places: np.ndarray) -> np.ndarray:
    """(n, k) float32, in proportion to what each place of the lamp brings; places: (k, 3) or (n, k, 3) in [−1, 1]."""
    origin = np.zeros(3) if lamp.distant else lamp.centre
    axes = lamp.axes.astype(np.float32)
    position = (receivers.position - origin.astype(np.float32)) @ axes.T
    normal = receivers.normal @ axes.T
    a, b, c = ((places[..., k] * np.float32(lamp.half[k])) for k in range(3))
    if lamp.distant:
        # the lamp's middle is at −z; rays get longer towards its rim
        length = np.sqrt(a * a + b * b + 1)
        return np.maximum(normal[:, :1] * a + normal[:, 1:2] * b - normal[:, 2:], 0) / length
    x, y, z = (v - position[:, k, None] for k, v in enumerate((a, b, c)))
    d2 = x * x + y * y + z * z
    cosine = np.maximum(normal[:, :1] * x + normal[:, 1:2] * y + normal[:, 2:] * z, 0)
    if not lamp.planar:
        # a sphere of even radiance; its far side brings nothing
        emitted = np.maximum(-(places[..., 0] * x + places[..., 1] * y + places[..., 2] * z), 0)
        return cosine * emitted / (d2 * d2)
    emitted = -z
    if light is not None and light.kind == "AREA" and light.spread < np.pi:
        slope = np.float32(np.tan(light.spread / 2))
        emitted = emitted * np.maximum(slope - np.hypot(x, y) / np.maximum(-z, np.float32(1e-20)), 0)
    return cosine * np.maximum(emitted, 0) / (d2 * d2)


def _places(lamp, receivers):
    """Samples of the receivers' sets, (k, 3) where they are the same for all."""
    if lamp.sets == 1:
        return lamp.places[0]
    return lamp.places[receivers.sets(np.arange(len(receivers)))]


def _exactly(light, lamp, receivers, seen):
    own = weights(light, lamp, receivers, _places(lamp, receivers))
    whole = own.sum(axis=1)
    # where no sample is above the horizon and yet a sliver of the lamp is, all samples count alike
    part = np.einsum("nk,nk->n", own, seen) / np.maximum(whole, np.float32(1e-30))
    return np.where(whole > 0, part, seen.mean(axis=1))


def _interpolated(light, lamp, receivers, seen):
    nodes = np.cos((2 * np.arange(NODES) + 1) * np.pi / (2 * NODES))
    grid = np.stack(np.meshgrid(nodes, nodes, [0.0], indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    own = weights(light, lamp, receivers, grid)
    groups = receivers.sets(np.arange(len(receivers)))
    seen_part, whole = np.empty((2, len(receivers)), np.float32)
    for one in range(lamp.sets):
        rows = np.flatnonzero(groups == one) if lamp.sets > 1 else slice(None)
        basis = _lagrange(nodes, lamp.places[one, :, 0])[:, :, None] * _lagrange(nodes, lamp.places[one, :, 1])[:, None]
        basis = basis.reshape(lamp.count, -1).astype(np.float32)
        seen_part[rows] = np.einsum("nk,nk->n", seen[rows] @ basis, own[rows])
        whole[rows] = own[rows] @ basis.sum(axis=0)
    return np.clip(seen_part / np.maximum(whole, np.float32(1e-30)), 0, 1)


def _lagrange(nodes, at):
    """(n, nodes) float64 values of the Lagrange polynomials of `nodes` at places (n,)."""
    result = np.ones((len(at), len(nodes)))
    for j, node in enumerate(nodes):
        for other in np.delete(nodes, j):
            result[:, j] *= (at - other) / (node - other)
    return result
