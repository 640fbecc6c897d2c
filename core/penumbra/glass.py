"""Light through see-through surfaces: only the relations that meet one are followed by rays that continue."""

from __future__ import annotations

import numpy as np

from ..rays import Tracer
from ..scene import Light
from .cast import cast
from .lamp import LampSamples
from .masks import Masks, bits_of
from .occluders import Occluders
from .receivers import Receivers
from .shading import weights

CHUNK = 1 << 18
"""Relations in memory at a time."""


def part_through(
    light: Light, lamp: LampSamples, receivers: Receivers, masks: Masks, tracer: Tracer, occluders: Occluders
) -> np.ndarray:
    """(R,) or, with tinted glass, (R, 3) float32: what see-through surfaces leave of the light that `masks` let pass.

    occluders: the see-through polygons, which are cast like opaque ones; where they stand between, rays continue
    through them.
    """
    crossing = cast(receivers, lamp, occluders)
    solid = masks.packed()
    met = crossing.packed() & ~solid
    rows = np.flatnonzero(met.any(axis=1))
    channels = (3,) if tracer.transmission.tinted else ()
    passed = np.ones((len(receivers), *channels), np.float32)
    targets = lamp.targets()
    for start in range(0, len(rows), max(1, CHUNK // lamp.count)):
        some = rows[start : start + max(1, CHUNK // lamp.count)]
        own = receivers.take(some)
        seen = 1 - bits_of(solid[some], lamp.count).astype(np.float32)
        groups = own.sets(np.arange(len(some)))
        weight = weights(light, lamp, own, lamp.places[groups] if lamp.sets > 1 else lamp.places[0]) * seen
        through = np.ones((*weight.shape, *channels), np.float32)
        row, sample = np.nonzero(bits_of(met[some], lamp.count))
        origins = own.position[row]
        through[row, sample] = tracer.visibility(origins, lamp.vectors(origins, targets[groups[row], sample]))
        whole = np.maximum(weight.sum(axis=1), np.float32(1e-30))
        if channels:
            passed[some] = np.einsum("nk,nkc->nc", weight, through) / whole[:, None]
        else:
            passed[some] = np.einsum("nk,nk->n", weight, through) / whole
    return passed
