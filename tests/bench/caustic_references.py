"""References for caustics: very many stratified point photons, kept on disk; and what points and uniform beams make of few.

A reference shares the lamps' squares and the tracer with what it judges (tests/core checks both against closed forms and
a plain tracer of its own), but neither patches, nor refinement, nor the spreading of power.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from lightpanes.core.caustics.emission import emitters
from lightpanes.core.caustics.families import families
from lightpanes.core.caustics.receivers import Receivers
from lightpanes.core.caustics.surfaces import Surfaces
from lightpanes.core.caustics.tracing import trace
from lightpanes.core.scene import Light

CACHE = Path(__file__).resolve().parents[2] / "out" / "bench" / "cache"

PHOTONS = 1e8
"""Of a reference; its own noise, told by its halves, is then a tenth of the errors that it judges. Minutes, once."""

BATCH = 1 << 18


def reference(
    name: str,
    surfaces: Surfaces,
    receivers: Receivers,
    light: Light,
    photons: float = PHOTONS,
    lamp_points: int = 1,
) -> np.ndarray:
    """(2, resolution², c) float64 W at each texel, two independent halves of so many stratified photons, from as many points
    of a soft lamp."""
    scene = surfaces.scene
    asked = (light.geometry, scene.materials, photons, *([] if lamp_points == 1 else [lamp_points]))
    key = hashlib.sha256(scene.positions.tobytes() + repr(asked).encode())
    path = CACHE / f"caustics_{name}_{receivers.resolution}_{key.hexdigest()[:16]}.npz"
    if path.exists():
        return np.load(path)["power"]
    power = np.stack(
        [points(surfaces, receivers, light, photons / 2, seed, lamp_points=lamp_points) for seed in (1, 2)]
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, power=power)
    return power


def points(
    surfaces: Surfaces,
    receivers: Receivers,
    light: Light,
    photons: float,
    seed: int,
    stratified: bool = True,
    spread: Callable | None = None,
    lamp_points: int = 1,
) -> np.ndarray:
    """(resolution², c) float64 W that point photons bring to each texel. spread: how a photon is shared by texels,
    (sums, x, y, power) → None; None: it goes to its own.

    lamp_points: of a soft lamp. stratified: a jittered grid for each family, else random places.
    """  # fmt: skip
    random = np.random.default_rng(seed)
    size = receivers.resolution
    total = np.zeros((surfaces.channels, size * size))
    trees = []
    for caster in surfaces.casters.tolist():
        squares = emitters(light, surfaces.bounding(caster, light), lamp_points, seed, surfaces.extent)
        chosen = families(surfaces, squares[len(squares) // 2], caster) if squares else []
        for emitter in squares:
            trees += [(emitter, caster, int(f)) for f in chosen]
    for emitter, caster, family in trees:
        side = max(2, round(np.sqrt(photons / len(trees))))
        for start in range(0, side * side, BATCH):
            cell = np.arange(start, min(start + BATCH, side * side))
            s, t = random.random((2, len(cell)))
            if stratified:
                s, t = (cell // side + s) / side, (cell % side + t) / side
            origins, directions, power = emitter.rays(s, t)
            first = np.full(len(cell), caster, np.int32)
            found = trace(surfaces, origins, directions, first, np.full(len(cell), family, np.int64))
            lands = np.flatnonzero((found.triangle >= 0) & ~found.back & (receivers.chart[found.triangle] > 0))
            x, y = receivers.place(found.triangle[lands], found.u[lands], found.v[lands])
            carried = found.carried[:, lands] * power[lands] / side**2
            if spread is not None:
                spread(total, x, y, carried)
                continue
            texel = np.clip(y, 0, size - 1).astype(np.int64) * size + np.clip(x, 0, size - 1).astype(np.int64)
            for channel in range(len(total)):
                total[channel] += np.bincount(texel, carried[channel], size * size)
    return total.T
