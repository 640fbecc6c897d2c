"""Elements of entries against the dense transport between the same elements."""

from functools import cache

import numpy as np
import pytest
from lightpanes.core import footprint
from lightpanes.core.bake import bake
from lightpanes.core.point_cache.darts import first_come, first_of_many
from lightpanes.core.rays import Bvh
from lightpanes.core.surface import cut_patches, make_patches
from lightpanes.core.threads import use_threads
from lightpanes.core.transfer import (
    ElementTransport,
    find_elements,
    find_entries,
    link_elements,
    make_gatherer,
    make_transport,
)
from lightpanes.core.transfer.entries import MAX_ALBEDO

from .shapes import lamp, moved, quick, relighter, room

OFFSET = 1e-5
PLACE = (3.0, 1.5, 2.0)


@cache
def both():
    """Of a room: elements, transport by their entries, and the dense one between all of them."""
    made = room()
    patches = make_patches(made, 250)
    finer, patches, owner = cut_patches(made, patches, 1000)
    bvh = Bvh(finer.corners)
    pilot = patches.sample(made, np.arange(len(patches)), 1)
    entries, _, is_buried = find_entries(made, patches, bvh, pilot, OFFSET)
    elements = find_elements(made, finer, owner, entries, is_buried)
    whole = make_transport(entries, make_gatherer(made, patches, entries, bvh, OFFSET), 512)
    gatherer = make_gatherer(made, finer, elements.sides, bvh, OFFSET)
    return (
        elements,
        ElementTransport(elements, whole, link_elements(entries, elements, whole, gatherer, 512)),
        make_transport(elements.sides, gatherer, 1024),
    )


def test_elements_are_parts_of_entries():
    elements, found, _ = both()
    assert 2 * len(found.links.far) < len(elements) == pytest.approx(1000, rel=0.15)
    assert (np.diff(elements.entry) >= 0).all()
    assert np.allclose(np.bincount(elements.entry, elements.share), 1, atol=1e-5)


def test_products_with_elements_are_those_of_their_matrix():
    elements, found, _ = both()
    random, matrix = np.random.default_rng(3), found.between.astype(np.float64)
    values = random.random((len(elements), 40), np.float32)
    assert np.allclose(found.arriving(values), matrix @ values, rtol=1e-4, atol=1e-6)
    rows = np.sort(random.permutation(len(elements))[:60])
    assert np.allclose(found.leaving(rows, values[rows]), values[rows].T @ matrix[rows], rtol=1e-4, atol=1e-6)
    glow = random.random(len(elements), np.float32)
    lone = found.spots(rows, glow)
    mix = random.random((lone.seen.shape[1], 40), np.float32)
    scale = random.random((len(rows), 1), np.float32)
    once = (scale * lone.seen) @ mix
    assert np.allclose(once, scale * (matrix @ lone.radiosity(mix))[rows], rtol=1e-3, atol=1e-5)
    # and transposed
    back = random.random((35, len(rows)), np.float32)
    assert np.allclose(back @ once, (back @ (scale * lone.seen)) @ mix, rtol=1e-3)


def test_light_of_elements_is_that_of_the_dense_solve():
    elements, found, dense = both()
    sides = elements.sides
    share = sides.area / sides.area.sum()
    albedo = sides.albedo[:, :1]
    # a lamp in the middle of the air, and what falls on a single element; far light is one over an entry of half a metre
    apart = sides.position - np.array(PLACE, np.float32)
    near = np.maximum(-np.einsum("nd,nd->n", apart, sides.normal), 0) / np.linalg.norm(apart, axis=1) ** 3
    single = (np.arange(len(sides)) == int(near.argmax())).astype(np.float32)
    for source, mean, each in ((near, 0.02, 0.09), (single, 0.1, 0.35)):
        source = albedo * source[:, None].astype(np.float32)
        one, other = (t.arriving(t.solve(albedo, source))[:, 0] for t in (found, dense))
        assert share @ one == pytest.approx(share @ other, rel=mean)
        assert np.sqrt(share @ (one - other) ** 2) < each * np.sqrt(share @ other**2)


def test_no_albedo_makes_light_of_elements_grow():
    elements, found, _ = both()
    share = elements.sides.area / elements.sides.area.sum()
    # their own sums may exceed 1 by as much as MAX_ALBEDO allows for, on average they do not
    sums = found.arriving(np.ones((len(elements), 1), np.float32))[:, 0]
    assert share @ sums < 1.02 and sums.max() < 1.0001 / MAX_ALBEDO
    white = np.full((len(elements), 1), MAX_ALBEDO, np.float32)
    light = found.solve(white, np.ones((len(elements), 1), np.float32))
    assert np.isfinite(light).all() and share @ light[:, 0] < 1.5 / (1 - MAX_ALBEDO)


@pytest.fixture
def few_entries(monkeypatch):
    monkeypatch.setattr(footprint, "BALANCED", 400)


@pytest.mark.usefixtures("frugal")
def test_a_bake_with_elements_relights_as_one_without(monkeypatch):
    made = room(lights=[lamp(PLACE)])
    given = quick(entries=1300, entry_rays=512)
    plain = bake(made, given)
    monkeypatch.setattr(footprint, "BALANCED", 400)
    found = bake(made, given)
    assert found.report["entries"] == pytest.approx(1300, rel=0.15)
    for place in (PLACE, (0.6, 2.4, 1.2)):
        truth, ours = (relighter(made, b).relight([lamp(place)])[..., :3].copy() for b in (plain, found))
        assert ours.mean() == pytest.approx(truth.mean(), rel=0.03)
        assert np.sqrt(((ours - truth) ** 2).mean()) < 0.1 * truth.mean()


@pytest.mark.usefixtures("frugal", "few_entries")
def test_elements_are_the_same_on_any_number_of_threads():
    made = moved(room(lights=[lamp(PLACE)]), shift=(1, 2, 3))
    bakes = []
    for count in (1, 3):
        use_threads(count)
        try:
            bakes.append(bake(made, quick(entries=1000)))
        finally:
            use_threads(0)
    for name, array in bakes[0].images.items():
        assert np.array_equal(array, bakes[1].images[name]), name


def test_a_crowd_is_thinned_out_as_if_one_came_after_another():
    made = room()
    patches = make_patches(made, 300)
    samples = patches.sample(made, np.random.default_rng(1).integers(0, len(patches), 9000).astype(np.int32), 2)
    radius = np.random.default_rng(2).uniform(0.1, 0.3, len(samples)).astype(np.float32)
    low = samples.position.min(axis=0)
    assert np.array_equal(first_of_many(samples, radius, low), first_come(samples, radius, low))
