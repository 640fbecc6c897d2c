"""Direct light over the atlas: exact in full, only changed lamps anew, and a coarse image that is the same but coarser."""

from dataclasses import replace

import numpy as np
import pytest
from lightpanes.core import direct_atlas
from lightpanes.core.direct_atlas import COARSE_SAMPLES, DirectAtlas, _coarse_leaders, _leaders
from lightpanes.core.lights import irradiance
from lightpanes.core.metrics import relative_rmse
from lightpanes.core.penumbra import DirectLight, Receivers, cast_rays, sample_lamp, shade
from lightpanes.core.rays import Tracer
from lightpanes.core.scene import Scene, SceneObject
from lightpanes.core.surface import make_texels, texel_places

from .shapes import lamp, quad, room, scene

RESOLUTION = 96
PANEL = lamp((1.0, 1.0, 2.3), kind="AREA", size=(0.6, 0.4))
BULB = replace(lamp((3.0, 2.0, 1.5)), name="Bulb")


@pytest.fixture
def atlas():
    made = room()
    return DirectAtlas(made, RESOLUTION, Tracer(made))


@pytest.fixture
def casts(monkeypatch):
    """(lamp's name, receivers, samples) of all that is cast."""
    found, unit = [], DirectLight.unit

    def counted(self, light, samples=None):
        found.append((light.name, len(self.receivers), samples))
        return unit(self, light, samples)

    monkeypatch.setattr(DirectLight, "unit", counted)
    return found


def test_it_is_what_rays_say(atlas):
    made = room()
    texels, tracer = make_texels(made, RESOLUTION), Tracer(made)
    samples, owner, place = texel_places(made, texels, 2)
    position = samples.position + samples.flat * np.float32(tracer.offset)
    receivers = Receivers(position, samples.normal, place)
    panel = sample_lamp(PANEL, 64, 4)
    expected = shade(PANEL, panel, receivers, cast_rays(receivers, panel, tracer.blocked))[:, None] * PANEL.power
    expected += irradiance(BULB, position, samples.normal, tracer.visibility)[:, None] * BULB.power
    mean = np.stack([np.bincount(owner, channel) for channel in expected.T], 1) / np.bincount(owner)[:, None]
    image = atlas.image([PANEL, BULB])
    assert (image[..., 3] == 1).all()
    shown = image[..., :3].reshape(-1, 3)
    assert np.allclose(shown[texels.index], mean, rtol=1e-5, atol=1e-5)
    assert shown.max() > 1 and not shown[texels.fill() < 0].any()


@pytest.mark.parametrize("kind", ["AREA", "POINT"])
def test_shadows_of_bars_as_narrow_as_texels(kind, monkeypatch):
    """A lattice that is as fine as the texels darkens all of them alike: each shows the mean over itself."""
    floor = quad((-1, -1, 0), (2, 0, 0), (0, 2, 0))
    pitch = 2 / (0.45 * RESOLUTION) * 0.93
    bars = np.array([quad((x, -2, 0.1), (0.5 * pitch, 0, 0), (0, 4, 0))[0] for x in np.arange(-2, 2, pitch)])
    corners = np.array([(0, 1, 2), (0, 2, 3)])[None] + 4 * np.arange(len(bars))[:, None, None]
    made = scene((*floor, 0), (bars.reshape(-1, 3), corners.reshape(-1, 3), np.full((2 * len(bars), 3, 2), np.nan), 0))
    light = lamp((0.2, 0.1, 2.0), kind=kind, **({"size": (0.03, 0.03)} if kind == "AREA" else {}))
    # whole blocks of 4 × 4 texels, and the light at places all over them
    first, last = 8, 40
    random, tracer = np.random.default_rng(0), Tracer(made)
    row, column = np.meshgrid(np.arange(first, last, 4), np.arange(first, last, 4), indexing="ij")
    at = np.stack([column, row], -1)[:, :, None] + 4 * random.random((*row.shape, 600, 2))
    place = np.full((*at.shape[:-1], 3), tracer.offset)
    place[..., :2] = (at / RESOLUTION * 2 - 0.05) / 0.9 * 2 - 1
    normal = np.broadcast_to([0, 0, 1.0], place.shape).reshape(-1, 3)
    truth = irradiance(light, place.reshape(-1, 3), normal, tracer.visibility, 16).reshape(at.shape[:3]).mean(axis=2)

    def error():
        image = DirectAtlas(made, RESOLUTION, tracer).image([light])[first:last, first:last, 0] / light.power[0]
        blocks = image.reshape(len(row), 4, len(row), 4).mean(axis=(1, 3))
        return np.sqrt(((blocks - truth) ** 2).mean()) / truth.mean()

    # the truth's own noise is 0.04
    assert error() < 0.08
    monkeypatch.setattr(direct_atlas, "PLACES", 1)
    assert error() > 0.15


def test_texels_of_the_finest_atlases_have_one_place(monkeypatch, casts):
    monkeypatch.setattr(direct_atlas, "MOST_PLACES", 100)
    made = room()
    atlas = DirectAtlas(made, RESOLUTION, Tracer(made))
    atlas.image([PANEL])
    assert casts == [("Lamp", atlas.texels, 64)]


def test_places_of_texels():
    made = room()
    texels = make_texels(made, RESOLUTION)
    samples, owner, place = texel_places(made, texels, 2)
    assert (np.unique(place) == np.arange(4)).all()
    assert (np.diff(owner) >= 0).all() and (np.unique(owner) == np.arange(len(texels))).all()
    assert np.bincount(owner).max() == 4 and (np.bincount(owner)[texels.centred] >= 3).mean() > 0.9
    own = texels.samples.take(owner)
    assert (made.triangle_object[own.triangle] == made.triangle_object[samples.triangle]).all()
    assert np.einsum("nd,nd->n", own.normal, samples.normal).min() > 0.9
    # inside of charts their middle is the texel's own
    whole = np.flatnonzero(np.bincount(owner) == 4)
    middle = samples.position[np.isin(owner, whole)].reshape(-1, 4, 3).mean(axis=1)
    size = np.median(np.linalg.norm(own.position - samples.position, axis=1))
    apart = np.linalg.norm(middle - texels.samples.position[whole], axis=1)
    assert np.quantile(apart, 0.9) < 0.05 * size and apart.max() < 2 * size


def test_only_lamps_that_changed_are_cast(atlas, casts):
    first = atlas.image([PANEL, BULB])
    brighter = replace(PANEL, power=2 * PANEL.power)
    more = atlas.image([brighter, BULB]) - first
    assert np.allclose(more[..., :3], atlas.image([PANEL])[..., :3], rtol=1e-4, atol=1e-4)
    assert [name for name, *_ in casts] == ["Lamp", "Bulb"]
    atlas.image([PANEL], {"Lamp": 128})
    ((name, receivers, samples),) = casts[2:]
    assert (name, samples) == ("Lamp", 128) and 3 * atlas.texels < receivers <= 4 * atlas.texels


def test_a_coarse_image_casts_the_lamp_that_moved_at_a_quarter_of_the_texels(atlas, casts):
    atlas.image([PANEL, BULB])
    moved = replace(PANEL, matrix=PANEL.matrix + np.array([0, 0, 0, 0.3])[None] * [[1], [0], [0], [0]])
    casts.clear()
    coarse = atlas.coarse([moved, BULB])
    ((name, receivers, samples),) = casts
    assert name == "Lamp" and samples == COARSE_SAMPLES
    # charts' borders have texels of their own
    assert 0.25 * atlas.texels <= receivers < 0.4 * atlas.texels
    full = atlas.image([moved, BULB])
    assert relative_rmse(coarse[..., :3], full[..., :3], None, 4) < 0.1
    assert np.array_equal(atlas.coarse([moved, BULB]), full), "what is known in full is shown so"


def test_large_atlases_halve_more_than_once(monkeypatch):
    monkeypatch.setattr(direct_atlas, "COARSE_TEXELS", 700)
    texels = make_texels(room(), RESOLUTION)
    leader, step = _coarse_leaders(texels)
    chosen = np.unique(leader)
    assert step > 2 and (leader[chosen] == chosen).all()
    # texels at charts' borders stand for themselves
    assert len(chosen) < 0.25 * len(texels)
    samples, place = texels.samples, np.stack(np.divmod(texels.index, RESOLUTION))
    assert 1 < np.abs(place - place[:, leader]).max() < step
    assert np.einsum("nd,nd->n", samples.normal, samples.normal[leader]).min() > 0.9
    assert np.linalg.norm(samples.position - samples.position[leader], axis=1).max() < 0.3 * step


def test_leaders_are_neighbours_on_the_same_surface():
    texels = make_texels(room(), RESOLUTION)
    leader = _leaders(texels)
    assert (leader[leader] == leader).all()
    apart = np.abs(
        np.stack(np.divmod(texels.index, RESOLUTION)) - np.stack(np.divmod(texels.index[leader], RESOLUTION))
    )
    assert apart.max() == 1
    samples = texels.samples
    assert np.einsum("nd,nd->n", samples.normal, samples.normal[leader]).min() > 0.9
    assert np.linalg.norm(samples.position - samples.position[leader], axis=1).max() < 0.3


def test_texels_inside_things_show_their_neighbours():
    made = room()
    texels = make_texels(made, RESOLUTION)
    own = np.zeros(RESOLUTION**2, bool)
    own[texels.index[::2]] = True
    shown = DirectAtlas(made, RESOLUTION, Tracer(made), own).image([BULB])[..., :3].reshape(-1, 3)
    whole = DirectAtlas(made, RESOLUTION, Tracer(made)).image([BULB])[..., :3].reshape(-1, 3)
    assert np.allclose(shown[own], whole[own], rtol=1e-5, atol=1e-6)
    assert shown[texels.index].any(axis=1).mean() > 0.5
    nobody = DirectAtlas(made, RESOLUTION, Tracer(made), np.zeros(RESOLUTION**2, bool))
    assert nobody.texels == len(texels), "a bake with nothing of its own shows all"


def test_no_lamps_and_no_texels(atlas):
    assert not atlas.image([])[..., :3].any() and not atlas.coarse([])[..., :3].any()
    made = room()
    objects = [SceneObject(part.name, at_vertices=True) for part in made.objects]
    bare = Scene(**{**vars(made), "objects": objects})
    empty = DirectAtlas(bare, 16, Tracer(bare))
    for light in (PANEL, BULB):
        assert not empty.image([light])[..., :3].any() and not empty.coarse([light])[..., :3].any()
