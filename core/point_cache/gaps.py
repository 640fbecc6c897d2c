"""Places that no point serves get points of their own: never a silent black, nor a far neighbour's light."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..sampling import hash_uint32
from ..surface import SurfaceSamples
from . import guides
from .build import RAYS, Ground
from .darts import first_of_many
from .interpolation import Interpolator, Weights, widen
from .points import PointSet


def serve(
    points: PointSet,
    places: SurfaceSamples,
    ground: Ground,
    kernel: str = "ward",
    seed: int = 0,
    buried: Callable[[SurfaceSamples], np.ndarray] | None = None,
) -> tuple[PointSet, Weights]:
    """Weights for all places (q,), and the points with those added that places without any became.

    kernel: see `Interpolator.weights`. buried(places): (n,) bool, those that need none and keep weights of 0. The added
    points keep their distance too: the radius is that of the nearest points, whichever way they face.
    """
    bvh, offset = ground.bvh, ground.offset
    found = Interpolator(points, bvh, offset).weights(places, kernel)
    lost = np.flatnonzero(found.orphan)
    if buried is not None and len(lost):
        lost = lost[~buried(places.take(lost))]
    if not len(lost):
        return points, found
    order = lost[np.argsort(hash_uint32(lost, 31, seed), kind="stable")]
    some = places.take(order)
    kept = first_of_many(some, _radius(points, some, ground), places.position.min(axis=0))
    points = points.join(_own(points, some.take(kept), ground, seed + 3))
    again = Interpolator(points, bvh, offset).weights(places.take(lost), kernel)
    still = np.flatnonzero(again.orphan)
    if len(still):
        # thin strips that see no other: each is its own
        again.point[still, 0] = len(points) + np.arange(len(still))
        again.weight[still, 0] = 1
        points = points.join(_own(points, places.take(lost[still]), ground, seed + 4))
    width = max(found.point.shape[1], again.point.shape[1])
    found, again = (Weights(widen(w.point, width), widen(w.weight, width)) for w in (found, again))
    found.point[lost], found.weight[lost] = again.point, again.weight
    return points, found


def _own(points, places, ground, seed):
    """The places as points, with the radius of the points around them."""
    ao = guides.openness(places, ground.bvh, ground.reach, RAYS, ground.offset, seed)
    return PointSet(places, _radius(points, places, ground), ao, places.behind(ground.scene))


def _radius(points, places, ground):
    """(q,) float32 m: that of the points around; where light gets nowhere yet, that of the coarse set."""
    if not len(points):
        return np.full(len(places), ground.size, np.float32)
    return guides.nearest_radius(points, places.position)
