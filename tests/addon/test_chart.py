"""The chart: what it measures, what it writes, and the references and ways that it compares."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lightpanes import addon  # noqa: E402
from lightpanes.addon import (  # noqa: E402
    atlas,
    chart,
    chart_page,
    commands,
    denoised,
    methods,
    preview_study,
    reference,
    rungs,
    studies,
)
from lightpanes.addon.extract import extract  # noqa: E402
from lightpanes.core.bake import Progress, Settings  # noqa: E402
from lightpanes.core.scene import SceneError  # noqa: E402
from lightpanes.tests.frugal import save_rays  # noqa: E402

from .glassware import ball, material  # noqa: E402

SIZE = 48
SMALL = {"entries": 400, "entry_rays": 256, "exit_rays": 64, "regions": 8, "panes": 16, "lamps": 150}
SETTINGS = Settings(resolution=SIZE, **SMALL)
PLAIN = ("cycles", "paper", "clusters", "panes")
"""All ways of the chart but the one that takes longest."""


@pytest.fixture
def small(monkeypatch):
    """A chart of few points, done in seconds."""
    monkeypatch.setattr(chart, "CYCLES_SPP", (1, 16, 128))
    monkeypatch.setattr(chart, "REFERENCE_SPP", 128)
    monkeypatch.setattr(chart, "REFERENCE_NOISE", 10.0)
    monkeypatch.setattr(rungs, "LADDER", ({**SMALL, "entries": 200, "exit_rays": 16}, SMALL))
    monkeypatch.setattr(rungs, "GATHERED", rungs.LADDER)
    monkeypatch.setattr(rungs, "WALKS", (64, 256))
    monkeypatch.setattr(chart, "ROUNDS", 1)
    save_rays(monkeypatch)


@pytest.fixture
def least(small, monkeypatch):
    """A chart whose figures do not matter."""
    monkeypatch.setattr(chart, "CYCLES_SPP", (1, 2))
    monkeypatch.setattr(chart, "REFERENCE_SPP", 4)
    monkeypatch.setattr(rungs, "LADDER", ({**SMALL, "entries": 200, "exit_rays": 16},))
    monkeypatch.setattr(rungs, "GATHERED", rungs.LADDER)


@pytest.fixture
def file(room, tmp_path):
    path = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.fixture
def placed(room):
    """The room with its atlas, as the ways see it."""
    atlas.make_atlas(bpy.context, [o for o in room.objects if o.type == "MESH"], SIZE)
    return extract(bpy.context, resolution=SIZE)


def nearest(scene, place):
    """Distance of a place from the scene's triangles, by brute force over points on them."""
    corners = scene.positions[scene.triangles]
    fine = np.stack(np.meshgrid(*[np.linspace(0, 1, 40)] * 2), -1).reshape(-1, 2)
    fine = fine[fine.sum(axis=1) <= 1]
    points = np.einsum("nk,tkc->tnc", np.column_stack([1 - fine.sum(axis=1), fine]), corners).reshape(-1, 3)
    return np.linalg.norm(points - place, axis=1).min()


def test_chart_of_a_room(file, small):
    steps: list[Progress] = []
    found = chart.measure(bpy.context, SIZE, 0, steps.append, PLAIN)
    assert list(found["methods"]) == ["Cycles", *methods.METHODS]
    assert json.loads(json.dumps(found)) == found
    cycles, walks, clusters, ours = found["methods"].values()
    for line in found["methods"].values():
        for point in line:
            assert len(point["errors"]) == len(found["lamps"]) == 3
            assert point["error"] == pytest.approx(np.mean(point["errors"]), abs=1e-4)
            assert 0 < point["relight_s"] < 60 and 0 < point["bake_s"] < 60
    assert [point["spp"] for point in cycles] == [1, 16, 128]
    # the error falls with the root of the samples
    assert cycles[1]["error"] == pytest.approx(cycles[0]["error"] / 4, rel=0.3)
    assert cycles[2]["error"] == pytest.approx(cycles[1]["error"] / np.sqrt(8), rel=0.4)
    assert max(found["reference_noise"]) < cycles[1]["error"] / 2
    assert ours[-1]["error"] < 0.25 and clusters[-1]["error"] < 0.5
    assert ours[-1]["error"] < walks[-1]["error"]
    assert all(point["relight_s"] < cycles[-1]["bake_s"] for point in ours)
    assert [step.fraction for step in steps] == sorted(step.fraction for step in steps)
    assert steps[-1].fraction == 1.0


def test_lamps_are_where_the_chart_says(placed):
    found = chart.find_lamps(placed, SIZE, 0)
    assert [lamp.kind for lamp in found] == ["far", "far", "near"]
    for lamp in found:
        assert (np.abs(lamp.place) < 1).all()
        assert nearest(placed, lamp.place) == pytest.approx(lamp.room, rel=0.35)
    extent = placed.extent
    assert min(lamp.room for lamp in found[:2]) > chart.FAR * extent
    assert found[2].room < 1.2 * chart.NEAR * extent
    assert chart.find_lamps(placed, SIZE, 0) == found
    assert chart.find_lamps(placed, SIZE, 1) != found


@pytest.mark.parametrize(
    ("name", "error", "bias"),
    [("Lightpanes", 0.12, 0.04), ("The paper's panes, our gather", 0.2, 0.04), ("The paper's method", 1.0, 0.15)],
)
def test_ways_against_cycles(placed, name, error, bias):
    lit = reference.indirect(bpy.context, SIZE, 128)
    made = methods.METHODS[name](placed, SETTINGS, lambda part: None)
    found = lit.compare(made.relight(placed.lights), made.valid)
    assert found.error < error
    assert abs(found.bias) < bias
    assert made.seconds > 0 and made.rays > 0 and made.bytes > 0
    assert made.entries == pytest.approx(SMALL["entries"], rel=0.1)
    # light is linear in the lamps
    once = made.relight(placed.lights).copy()
    twice = made.relight([replace(placed.lights[0], power=2 * placed.lights[0].power)])
    assert np.allclose(twice, 2 * once, rtol=1e-3, atol=1e-6)


def test_virtual_lights_of_some_texels(placed):
    whole = methods.virtual_lights(placed, replace(SETTINGS, entries=64), lambda part: None)
    part = np.indices((SIZE, SIZE)).sum(axis=0) % 5 == 0
    some = methods.virtual_lights(placed, replace(SETTINGS, entries=64), lambda part: None, part)
    assert (some.valid == (whole.valid & part)).all()
    expected = whole.relight(placed.lights)[some.valid]
    assert np.allclose(some.relight(placed.lights)[some.valid], expected, rtol=1e-4)


def test_reference_halves_are_independent_and_leave_the_scene(placed, room):
    before = (
        room.render.engine,
        room.cycles.samples,
        room.cycles.seed,
        {o.name: o.data.name for o in room.objects},
        {m.name: len(m.node_tree.nodes) for m in bpy.data.materials},
        len(bpy.data.images),
        len(bpy.data.meshes),
    )
    calls = []
    found = reference.indirect(bpy.context, SIZE, 16, progress=lambda: calls.append(0))
    again = reference.indirect(bpy.context, SIZE, 16)
    assert len(calls) == 2
    assert np.array_equal(found.halves, again.halves)
    other = reference.indirect(bpy.context, SIZE, 16, seed=1)
    inside = found.mask
    gap = (found.halves[0] - found.halves[1])[inside]
    cross = (found.halves[0] - other.halves[0])[inside]
    assert gap.std() == pytest.approx(cross.std(), rel=0.25)
    assert abs(gap.mean()) < 0.05 * found.image[inside].mean()
    after = (
        room.render.engine,
        room.cycles.samples,
        room.cycles.seed,
        {o.name: o.data.name for o in room.objects},
        {m.name: len(m.node_tree.nodes) for m in bpy.data.materials},
        len(bpy.data.images),
        len(bpy.data.meshes),
    )
    assert after == before


def test_steady_light_is_put_out(room, small):
    world = bpy.data.worlds.new("Sky")
    room.world = world
    shader = bpy.data.materials["Block"].node_tree.nodes["Principled BSDF"]
    shader.inputs["Emission Color"].default_value = (1, 1, 1, 1)
    shader.inputs["Emission Strength"].default_value = 50.0
    scene, _ = chart._open(bpy.context, SIZE)
    assert not any(any(m.emission) for m in scene.materials) and scene.sky is None and not scene.lights
    dark, mask, _ = reference.cycles_bake(bpy.context, {"DIRECT", "INDIRECT"}, SIZE, 1)
    assert mask.any() and not dark[mask].any()


def test_glass_and_mirrors_are_alike_for_cycles_and_for_us(room, small):
    """Else Cycles would add what they focus, and the light that ours lets straight on through glass."""
    ball(room, radius=0.4)
    ball(room, "Mirror", (0.5, -0.5, -0.6), 0.3, material("Metal", Metallic=1.0))
    assert chart.blacken() == ["'Glass'", "'Metal'"]
    atlas.make_atlas(bpy.context, [o for o in room.objects if o.type == "MESH"], SIZE)
    scene = extract(bpy.context, resolution=SIZE)
    lights = tuple(scene.lights)
    truth = reference.indirect(bpy.context, SIZE, 64)
    made = methods.eigenpanes(scene, SETTINGS, lambda part: None)
    found = truth.compare(made.relight(lights), made.valid)
    assert found.error < 0.12 and abs(found.bias) < 0.04
    assert chart.blacken() == []


def test_black_scene(room, small):
    for made in bpy.data.materials:
        made.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0, 0, 0, 1)
    with pytest.raises(SceneError, match="light nothing: every surface is black"):
        chart.measure(bpy.context, 32)


def test_long_ways_are_left_out(room, least, monkeypatch):
    """But for the smallest bake of each way, and the default one."""
    default = {**SMALL, "entries": 220}
    monkeypatch.setattr(rungs, "PATIENCE", 1e-3)
    monkeypatch.setattr(rungs, "DEFAULT", default)
    monkeypatch.setattr(rungs, "LADDER", (*rungs.LADDER, SMALL, default, {**SMALL, "entries": 300}))
    monkeypatch.setattr(rungs, "GATHERED", rungs.LADDER[:2])
    found = chart.measure(bpy.context, 32, names=PLAIN)
    assert [len(line) for line in found["methods"].values()] == [1, 1, 1, 2]
    assert found["methods"]["Lightpanes"][1] == found["default"]
    assert found["notes"] == [
        "Cycles: 2 samples left out, a bake takes over 0.001 s.",
        "Lightpanes: 400 entries left out, a bake takes over 0.001 s.",
        "Lightpanes: 300 entries left out, a bake takes over 0.001 s.",
        "The paper's panes, our gather: 400 entries left out, a bake takes over 0.001 s.",
        "The paper's method: 256 entries left out, a bake takes over 0.001 s.",
        "Lightpanes: the default's budgets by hand left out, a bake takes over 0.001 s.",
    ]


def test_default_bake_beside_the_same_budgets_by_hand(room, least, monkeypatch):
    monkeypatch.setattr(rungs, "LADDER", (rungs.DEFAULT,))
    found = chart.measure(bpy.context, 32, names=("panes",))
    assert found["methods"]["Lightpanes"] == [found["default"]]
    tried, given = found["default"], found["by_hand"]
    # the trials' budgets, and with them the same bake but for its trials
    assert given["entries"] == tried["entries"] and given["bytes"] == tried["bytes"]
    assert given["error"] == pytest.approx(tried["error"], rel=0.2)
    assert given["rays"] < tried["rays"]


def run_chart(*words):
    return commands.main(["chart", *map(str, words), "--resolution", "32", "--methods", ",".join(PLAIN)])


def test_command_writes_picture_and_figures(file, least, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    original, folder = file.read_bytes(), tmp_path / "out"
    assert run_chart(file, "--output", folder, "--json", tmp_path / "report.json") == 0
    assert sorted(p.name for p in folder.iterdir()) == ["room_chart.html", "room_chart.json", "room_chart.png"]
    assert file.read_bytes() == original
    said = json.loads((folder / "room_chart.json").read_text())
    assert said == json.loads((tmp_path / "report.json").read_text())
    assert said["scene"] == "room" and said["resolution"] == 32
    assert "room_chart.png" in capsys.readouterr().out
    page = (folder / "room_chart.html").read_text("utf-8")
    assert page.count("data:image/png;base64,") == 1 and "://" not in page
    for word in (said["date"], said["machine"], said["versions"], "Lightpanes", "room"):
        assert word in page
    assert chart_page.figures(page) == [said]
    picture = bpy.data.images.load(str(folder / "room_chart.png"))
    assert min(picture.size) > 600
    pixels = np.array(picture.pixels, np.float32).reshape(-1, 4)[:, :3]
    assert 0.01 < (pixels.min(axis=1) < 0.8).mean() < 0.4


def test_command_without_matplotlib(file, least, monkeypatch, capsys):
    for name in [n for n in sys.modules if n.split(".")[0] == "matplotlib" or n == "lightpanes.addon.plot"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.delattr(addon, "plot", raising=False)
    assert run_chart(file) == 0
    assert sorted(p.name for p in file.parent.iterdir()) == ["room.blend", "room_chart.json"]
    assert "no picture: that needs matplotlib (pip install matplotlib)" in capsys.readouterr().out


def test_command_without_a_mesh(file, small, capsys):
    for item in [o for o in bpy.context.scene.objects if o.type == "MESH"]:
        bpy.data.objects.remove(item)
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    assert run_chart(file) == 2
    assert "There is nothing to bake" in capsys.readouterr().err
    assert [p.name for p in file.parent.glob("*chart*")] == []


def test_picture_of_odd_figures(tmp_path):
    pytest.importorskip("matplotlib")
    from lightpanes.addon import plot

    one = {"error": 0.0, "errors": [0.0, 0.0], "bake_s": 2000.0, "relight_s": 2e-5, "entries": 10}
    far = {"error": 9.0, "errors": [8.0, 10.0], "bake_s": 0.01, "relight_s": 3.0, "spp": 1}
    found = {
        "scene": "odd",
        "resolution": 32,
        "triangles": 12,
        "reference_spp": [4],
        "reference_noise": [0.01, 0.02],
        "lamps": [{"kind": "far", "room_m": 1.0}, {"kind": "near", "room_m": 0.004}],
        "methods": {"Cycles": [far], "Lightpanes": [one], "The paper's panes, our gather": []},
    }
    plot.draw(found, tmp_path / "odd.png")
    assert (tmp_path / "odd.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("lines", "log"),
    [
        ({"flat": [[100, 0.05], [200, 0.05]]}, "xy"),
        ({"wide": [[1, 1e-4], [1e6, 50.0]], "one": [[30, 0.2]]}, "xy"),
        ({"nothing": [[1, 0.0], [2, 0.0]]}, "xy"),
        ({"likeness": [[0.1, 0.3], [0.12, 0.31]]}, "x"),
    ],
)
def test_picture_of_odd_studies(tmp_path, lines, log):
    pytest.importorskip("matplotlib")
    from lightpanes.addon import plot

    study = {"title": "Odd", "x": "s", "y": "error", "log": log, "lines": lines, "note": ""}
    axes = plot.draw_study(study, tmp_path / "odd.png").axes[0]
    assert (tmp_path / "odd.png").stat().st_size > 5_000
    # numbers at both axes, or nobody can read a figure off
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        assert sum(low <= place <= high for place in axis.get_majorticklocs()) >= 2
    assert all(text.get_text().endswith("%") for text in axes.get_yticklabels())
    assert axes.get_xlabel() == "seconds"


def test_denoised_bakes(room, least):
    """In a small atlas with much noise: less error than plain ones, and other pixels."""
    found = chart.measure(bpy.context, 32, names=("cycles", "denoised"))
    plain, clean = found["methods"].values()
    assert list(found["methods"]) == ["Cycles", "Cycles, OpenImageDenoise"]
    assert clean[0]["error"] != plain[0]["error"] and clean[0]["bake_s"] > plain[0]["bake_s"]


def test_denoising_leaves_the_file_as_it_was(room):
    # Blender's own builds have it
    assert denoised.can()
    before = everything()
    truth = np.full((40, 56, 3), np.linspace(1, 12, 56)[:, None], np.float32)
    noisy = truth * np.random.default_rng(0).gamma(4, 1 / 4, truth.shape).astype(np.float32)
    found, seconds = denoised.denoise(noisy)
    assert found.shape == truth.shape and seconds > 0
    errors = [np.sqrt(((image - truth) ** 2).mean()) for image in (found, noisy)]
    assert errors[0] < 0.4 * errors[1]
    assert found.mean() == pytest.approx(noisy.mean(), rel=0.05) and found.max() > 8
    assert everything() == before


def everything():
    kinds = ("scenes", "objects", "cameras", "node_groups")
    found = {kind: sorted(item.name for item in getattr(bpy.data, kind)) for kind in kinds}
    # Blender keeps the last render
    return found | {"images": [image.name for image in bpy.data.images if image.type != "RENDER_RESULT"]}


def test_where_nothing_can_denoise(room, least, monkeypatch):
    monkeypatch.setattr(denoised, "can", lambda: False)
    found = chart.measure(bpy.context, 32, names=("denoised",))
    assert found["methods"] == {} and "without OpenImageDenoise" in found["notes"][0]


@pytest.fixture
def few(monkeypatch):
    """Studies of two points a line."""
    for name, value in {
        "POINTS": (100, 400), "POINT_RAYS": 64, "PANES": (2, 8), "REGIONS": (4,), "CLUSTERS": (8, 64), "SAMPLES": (16, 64),
        "ROUNDS": 1, "PHOTONS": (500, 8000), "MANY": 4, "BASE": SMALL,
    }.items():  # fmt: skip
        monkeypatch.setattr(studies, name, value)
    for name, value in {"WIDTH": 40, "FRAMES": (1, 16), "SPP": (1,), "REFERENCE_SPP": 64}.items():
        monkeypatch.setattr(preview_study, name, value)
    save_rays(monkeypatch)


def test_studies(file, small, few, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.2, location=(-0.4, 0.3, -0.4))
    bpy.ops.object.shade_smooth()
    glass = bpy.data.materials.new("Glass")
    if glass.node_tree is None:
        glass.use_nodes = True
    shader = next(node for node in glass.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Transmission Weight"].default_value, shader.inputs["Roughness"].default_value = 1.0, 0.0
    bpy.context.object.data.materials.append(glass)
    bpy.ops.object.camera_add(location=(-0.8, -0.8, 0.3), rotation=(1.3, 0, -0.8))
    bpy.context.scene.camera = bpy.context.object
    bpy.ops.wm.save_mainfile()
    names = "points compression penumbra caustics preview"
    assert (
        commands.main(["chart", str(file), "--output", str(tmp_path / "out"), "--resolution", "48", "--methods", names])
        == 0
    )
    found = json.loads((tmp_path / "out" / "room_chart.json").read_text())
    assert found["methods"] == {} and sorted(found["studies"]) == sorted(names.split())
    lines = {name: study["lines"] for name, study in found["studies"].items()}
    # more of anything is better
    for line in lines["points"].values():
        assert line[1][1] < line[0][1]
    [ours, paper] = lines["compression"].values()
    assert ours[1][1] < ours[0][1] and paper[1][1] < paper[0][1]
    [photons] = lines["caustics"].values()
    assert photons[1][1] < photons[0][1]
    frames, _ = lines["preview"].values()
    assert frames[1][1] > frames[0][1] and frames[1][0] > frames[0][0]
    assert all(value > 0 for _, value in lines["penumbra"]["penumbra casting"])
    page = (tmp_path / "out" / "room_chart.html").read_text("utf-8")
    assert page.count("data:image/png;base64,") == 5 and "://" not in page
    assert len(list((tmp_path / "out").glob("room_chart_*.png"))) == 5


def test_studies_that_do_not_apply(room, few, small):
    found = chart.measure(bpy.context, 32, names=("caustics", "preview"))
    assert "glass or metal" in found["studies"]["caustics"]["skipped"]
    assert "no camera" in found["studies"]["preview"]["skipped"]


def test_wrong_names_of_methods(file, capsys):
    assert commands.main(["chart", str(file), "--methods", "cycles,eevee"]) == 2
    assert "use some of cycles, denoised" in capsys.readouterr().err


def test_references_take_as_many_samples_as_their_noise_asks_for(room, least, monkeypatch):
    asked = []

    def indirect(context, resolution, spp, seed, progress):
        asked.append(spp)
        return reference.indirect(context, resolution, spp, seed, progress=progress)

    monkeypatch.setattr(chart, "REFERENCE_NOISE", 0.1)
    found = chart.measure(bpy.context, 32, names=("cycles",), indirect=indirect)
    assert asked.count(4) == 3 and found["reference_spp"] == [2 * spp for spp in asked if spp > 4]
    assert max(found["reference_noise"]) == pytest.approx(0.1, rel=0.5)


def test_how_far_a_point_is_from_the_best():
    """Of the row of `make bench ONLY=charts`: the same error in less time, less error in the same time."""
    factors = chart_page.factors

    def point(seconds, error):
        return {"bake_s": seconds, "error": error}

    ours, slower, rougher = point(6.0, 0.03), point(9.0, 0.01), point(1.0, 0.05)
    assert factors(ours, [ours, slower, rougher]) == (1.0, 1.0)
    time, error = factors(ours, [ours, slower, rougher, point(4.0, 0.025)])
    assert time == 1.5 and error == pytest.approx(1.2)
    assert factors(ours, []) == (1.0, 1.0)


def test_figures_may_hold_anything():
    odd = {
        "scene": "</script><b>",
        "date": "d",
        "machine": "m",
        "versions": "v",
        "methods": {},
        "notes": ["a </script> b"],
    }
    page = chart_page.page([odd], [[]])
    assert chart_page.figures(page) == [odd] and page.count("</script>") == 1
    assert chart_page.figures("<html></html>") == []
