"""The panels draw what they should in every state, by names that exist."""

import re

import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import engine, figures, job, panel, preflight, store  # noqa: E402

from .drawing import Context, draw, paragraph, texts, value  # noqa: E402


def test_before_a_bake(room):
    drawn = draw(panel.LIGHTPANES_PT_render)
    assert texts(drawn, "operator") == ["lightpanes.bake"]
    assert value(drawn, "Objects") == "2" and value(drawn, "Lamps") == "1 live"
    assert re.fullmatch(r"[\d,]+ texels", value(drawn, "Light At"))
    assert value(drawn, "Time").startswith("~ ") and value(drawn, "Memory").endswith("MB")
    for cls in (panel.LIGHTPANES_PT_results, panel.LIGHTPANES_PT_debug):
        assert draw(cls) is None
    assert texts(draw(panel.LIGHTPANES_PT_quality), "prop") == ["error_target", "time_budget", "resolution"]
    assert texts(draw(panel.LIGHTPANES_PT_advanced), "prop") == ["exits", "photons", "memory_budget", "seed"]


def test_obstacles_have_their_buttons(room):
    for name in ("Room", "Block"):
        bpy.data.objects[name].hide_render = True
    bpy.data.objects["Lamp"].hide_render = True
    drawn = draw(panel.LIGHTPANES_PT_render)
    assert "every mesh in scene 'Scene' is hidden from renders" in paragraph(drawn)
    assert "Objects" not in texts(drawn)
    buttons = [entry for entry in drawn if entry[:2] == ("operator", "lightpanes.fix")]
    assert [entry[2] for entry in buttons] == ["Show in Renders", "Show Lamps"]
    for entry in buttons:
        button = entry[3]
        assert bpy.ops.lightpanes.fix(kind=button.kind, target=button.target) == {"FINISHED"}
    assert texts(draw(panel.LIGHTPANES_PT_render), "operator") == ["lightpanes.bake"]


def test_many_obstacles_are_cut_short(room):
    for number in range(20):
        mesh = bpy.data.meshes.new(f"Mesh {number}")
        mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
        mesh.attributes.new("Lightpanes", "FLOAT", "POINT")
        room.collection.objects.link(bpy.data.objects.new(f"Object {number}", mesh))
    preflight.forget()
    drawn = draw(panel.LIGHTPANES_PT_render)
    assert texts(drawn, "operator").count("lightpanes.fix") == panel.MOST_OBSTACLES
    assert "12 more" in texts(drawn)


def test_while_a_bake_runs(room, monkeypatch):
    monkeypatch.setattr(job, "running", lambda: True)
    monkeypatch.setattr(job, "draw", lambda layout, context: layout.label(text="42 %"))
    drawn = draw(panel.LIGHTPANES_PT_render)
    assert texts(drawn) == ["42 %"] and not texts(drawn, "operator")


def test_where_no_ray_can_be_traced(room, monkeypatch):
    monkeypatch.setattr(engine, "unusable", lambda: "Lightpanes can't trace rays here.")
    drawn = draw(panel.LIGHTPANES_PT_render)
    assert "Lightpanes can't trace rays here." in texts(drawn)
    (button,) = [entry[3] for entry in drawn if entry[:2] == ("operator", "lightpanes.bake")]
    assert not button.enabled


def test_after_a_bake(room, quick):
    bpy.data.lights["Lamp"].lightpanes.live = False
    other = bpy.data.objects.new("Other", bpy.data.lights.new("Other", "SPOT"))
    room.collection.objects.link(other)
    room.lightpanes.exits = "POINTS"
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    preflight.forget()
    drawn = draw(panel.LIGHTPANES_PT_render)
    assert ("operator", "lightpanes.bake", "Bake Again") == drawn[0][:3]
    assert "lightpanes.clear" in texts(drawn, "operator")
    assert value(drawn, "Lamps") == "1 live, 1 baked in"

    report = store.read_meta(room)["report"]
    drawn = draw(panel.LIGHTPANES_PT_results)
    assert value(drawn, "Error") == f"{100 * report['error']:.1f} %"
    for name, part in report["error_parts"].items():
        assert value(drawn, panel.ERROR_PARTS[name]) == f"{100 * part:.1f} %"
    assert value(drawn, "Size") == figures.size(report["bytes"])
    assert value(drawn, "Rays") == f"{report['rays'] / 1e6:.1f} M"
    assert value(drawn, "Last Relight").endswith(" ms")
    for warning in report["warnings"]:
        assert warning in paragraph(drawn)

    drawn = draw(panel.LIGHTPANES_PT_lamps)
    labels = texts(drawn)
    assert labels == ["Lamp", "Baked In", "Other", ""] and texts(drawn, "prop") == ["live", "live"]

    drawn = draw(panel.LIGHTPANES_PT_output)
    assert "Lightpanes Irradiance" in texts(drawn) and "lightpanes.save_images" in texts(drawn, "operator")
    drawn = draw(panel.LIGHTPANES_PT_debug)
    assert texts(drawn, "prop") == ["show_points"] and value(drawn, "Entries") == f"{report['entries']:,}"


def test_a_damaged_bake(room, quick):
    bpy.ops.lightpanes.bake()
    store.find_entries(room).data[store.META] = "{"
    preflight.forget()
    assert "The bake is damaged; bake again." in paragraph(draw(panel.LIGHTPANES_PT_results))
    for cls in (panel.LIGHTPANES_PT_render, panel.LIGHTPANES_PT_output, panel.LIGHTPANES_PT_debug):
        draw(cls)


def test_relighting_by_hand(room, quick):
    bpy.ops.lightpanes.bake()
    assert "lightpanes.relight" not in texts(draw(panel.LIGHTPANES_PT_results), "operator")
    room.lightpanes.live = False
    assert "lightpanes.relight" in texts(draw(panel.LIGHTPANES_PT_results), "operator")


def test_stale_bakes_are_told(room, quick):
    bpy.ops.lightpanes.bake()
    bpy.data.objects["Block"].location.x += 0.1
    bpy.context.view_layer.update()
    bpy.ops.lightpanes.relight()
    assert "'Block' was moved or edited since the bake; bake again." in paragraph(draw(panel.LIGHTPANES_PT_results))


def test_objects_and_lamps(room):
    block, lamp = bpy.data.objects["Block"], bpy.data.objects["Lamp"]
    drawn = draw(panel.LIGHTPANES_PT_object, Context(object=block))
    assert texts(drawn, "prop") == ["exclude", "target", "weight"]
    assert draw(panel.LIGHTPANES_PT_object, Context(object=lamp)) is None
    shown = draw(panel.LIGHTPANES_PT_light, Context(light=lamp.data))
    assert texts(shown, "prop") == ["live", "group", "samples"]
    assert draw(panel.LIGHTPANES_PT_light, Context(light=None)) is None
    bpy.context.view_layer.objects.active = block
    assert texts(draw(panel.LIGHTPANES_PT_output), "prop") == ["target", "direct", "caustics", "storage"]


def test_no_lamps(room):
    bpy.data.objects.remove(bpy.data.objects["Lamp"])
    preflight.forget()
    assert texts(draw(panel.LIGHTPANES_PT_lamps)) == ["No lamps"]


def test_numbers_as_people_write_them():
    assert [figures.duration(s) for s in (0.04, 9.94, 12.4, 200)] == ["0.0 s", "9.9 s", "12 s", "3 min 20 s"]
    assert [figures.size(n) for n in (12, 3400, 71.9e6, 2.34e9)] == ["12 B", "3 KB", "72 MB", "2.3 GB"]


def test_an_image_of_the_error(room, quick):
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert "lightpanes.show_error" in texts(draw(panel.LIGHTPANES_PT_debug), "operator")
    for _ in range(2):
        assert bpy.ops.lightpanes.show_error() == {"FINISHED"}
    image = store.find_image(room, store.ERROR)
    assert image.name == "Lightpanes Error" and image.size[0] <= 64
    assert store.read_image(room, store.ERROR)[..., :3].any()
    # another bake is another error
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert store.find_image(room, store.ERROR) is None
    store.write_meta(room, {"report": {}})
    assert not bpy.ops.lightpanes.show_error.poll()
