"""Lamps whose light is in the bake are kept off what shows it, in each engine, and off nothing else."""

import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import direct, linking, relight, store  # noqa: E402
from lightpanes.core.metrics import relative_rmse  # noqa: E402

from .files import reopen  # noqa: E402
from .mending import found, mend  # noqa: E402
from .soft import EEVEE, camera, error, image, linked, render, shine  # noqa: E402
from .test_relight import update  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick")


def test_cycles_shows_the_same_either_way(panel, tmp_path):
    """A plain room: what Lightpanes adds is what the lamp, which no longer lights it, would have brought."""
    bpy.data.objects.remove(bpy.data.objects["Block"])
    panel.lightpanes.direct, panel.lightpanes.resolution = "OFF", 128
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    camera(panel)
    panel.render.engine, panel.lightpanes.cycles = "CYCLES", True
    panel.cycles.samples, panel.cycles.use_denoising, panel.cycles.use_adaptive_sampling = 128, False, False
    engine = render(tmp_path)
    panel.lightpanes.direct = "BAKED"
    ours = render(tmp_path)
    assert linked() == {"Panel": ["Room"]}
    assert relative_rmse(ours, engine, block=4) < 0.03
    panel.lightpanes.cycles = False
    assert linked() == {}
    assert render(tmp_path).mean() > 0.3 * engine.mean(), "the lamp shines again where the bake is not shown"


def test_lamps_shine_in_engines_that_do_not_show_the_bake(baked_panel, tmp_path):
    assert list(linked()) == ["Panel"]
    baked_panel.render.engine = "CYCLES"
    update()
    assert linked() == {}
    baked_panel.lightpanes.cycles = True
    assert list(linked()) == ["Panel"]
    baked_panel.lightpanes.cycles = False
    baked_panel.render.engine = EEVEE
    update()
    assert list(linked()) == ["Panel"]
    baked_panel.render.engine = "CYCLES"
    camera(baked_panel)
    baked_panel.cycles.samples = 1
    render(tmp_path)
    assert linked() == {}


def test_a_reference_has_the_lamps(baked_panel):
    baked_panel.render.engine, baked_panel.lightpanes.cycles = "CYCLES", True
    update()
    assert error(64) < 0.04 and list(linked()) == ["Panel"]


def test_a_lamp_with_light_linking_of_its_own_is_left_alone(baked_panel):
    second = shine(baked_panel, "Second", (0.5, 0.5, 0.5))
    update()
    both = image()
    assert sorted(linked()) == ["Panel", "Second"]
    mine = bpy.data.collections.new("Mine")
    second.light_linking.receiver_collection = mine
    relight.relight(bpy.context)
    assert second.light_linking.receiver_collection == mine
    assert image().mean() < 0.9 * both.mean()
    said = "Lamp 'Second' has light linking of its own, so its direct light is left to the engine."
    assert direct.sentences(baked_panel) == [said]
    baked_panel.lightpanes.direct = "OFF"
    assert second.light_linking.receiver_collection == mine


def test_a_lamp_of_two_scenes_is_left_alone(baked_panel):
    other = bpy.data.scenes.new("Other")
    other.collection.objects.link(bpy.data.objects["Panel"])
    relight.relight(bpy.context)
    assert image().max() == 0 and linked() == {}
    assert "is in 2 scenes" in direct.sentences(baked_panel)[0]


def test_a_copy_of_the_scene_has_links_of_its_own(baked_panel):
    bpy.ops.scene.new(type="FULL_COPY")
    copy = bpy.context.scene
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert copy.lightpanes.receivers != baked_panel.lightpanes.receivers
    assert all("." not in name for name in linked()["Panel"]), "the first scene keeps its own"
    copy.lightpanes.direct = "OFF"
    assert linked() == {"Panel": ["Block", "Room"]}


def test_objects_at_vertices_are_left_to_the_lamps(panel):
    bpy.data.objects["Block"].lightpanes.target = "VERTICES"
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert linked() == {"Panel": ["Room"]}
    assert direct.sentences(panel) == ["Lit at their vertices, which hold no direct light of lamps: 'Block'."]


def test_our_links_are_no_links_of_the_users(baked_panel):
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert not [said for said in store.read_meta(baked_panel)["report"]["warnings"] if "linking" in said]


def test_deleted_objects_are_not_kept_alive(baked_panel, tmp_path):
    with bpy.context.temp_override(selected_objects=[bpy.data.objects["Block"]]):
        bpy.ops.object.delete()
    reopen(tmp_path)
    assert "Block" not in bpy.data.objects and linked() == {"Panel": ["Room"]}


def test_an_eevee_without_light_linking_is_named(baked_panel, monkeypatch):
    assert not found("LAMPS")
    monkeypatch.setattr(linking, "EEVEE_KNOWS", (9, 0))
    mend("LAMPS")
    assert baked_panel.lightpanes.direct == "OFF" and linked() == {}
