"""Where a point cache fails. What is spread from the points is a lamp's direct light, known at any place."""

from __future__ import annotations

import numpy as np
from lightpanes.core.point_cache import guides, make_points

from ..core.shapes import box, lamp, quad, room, room_parts, scene
from ..core.test_darts import surveyed
from ..core.test_interpolation import anywhere
from ..core.test_point_failures import SIZES, inside, lit, pillar, pillar_errors, set_of, spread
from .entry import Curves, Found, Places, entry


@entry(
    "Point cache",
    "a shadow edge on a flat open floor",
    """Ambient occlusion, the paper's guide, sees no shadow: points are as few there as on the open floor, and the edge is
    as soft as they are apart. Bakes let training lamps guide the points, which see edges.""",
    "worst error over the most light, 1000 points guided by occlusion",
    0.15,
    """core/test_point_failures.py::test_the_shadow_of_a_pillar_is_bounded
    core/test_point_failures.py::test_occlusion_does_not_see_a_shadow_s_edge_and_lamps_do""",
)
def open_floor() -> Found:
    ground, places, truth = pillar()
    points = make_points(ground, guides.by_occlusion(ground.ao), 1000, 0)
    found = spread(ground, points, places, "affine")[0]
    at = places.position[:, :2]
    rmse, worst = pillar_errors("occlusion")
    shown = {"truth": (at, truth), "from the points": (at, found), "10 × |error|": (at, 10 * np.abs(found - truth))}
    detail = f"RMSE over the mean {rmse:.3f}; points guided by lamps {pillar_errors('lamps')[0]:.3f}"
    return Found(worst, Places(shown, "W/m²"), detail)


@entry(
    "Point cache",
    "thin objects that no dart hits",
    """Places that no point serves become points of their own, so a wire's light comes from the wire.""",
    "RMSE over the mean along a wire 2 mm thick, 300 points in the whole room",
    0.15,
    "core/test_point_failures.py::test_a_wire_two_millimetres_thick core/test_gaps.py::test_gaps_get_points_of_their_own",
)
def wire() -> Found:
    thin = box((0.2, 2.2, 1.8), (3.8, 2.202, 1.802))
    made = scene(*room_parts(), (*thin, 1), materials=room().materials, lights=[lamp((3, 1, 2))])
    ground = surveyed(made)
    points = make_points(ground, guides.by_occlusion(ground.ao), 300)
    places = anywhere(made, 1500, rows=np.flatnonzero(made.triangle_object == 2))
    found, more, _ = spread(ground, points, places)
    truth = lit(ground, places)
    top = np.flatnonzero(places.normal[:, 2] > 0.5)
    top = top[np.argsort(places.position[top, 0])]
    curves = {name: (places.position[top, 0], v[top]) for name, v in (("truth", truth), ("from the points", found))}
    value = np.sqrt(((found - truth) ** 2).mean()) / truth.mean()
    return Found(value, Curves(curves, "along the wire, m", "W/m²"), f"{len(more) - len(points)} points of its own")


@entry(
    "Point cache",
    "both sides of a sheet",
    """A point serves only what faces as it does, so a sheet's dark back takes nothing from its bright front.""",
    "most light on the back over the mean on the front",
    0.01,
    "core/test_point_failures.py::test_the_back_of_a_sheet_stays_dark core/test_interpolation.py::test_nothing_crosses_a_thin_wall",
)
def sheet() -> Found:
    made = scene(
        (*box((0, 0, 0), (4, 3, 2.5), True), 0),
        (*quad((1, 1, 1.2), (2, 0, 0), (0, 1, 0)), 0),
        lights=[lamp((2, 1.5, 2)), lamp((2, 1.5, 0.1), 1e-9)],
    )
    ground = surveyed(made)
    points = make_points(ground, guides.by_occlusion(ground.ao), 1000)
    front = anywhere(made, 1500, rows=np.flatnonzero(made.triangle_object == 1))
    bright = spread(ground, points, front)[0]
    dark = spread(ground, points, front.flipped(np.ones(len(front), bool)))[0]
    at = front.position[:, :2]
    return Found(np.abs(dark).max() / bright.mean(), Places({"front": (at, bright), "back": (at, dark)}, "W/m²"))


@entry(
    "Point cache",
    "rooms that no lamp's particles reach",
    """Particles from the lamps say where light gets; a sealed room has none and so no points. Its places become their
    own points, dark, and take nothing from the room beyond the wall.""",
    "most light in the sealed room over the mean next door, walls 1 mm apart",
    1e-6,
    "core/test_point_failures.py::test_a_sealed_room_takes_nothing_from_its_neighbour",
)
def sealed() -> Found:
    left, right = box((0, 0, 0), (2, 2, 2), True), box((2.001, 0, 0), (4.001, 2, 2), True)
    ground = surveyed(scene((*left, 0), (*right, 0), lights=[lamp((1.9, 1, 1))]))
    points = make_points(ground, guides.by_occlusion(ground.ao), 1000)
    places = anywhere(ground.scene, 3000)
    there = ground.scene.triangle_object[places.triangle] == 1
    found, more, _ = spread(ground, points, places)
    low = (more.position[:, 2] < 1e-3) & (more.normal[:, 2] > 0.5)
    shown = {"points on both floors, and their light": (more.position[low, :2], lit(ground, more.samples)[low])}
    return Found(np.abs(found[there]).max() / found[~there].mean(), Places(shown, "W/m²"))


@entry(
    "Point cache",
    "scenes in millimetres or kilometres",
    """Everything is in parts of the scene's size, so a room 1 mm or 10 km across, or 10 km away, has the same points.""",
    "deviation of the number of points from that of the room in metres, the worst of five sizes and places",
    0.03,
    """core/test_point_failures.py::test_a_scene_of_any_size_and_place_has_the_same_points
    core/test_failures.py::test_a_scene_of_any_size_has_the_same_light
    core/test_failures.py::test_a_scene_far_from_the_origin_has_the_same_light""",
)
def any_size() -> Found:
    usual = len(set_of(1, 0)[0])
    counts = {4 * size: len(set_of(size, away)[0]) for size, away in SIZES if not away}
    away = {max(distance, 1): len(set_of(1, distance)[0]) for distance in (0, 300, 1e4)}
    assert all((1, distance) in SIZES for distance in (300, 1e4))
    curves = {
        "size of the room": (np.array(sorted(counts)), np.array([counts[s] for s in sorted(counts)])),
        "distance from the origin": (np.array(list(away)), np.array(list(away.values()))),
    }
    value = max(abs(count / usual - 1) for count in (*counts.values(), *away.values()))
    return Found(value, Curves(curves, "m", "points", "x"))


@entry(
    "Point cache",
    "coincident surfaces",
    """Floors in one plane share their points, and rays meet either: no holes, no specks. In the panes the copies weigh as
    so many floors, and up to a sixth of the light between far surfaces is lost.""",
    "RMSE over the mean on three floors that coincide, one upside down",
    0.15,
    """core/test_point_failures.py::test_floors_that_coincide_share_their_points
    core/test_failures.py::test_coincident_surfaces_neither_leak_nor_blow_up""",
)
def coincident() -> Found:
    floor, turned = quad((0, 0, 0), (4, 0, 0), (0, 3, 0)), quad((0, 0, 0), (0, 3, 0), (4, 0, 0))
    made = scene(
        *room_parts(), (*floor, 0), (*floor, 0), (*turned, 0), materials=room().materials, lights=[lamp((3, 1.5, 2))]
    )
    ground = surveyed(made)
    points = make_points(ground, guides.uniform(ground.coarse), 1500)
    places = anywhere(made, 1500, rows=np.flatnonzero(made.triangle_object >= 2))
    places = places.flipped(places.flat[:, 2] < 0)
    places = places.take(~inside(places.position, (0.97, 0.96, -1), (1.83, 2.01, 1)))
    found, truth = spread(ground, points, places)[0], lit(ground, places)
    at = places.position[:, :2]
    value = np.sqrt(((found - truth) ** 2).mean()) / truth.mean()
    return Found(value, Places({"truth": (at, truth), "from the points": (at, found)}, "W/m²"))
