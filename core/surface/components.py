"""The connected parts of a graph: of triangles by their edges, of vertices by their triangles."""

from __future__ import annotations

import numpy as np


def components(count: int, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """(count,) int32 number of the part that each node belongs to, in the order of their first nodes.

    here, there: (edges,) integers, the two nodes that each edge joins.
    """
    label = np.arange(count)
    while len(here):
        # roots take the smaller of the two roots' numbers, then chains are cut short: about log(n) rounds
        a, b = label[here], label[there]
        apart = a != b
        if not apart.any():
            break
        here, there, a, b = here[apart], there[apart], a[apart], b[apart]
        least = np.minimum(a, b)
        np.minimum.at(label, a, least)
        np.minimum.at(label, b, least)
        while (label[label] != label).any():
            label = label[label]
    return np.unique(label, return_inverse=True)[1].reshape(-1).astype(np.int32)
