"""The gather's ids against full hits, found for every ray apart, in double precision."""

import numpy as np
import pytest
from lightpanes.core.rays import Bvh, chunks
from lightpanes.core.sampling import uniform_sphere
from lightpanes.core.scene import Material, Scene
from lightpanes.core.surface import SurfaceSamples, make_patches, make_texels
from lightpanes.core.transfer import Gatherer, find_entries, make_gatherer
from lightpanes.core.transfer.entries import PLACES
from lightpanes.core.transfer.gather import sky_bin

from .shapes import box, globe, quad, room, room_parts, scene
from .test_rays import intersect
from .test_surface import barycentric

pytestmark = pytest.mark.thorough

OFFSET = 1e-4


class Recorder:
    """A Bvh that remembers the rays it was asked for."""

    def __init__(self, bvh: Bvh):
        self.bvh, self.origins, self.directions = bvh, [], []

    def closest(self, origins, directions):
        self.origins.append(np.array(origins))
        self.directions.append(np.array(directions))
        return self.bvh.closest(origins, directions)


def collect(gatherer: Gatherer, points: SurfaceSamples, rays: int, seed: int = 1, threads: int = 1) -> np.ndarray:
    """(rays, n) ids."""
    parts = {s.start: [] for s in chunks(len(points))}
    gatherer.gather(points, rays, seed, lambda piece, ids: parts[piece.start].append(ids.copy()), threads=threads)
    return np.concatenate([np.concatenate(p) for p in parts.values()], axis=1)


def prepared(made: Scene, count: int = 200):
    """Patches, their hierarchy, a place on each, entries and their gatherer."""
    patches = make_patches(made, count)
    bvh = Bvh(patches.corners)
    places = patches.sample(made, np.arange(len(patches)), 5)
    entries, _, _ = find_entries(made, patches, bvh, places, OFFSET)
    return patches, bvh, places, entries, make_gatherer(made, patches, entries, bvh, OFFSET)


def slow_ids(made: Scene, patches, entries, origins, directions) -> np.ndarray:
    """(n,) entry of each ray: the triangle it hits, the side it comes from, the patch it lands in."""
    triangle, u, v, _ = intersect(made.positions[made.triangles], origins, directions)
    cross = made.triangle_cross().astype(np.float64)
    result = np.full(len(origins), len(entries) + 1)
    for i in np.flatnonzero(triangle >= 0):
        pieces = np.flatnonzero(patches.parent == triangle[i])
        inside = barycentric(np.array([[u[i], v[i]]]), patches.weights[pieces][:, :, 1:])[0]
        patch = patches.patch[pieces[inside.min(axis=1).argmax()]]
        sides = entries.front_id[patch], entries.back_id[patch]
        if cross[triangle[i]] @ directions[i] > 0:
            sides = sides[::-1]
        result[i] = sides[0] if sides[0] < len(entries) else sides[1]
    return result


def sheet_room() -> Scene:
    """A room with a block and a sheet that is seen from both sides."""
    return scene(
        *room_parts(), (*quad((1, 0.5, 1.6), (1.5, 0, 0.3), (0, 1.5, 0.2)), 1), materials=(Material("A"), Material("B"))
    )


def test_ids_are_the_entries_on_which_rays_land():
    made = sheet_room()
    patches, bvh, places, entries, gatherer = prepared(made)
    assert entries.back.any()
    gatherer.bvh = Recorder(bvh)
    ids = collect(gatherer, places, 16)
    origins, directions = np.concatenate(gatherer.bvh.origins), np.concatenate(gatherer.bvh.directions)
    expected = slow_ids(made, patches, entries, origins, directions)
    # float32 may decide otherwise on the border of two patches
    assert (ids.reshape(-1) == expected).mean() > 0.995


def test_directions_follow_the_cosine():
    made = scene((*globe(rings=16), 0))
    _, bvh, places, _, gatherer = prepared(made, 100)
    gatherer.bvh = Recorder(bvh)
    collect(gatherer, places, 256)
    directions = np.stack(gatherer.bvh.directions)
    assert np.allclose(np.linalg.norm(directions, axis=2), 1, atol=1e-5)
    cosine = np.einsum("snd,nd->sn", directions, places.normal)
    assert cosine.min() > -1e-5
    # E[cos] = 2/3, E[cos²] = 1/2 under the density cos/π; the points share one pattern of 256 heights
    assert cosine.mean() == pytest.approx(2 / 3, abs=0.5 / 256)
    assert (cosine**2).mean() == pytest.approx(1 / 2, abs=0.5 / 256)
    # turned about the normal: no direction is preferred
    assert np.abs(np.einsum("snd->nd", directions) / len(directions) - 2 / 3 * places.normal).max() < 0.03
    starts = np.stack(gatherer.bvh.origins)[0]
    assert np.allclose(starts, places.position + OFFSET * places.flat, atol=1e-6)


def test_threads_do_not_change_the_ids():
    made = room()
    *_, gatherer = prepared(made)
    texels = make_texels(made, 160).samples
    assert len(texels) > 8192
    alone, both = (collect(gatherer, texels, 20, threads=n) for n in (1, 2))
    assert np.array_equal(alone, both)
    assert not np.array_equal(alone, collect(gatherer, texels, 20, seed=2))


def test_a_tick_can_end_the_gather():
    *_, places, _, gatherer = prepared(room())

    def stop(rays):
        raise InterruptedError(rays)

    with pytest.raises(InterruptedError):
        gatherer.gather(places, 4, 0, lambda piece, ids: None, stop)


@pytest.mark.parametrize("transmission", [(0.5, 0.5, 0.5), (0.2, 0.2, 0.2), (1.0, 0.5, 0.0)])
def test_sheets_let_their_mean_part_through(transmission):
    # a floor under a wide sheet: what is not stopped goes to the sky
    floor = quad((-1, -1, 0), (2, 0, 0), (0, 2, 0))
    sheet = quad((-50, -50, 0.5), (100, 0, 0), (0, 100, 0))
    made = scene((*floor, 0), (*sheet, 1), materials=(Material("Floor"), Material("Net", transmission=transmission)))
    patches = make_patches(made, 50)
    bvh = Bvh(patches.corners)
    texels = make_texels(made, 64).samples
    texels = texels.take(made.triangle_object[texels.triangle] == 0)
    own = 2 * made.triangle_object[patches.parent]
    gatherer = Gatherer(made, patches, bvh, own, own + 1, 5, offset=OFFSET)
    share = np.bincount(collect(gatherer, texels, 64).reshape(-1), minlength=6) / (64 * len(texels))
    passed = np.mean(transmission)
    # its lower side is its back; the floor's front is behind the rays
    assert share[3] == pytest.approx(1 - passed, abs=0.01)
    assert share[5] == pytest.approx(passed, abs=0.01)
    # the other way, between two places
    lit = gatherer.visible(np.array([[0, 0, 0.1]], np.float32), np.array([[0, 0, 0.8]], np.float32))
    assert lit == pytest.approx(passed, abs=1e-5)


def test_rays_below_the_surface_carry_nothing():
    # shading normals tilted by 45°: part of their hemisphere is below the floor
    points, triangles, uv = quad((-1, -1, 0), (2, 0, 0), (0, 2, 0))
    lid, lid_triangles, _ = quad((-50, -50, 1), (0, 100, 0), (100, 0, 0))
    tilted = np.zeros((4, 3, 3))
    tilted[:2] = np.array([1, 0, 1]) / np.sqrt(2)
    tilted[2:] = (0, 0, -1)
    made = Scene(
        np.r_[points, lid],
        np.r_[triangles, lid_triangles + 4],
        corner_normals=tilted,
        atlas_uv=np.r_[uv, np.full_like(uv, np.nan)],
    )
    *_, entries, gatherer = prepared(made, 50)
    texels = make_texels(made, 32).samples
    ids = collect(gatherer, texels, 128)
    # the part of a cosine hemisphere below a plane at 45° is (1 − cos 45°) / 2
    assert (ids == len(entries)).mean() == pytest.approx((1 - np.sqrt(0.5)) / 2, abs=0.005)


def test_bins_of_the_sky_are_of_one_size():
    random = np.random.default_rng(0)
    directions = uniform_sphere(random.uniform(size=(200_000, 2))).astype(np.float32)
    found = np.bincount(sky_bin(directions, (8, 16)), minlength=128) / len(directions)
    assert np.allclose(found, 1 / 128, rtol=0.1)
    assert sky_bin(np.array([[0, 0, -1], [0, 0, 1]], np.float32), (8, 16)) // 16 == pytest.approx([0, 7])


def test_the_outside_of_a_sealed_room_has_no_entry():
    made = room()
    patches, _, _, entries, _ = prepared(made)
    walls = made.triangle_object[patches.parent[np.unique(patches.patch, return_index=True)[1]]] == 0
    # the block stands on the floor, parts of which lie inside of it
    low, high = np.array([1, 0.99, -1]), np.array([1.8, 1.98, 1e-3])
    below = walls & ((patches.position > low) & (patches.position < high)).all(axis=1)
    assert below.any() and (entries.front_id[below] == len(entries)).all()
    assert (entries.front_id[walls & ~below] < len(entries)).all()
    assert (entries.back_id == len(entries)).all()
    assert np.array_equal(np.sort(entries.front_id[entries.front_id < len(entries)]), np.arange(len(entries)))
    # places on entries are on their own side
    normal = np.repeat(entries.normal, PLACES, axis=0)
    assert (np.einsum("nd,nd->n", entries.places.flat, normal) > 0.99).all()


def test_texels_inside_a_solid_are_buried():
    # a block sunk halfway through the floor: what is below is out of the room
    made = scene((*box((0, 0, 0), (4, 3, 2.5), True), 0), (*box((1, 1, -0.5), (2, 2, 0.5)), 0))
    patches = make_patches(made, 300)
    texels = make_texels(made, 64).samples
    _, buried, _ = find_entries(made, patches, Bvh(patches.corners), texels, OFFSET)
    place, block = texels.position, made.triangle_object[texels.triangle] == 1
    below = block & (place[:, 2] < -0.02)
    under = ~block & (place[:, 2] < 1e-3) & ((place[:, :2] > 1.02) & (place[:, :2] < 1.98)).all(axis=1)
    free = ~(block & (place[:, 2] < 0.02)) & ~(
        ~block & (place[:, 2] < 1e-3) & ((place[:, :2] > 0.98) & (place[:, :2] < 2.02)).all(axis=1)
    )
    assert under.sum() > 5 and below.sum() > 5
    assert buried[under].all()
    assert not buried[free].any()
