"""Where penumbra casting fails: it must tell what rays tell, bit for bit, and may only get slower."""

from __future__ import annotations

import numpy as np
from lightpanes.core.penumbra import Cost, Occluders, Receivers, cast, cast_rays, sample_lamp
from lightpanes.core.rays import Bvh, Tracer

from ..bench.penumbra_scenes import area_lamp, box, room, scene_of, sphere
from ..core.test_penumbra import FLOOR, LAMPS, clutter, differing, lamp_of
from .entry import Found, Images, entry

SIDE = 48
"""Receivers along each side of a picture of the floor."""

REACH = 1.6
"""m from the middle to the picture's sides."""

RULE = """By lines across the lamp or, where those would cost more or float32 cannot tell, by rays: the masks are those
that brute-force rays give."""


def on_floor(lift: float) -> Receivers:
    """A grid on the floor, rows of y."""
    step = np.linspace(-REACH, REACH, SIDE)
    x, y = np.meshgrid(step, step)
    place = np.stack([x, y, np.full(x.shape, lift)], -1).reshape(-1, 3)
    return Receivers(place.astype(np.float32), np.tile(np.float32([0, 0, 1]), (len(place), 1)))


def shadows(scene, lamps: dict, extra=None) -> Found:
    """Bits in which lines and rays differ, over all lamps, {title: samples of a lamp}, and what the floor sees of them.

    extra: (n, 3, 3) further triangles, which no Scene takes.
    """
    tracer = Tracer(scene)
    corners, blocked = tracer.solid_corners, tracer.blocked
    if extra is not None:
        corners = np.concatenate([corners, extra.astype(np.float32)])
        blocked = Bvh(corners).occluded
        occluders = Occluders(corners, blocked)
    else:
        occluders = Occluders.of(tracer, True)
    receivers = on_floor(tracer.offset)
    bits, images, shares = 0, {}, []
    for title, lamp in lamps.items():
        masks = cast(receivers, lamp, occluders, cost=Cost(lamp.count, "lines"))
        bits += differing(masks, cast_rays(receivers, lamp, blocked))
        images[title] = masks.seen().reshape(SIDE, SIDE)
        shares.append(f"{title}: {masks.statistics.candidates:.1f} polygons a receiver in penumbra")
    return Found(float(bits), Images(images, "part of the lamp that is seen", high=1.0), "; ".join(shares))


@entry(
    "Penumbra casting",
    "very large lamps",
    """The larger the lamp, the more of the scene lies in its penumbrae, and the more polygons each receiver has to ask:
    the paper's method slows down. Whole clusters go to rays where these are the cheaper way.""",
    "samples of which lines and rays say different things",
    0,
    "core/test_penumbra.py::test_every_lamp core/test_penumbra.py::test_some_clusters_by_lines_and_some_by_rays",
)
def large_lamps() -> Found:
    sizes = (0.2, 1.0, 5.0)
    lamps = {f"{s:g} m": sample_lamp(lamp_of("AREA", (0, 0, 2.5), size=(s, s)), 64) for s in sizes}
    return shadows(clutter(), lamps)


@entry(
    "Penumbra casting",
    "a lamp cutting through geometry",
    RULE,
    "samples of which lines and rays say different things",
    0,
    "core/test_penumbra.py::test_lamp_cutting_through_geometry",
)
def cutting_lamp() -> Found:
    block = box(np.array([-0.5, -0.5, 0.5]), *np.diag([1.0, 1.0, 1.0]), 2)
    lamp = sample_lamp(lamp_of("AREA", (0.4, 0.3, 0.8), size=(1.2, 1.2)), 64)
    return shadows(scene_of([FLOOR, block]), {"a lamp through a block's side": lamp})


@entry(
    "Penumbra casting",
    "receivers on the lamp",
    """A lamp that all but lies on the floor, and one that lies in the ceiling. """ + RULE,
    "samples of which lines and rays say different things",
    0,
    """core/test_penumbra.py::test_receivers_on_the_lamp_and_behind_it
    core/test_penumbra.py::test_lamp_on_a_ceiling_and_on_a_wall""",
)
def on_the_lamp() -> Found:
    shapes = [*room((-2, -2, 0), (2, 2, 2.5), 2), box(np.array([0.6, 0.2, 0.0]), *np.diag([0.3, 0.3, 0.8]), 1)]
    lamps = {
        "2 mm above the floor": sample_lamp(area_lamp((0, 0, 2e-3), 1.0), 64),
        "in the ceiling": sample_lamp(area_lamp((0, 0, 2.5), 1.0), 64),
    }
    return shadows(scene_of(shapes), lamps)


@entry(
    "Penumbra casting",
    "degenerate triangles",
    "Needles and points without area among the occluders. " + RULE,
    "samples of which lines and rays say different things",
    0,
    "core/test_penumbra.py::test_degenerate_triangles core/test_penumbra_polygons.py::test_slivers_join_nothing_wrong",
)
def degenerate() -> Found:
    random = np.random.default_rng(2)
    needle = random.uniform((-1, -1, 0), (1, 1, 2), (40, 3, 3))
    needle[:20, 2] = needle[:20, 1]
    needle[20:30, 2] = (needle[20:30, 0] + needle[20:30, 1]) / 2
    needle[30:, 2] = needle[30:, 1] + 1e-6
    return shadows(clutter(6, 5), {"with 40 needles": sample_lamp(LAMPS["square"], 64)}, needle)


@entry(
    "Penumbra casting",
    "many tiny triangles",
    """Each triangle has edges of its own, so finely divided curves cost more than large faces; merging flat neighbours
    helps little there.""",
    "samples of which lines and rays say different things",
    0,
    "core/test_penumbra.py::test_many_tiny_triangles",
)
def tiny_triangles() -> Found:
    made = scene_of([FLOOR, sphere((0, 0, 1), 0.5, 24, 48)])
    return shadows(made, {f"{len(made.triangles)} triangles": sample_lamp(LAMPS["square"], 64)})


@entry(
    "Penumbra casting",
    "one light sample",
    """A single sample makes hard shadows, and any number works. There is nothing to share between samples then, so rays
    are as fast.""",
    "samples of which lines and rays say different things",
    0,
    "core/test_penumbra.py::test_any_number_of_samples",
)
def one_sample() -> Found:
    return shadows(clutter(1), {f"{n} samples": sample_lamp(LAMPS["square"], n) for n in (1, 7, 64)})
