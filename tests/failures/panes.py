"""Where panes fail. The truth is the uncompressed solve of the same entries, or a closed form."""

from __future__ import annotations

from functools import cache

import numpy as np
from lightpanes.core.bake import bake
from lightpanes.core.scene import Material
from lightpanes.core.surface import make_texels

from ..core.shapes import box, lamp, quick, relighter, scene
from ..core.uncompressed import WHITISH, red, relative, walled
from .entry import Curves, Found, Images, Places, entry
from .looks import atlas, floor_of, look

EYE, TARGET = (0.3, 0.3, 2.0), (3.0, 2.0, 0.3)
"""A look into the room with a block and a wall."""


@entry(
    "Panes",
    "a lamp centimetres from a surface",
    """The pool of light under such a lamp is smaller than an entry, and few training lamps hung there: light comes back
    from a blob as wide as an entry. Its power is right. The panel warns.""",
    "error over the room, lamps 1 cm from floor, wall and block, the worst of three",
    0.3,
    "core/test_failures.py::test_a_lamp_centimetres_from_a_surface core/test_panes.py::test_all_of_a_lamp_s_power_arrives",
)
def near_lamp() -> Found:
    made, baked, truth = walled()
    runtime = relighter(made, baked)
    errors = {}
    for height in (0.01, 0.02, 0.04, 0.1):
        lights = [lamp((3.3, 1.2, height)), lamp((2.6 - height, 1.3, 0.9)), lamp((1.7, 2.95, 1 + height))]
        found, expected = red(runtime, lights), truth.texels(lights)
        errors[height] = relative(found, expected).max()
        if height == 0.01:
            shown = [look(made, atlas(truth.ready.exits, v[0]), EYE, TARGET) for v in (found, expected)]
    steps = ", ".join(f"{100 * height:g} cm: {error:.2f}" for height, error in errors.items())
    high = float(np.quantile(shown[1], 0.995))
    return Found(errors[0.01], Images(dict(zip(("panes", "truth"), shown, strict=True)), "W/m²", high=high), steps)


@entry(
    "Panes",
    "a lamp crossing an occluder's edge",
    """Entries pass from shadow to light one by one as the lamp moves, in the truth as well; panes add little to these
    steps.""",
    "median change from frame to frame over the truth's, 1 cm a frame past a wall's edge",
    1.5,
    "core/test_failures.py::test_light_does_not_flicker_as_a_lamp_crosses_an_edge",
)
def crossing() -> Found:
    made, baked, truth = walled()
    y = np.linspace(2.25, 2.55, 31)
    lights = [lamp((2.2, at, 1.0)) for at in y]
    found, expected = red(relighter(made, baked), lights), truth.texels(lights)
    jumps = [np.sqrt((np.diff(frames, axis=0) ** 2).mean(axis=1)) / expected.mean() for frames in (found, expected)]
    curves = {name: (y[1:], values) for name, values in zip(("panes", "truth"), jumps, strict=True)}
    value = np.median(jumps[0]) / np.median(jumps[1])
    return Found(value, Curves(curves, "lamp's place, m (the edge is at 2.4)", "change a frame, over the mean"))


def places_of(made, baked):
    """Samples of a bake's rows."""
    texels = make_texels(made, baked.resolution)
    row = np.zeros(baked.resolution**2, np.int64)
    row[texels.index] = np.arange(len(texels))
    return texels.samples.take(row[baked.panes().texel])


def two_rooms(thick: float):
    left, right = box((0, 0, 0), (2, 3, 2.5), True), box((2 + thick, 0, 0), (4 + thick, 3, 2.5), True)
    lights = [lamp((1, 1.5, 1.2)), lamp((3 + thick, 1.5, 1.2))]
    return scene((*left, 0), (*right, 0), materials=(WHITISH,), lights=lights)


@entry(
    "Panes",
    "a lamp behind a thin wall",
    """Rooms between which no light passes have panes of their own, so nothing leaks through a wall, however thin.""",
    "most light in the dark room over the mean in the lit one, a wall of no thickness, the lamp 2 cm from it",
    0.005,
    "core/test_failures.py::test_no_light_through_a_thin_wall",
)
def thin_wall() -> Found:
    made, settings = two_rooms(0.0), quick(entries=600)
    baked = bake(made, settings)
    found, exits = relighter(made, baked).texels([lamp((1.98, 1.5, 1.2))])[:, 0], places_of(made, baked)
    there = made.triangle_object[exits.triangle] == 1
    value = np.abs(found[there]).max() / found[~there].mean()
    return Found(value, Places({"both floors from above": floor_of(exits, found)}, "W/m²"))


@entry(
    "Panes",
    "a wall on a floor of one piece",
    """Rooms of one mesh, parted by a wall that stands in it: the floor goes on below. It is cut where the wall stands, and
    entries end there, so nothing leaks. A kerb lower than half an entry parts none, and below a wall that leans over the floor
    they reach on by a thirty-second of their size.""",
    "mean light in the dark room over that in the lit one, a closed wall 5 cm thick, 600 entries",
    0.005,
    "core/test_walls.py::test_no_light_below_a_wall_on_one_floor core/test_walls.py::test_patches_have_one_side",
)
def wall_on_floor() -> Found:
    inside = box((2, 0, 0), (2.05, 3, 2.5))
    lights = [lamp((1, 1.5, 1.2)), lamp((3, 1.5, 1.2))]
    made = scene((*box((0, 0, 0), (4, 3, 2.5), True), 0), (*inside, 0), materials=(WHITISH,), lights=lights)
    leaks = {}
    for count in (300, 600, 2400):
        baked = bake(made, quick(entries=count, resolution=96))
        found, exits = relighter(made, baked).texels(lights[:1])[:, 0], places_of(made, baked)
        # no texel that reaches below the wall
        dark, lit = exits.position[:, 0] > 2.35, exits.position[:, 0] < 1.7
        leaks[count] = float(found[dark].mean() / found[lit].mean())
        if count == 600:
            shown = Places(
                {"floor from above, the lamp on the left": floor_of(exits, found)},
                "W/m²",
                high=float(found[dark].max()),
            )
    detail = ", ".join(f"{count} entries: {leak:.3f}" for count, leak in leaks.items())
    return Found(leaks[600], shown, detail)


def boxed():
    inner = box((1, 1, 0.8), (1.6, 1.6, 1.4))
    return scene((*box((0, 0, 0), (4, 3, 2.5), True), 0), (*inner, 0), materials=(WHITISH,), lights=[lamp((3, 1.5, 2))])


def dark_places(made, places, label) -> Found:
    """Most light from lamps at places from where none must come, over the mean of one in the room."""
    baked = bake(made, quick())
    runtime, exits = relighter(made, baked), places_of(made, baked)
    outside = runtime.texels([lamp((3, 1.5, 2))])[:, 0]
    found = [runtime.texels([lamp(place)])[:, 0] for place in places]
    value = max(np.abs(values).max() for values in found) / outside.mean()
    shown = {"lamp in the room": floor_of(exits, outside), label: floor_of(exits, found[0])}
    return Found(value, Places(shown, "W/m²"))


@entry(
    "Panes",
    "a lamp inside a closed box",
    """It lights the box's inside, which nobody sees, and nothing else. The panel says that it lights nothing.""",
    "most light in the room over that of a lamp in the room",
    0.005,
    "core/test_failures.py::test_a_lamp_inside_a_closed_box_stays_there",
)
def closed_box() -> Found:
    return dark_places(boxed(), [(1.3, 1.3, 1.1), (1.05, 1.3, 1.35), (1.001, 1.001, 0.801)], "lamp in the box")


@entry(
    "Panes",
    "a lamp outside the room",
    """Walls of one face block light from their back, too. The panel says that the lamp lights nothing.""",
    "most light in the room over that of a lamp in the room, lamps 1 cm and more outside",
    0.005,
    "core/test_failures.py::test_a_lamp_outside_the_room_does_not_shine_in",
)
def outside_lamp() -> Found:
    made = scene((*box((0, 0, 0), (4, 3, 2.5), True), 0), materials=(WHITISH,), lights=[lamp((3, 1.5, 2))])
    return dark_places(made, [(4.01, 1.5, 1), (5, 5, 5), (2, 1.5, -0.001)], "lamp outside")


@cache
def white_room(albedo: float) -> np.ndarray:
    made = scene((*box((0, 0, 0), (2, 2, 2), True), 0), materials=(Material("Coat", (albedo,) * 3),))
    return relighter(made, bake(made, quick(entries=400))).texels([lamp((1, 1, 1))])


@entry(
    "Panes",
    "albedo 1",
    """In a closed room light would never fade. Albedo is lowered to 0.98, and a warning names the material: light is then
    that of Φ ρ / (1 − ρ) over the area, which is much, and finite.""",
    "deviation of the mean from the closed form, albedo 1",
    0.03,
    "core/test_failures.py::test_no_albedo_makes_too_much_light core/test_closed_forms.py::test_albedo_of_one_is_bounded",
)
def albedo_one() -> Found:
    albedos = np.array([0.0, 0.9, 1.0])
    means = np.array([white_room(albedo).mean() for albedo in albedos])
    lowered = np.minimum(albedos, 0.98)
    expected = 100 / 24 * lowered / (1 - lowered)
    curves = {"panes": (albedos, means), "closed form, at most 0.98": (albedos, expected)}
    return Found(abs(means[-1] / expected[-1] - 1), Curves(curves, "albedo", "mean irradiance, W/m²"))


@entry(
    "Panes",
    "albedo 0",
    "Nothing comes back, not even noise.",
    "most light, W/m²",
    1e-6,
    "core/test_failures.py::test_no_albedo_makes_too_much_light core/test_closed_forms.py::test_no_light_without_albedo",
)
def albedo_zero() -> Found:
    black, grey = white_room(0.0), white_room(0.9)
    count = np.arange(len(grey))
    curves = {"albedo 0.9": (count, np.sort(grey[:, 0])), "albedo 0": (count, np.sort(black[:, 0]))}
    return Found(float(np.abs(black).max()), Curves(curves, "texels, sorted", "irradiance, W/m²"))


@entry(
    "Panes",
    "entries that straddle a shadow edge",
    """An entry holds one number. Where a shadow's edge cuts it in two that is the mean of both, taken at several places,
    exactly where the lamp is near.""",
    "error over the room, lamps low behind a wall, the worst of three",
    0.15,
    "core/test_failures.py::test_shadow_edges_across_entries",
)
def shadow_edge() -> Found:
    made, baked, truth = walled()
    lights = [lamp((2.3, 1.5, z)) for z in (1.62, 1.7, 1.9)]
    found, expected = red(relighter(made, baked), lights), truth.texels(lights)
    exits = truth.ready.exits.samples
    shown = {name: floor_of(exits, values[0]) for name, values in (("panes", found), ("truth", expected))}
    return Found(relative(found, expected).max(), Places(shown, "W/m²"))


@entry(
    "Panes",
    "corners: spikes of virtual lights",
    """Virtual lights, the paper's way, make spikes of 1/r² in corners. A gather and a linear solve have none.""",
    "brightest texel over the truth's, a lamp in a corner",
    1.3,
    "core/test_failures.py::test_corners_have_no_spikes",
)
def corners() -> Found:
    made, baked, truth = walled()
    light = lamp((0.3, 0.3, 0.3))
    found, expected = red(relighter(made, baked), [light])[0], truth.texels([light])[0]
    eye = (0.9, 0.8, 1.4), (0.0, 0.0, 0.2)
    shown = {name: look(made, atlas(truth.ready.exits, v), *eye) for name, v in (("panes", found), ("truth", expected))}
    return Found(found.max() / expected.max(), Images(shown, "W/m²", high=float(expected.max())))
