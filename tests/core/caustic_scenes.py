"""Scenes with mirrors and glass, made in code: receivers with a place in the atlas, casters without one."""

from __future__ import annotations

import numpy as np
from lightpanes.core.scene import Material, Optics, Scene, SceneObject

from .shapes import GREY, globe, quad

WHITE = (1.0, 1.0, 1.0)
BLACK = (0.0, 0.0, 0.0)
MIRROR = Material("Mirror", BLACK, optics=Optics(mirror=WHITE, mirror_edge=WHITE))


def glass(ior: float = 1.5, **more) -> Material:
    """Clear glass."""
    return Material("Glass", BLACK, transmission=WHITE, optics=Optics(glass=WHITE, gloss=WHITE, ior=ior, **more))


def staged(*parts, materials=(GREY, MIRROR), lights=()) -> Scene:
    """Scene of objects (name, positions, triangles, atlas_uv or None, normals (V, 3) or None for flat, material)."""
    points, triangles, uvs, normals, material, owner, count = [], [], [], [], [], [], 0
    for k, (_, p, t, uv, n, m) in enumerate(parts):
        p, t = np.asarray(p, float), np.asarray(t)
        points.append(p)
        triangles.append(t + count)
        count += len(p)
        uvs.append(np.full((len(t), 3, 2), np.nan) if uv is None else uv)
        if n is None:
            cross = np.cross(p[t[:, 1]] - p[t[:, 0]], p[t[:, 2]] - p[t[:, 0]])
            cross /= np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-30)
            normals.append(np.repeat(cross[:, None], 3, axis=1))
        else:
            normals.append(np.asarray(n)[t])
        material.append(np.full(len(t), m))
        owner.append(np.full(len(t), k))
    return Scene(
        np.concatenate(points),
        np.concatenate(triangles),
        corner_normals=np.concatenate(normals),
        atlas_uv=np.concatenate(uvs),
        triangle_material=np.concatenate(material),
        triangle_object=np.concatenate(owner),
        materials=materials,
        objects=[SceneObject(part[0]) for part in parts],
        lights=lights,
    )


def floor(side: float = 2.0, height: float = 0.0, material: int = 0):
    """A square floor around the origin, which fills all of the atlas but a margin."""
    p, t, uv = quad((-side / 2, -side / 2, height), (side, 0, 0), (0, side, 0))
    return "Floor", p, t, uv, None, material


def ball(middle, radius: float, rings: int = 96, material: int = 1, name: str = "Ball"):
    """A smooth sphere."""
    p, t, _ = globe(rings, 1.0, inward=False)
    return name, p * radius + np.asarray(middle), t, None, p, material


def panel(corner, along, across, material: int = 1, name: str = "Panel"):
    """A flat sheet that faces along × across."""
    p, t, _ = quad(corner, along, across)
    return name, p, t, None, None, material


def floor_places(resolution: int, side: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """(resolution, resolution, 2) x and y, m, of the middles of the texels of `floor`, and which lie on it."""
    at = (np.arange(resolution) + 0.5) / resolution
    x, y = np.meshgrid(at, at)
    place = (np.stack([x, y], -1) - 0.05) / 0.9
    return (place - 0.5) * side, ((place > 0) & (place < 1)).all(axis=-1)


def lens(radius: float, aperture: float, edge: float, height: float, turns: int = 192, pieces: int = 64):
    """A plano-convex lens about the z axis, its flat side down at `height`."""
    turn = np.linspace(np.arcsin(aperture / radius), 0, pieces)
    arc = np.stack([radius * np.sin(turn), radius * np.cos(turn)], 1)
    arc[:, 1] += height + edge - arc[0, 1]
    flat = [(1e-7, height), (aperture, height)]
    return lathe(np.concatenate([flat, arc[:-1], [(1e-7, arc[-1, 1])]]), turns, "Lens")


def band(radius: float, tall: float, turns: int = 512, material: int = 1):
    """The inside of a cylinder that stands on z = 0: a sheet."""
    return lathe([(radius, 0.0), (radius, tall)], turns, "Band", material)


def lathe(profile, turns: int, name: str, material: int = 1, smooth: float = 0.7):
    """A surface of revolution about z: `profile` (n, 2) radius and height, anticlockwise seen from outside, closed if its
    ends meet. Edges of the profile that turn by more than `smooth` rad stay hard."""
    profile = np.asarray(profile, float)
    angle = np.linspace(0, 2 * np.pi, turns, endpoint=False)
    step = np.diff(profile, axis=0)
    across = np.stack([step[:, 1], -step[:, 0]], 1)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
    wraps = np.allclose(profile[0], profile[-1])
    points, triangles, normals, count = [], [], [], 0
    for k in range(len(step)):
        for end, beside in ((k, k - 1), (k + 1, k + 1)):
            normal = across[k]
            if 0 <= beside < len(step) or wraps:
                other = across[beside % len(step)]
                if other @ normal > np.cos(smooth):
                    normal = (normal + other) / np.linalg.norm(normal + other)
            (radius, height), (out, up) = profile[end], normal
            points.append(np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle + height], 1))
            normals.append(np.stack([out * np.cos(angle), out * np.sin(angle), 0 * angle + up], 1))
        low, high = count + np.arange(turns), count + turns + np.arange(turns)
        triangles.append(np.stack([low, np.roll(low, -1), np.roll(high, -1)], 1))
        triangles.append(np.stack([low, np.roll(high, -1), high], 1))
        count += 2 * turns
    return name, np.concatenate(points), np.concatenate(triangles), None, np.concatenate(normals), material


def within(mask, margin: int = 2):
    """Texels of a mask that are more than `margin` from its border."""
    for axis in (0, 1):
        for step in range(-margin, margin + 1):
            mask = mask & np.roll(mask, step, axis)
    return mask


def closed(energy) -> float:
    """What all parts of the light sum up to, over what was emitted."""
    parts = energy.landed + energy.absorbed + energy.escaped + energy.missed + energy.untraced
    return parts / energy.emitted
