"""Lamps that are hidden from parts of a scene: nothing of their light may be lost."""

import numpy as np
import pytest
from lightpanes.core.preview import Lamps
from lightpanes.core.preview.darkness import RARELY, Darkness
from lightpanes.core.rays import Tracer

from . import shapes

BOUNDS = np.array([[0.0, 0.0, 0.0], [8.0, 4.0, 3.0]])
LAMP = shapes.lamp((6.0, 2.0, 2.0), 100.0)


class Counting:
    """Shadow rays of a scene, and how many were sent."""

    def __init__(self, *parts):
        self.tracer, self.sent = Tracer(shapes.scene(*parts)).alone(), 0

    def visibility(self, origins, vectors):
        self.sent += len(origins)
        return self.tracer.visibility(origins, vectors)


def floor_points(count, low, high, seed=0):
    """Places on the floor between two of them, and their normals."""
    points = np.random.default_rng(seed).uniform((*low, 1e-3), (*high, 1e-3), (count, 3)).astype(np.float32)
    return points, np.tile(np.float32([0, 0, 1]), (count, 1))


def asked(lamps, points, normals, seed):
    u = np.random.default_rng(seed).random((2, len(points))).astype(np.float32)
    return lamps.irradiance(points, normals, u, u[0])


def wall(gap=0.0):
    """Between two rooms; its gap is at the floor."""
    return (*shapes.quad((4, -1, gap), (0, 6, 0), (0, 0, 5)), 0)


def test_a_lamp_behind_a_wall_is_asked_rarely_and_one_that_is_seen_always():
    tracer = Counting(wall(), (*shapes.quad((-1, -1, -1), (10, 0, 0), (0, 6, 0)), 0))
    lamps = Lamps([LAMP], tracer, BOUNDS)
    dark, lit = floor_points(40_000, (0, 0), (3.4, 4)), floor_points(5000, (4.6, 0), (8, 4))
    assert (asked(lamps, *dark, 1) == 0).all() and tracer.sent == 40_000
    # what was learnt counts once it is settled
    asked(lamps, *dark, 2)
    assert tracer.sent == 80_000
    lamps.darkness.settle()
    tracer.sent = 0
    asked(lamps, *dark, 3)
    assert tracer.sent == pytest.approx(40_000 / RARELY, rel=0.2)
    tracer.sent = 0
    found = asked(lamps, *lit, 4)
    assert tracer.sent == 5000 and (found > 0).all()


def test_light_through_a_gap_is_not_lost():
    # the gap lets light to a strip of floor that few of the first rays start from
    tracer = Counting(wall(0.05), (*shapes.quad((-1, -1, -1), (10, 0, 0), (0, 6, 0)), 0))
    lamps = Lamps([LAMP], tracer, BOUNDS)
    far, near = floor_points(20_000, (0, 0), (3.45, 4)), floor_points(4000, (3.9, 1), (3.95, 3))
    asked(lamps, *far, 1)
    lamps.darkness.settle()
    fresh = asked(Lamps([LAMP], tracer, BOUNDS), *near, 2)
    assert fresh.mean() > 1e-3
    # cells of which nothing is known ask always
    assert (asked(lamps, *near, 3) == fresh).all()


def test_rare_rays_count_for_all():
    tracer = Counting((*shapes.quad((-1, -1, -1), (10, 0, 0), (0, 6, 0)), 0))
    lamps = Lamps([LAMP], tracer, BOUNDS)
    points, normals = floor_points(60_000, (0, 0), (8, 4))
    every = asked(lamps, points, normals, 1)
    # as if a wall had stood there when the rays were sent
    cell = lamps.darkness.cells(points.T)
    lamps.darkness = Darkness(1, BOUNDS)
    u = np.random.default_rng(3).random(len(cell)).astype(np.float32)
    lamps.darkness.learn(0, cell, np.zeros(len(cell), bool), u)
    lamps.darkness.settle()
    rare = asked(lamps, points, normals, 2)
    assert 0 < np.count_nonzero(rare[:, 0]) < 1.3 * len(points) / RARELY
    assert rare.mean() == pytest.approx(every.mean(), rel=0.05)
    # and now that light was seen all ask again
    lamps.darkness.settle()
    assert np.count_nonzero(asked(lamps, points, normals, 3)[:, 0]) == len(points)


def test_what_is_learnt_does_not_depend_on_how_points_are_cut_into_pieces():
    scene = wall(0.05), (*shapes.quad((-1, -1, -1), (10, 0, 0), (0, 6, 0)), 0)
    points, normals = floor_points(50_000, (0, 0), (8, 4))
    u = np.random.default_rng(1).random((2, len(points))).astype(np.float32)
    rays = []
    for pieces in (1, 8):
        tracer = Counting(*scene)
        lamps = Lamps([LAMP], tracer, BOUNDS)
        for piece in np.array_split(np.arange(len(points)), pieces):
            lamps.irradiance(points[piece], normals[piece], u[:, piece], u[0, piece])
        lamps.darkness.settle()
        tracer.sent = 0
        asked(lamps, points, normals, 2)
        rays.append(tracer.sent)
    assert rays[0] == rays[1] < 0.9 * len(points)
