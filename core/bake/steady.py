"""The light that a bake holds as it is: the sky's, emissive faces' and that of lamps that are not live."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..caustics import CausticAtlas
from ..lights import irradiance, sky_radiance
from ..panes.caustic_light import CausticLight
from ..panes.entry_light import EntryLight, EntrySurface
from ..rays import Tracer
from ..scene import Light, Scene, Sky
from ..surface import Patches, sample_triangles
from ..transfer import Entries, Transport
from ..transfer.entries import PLACES
from .photons import trace_lamps

SKY_BINS = (32, 64)
"""Bins of a sky that is not uniform: rows of equal solid angle, columns."""

QUARTERS = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4], [2, 2, 2]], np.float32) / 6
"""Barycentric middles of a triangle's quarters."""


def sky_bins(sky: Sky | None) -> tuple[int, int]:
    """Rows and columns of bins that the sky needs."""
    return (1, 1) if sky is None or sky.radiance.shape[:2] == (1, 1) else SKY_BINS


def static_lamps(scene: Scene) -> list[Light]:
    """Lamps that are not live."""
    return [light for light in scene.lights if not light.live]


def static_light(scene: Scene, surface: EntrySurface, tracer: Tracer, seed: int) -> np.ndarray | None:
    """(n, 3) float32 direct irradiance of the entries, W/m², by lamps that are not live; None where all are.

    Computed once, so all places of all entries see the lamps.
    """
    lamps = static_lamps(scene)
    if not lamps:
        return None
    eyes = EntryLight(surface, tracer, seed, few=PLACES)
    return sum(_coloured(eyes.unit(light), light) for light in lamps)


def static_caustics(
    scene: Scene,
    surface: EntrySurface,
    resolution: int,
    tracer: Tracer,
    seed: int,
    photons: int,
    tell: Callable[[float], object],
    seconds: float,
) -> np.ndarray:
    """(n, 3) float32 irradiance of the entries, W/m², by what mirrors and glass make of the light of lamps that are not
    live. photons, tell, seconds: as in `trace_lamps`."""
    atlas = CausticAtlas(scene, resolution, seed=seed)
    lamps = static_lamps(scene)
    trace_lamps(atlas, lamps, photons, tell, seconds)
    focused = CausticLight(surface, atlas.landings, tracer.offset)
    return sum(_coloured(focused.unit(light), light) for light in lamps)


def piece_excess(
    scene: Scene, patches: Patches, entries: Entries, owner: np.ndarray, static: np.ndarray, tracer: Tracer, seed: int
) -> np.ndarray:
    """(sides, 3) float32 W/m²: by how much more than its entry each side of each piece reflects of the light of lamps
    that are not live.

    owner: (sides,) as from `make_piece_gatherer`. static: (n, 3) from `static_light`. A piece is a fraction of its
    entry, so light that changes over the entry, near a lamp or at a shadow's edge, leaves from where it falls.
    """
    sides = np.flatnonzero(owner < len(entries))
    own = owner[sides]
    direct = np.zeros((len(sides), 3), np.float32)
    for quarter in QUARTERS:
        weights = np.einsum("k,nkc->nc", quarter, patches.weights[sides // 2])
        samples = sample_triangles(scene, patches.parent[sides // 2], weights)
        samples = samples.on_side(scene, entries.back[own])
        position = samples.position + samples.flat * np.float32(tracer.offset)
        for light in static_lamps(scene):
            direct += _coloured(irradiance(light, position, samples.normal, tracer.visibility, 1, seed), light)
    result = np.zeros((len(owner), 3), np.float32)
    result[sides] = entries.albedo[own] * (direct / len(QUARTERS) - static[own])
    return result


def _coloured(unit, light):
    """(n, 3) float32 irradiance of a lamp from that at unit power, (n,) or (n, 3)."""
    return (unit if unit.ndim == 2 else unit[:, None]) * light.power.astype(np.float32)


def steady_light(
    sky: Sky | None, bins: tuple[int, int], entries: Entries, transport: Transport, static: np.ndarray | None
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Light that no live lamp changes: radiosity beyond what is emitted (n, 3) float32, W/m², and what the sky and
    emissive faces themselves shine (ids, 3), π · radiance; None where there is none.

    static: (n, 3) irradiance of the lamps that are not live, or None.
    """
    emitted = entries.radiosity
    shines = (sky is not None and not sky.is_black) or bool(emitted.any())
    if not shines and static is None:
        return None, None
    count = len(entries)
    from_sky = np.zeros((bins[0] * bins[1], 3), np.float32)
    if sky is not None:
        from_sky = np.float32(np.pi) * _bin_radiance(sky, bins)
    arrives = transport.from_sky(from_sky)
    if static is not None:
        arrives = arrives + static
    source = emitted + entries.albedo * arrives
    radiosity = np.stack(
        [transport.solve(entries.albedo[:, c : c + 1], source[:, c : c + 1])[:, 0] for c in range(3)], 1
    )
    if not shines:
        return radiosity - emitted, None
    shine = np.zeros((count + 1 + len(from_sky), 3), np.float32)
    shine[:count] = emitted
    shine[count + 1 :] = from_sky
    return radiosity - emitted, shine


def _bin_radiance(sky, bins):
    """(bins, 3) float32 mean radiance of each of the sky's bins."""
    if bins == (1, 1):
        return sky.radiance.reshape(-1, 3).mean(axis=0, keepdims=True)
    fine = 8
    rows, columns = bins
    z = (np.arange(rows * fine, dtype=np.float32) + 0.5) * np.float32(2 / (rows * fine)) - 1
    around = np.float32(2 * np.pi) * (0.5 - (np.arange(columns * fine, dtype=np.float32) + 0.5) / (columns * fine))
    z, around = np.meshgrid(z, around, indexing="ij")
    ring = np.sqrt(1 - z * z)
    directions = np.stack([ring * np.cos(around), ring * np.sin(around), z], -1).reshape(-1, 3)
    radiance = sky_radiance(sky, directions.astype(np.float32))
    return radiance.reshape(rows, fine, columns, fine, 3).mean(axis=(1, 3)).reshape(-1, 3)
