"""Warps against their densities by χ²; sequences and hashes against the uniform distribution."""

import numpy as np
import pytest
from lightpanes.core import sampling

COUNT = 200_000


def chi_square_bound(cells):
    """A χ² value that a right sampler passes with odds of about one in 10⁵ (Wilson-Hilferty)."""
    k = cells - 1
    return k * (1 - 2 / (9 * k) + 4.3 * np.sqrt(2 / (9 * k))) ** 3


def chi_square(coordinates, density, limits, cells=(12, 24), detail=16):
    """χ² of points in a 2D chart against a density given per chart area, integrated by midpoints."""
    edges = [np.linspace(low, high, n + 1) for (low, high), n in zip(limits, cells, strict=True)]
    found, _, _ = np.histogram2d(*coordinates.T, bins=edges)
    fine = [np.linspace(low, high, n * detail + 1) for (low, high), n in zip(limits, cells, strict=True)]
    mid = [(e[1:] + e[:-1]) / 2 for e in fine]
    a, b = np.meshgrid(*mid, indexing="ij")
    value = density(a.ravel(), b.ravel()).reshape(a.shape) * (fine[0][1] - fine[0][0]) * (fine[1][1] - fine[1][0])
    expected = value.reshape(cells[0], detail, cells[1], detail).sum((1, 3)) * len(coordinates)
    assert abs(expected.sum() / len(coordinates) - 1) < 2e-3, "the density does not integrate to one"
    large = expected > 20
    rest, rest_found = expected[~large].sum(), found[~large].sum()
    statistic = ((found - expected)[large] ** 2 / expected[large]).sum()
    if rest > 20:
        statistic += (rest_found - rest) ** 2 / rest
    else:
        assert rest_found < rest + 40
    return statistic, chi_square_bound(large.sum() + 1)


def random_points(seed=1):
    index = np.arange(COUNT)
    return np.stack([sampling.hash_uniform(index, d, seed) for d in (0, 1)], axis=1)


def chart(directions):
    """z and azimuth: equal areas on the sphere."""
    return np.stack([directions[:, 2], np.arctan2(directions[:, 1], directions[:, 0])], axis=1)


def from_chart(z, azimuth):
    radius = np.sqrt(np.maximum(1 - z * z, 0))
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)


@pytest.mark.parametrize(
    "warp, pdf, low",
    [
        (sampling.cosine_hemisphere, sampling.cosine_hemisphere_pdf, 0.0),
        (sampling.uniform_sphere, sampling.uniform_sphere_pdf, -1.0),
        (lambda u: sampling.uniform_cone(u, 0.7), lambda d: sampling.uniform_cone_pdf(d, 0.7), 0.7),
    ],
    ids=["cosine hemisphere", "sphere", "cone"],
)
def test_direction_warps_follow_their_density(warp, pdf, low):
    directions = warp(random_points())
    assert np.abs(np.linalg.norm(directions, axis=1) - 1).max() < 1e-5
    limits = ((low, 1.0 + 1e-6), (-np.pi, np.pi))
    statistic, bound = chi_square(chart(directions), lambda z, a: pdf(from_chart(np.minimum(z, 1), a)), limits)
    assert statistic < bound


@pytest.mark.parametrize(
    "warp, pdf, limits",
    [
        (sampling.concentric_disk, sampling.concentric_disk_pdf, ((-1, 1), (-1, 1))),
        (sampling.uniform_triangle, sampling.uniform_triangle_pdf, ((0, 1), (0, 1))),
    ],
    ids=["disk", "triangle"],
)
def test_plane_warps_follow_their_density(warp, pdf, limits):
    points = warp(random_points())
    assert (pdf(points * 0.999999) > 0).all()
    # border cells are cut by a curve or diagonal, whose area midpoints know to a few parts in a thousand only
    statistic, bound = chi_square(points, lambda a, b: pdf(np.stack([a, b], 1)), limits, (16, 16), 128)
    assert statistic < bound


def test_narrow_cone_keeps_its_digits():
    cosine = np.cos(1e-3)
    directions = sampling.uniform_cone(random_points(), cosine)
    assert np.hypot(directions[:, 0], directions[:, 1]).max() == pytest.approx(np.sin(1e-3), rel=1e-3)
    assert np.hypot(directions[:, 0], directions[:, 1]).mean() == pytest.approx(2e-3 / 3, rel=1e-2)


@pytest.mark.parametrize("seed", [0, 1, 2**40 + 3])
def test_hash_is_uniform_and_its_streams_are_independent(seed):
    index = np.arange(COUNT)
    value = np.stack([sampling.hash_uniform(index, d, seed) for d in range(3)], axis=1)
    assert value.dtype == np.float32 and value.min() >= 0 and value.max() < 1
    for a, b in ((0, 1), (1, 2)):
        statistic, bound = chi_square(value[:, [a, b]], lambda x, y: np.ones_like(x), ((0, 1), (0, 1)), (16, 16))
        assert statistic < bound
    neighbours = np.stack([value[:-1, 0], value[1:, 0]], axis=1)
    statistic, bound = chi_square(neighbours, lambda x, y: np.ones_like(x), ((0, 1), (0, 1)), (16, 16))
    assert statistic < bound
    other = sampling.hash_uniform(index, 0, seed + 1)
    assert abs(np.corrcoef(value[:, 0], other)[0, 1]) < 0.01


def test_hash_changes_half_the_bits_and_sees_all_of_64():
    index = np.arange(4096, dtype=np.uint64)
    base = sampling.hash_uint32(index)
    for bit in (0, 7, 31, 32, 50):
        change = base ^ sampling.hash_uint32(index ^ np.uint64(1 << bit))
        ones = np.unpackbits(change.view(np.uint8)).sum() / len(index)
        assert ones == pytest.approx(16, abs=0.4)


def test_hash_does_not_depend_on_integer_type():
    index = np.arange(1000)
    for kind in (np.int32, np.uint32, np.int64, np.uint64):
        assert np.array_equal(sampling.hash_uint32(index.astype(kind), 3, 4), sampling.hash_uint32(index, 3, 4))


@pytest.mark.parametrize("points", [sampling.r2_points, sampling.hammersley_points])
def test_sequences_beat_random_points(points):
    def error(u):
        return abs(np.mean(np.exp(-u[:, 0]) * u[:, 1] ** 2) - (1 - np.exp(-1)) / 3)

    even = np.mean([error(points(256, seed)) for seed in range(20)])
    random = np.mean([error(random_points(seed)[:256]) for seed in range(20)])
    assert even < random / 5
    u = points(256, 5)
    assert u.shape == (256, 2) and u.dtype == np.float32 and u.min() >= 0 and u.max() < 1
    assert np.array_equal(u, points(256, 5)) and not np.array_equal(u, points(256, 6))


def test_r2_is_progressive_and_hammersley_stratified():
    assert np.array_equal(sampling.r2_points(100, 3)[40:], sampling.r2_points(60, 3, start=40))
    column = np.sort(sampling.hammersley_points(64, 9)[:, 0])
    assert np.array_equal(np.floor(column * 64), np.arange(64))


def test_frames_are_orthonormal_and_right_handed():
    normals = sampling.uniform_sphere(random_points()[:5000])
    normals = np.vstack([normals, np.eye(3), -np.eye(3), [[1e-7, 0, -1]]]).astype(np.float32)
    tangent, bitangent = sampling.frame(normals)
    basis = np.stack([tangent, bitangent, normals], axis=1)
    assert np.abs(basis @ basis.transpose(0, 2, 1) - np.eye(3)).max() < 1e-5
    assert np.abs(np.cross(tangent, bitangent) - normals).max() < 1e-5
