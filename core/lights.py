"""Irradiance of each lamp type at points, as Cycles has it; the sky.

Light that nothing blocks is known in closed form for every lamp but a soft box, whose integral is
a Gauss rule. So the samples of a lamp only decide which part of it a point sees:

    E = E_free · Σ w V / Σ w,

w being what each sample would bring. Where nothing is in the way the result has no noise at all,
with one sample as with many. In penumbrae the quotient is biased by O(1/samples).

Names: `rows` are the points of a chunk that the lamp may reach, m of them; arrays over lamp samples
are (S, m), sample-major, and vectors are kept as three such arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from .form_factors import cap, dot, form_factor, gauss, polygon
from .sampling import frame, hammersley_points, hash_uniform
from .scene import Light, SceneError, Sky

Visibility = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(origins (n, 3), vectors (n, 3)) → (n,) or (n, 3) float32: 1 free, 0 blocked on the way."""

CHUNK = 1 << 16
"""Lamp samples in memory at a time."""

FAR = 100.0
"""An area lamp at this many times its size is a point: error under 1e-4, where polygons lose digits."""

SOFT_BOX_ROWS = 16
"""Rows of a soft box on each side of the horizon: 0.2 % of the mean at most, 6 % where only a sliver is seen."""

ELLIPSE_EDGES = {2.0: 24, FAR: 8}
"""Edges of the polygon that stands for an ellipse, up to so many sizes away: error under 0.1 %."""

NEAREST = 1e-12
"""Least squared distance from a lamp, m². A point lamp's light grows without limit as a surface nears
it, which is right, so this guards the division only."""

SUN_REACH = 1e4
"""Length of a shadow ray towards the sun, m, to which ten times the points' extent is added."""

_F = np.float32


@dataclass
class _Lit:
    """Points that a lamp reaches, and its samples.

    rows: (m,) of the chunk. free: (m,) unoccluded irradiance for unit power, 1/m².
    reference, weight: (S, m); weight differs only by what the lamp itself blocks (a spot's cone).
    vectors: three (S, m), from the point to the lamp's sample, m.
    """

    rows: np.ndarray
    free: np.ndarray
    reference: np.ndarray
    weight: np.ndarray
    vectors: tuple[np.ndarray, np.ndarray, np.ndarray]


def irradiance(
    light: Light,
    points: np.ndarray,
    normals: np.ndarray,
    visibility: Visibility | None,
    samples: int = 1,
    seed: int = 0,
) -> np.ndarray:
    """Irradiance of a lamp of unit power; times light.power it is W/m².

    points: (n, 3) m, lifted off their surface already. normals: (n, 3) unit.
    visibility: shadow rays, called for chunks of the points that the lamp faces; None: nothing blocks.
    samples: places on the lamp for each point. They are stratified, and shifted by a hash of the
        point's index and the seed. Lamps without size take one.
    Returns (n,) float32, or (n, 3) where visibility returns three channels. Raises SceneError if
    samples is below 1.
    """
    if samples < 1:
        raise SceneError(f"Lamp '{light.name}' needs at least one sample, not {samples}.")
    points = np.ascontiguousarray(points, np.float32).reshape(-1, 3)
    normals = np.ascontiguousarray(normals, np.float32).reshape(-1, 3)
    if not light.casts_shadow:
        visibility = None
    if _is_sharp(light):
        samples = 1
    emitter = {"POINT": _ball, "SPOT": _ball, "SUN": _sun, "AREA": _panel}[light.kind]
    lattice = hammersley_points(samples, seed)
    # one length for all, so that results do not depend on the chunks
    reach = SUN_REACH + (10 * float(np.ptp(points, axis=0).max()) if len(points) else 0)
    result = np.zeros(len(points), np.float32)
    step = max(1, CHUNK // samples)
    for start in range(0, len(points), step):
        chunk = slice(start, start + step)

        def strata(rows, start=start):
            return _strata(lattice, rows + start, seed)

        for lit in emitter(light, points[chunk], normals[chunk], strata, reach):
            if not len(lit.rows):
                continue
            value = _shade(lit, points[chunk], visibility)
            if value.ndim == 2 and result.ndim == 1:
                result = np.repeat(result[:, None], 3, axis=1)
            if value.ndim == 1 and result.ndim == 2:
                value = value[:, None]
            result[lit.rows + start] = value
    return result


def _is_sharp(light: Light) -> bool:
    if light.kind == "SUN":
        return light.angle <= 0
    if light.kind == "AREA":
        return light.spread <= 0
    return light.radius <= 0


def _strata(lattice, index, seed):
    """Two (S, m) coordinates in [0, 1): the lattice, turned by a hash of each point's index."""
    u = lattice[:, 0, None] + hash_uniform(index, 101, seed)
    v = lattice[:, 1, None] + hash_uniform(index, 102, seed)
    u -= u >= 1
    v -= v >= 1
    return u, v


def _shade(lit: _Lit, points, visibility):
    """(m,) or (m, 3) irradiance of the points in `lit`."""
    scale = lit.free / np.maximum(lit.reference.sum(axis=0), _F(1e-30))
    if visibility is None:
        return scale * lit.weight.sum(axis=0)
    seen = (lit.weight > 0) & (lit.free > 0)
    cells = np.flatnonzero(seen)
    if not len(cells):
        return np.zeros(len(lit.rows), np.float32)
    row = cells % len(lit.rows)
    vectors = np.empty((len(cells), 3), np.float32)
    for axis in range(3):
        vectors[:, axis] = lit.vectors[axis].ravel()[cells]
    through = np.asarray(visibility(points[lit.rows[row]], vectors), np.float32)
    weight = lit.weight.ravel()[cells]
    if through.ndim == 1:
        part = np.zeros(lit.weight.shape, np.float32)
        part.ravel()[cells] = weight * through
        return scale * part.sum(axis=0)
    part = np.zeros((*lit.weight.shape, through.shape[1]), np.float32)
    part.reshape(-1, through.shape[1])[cells] = weight[:, None] * through
    return scale[:, None] * part.sum(axis=0)


# ---- point, spot and sun: a cap of directions, evenly bright ----


def _cap_samples(light, rows, middle, normal, cosine, sine2, distance, free, strata) -> _Lit:
    """Directions spread evenly over each point's cap; those below the horizon weigh nothing.

    middle, normal: three (m,) each. distance(z, radius): (S, m) way along a direction whose cosine
    and sine to the middle are z and radius.
    """
    u, v = strata(rows)
    depth = u * (sine2 / (1 + np.sqrt(1 - sine2)))
    radius = np.sqrt(depth * (2 - depth))
    z = 1 - depth
    angle = v * _F(2 * np.pi)
    a, b = radius * np.cos(angle), radius * np.sin(angle)
    tangent, bitangent = (t.T for t in frame(np.stack(middle, axis=1)))
    reference = z * cosine + a * dot(normal, tangent) + b * dot(normal, bitangent)
    np.maximum(reference, 0, out=reference)
    blind = np.flatnonzero(reference.max(axis=0) <= 0)
    if len(blind):
        # every sample is below the horizon and yet a sliver of the lamp is above: look at its top
        rise_a, rise_b = dot(normal, tangent)[blind], dot(normal, bitangent)[blind]
        sine = np.sqrt(sine2[blind]) / np.maximum(np.hypot(rise_a, rise_b), _F(1e-20)) * _F(0.999)
        a[0, blind], b[0, blind] = sine * rise_a, sine * rise_b
        z[0, blind] = np.sqrt(np.maximum(1 - a[0, blind] ** 2 - b[0, blind] ** 2, 0))
        radius[0, blind] = np.hypot(a[0, blind], b[0, blind])
        reference[0, blind] = 1
    way = distance(z, radius)
    direction = [z * middle[k] + a * tangent[k] + b * bitangent[k] for k in range(3)]
    weight = reference * spot_cone(light, direction) if light.kind == "SPOT" else reference
    return _Lit(rows, free, reference, weight, tuple(d * way for d in direction))


def _ball(light: Light, points, normals, strata, reach) -> Iterator[_Lit]:
    """POINT and SPOT: a sphere of even radiance, or a disk that always faces the point (soft falloff)."""
    centre = light.position.astype(np.float32)
    radius2 = _F(light.radius) ** 2
    soft = light.shape == "DISK"
    to_lamp = [centre[k] - points[:, k] for k in range(3)]
    d2 = np.maximum(dot(to_lamp, to_lamp), _F(NEAREST))
    facing = dot(to_lamp, normals.T)
    outside = np.ones(len(points), bool) if soft else d2 > radius2
    reached = outside & (facing > -light.radius)
    if light.kind == "SPOT":
        reached &= _in_cone(light, to_lamp, d2)
    rows = np.flatnonzero(reached)
    d2 = d2[rows]
    d = np.sqrt(d2)
    middle = [t[rows] / d for t in to_lamp]
    cosine = facing[rows] / d
    spread2 = d2 + radius2 if soft else d2
    sine2 = radius2 / spread2
    free = cap(cosine, sine2) / (_F(4 * np.pi) * spread2)
    if radius2 == 0:
        weight = np.ones((1, len(rows)), np.float32)
        vectors = tuple(t[None, rows] for t in to_lamp)
        aimed = spot_cone(light, [m[None] for m in middle]) if light.kind == "SPOT" else weight
        yield _Lit(rows, free, weight, aimed, vectors)
        return

    def distance(z, radius):
        if soft:
            return d / np.maximum(z, _F(1e-6))
        return d * z - np.sqrt(np.maximum(radius2 - d2 * radius * radius, 0))

    normal = normals[rows].T
    yield _cap_samples(light, rows, middle, normal, cosine, sine2, distance, free, strata)
    if not outside.all():
        yield _inside(np.flatnonzero(~outside), to_lamp, normals, radius2, strata)


def _inside(rows, to_lamp, normals, radius2, strata) -> _Lit:
    """Points within a lamp's sphere, which shines on them from everywhere; a spot has no cone here."""
    u, v = strata(rows)
    sine, angle = np.sqrt(u), v * _F(2 * np.pi)
    normal = normals[rows]
    tangent, bitangent = frame(normal)
    a, b, c = sine * np.cos(angle), sine * np.sin(angle), np.sqrt(1 - u)
    direction = [a * tangent[:, k] + b * bitangent[:, k] + c * normal[:, k] for k in range(3)]
    centre = [t[rows] for t in to_lamp]
    along = dot(direction, centre)
    way = along + np.sqrt(np.maximum(along * along + radius2 - dot(centre, centre), 0))
    weight = np.ones(u.shape, np.float32)
    free = np.full(len(rows), 1 / (4 * np.pi * radius2), np.float32)
    return _Lit(rows, free, weight, weight, tuple(d * way for d in direction))


def spot_cone(light: Light, direction):
    """Attenuation in [0, 1] of a spot along directions from points towards it.

    A lamp that is scaled unevenly has an elliptical cone: light.size holds the scale of X and Y over Z.
    """
    axes = light.matrix[:3, :3] / np.linalg.norm(light.matrix[:3, :3], axis=0)
    x, y, z = (dot(direction, axes[:, k].astype(np.float32)) for k in range(3))
    if tuple(light.size) != (1.0, 1.0):
        x, y = x / _F(light.size[0]), y / _F(light.size[1])
        z = z / np.sqrt(np.maximum(x * x + y * y + z * z, _F(1e-20)))
    edge = np.cos(light.spot_angle / 2)
    step = np.clip((z - _F(edge)) / _F(max((1 - edge) * light.spot_blend, 1e-7)), 0, 1)
    return step * step * (3 - 2 * step)


def _in_cone(light: Light, to_lamp, d2):
    """(n,) bool: whether any of a spot's light may reach a point; errs towards yes."""
    half = np.arctan(np.tan(min(light.spot_angle / 2, 1.5707)) * max(1e-6, *light.size))
    cosine = -dot(to_lamp, light.direction.astype(np.float32)) / np.sqrt(d2)
    sine = np.minimum(_F(light.radius) / np.sqrt(d2), 1)
    limit = np.minimum(half + np.arcsin(sine) + _F(1e-4), _F(np.pi))
    return cosine >= np.cos(limit)


def _sun(light: Light, points, normals, strata, reach) -> Iterator[_Lit]:
    """SUN: a disk of the sky, angle wide, that brings power on a surface facing its middle."""
    towards = -light.direction.astype(np.float32)
    half = min(light.angle, np.pi) / 2
    cosine = normals @ towards
    rows = np.flatnonzero(cosine > -np.sin(half))
    cosine = cosine[rows]
    if half <= 0:
        weight = np.ones((1, len(rows)), np.float32)
        vectors = tuple(np.full((1, len(rows)), t * reach, np.float32) for t in towards)
        yield _Lit(rows, np.maximum(cosine, 0), weight, weight, vectors)
        return
    sine2 = np.full(len(rows), np.sin(half) ** 2, np.float32)
    middle = [np.full(len(rows), t, np.float32) for t in towards]
    free = cap(cosine, sine2)
    normal = normals[rows].T
    yield _cap_samples(light, rows, middle, normal, cosine, sine2, lambda z, radius: _F(reach), free, strata)


# ---- area lamps ----


def _panel(light: Light, points, normals, strata, reach) -> Iterator[_Lit]:
    """AREA: a flat lamp that shines to one side, evenly or through a soft box's grid (spread).

    In the lamp's own frame x and y lie in it and z is the distance before it.
    """
    width, height = (_F(s) for s in light.size)
    if width <= 0 or height <= 0:
        return
    axes = light.matrix[:3, :3] / np.linalg.norm(light.matrix[:3, :3], axis=0)
    axes = axes.astype(np.float32) * np.array([1, 1, -1], np.float32)
    local = (points - light.position.astype(np.float32)) @ axes
    normal = normals @ axes
    round_ = light.shape in ("DISK", "ELLIPSE")
    rise_x, rise_y = np.abs(normal[:, 0]) * (width / 2), np.abs(normal[:, 1]) * (height / 2)
    highest = np.hypot(rise_x, rise_y) if round_ else rise_x + rise_y
    level = -dot(normal.T, local.T)
    reached = (local[:, 2] > 0) & (level + highest > 0)
    if light.spread < np.pi:
        slope = _F(np.tan(light.spread / 2))
        for k, size in ((0, width), (1, height)):
            reached &= np.abs(local[:, k]) <= size / 2 + slope * local[:, 2]
    rows = np.flatnonzero(reached)
    place, normal = local[rows].T, normal[rows].T
    if light.spread <= 0:
        yield _beam(rows, place, normal, width, height, round_, axes)
    elif light.spread < np.pi:
        yield _soft_box(light, rows, place, normal, width, height, round_, axes, strata)
    else:
        yield _lambertian(rows, place, normal, width, height, round_, axes, strata)


def _area(width, height, round_):
    return width * height * _F(np.pi / 4 if round_ else 1)


def _to_world(axes, a, b, c):
    return tuple(a * axes[k, 0] + b * axes[k, 1] + c * axes[k, 2] for k in range(3))


def _lambertian(rows, place, normal, width, height, round_, axes, strata) -> _Lit:
    """An area lamp of even radiance 1/(π · area)."""
    x, y, z = place
    area = _area(width, height, round_)
    u, v = strata(rows)
    if round_:
        radius, angle = np.sqrt(u) * _F(0.5), v * _F(2 * np.pi)
        a, b = width * radius * np.cos(angle) - x, height * radius * np.sin(angle) - y
    else:
        a, b = width * (u - _F(0.5)) - x, height * (v - _F(0.5)) - y
    reference = _brought(a, b, z, normal)
    blind = np.flatnonzero(reference.max(axis=0) <= 0)
    if len(blind):
        top = [np.sign(normal[0, blind]) * width, np.sign(normal[1, blind]) * height]
        if round_:
            top = [normal[0, blind] * width**2, normal[1, blind] * height**2]
            size = np.maximum(np.hypot(normal[0, blind] * width, normal[1, blind] * height), _F(1e-20))
            top = [t / size for t in top]
        a[0, blind], b[0, blind] = _F(0.4999) * top[0] - x[blind], _F(0.4999) * top[1] - y[blind]
        reference[0, blind] = _above(a, b, z, normal, blind)
    free = _brought(-x, -y, z, normal) / _F(np.pi)
    sizes = np.sqrt(x * x + y * y + z * z) / max(width, height)
    nearer = 0.0
    for limit, edges in (ELLIPSE_EDGES if round_ else {FAR: 4}).items():
        part = np.flatnonzero((sizes >= nearer) & (sizes < limit))
        corners = polygon(width, height, edges)
        free[part] = form_factor(corners, place[:, part], normal[:, part]) / area
        nearer = limit
    return _Lit(rows, free, reference, reference, _to_world(axes, a, b, -z))


def _above(a, b, z, normal, blind):
    """1 where the first sample is above the horizon: as in _cap_samples, it decides where no other is."""
    return normal[0, blind] * a[0, blind] + normal[1, blind] * b[0, blind] > normal[2, blind] * z[blind]


def _brought(a, b, z, normal):
    """cosθ cosθ' / d² of a place on the lamp, (a, b, −z) away from the point."""
    d2 = a * a + b * b + z * z
    return np.maximum(normal[0] * a + normal[1] * b - normal[2] * z, 0) * z / (d2 * d2)


def _beam(rows, place, normal, width, height, round_, axes) -> _Lit:
    """Spread 0: parallel light, straight out of the lamp."""
    a, b, z = 2 * place[0] / width, 2 * place[1] / height, place[2]
    inside = a * a + b * b <= 1 if round_ else np.maximum(np.abs(a), np.abs(b)) <= 1
    free = np.where(inside, np.maximum(-normal[2], 0), 0) / _area(width, height, round_)
    weight = np.ones((1, len(rows)), np.float32)
    return _Lit(rows, free.astype(np.float32), weight, weight, _to_world(axes, 0 * z[None], 0 * z[None], -z[None]))


def soft_box_norm(half: float) -> float:
    """What makes the light of a soft box of `half` its spread, rad, as much as that of one without a grid."""
    # ∫ cos (1 − tan/slope) sin over the cone, inverted; third order where digits cancel
    return 3 / half**3 if half < 0.05 else 1 / (np.tan(half) - half)


def _soft_box(light, rows, place, normal, width, height, round_, axes, strata) -> _Lit:
    """An area lamp with a spread: radiance falls as tan(spread/2) − tan(angle), to zero at spread/2.

    Only a circle of the lamp, around the point's own foot, is seen. It is walked through row by row:
    y over the part's extent, x over the chord at that y.
    """
    half = light.spread / 2
    slope = np.tan(half)
    norm = soft_box_norm(half)
    x, y, z = place
    radius = _F(slope) * z
    low, high = np.maximum(-height / 2, y - radius), np.minimum(height / 2, y + radius)
    steep = np.where(np.abs(normal[0]) < 1e-6, _F(1e-6), normal[0])

    def at(u, v, low=low, high=high):
        extent = np.maximum(high - low, 0)
        b = low + v * extent
        reach = np.sqrt(np.maximum(1 - (2 * b / height) ** 2, 0)) * (width / 2) if round_ else width / 2
        chord = np.sqrt(np.maximum(radius * radius - (b - y) ** 2, 0))
        horizon = x + (normal[2] * z - normal[1] * (b - y)) / steep
        left = np.maximum(np.maximum(-reach, x - chord), np.where(steep > 0, horizon, -np.inf))
        right = np.minimum(np.minimum(reach, x + chord), np.where(steep > 0, np.inf, horizon))
        across = np.maximum(right - left, 0)
        a, b = left + u * across - x, b - y
        grid = np.maximum(_F(slope) - np.hypot(a, b) / z, 0) * _F(norm)
        return a, b, _brought(a, b, z, normal) * grid * across * extent

    # the horizon bends the sum over rows where it passes below the point: integrate each side apart
    level = np.where(np.abs(normal[1]) < 1e-6, _F(1e-6), normal[1])
    bend = np.clip(y + normal[2] * z / level, low, np.maximum(low, high))
    free = np.zeros(len(rows), np.float32)
    across, share = gauss(8)
    for v, part in zip(*gauss(SOFT_BOX_ROWS, round_ends=True), strict=True):
        for side in ((low, bend), (bend, high)):
            free += part * (at(across[:, None], v, *side)[2] * share[:, None]).sum(axis=0)
    u, v = strata(rows)
    a, b, reference = at(u, v)
    blind = np.flatnonzero(reference.max(axis=0) <= 0)
    if len(blind):
        top = at((normal[0] > 0) * _F(0.98) + _F(0.01), (normal[1] > 0) * _F(0.98) + _F(0.01))
        a[0, blind], b[0, blind] = top[0][blind], top[1][blind]
        reference[0, blind] = _above(a, b, z, normal, blind)
    return _Lit(
        rows, free / (_F(np.pi) * _area(width, height, round_)), reference, reference, _to_world(axes, a, b, -z)
    )


# ---- sky ----


def sky_radiance(sky: Sky, directions: np.ndarray) -> np.ndarray:
    """(n, 3) float32 W/(m² sr) of the sky along (n, 3) directions of any length, bilinear."""
    height, width = sky.radiance.shape[:2]
    directions = np.asarray(directions, np.float32).reshape(-1, 3)
    if height == width == 1:
        return np.broadcast_to(sky.radiance[0], (len(directions), 3)).copy()
    x, y, z = directions.T
    column = (_F(0.5) - np.arctan2(y, x) / _F(2 * np.pi)) * width - _F(0.5)
    row = (_F(0.5) + np.arctan2(z, np.hypot(x, y)) / _F(np.pi)) * height - _F(0.5)
    row = np.clip(row, 0, height - 1)
    left, low = np.floor(column), np.floor(row)
    across, up = (column - left)[:, None], (row - low)[:, None]
    left, low = left.astype(np.int32), low.astype(np.int32)
    columns, rows = (left % width, (left + 1) % width), (low, np.minimum(low + 1, height - 1))
    below, above = (sky.radiance[r, columns[0]] * (1 - across) + sky.radiance[r, columns[1]] * across for r in rows)
    return below * (1 - up) + above * up
