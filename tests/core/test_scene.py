"""What a scene accepts, drops and refuses, and what it tells the user."""

import numpy as np
import pytest
from lightpanes.core.planner import Settings, plan
from lightpanes.core.scene import Light, Material, Scene, SceneError, SceneObject, Sky, used_rows

from .shapes import box, lamp, quad, room, scene

CUBE = box((0, 0, 0), (1, 1, 1))


def test_vertices_that_are_not_numbers_name_their_object():
    for bad in (np.nan, np.inf):
        points = CUBE[0].copy()
        points[3, 1] = bad
        with pytest.raises(SceneError, match=r"'Bent' has vertices that are not numbers") as caught:
            scene((*CUBE, 0), (points, *CUBE[1:], 0), names=["Sound", "Bent"])
        assert "Sound" not in str(caught.value)


def test_faces_without_area_are_dropped():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [1e-12, 0, 0]])
    # a line, a point, a hair; the second is sound
    triangles = np.array([[0, 1, 3], [0, 1, 2], [1, 1, 1], [0, 4, 2]])
    made = Scene(
        points,
        triangles,
        atlas_uv=np.arange(24).reshape(4, 3, 2) / 24,
        triangle_material=np.array([0, 1, 0, 0]),
        triangle_object=np.array([0, 1, 0, 0]),
        materials=(Material("A"), Material("B")),
        objects=(SceneObject("A"), SceneObject("B")),
    )
    assert made.triangles.tolist() == [[0, 1, 2]]
    assert made.triangle_material.tolist() == made.triangle_object.tolist() == [1]
    assert made.atlas_uv.shape == (1, 3, 2) and made.corner_normals.shape == (1, 3, 3)
    assert np.allclose(made.corner_normals, [0, 0, 1])


@pytest.mark.parametrize("size", [1e-6, 1e-3, 1e4])
def test_small_and_large_faces_are_kept(size):
    made = scene((CUBE[0] * size, *CUBE[1:], 0))
    assert len(made.triangles) == 12
    assert np.allclose(np.linalg.norm(made.corner_normals, axis=2), 1, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"triangles": np.zeros((0, 3))}, "There are no faces to bake: the scene has no visible mesh"),
        ({"positions": np.zeros((0, 3)), "triangles": np.zeros((0, 3))}, "There are no faces to bake"),
        ({"positions": np.zeros((8, 3))}, "Every face has zero area"),
        ({"triangles": [[0, 1, 8]]}, "names a vertex that does not exist"),
        ({"triangles": [[0, 1, -1]]}, "names a vertex that does not exist"),
        ({"triangle_material": np.zeros(3)}, "triangle_material has 3 rows for 12 triangles"),
        ({"triangle_material": np.full(12, 1)}, "names a material that does not exist"),
        ({"triangle_object": np.full(12, -1)}, "names an object that does not exist"),
        ({"atlas_uv": np.zeros((2, 3, 2))}, "atlas_uv has 2 rows for 12 triangles"),
    ],
)
def test_what_does_not_fit_together_is_refused(change, message):
    with pytest.raises(SceneError, match=message):
        Scene(**({"positions": CUBE[0], "triangles": CUBE[1]} | change))


def test_lamps_and_skies_that_make_no_sense_are_refused():
    with pytest.raises(SceneError, match=r"Lamp 'Glow': unknown kind 'NEON'"):
        Light("Glow", "NEON", np.eye(4), np.ones(3))
    with pytest.raises(SceneError, match=r"Lamp 'Glow': unknown shape 'STAR'"):
        Light("Glow", "AREA", np.eye(4), np.ones(3), shape="STAR")
    for matrix, power in ((np.full((4, 4), np.nan), 1), (np.eye(4), np.inf)):
        with pytest.raises(SceneError, match=r"Lamp 'Glow' has a place or power that is not a number"):
            Light("Glow", "POINT", matrix, power)
    for radiance in (np.ones((4, 8)), np.full((1, 1, 3), np.nan)):
        with pytest.raises(SceneError, match="finite numbers"):
            Sky(radiance)


def test_a_lamp_is_known_by_its_place_and_not_by_its_power():
    assert lamp((1, 2, 3), 5).geometry == lamp((1, 2, 3), 7).geometry
    assert lamp((1, 2, 3)).geometry != lamp((1, 2, 3.001)).geometry
    assert lamp((1, 2, 3)).geometry != lamp((1, 2, 3), radius=0.1).geometry
    assert np.allclose(lamp((1, 2, 3)).direction, (0, 0, -1))


def test_extent_counts_used_vertices_only():
    points, triangles, uv = quad((0, 0, 0), (3, 0, 0), (0, 4, 0))
    assert Scene(np.r_[points, [[1e6, 0, 0]]], triangles, atlas_uv=uv).extent == pytest.approx(5)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"error_target": 0}, "error target is 0; use a number from 0.001 to 1"),
        ({"error_target": 2.0}, "error target"),
        ({"error_target": float("nan")}, "error target"),
        ({"time_budget": -1}, "time budget is -1 s; use 0 for none"),
        ({"time_budget": float("nan")}, "time budget"),
        ({"resolution": 8}, "resolution is 8; use 16 to 8192"),
        ({"resolution": 10_000}, "resolution"),
        ({"entries": 0}, "entries"),
        ({"panes": 0}, "panes"),
        ({"exit_rays": -5}, "exit_rays"),
        ({"regions": 0}, "regions"),
        ({"lamps": 0}, "lamps"),
    ],
)
def test_settings_out_of_range_are_refused(given, message):
    with pytest.raises(SceneError, match=message):
        Settings(**given)


def test_a_smaller_error_gets_more_of_everything():
    made = room()
    coarse, usual, fine = (plan(made, Settings(error_target=e)) for e in (0.2, 0.05, 0.02))
    for name in ("entries", "entry_rays", "exit_rays", "regions", "panes", "lamps"):
        assert getattr(coarse, name) <= getattr(usual, name) <= getattr(fine, name)
    assert plan(made, Settings(entries=123)).entries == 123


def test_used_rows_are_what_unique_gives():
    names = np.random.default_rng(0).integers(0, 90, (40, 3))
    assert np.array_equal(used_rows(names, 100), np.unique(names))
    assert not len(used_rows(names[:0], 100))
