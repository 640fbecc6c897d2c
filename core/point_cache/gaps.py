"""Places that no point serves get points of their own: never a silent black, nor a far neighbour's light."""

from __future__ import annotations

import numpy as np

from ..rays import Bvh
from ..sampling import hash_uint32
from ..surface import SurfaceSamples
from . import guides
from .build import RAYS
from .darts import first_come
from .interpolation import Interpolator, Weights
from .points import PointSet


def serve(
    points: PointSet, places: SurfaceSamples, back: np.ndarray, bvh: Bvh, offset: float, reach: float, seed: int = 0
) -> tuple[PointSet, Weights]:
    """Weights for all places (q,), and the points with those added that places without any became.

    back: (q,) bool, whether a place is on its triangle's reverse. reach: m, of ambient occlusion. The added points keep
    their distance too: the radius is that of the nearest points, whichever way they face.
    """
    found = Interpolator(points, bvh, offset).weights(places)
    lost = np.flatnonzero(found.orphan)
    if not len(lost):
        return points, found
    order = lost[np.argsort(hash_uint32(lost, 31, seed), kind="stable")]
    some = places.take(order)
    radius = guides.nearest_radius(points, some.position)
    kept = first_come(some, radius, places.position.min(axis=0))
    added = some.take(kept)
    ao, _ = guides.surroundings(added, bvh, reach, RAYS, offset, seed + 3)
    extra = PointSet(added, radius[kept], ao, back[order[kept]])
    points = points.join(extra)
    again = Interpolator(points, bvh, offset).weights(places.take(lost))
    still = np.flatnonzero(again.orphan)
    if len(still):
        # thin strips that see no other: each is its own
        alone = places.take(lost[still])
        ao, _ = guides.surroundings(alone, bvh, reach, RAYS, offset, seed + 4)
        near = guides.nearest_radius(points, alone.position)
        again.point[still, 0] = len(points) + np.arange(len(still))
        again.weight[still, 0] = 1
        points = points.join(PointSet(alone, near, ao, back[lost[still]]))
    found.point[lost], found.weight[lost] = again.point, again.weight
    return points, found
