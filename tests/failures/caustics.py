"""Where caustics fail: against closed forms and the conservation of energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from lightpanes.core.caustics import CausticAtlas

from ..core.caustic_scenes import ball, closed, floor, floor_places, glass, panel, staged
from ..core.shapes import GREY, box, lamp
from .entry import Curves, Found, Images, entry

SIDE = 96
PHOTONS = 20_000


def image_of(scene, lights, resolution: int = SIDE):
    """The atlas, and its red image."""
    atlas = CausticAtlas(scene, resolution)
    return atlas, atlas.image(lights, PHOTONS)[..., 0]


@entry(
    "Caustics",
    "the focus itself",
    """A focus is a spike without an end: its height depends on the resolution, its power does not.""",
    "difference of the power within 10 cm of the focus, 64² and 128² texels",
    0.03,
    "core/test_caustics.py::test_the_focus_keeps_its_power_and_is_no_wider_than_it_is",
)
def focus() -> Found:
    light = lamp((0.6, 0.2, 2.5))
    scene = staged(floor(), ball((0, 0, 0.7), 0.4), materials=(GREY, glass()), lights=[light])
    sums, images = [], {}
    for resolution in (64, 128):
        _, image = image_of(scene, [light], resolution)
        place, _ = floor_places(resolution)
        peak = place[np.unravel_index(image.argmax(), image.shape)]
        near = np.hypot(*(place - peak).transpose(2, 0, 1)) < 0.1
        sums.append(image[near].sum() / resolution**2)
        images[f"{resolution}² texels, most {image.max():.0f} W/m²"] = image
    high = float(np.quantile(image, 0.998))
    return Found(abs(sums[0] / sums[1] - 1), Images(images, "W/m²", high=high))


@entry(
    "Caustics",
    "total internal reflection",
    """Beyond the critical angle all light turns: Fresnel's factor is exactly 1 there, and photons go on inside.""",
    "deviation of the light that leaves a prism from Fresnel's law at its two faces",
    0.02,
    "core/test_caustics.py::test_total_reflection_turns_all_light",
)
def total_reflection() -> Found:
    corners = np.array([(-0.5, 0.2), (0.5, 0.2), (0.5, 1.2)])
    points = np.array([(x, y, z) for y in (-0.5, 0.5) for x, z in corners])
    triangles = np.array([(0, 1, 2), (3, 5, 4), (0, 3, 1), (1, 3, 4), (1, 4, 2), (2, 4, 5), (2, 5, 0), (0, 5, 3)])
    a, b, c = points[triangles].transpose(1, 0, 2)
    inward = (((a + b + c) / 3 - points.mean(axis=0)) * np.cross(b - a, c - a)).sum(axis=1) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([(0, 1.0, 0), (0, 0, 1.0), (1.0, 0, 0)], axis=1)
    sun = replace(lamp((0, 0, 0), power=1.0, kind="SUN"), matrix=matrix, angle=0.0)
    scene = staged(floor(), ("Prism", points, triangles, None, None, 1), materials=(GREY, glass()), lights=[sun])
    atlas, image = image_of(scene, [sun])
    value = abs(atlas.energy(sun).landed / (1 - 0.04) ** 2 - 1)
    return Found(value, Images({"the floor below the prism, sun from the side": image}, "W/m²", high=1.0))


@entry(
    "Caustics",
    "parallel plates",
    """Light leaves a window as it came, a little aside: there is nothing to focus, and the sum of all reflections between
    its faces has a closed form.""",
    "deviation of the light below a slab from Fresnel's and Snell's laws, all of a ring of 1.1 m",
    0.01,
    "core/test_caustic_forms.py::test_a_parallel_plate_only_reflects_and_shifts",
)
def plate() -> Found:
    height, top, thick, index = 2.0, 1.2, 0.2, 1.5
    light = lamp((0, 0, height))
    slab = ("Plate", *box((-6, -6, top - thick), (6, 6, top))[:2], None, None, 1)
    _, image = image_of(staged(floor(), slab, materials=(GREY, glass(index)), lights=[light]), [light])
    theta = (np.arange(100_000) + 0.5) / 100_000 * 0.9
    lost, inner = fresnel_of(np.cos(theta), index)
    landed = (height - thick) * np.tan(theta) + thick * np.sqrt(1 - inner**2) / inner
    # all even numbers of reflections inside
    power = 100 / (4 * np.pi) * 2 * np.pi * np.sin(theta) * (1 - lost) ** 2 / (1 - lost**2) * (theta[1] - theta[0])
    edges = np.linspace(0.2, 0.9, 8)
    expected = np.histogram(landed, edges, weights=power)[0]
    place, _ = floor_places(SIDE)
    texel = (2 / 0.9 / SIDE) ** 2
    found = np.histogram(np.hypot(*place.transpose(2, 0, 1)), edges, weights=image * texel)[0]
    ring = np.pi * np.diff(edges**2)
    middle = (edges[1:] + edges[:-1]) / 2
    curves = {"Fresnel and Snell": (middle, expected / ring), "photons": (middle, found / ring)}
    value = abs(found.sum() / expected.sum() - 1)
    return Found(value, Curves(curves, "m from below the lamp", "W/m²"))


def fresnel_of(cosine, index):
    """Part that a face reflects, and the cosine inside (Fresnel, Snell)."""
    inner = np.sqrt(1 - (1 - cosine**2) / index**2)
    along = (index * cosine - inner) / (index * cosine + inner)
    across = (cosine - index * inner) / (cosine + index * inner)
    return (along**2 + across**2) / 2, inner


@entry(
    "Caustics",
    "an object outside the lamp's view",
    """Photons start only towards what the lamp sees: a ball behind a wall, outside of a spot's cone or behind an area lamp
    costs nothing and makes no light.""",
    "most light of a ball outside a spot's cone, W/m²",
    0,
    "core/test_caustics.py::test_what_a_lamp_cannot_see_makes_no_caustics",
)
def out_of_view() -> Found:
    scene = staged(floor(), ball((0.5, 0, 0.4), 0.2, 32), materials=(GREY, glass()))
    narrow, wide = (lamp((-0.6, 0, 2), kind="SPOT", spot_angle=angle) for angle in (0.4, 2.0))
    images = {name: image_of(scene, [light])[1] for name, light in (("in the cone", wide), ("outside", narrow))}
    high = float(np.quantile(images["in the cone"], 0.99))
    return Found(float(images["outside"].max()), Images(images, "W/m²", high=high))


@entry(
    "Caustics",
    "energy: what leaves equals what arrives",
    """Every photon's power is accounted for: landed, absorbed, escaped, or below what is worth tracing.""",
    "deviation of all parts from what was emitted, a ball of glass beside a mirror",
    0.005,
    "core/test_caustics.py::test_it_is_what_single_photons_say core/test_caustic_failures.py::test_many_casters_share_the_photons",
)
def energy() -> Found:
    light = lamp((-0.5, 0.1, 1.6))
    mirror = panel((0.7, -0.6, 0.02), (0, 0, 0.9), (0, 1.2, 0), material=2)
    half = replace(GREY, optics=replace(glass().optics, glass=(0, 0, 0), mirror=(0.6,) * 3, mirror_edge=(0.6,) * 3))
    scene = staged(floor(), ball((0.1, 0, 0.5), 0.35, 64), mirror, materials=(GREY, glass(), half), lights=[light])
    atlas, image = image_of(scene, [light])
    parts = atlas.energy(light)
    names = ("landed", "absorbed", "escaped", "missed", "untraced")
    detail = ", ".join(f"{name} {getattr(parts, name) / parts.emitted:.3f}" for name in names)
    high = float(np.quantile(image, 0.998))
    return Found(abs(closed(parts) - 1), Images({"a ball of glass beside a mirror": image}, "W/m²", high=high), detail)
