"""The lamps' direct light, soft shadows included, at receivers that stay where they are while lamps move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..lights import irradiance
from ..rays import Tracer
from ..scene import Light
from .cast import cast
from .glass import part_through
from .lamp import sample_lamp
from .occluders import Occluders
from .receivers import Receivers
from .shading import shade

STEPS = ((0.03, 64), (0.008, 256), (0.0, 1024))
"""Samples of an area lamp for an accepted error, relative, on blocks of 4 × 4 texels."""


def samples_for(error: float) -> int:
    """Samples of a lamp that keep a soft shadow's error on 4 × 4-texel blocks below `error`, relative to the mean."""
    return next(samples for least, samples in STEPS if error >= least)


def is_soft(light: Light) -> bool:
    """Whether a lamp's samples can stay the same for all receivers: an area lamp or a sun with a size.

    The ball of a POINT or SPOT lamp shows another side to each receiver; rays serve it best.
    """
    if not light.casts_shadow:
        return False
    if light.kind == "AREA":
        return light.spread > 0 and min(light.size) > 0
    return light.kind == "SUN" and 0 < light.angle < np.pi


class DirectLight:
    """Evaluates lamps at receivers; a lamp that did not change costs nothing.

    receivers: with normals, lifted by tracer.offset. samples: of a lamp for which none are named. threads: None for all.
    shared: receivers whose mean is wanted; the rays of a lamp that rays serve best are shared among them.
    """

    def __init__(
        self,
        receivers: Receivers,
        tracer: Tracer,
        samples: int = 64,
        seed: int = 0,
        threads: int | None = None,
        shared: int = 1,
    ):
        self.receivers, self.tracer = receivers, tracer
        self.samples, self.seed, self.threads, self.shared = samples, seed, threads, shared
        self._occluders: Occluders | None = None
        self._glass: Occluders | None = None
        self._unit: dict[tuple, np.ndarray] = {}

    @property
    def occluders(self) -> Occluders:
        """Of the tracer's scene, made when first needed."""
        if self._occluders is None:
            self._occluders = Occluders.of(self.tracer)
        return self._occluders

    def unit(self, light: Light, samples: int | None = None) -> np.ndarray:
        """(R,) or (R, 3) float32 irradiance of a lamp at unit power; three channels behind tinted glass."""
        receivers = self.receivers
        samples = samples or self.samples
        if not is_soft(light):
            samples = -(-samples // self.shared) if light.radius > 0 else 1
            return irradiance(light, receivers.position, receivers.normal, self.tracer.visibility, samples, self.seed)
        sets = 1 if receivers.group is None else int(receivers.group.max(initial=0)) + 1
        extent = float(np.ptp(receivers.position, axis=0).max()) if len(receivers) else 0.0
        lamp = sample_lamp(light, samples, sets, self.seed, extent)
        masks = cast(receivers, lamp, self.occluders, self.threads)
        result = shade(light, lamp, receivers, masks)
        if self.tracer.has_glass:
            if self._glass is None:
                self._glass = Occluders(self.tracer.glass_corners, self.tracer.meets_glass)
            passed = part_through(light, lamp, receivers, masks, self.tracer, self._glass)
            result = result * passed if passed.ndim == 1 else result[:, None] * passed
        return result

    def irradiance(self, lights: Sequence[Light], samples: Mapping[str, int] | None = None) -> np.ndarray:
        """(R, 3) float32 direct irradiance of the lamps, W/m².

        samples: of some lamps, by name. Lamps that are not among `lights` are forgotten.
        """
        unit = {}
        total = np.zeros((len(self.receivers), 3), np.float32)
        for light in lights:
            key = self._key(light, samples)
            if key not in unit:
                found = self._unit.get(key)
                unit[key] = self.unit(light, key[1]) if found is None else found
            total += coloured(unit[key], light)
        self._unit = unit
        return total

    def known(self, light: Light, samples: Mapping[str, int] | None = None) -> np.ndarray | None:
        """(R, 3) float32 irradiance, W/m², of a lamp that the last call of `irradiance` held; None of another."""
        found = self._unit.get(self._key(light, samples))
        return None if found is None else coloured(found, light)

    def _key(self, light, samples):
        return light.geometry, (samples or {}).get(light.name, self.samples)


def coloured(unit: np.ndarray, light: Light) -> np.ndarray:
    """(R, 3) float32 irradiance of a lamp, W/m², from that at unit power, (R,) or (R, 3)."""
    return (unit if unit.ndim == 2 else unit[:, None]) * light.power.astype(np.float32)
