"""Photons followed through mirrors and glass until they land.

At every surface that both reflects and refracts the light splits in two, and so it does at one that scatters a part of
it and lets the rest on. A *family* of paths says which part is followed: bit i of its number is set where the i-th split
on the way reflects or scatters. 0 goes on everywhere, 1 is the outer reflection, 2 is reflected once inside, and so on.
All families together are all light, and no path is in two of them.

What a caster lets straight on beside its lobes (`Optics.clear`) shadow rays carry up to the first of them; photons don't.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..optics import fresnel, schlick
from ..threads import in_threads
from ..vectors import dot
from .bending import onward
from .surfaces import BENDS, LANDS, PASSES, Surfaces

CHUNK = 16_384
"""Photons that are followed together."""

BOUNCES = 16
"""Surfaces that a photon meets at most; what it still carries then is told as untraced."""

SPLITS = 8
"""Splits whose other part can be told apart; a later one's counts for the last."""

OPAQUE = 1e-3
"""Part of the light that a surface must let on to count as see-through, and scatter to count as more than a pane."""

LEAST = 1e-6
"""Part of its power below which a photon is dropped, and told as untraced."""

_F = np.float32


@dataclass
class Landed:
    """Where photons of unit power ended.

    triangle: (n,) int32, −1 where none landed. u, v: (n,) float32 barycentric place on it. back: (n,) bool, landed on
    the reverse. carried: (c, n) float32 part of the power that landed. path: (n,) int64 what happened on the way, 0 where
    the caster was missed. absorbed, escaped: (n,) float32 parts of the power, mean of the channels, after the family's
    own way began. left: (SPLITS, n) float32 what other families take at each split; lost: (n,) what was not followed to
    its end. past: (n,) float32 what never met a caster's lobes, of photons that met one: it went straight on there, or
    was stopped before. twice: (n,) float32 part of what is carried that the surface lets on as well: it shines there as
    on any other, its albedo is smaller.
    """

    triangle: np.ndarray
    u: np.ndarray
    v: np.ndarray
    back: np.ndarray
    carried: np.ndarray
    path: np.ndarray
    absorbed: np.ndarray
    escaped: np.ndarray
    lost: np.ndarray
    left: np.ndarray
    past: np.ndarray
    twice: np.ndarray


def trace(
    surfaces: Surfaces,
    origins: np.ndarray,
    directions: np.ndarray,
    first: np.ndarray,
    family: np.ndarray,
    threads: int | None = None,
    bounces: int = BOUNCES,
) -> Landed:
    """Follow photons. origins, directions: (3, n) float32, m and unit. first: (n,) int32 object that each must meet
    before any other surface. family: (n,) int64."""
    count = origins.shape[1]
    pieces = [slice(s, min(s + CHUNK, count)) for s in range(0, max(count, 1), CHUNK)]
    parts = in_threads(
        lambda p: _follow(surfaces, origins[:, p], directions[:, p], first[p], family[p], bounces), pieces, threads
    )
    if len(parts) == 1:
        return parts[0]
    return Landed(*(np.concatenate([getattr(p, name) for p in parts], axis=-1) for name in Landed.__dataclass_fields__))


def _follow(s: Surfaces, o, d, first, family, bounces) -> Landed:
    n = len(first)
    c = s.channels
    result = Landed(
        triangle=np.full(n, -1, np.int32), u=np.zeros(n, np.float32), v=np.zeros(n, np.float32), back=np.zeros(n, bool),
        carried=np.zeros((c, n), np.float32), path=np.zeros(n, np.int64), absorbed=np.zeros(n, np.float32),
        escaped=np.zeros(n, np.float32), lost=np.zeros(n, np.float32), left=np.zeros((SPLITS, n), np.float32),
        past=np.zeros(n, np.float32), twice=np.zeros(n, np.float32),
    )  # fmt: skip
    # events count from the split on at which the family leaves the one that it branches off from
    highest = np.frexp(family.astype(np.float64))[1]
    rows = np.arange(n)
    power = np.ones((c, n), np.float32)
    mask, splits, path = np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64)
    met = np.zeros(n, bool)
    for _ in range(bounces):
        if not len(rows):
            break
        hits = s.bvh.hits(np.ascontiguousarray(o.T), np.ascontiguousarray(d.T))
        tri = hits.triangle
        kind = np.where(tri >= 0, s.kind[tri], LANDS)
        gone = tri < 0
        ahead = ~met & ~gone & s.ghost[tri]
        kind[ahead] = PASSES
        if s.clears and not met.all():
            # on the way to the object that is meant, others let on what they let shadow rays
            kind[~met & (kind == BENDS) & (s.object[tri] != first[rows]) & s.transmission.see_through[tri]] = PASSES
        through = None
        passing = np.flatnonzero(~gone & (kind == PASSES))
        if len(passing):
            through, parted, splits = _share(
                s, result, rows, passing, hits, ahead, met, power, kind, splits, family, highest
            )
        own = splits >= highest[rows]
        if gone.any():
            out = gone & met & own
            result.escaped[rows[out]] += power[:, out].mean(axis=0)
        lands = ~gone & (kind == LANDS) & met & own
        at = rows[lands]
        result.triangle[at], result.u[at], result.v[at] = tri[lands], hits.u[lands], hits.v[lands]
        result.back[at] = dot(d[:, lands], s.flat[tri[lands]].T) > 0
        lit, distance = power[:, lands], hits.distance[lands]
        inner = s.inside(mask[lands])
        if inner.any():
            lit = _dimmed(s, result, at, lit, inner, distance, True)
        result.carried[:, at] = lit
        if through is not None:
            result.twice[at] = (lit * through[:, lands]).mean(axis=0)
        stays = ~gone & (kind != LANDS)
        if not met.all():
            stays &= met | (kind == PASSES) | (s.object[tri] == first[rows])
        # one that lands though it should have split further belongs to another family
        result.path[rows[met & ~stays]] = path[met & ~stays]
        keep = np.flatnonzero(stays)
        if not len(keep):
            rows = rows[keep]
            break
        rows, tri, kind, u, v, distance = (
            rows[keep],
            tri[keep],
            kind[keep],
            hits.u[keep],
            hits.v[keep],
            hits.distance[keep],
        )
        o, d, power = (a.take(keep, axis=1) for a in (o, d, power))
        mask, splits, path, met, ahead = mask[keep], splits[keep], path[keep], met[keep], ahead[keep]
        bends = np.flatnonzero(kind == BENDS)
        passing = np.flatnonzero(kind == PASSES)
        if len(passing):
            o, power, path = _pass(
                s, result, rows, o, d, power, mask, path, met, tri, distance, passing, splits >= highest[rows],
                through[:, keep[passing]], parted[keep[passing]],
            )  # fmt: skip
        if len(bends) == len(rows):
            o, d, power, mask, splits, path = _bend(
                s, result, rows, d, power, mask, splits, path, met, tri, u, v, distance, family, highest
            )
            met = np.ones(len(rows), bool)
        elif len(bends):
            some = _bend(
                s, result, rows[bends], d[:, bends], power[:, bends], mask[bends], splits[bends], path[bends], met[bends],
                tri[bends], u[bends], v[bends], distance[bends], family, highest,
            )  # fmt: skip
            o[:, bends], d[:, bends], power[:, bends] = some[:3]
            mask[bends], splits[bends], path[bends] = some[3:]
            met[bends] = True
        weak = power.max(axis=0) < LEAST
        if weak.any():
            dropped = weak & met & (splits >= highest[rows])
            result.lost[rows[dropped]] += power[:, dropped].mean(axis=0)
            result.path[rows[weak]] = path[weak]
            rows, o, d, power = rows[~weak], o[:, ~weak], d[:, ~weak], power[:, ~weak]
            mask, splits, path, met = mask[~weak], splits[~weak], path[~weak], met[~weak]
    own = met & (splits >= highest[rows]) if len(rows) else np.zeros(0, bool)
    result.lost[rows[own]] += power[:, own].mean(axis=0)
    if len(rows):
        result.path[rows[met]] = path[met]
    return result


def _dimmed(s, result, at, power, inner, distance, own):
    """Beer and Lambert: what is left of power (c, n) after `distance` in media `inner` (n,)."""
    passed = power * np.exp(-s.absorption[:, inner] * distance)
    result.absorbed[at] += np.where(own, (power - passed).mean(axis=0), 0)
    return passed


def _share(s, result, rows, passing, hits, ahead, met, power, kind, splits, family, highest):
    """What see-through surfaces let on at hits `passing`: (c, n) float32, 0 elsewhere; (n,) bool, where the family leaves
    to others what is scattered; and the splits so far. Where it is to land, `kind` says so."""
    parted = np.zeros(len(rows), bool)
    through = np.zeros(power.shape, np.float32)
    triangle = hits.triangle[passing]
    part = s.through(triangle, hits.u[passing], hits.v[passing])
    part[:, ahead[passing]] = 1
    through[:, passing] = part
    most = part.max(axis=0)
    # of a map, most of which may be opaque
    kind[passing[most <= OPAQUE]] = LANDS
    split = passing[(most > OPAQUE) & (most < 1 - OPAQUE) & met[passing] & s.scatters[triangle]]
    if not len(split):
        return through, parted, splits
    splits = splits.copy()
    wanted = (family[rows[split]] >> np.minimum(splits[split], 62)) & 1 == 1
    kind[split[wanted]] = LANDS
    on = split[~wanted]
    parted[on] = True
    rest = np.where(splits[on] >= highest[rows[on]], (power[:, on] * (1 - through[:, on])).mean(axis=0), 0)
    result.left[np.minimum(splits[on], SPLITS - 1), rows[on]] += rest
    splits[split] += 1
    return through, parted, splits


def _pass(s, result, rows, o, d, power, mask, path, met, tri, distance, some, own, through, parted):
    """Straight on through see-through surfaces, which let on `through`, (c, k)."""
    lit = power[:, some]
    inner = s.inside(mask[some])
    if inner.any():
        lit = _dimmed(s, result, rows[some], lit, inner, distance[some], own[some] & met[some])
    passed = lit * through
    stopped = np.where(own[some] & ~parted, (lit - passed).mean(axis=0), 0)
    result.absorbed[rows[some]] += np.where(met[some], stopped, 0)
    result.past[rows[some]] += np.where(met[some], 0, stopped)
    o, power, path = o.copy(), power.copy(), path.copy()
    power[:, some] = passed
    o[:, some] += d[:, some] * (distance[some] + s.offset)
    path[some] = path[some] * 1000003 + s.object[tri[some]] + 7
    return o, power, path


def _bend(s, result, rows, d, power, mask, splits, path, met, tri, u, v, distance, family, highest):
    """One event on smooth surfaces: the new origins, directions, powers, media, splits and paths."""
    mirror, edge, glass, gloss = s.optics(tri)
    at = s.crossing(tri, u, v, d, mask, glass.max(axis=0) > 0)
    own = splits >= highest[rows]
    if at.before.any() and s.absorption.any():
        power = _dimmed(s, result, rows, power, at.before, distance, own)
    reflected, inner = fresnel(at.cosine, at.relative)
    back = schlick(mirror, edge, at.cosine) + gloss * reflected
    # an index that is equal on both sides is no surface, though a tint stays
    through = glass * (1 - reflected)
    straight = np.zeros(len(rows), bool)
    aside = _F(0)
    if s.clears:
        clear = s.through(tri, u, v)
        # photons that met a caster go on through windows; beside glass that is a third way, which nobody follows
        straight = met & (glass.max(axis=0) <= 0) & (clear.max(axis=0) > 0)
        through = np.where(straight, clear, through)
        aside = np.where(straight, _F(0), clear)
        told = np.where(own, (power * aside).mean(axis=0), 0)
        result.past[rows] += np.where(met, 0, told)
        result.lost[rows] += np.where(met, told, 0)
    some_back, some_through = back.max(axis=0) > 1e-7, through.max(axis=0) > 1e-7
    split = some_back & some_through
    wanted = (family[rows] >> np.minimum(splits, 62)) & 1
    mirrors = np.where(split, wanted == 1, ~some_through)
    weight = np.where(mirrors, back, through)
    other = np.where(split, np.where(mirrors, through, back), _F(0))
    # what the other part carries is another family's, which counts it if this one's own way had begun
    taken = np.where(split & own & ~mirrors, (power * other).mean(axis=0), 0)
    slot = np.minimum(splits, SPLITS - 1)
    result.left[slot, rows] += taken
    splits_after = splits + split
    absorbed = (power * (1 - weight - other - aside)).mean(axis=0)
    result.absorbed[rows] += np.where(own, np.maximum(absorbed, 0), 0)
    power = power * weight
    ahead = onward(d, at, inner, mirrors, straight)
    mask = np.where(mirrors | straight, mask, np.where(at.enters, at.within, at.without))
    place = at.place + at.flat * np.where(mirrors, s.offset, -s.offset)
    event = np.where(mirrors, np.where(split, 0, 1), 2)
    path = path * 1000003 + s.group[tri] * 4 + event + 11
    return place, ahead, power, mask, splits_after, path
