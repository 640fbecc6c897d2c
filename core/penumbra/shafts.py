"""Which occluders may stand between a cluster of receivers and the lamp: what meets the shaft between their boxes.

All boxes are in the lamp's frame (see occluders.LampView), where lamp and clusters are boxes along the same axes, so
that the shaft between them has four plane sides and two-dimensional tests decide (the main penumbra volume of Laine and
Aila 2005, turned around: of a receiver node instead of a triangle).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .lamp import LampSamples
from .occluders import BLOCK, Tree


@dataclass(frozen=True)
class Boxes:
    """low, high: (n, 3) float32, m, in the lamp's frame."""

    low: np.ndarray
    high: np.ndarray


def candidates(
    clusters: Boxes, tree: Tree, lamp: LampSamples, most: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs (cluster, occluder), two (n,) intp sorted by cluster, of all whose boxes may meet.

    most: occluders at which a cluster is given up: once its blocks hold more, it has no pairs, and its place in the
    third result, (clusters,) bool, is set.
    """
    crowded = np.zeros(len(clusters.low), bool)
    level = len(tree.low) - 1
    cluster = np.repeat(np.arange(len(clusters.low)), len(tree.low[level]))
    node = np.tile(np.arange(len(tree.low[level])), len(clusters.low))
    while True:
        keep = meets(clusters, cluster, tree.low[level], tree.high[level], node, lamp)
        cluster, node = cluster[keep], node[keep]
        if level == 0:
            return cluster, node, crowded
        if level == 1:
            crowded = np.bincount(cluster, minlength=len(clusters.low)) * BLOCK > most
            if crowded.any():
                keep = ~crowded[cluster]
                cluster, node = cluster[keep], node[keep]
        each = tree.children(level)
        level -= 1
        node = (node[:, None] * each + np.arange(each)).ravel()
        cluster = np.repeat(cluster, each)
        inside = node < len(tree.low[level])
        cluster, node = cluster[inside], node[inside]


def meets(clusters: Boxes, cluster, low, high, node, lamp: LampSamples) -> np.ndarray:
    """(n,) bool: whether the boxes (low, high)[node] may meet the shafts of clusters[cluster]."""
    near, far = clusters.low[cluster, 2], clusters.high[cluster, 2]
    top, bottom = low[node, 2], high[node, 2]
    hx, hy, hz = (np.float32(v) for v in lamp.half)
    with np.errstate(divide="ignore", invalid="ignore"):
        if lamp.distant:
            # the way back from a receiver to a box, along z
            most = far - top
            keep = most >= 0
            np.maximum(most, 0, out=most)
            grow = ((hx * most, hx * most), (hy * most, hy * most))
        else:
            behind = near <= hz
            least = np.where(behind, 0, np.clip((top - hz) / (far - hz), 0, 1))
            most = np.where(behind, 1, np.clip((bottom + hz) / (near + hz), 0, 1))
            keep = (top <= np.maximum(far, hz)) & (bottom >= np.minimum(near, -hz))
    for axis, half in ((0, hx), (1, hy)):
        left, right = clusters.low[cluster, axis], clusters.high[cluster, axis]
        if lamp.distant:
            first, last = left - grow[axis][0], right + grow[axis][1]
        else:
            spread = right - half
            last = half + np.maximum(spread * least, spread * most)
            spread = left + half
            first = np.minimum(spread * least, spread * most) - half
        slack = np.float32(1e-6) * (np.abs(first) + np.abs(last))
        keep &= (low[node, axis] <= last + slack) & (high[node, axis] >= first - slack)
    return keep
