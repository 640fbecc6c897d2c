"""Error against time: Cycles, the paper's way, and ours, at lamps that nothing was trained on.

The scene's own lamps, sky and emissive materials are put out, and what casts caustics is made black; test lamps shine
one at a time, so that no steady light hides their error. The open file is changed and must not be saved.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ..core.bake import Progress, Settings
from ..core.panes.training import free_air, room_around
from ..core.rays import Bvh, Tracer
from ..core.scene import Scene, SceneError
from ..core.surface import make_patches, make_texels
from ..core.transfer import find_entries, make_gatherer
from ..core.transfer.entries import PLACES
from . import atlas, baking, caustics, denoised, lamps, methods, preview_study, reference, relight, rungs, store
from .extract import extract
from .rungs import Bakes, Steps, point
from .studies import STUDIES, Subject
from .trees import surface_output

WAYS = {
    "cycles": "Cycles",
    "denoised": "Cycles, OpenImageDenoise",
    "paper": "The paper's method",
    "clusters": "The paper's panes, our gather",
    "panes": "Lightpanes",
}
"""What error against time is drawn of, by the names that the command line knows."""

NAMES = (*WAYS, *STUDIES, "preview")
"""All that can be asked for."""

RESOLUTION = 256
"""Texels a side, as in a bake."""

CYCLES_SPP = (1, 8, 40, 160)
REFERENCE_SPP = 64
"""Samples a texel of each half that tell how many more a reference needs: a lamp close to a surface makes small bright
spots, which paths find rarely."""

REFERENCE_NOISE = 0.025
"""Relative RMSE on blocks that a reference's own noise may make; it is subtracted, all but about a quarter of it."""

REFERENCE_TIME = 20.0
"""s that a reference may take, about, both halves; one of more noise has to do then, and the chart says how much."""

FAR, NEAR = 0.08, 0.025
"""Distances of the test lamps from surfaces, in parts of the scene's extent: far at least, near about."""

PATHS = 800_000
"""Of Cycles in a second on two cores, about."""

ROUNDS = 2
"""Times that a curve's bakes are made, all in turn each time. The best time of each counts: whatever else the machine
does can only add to it."""

POWER = 100.0
"""W of the test lamps."""


@dataclass(frozen=True)
class TestLamp:
    """A point lamp. kind: "far" or "near". room: m to about the nearest surface."""

    kind: str
    place: tuple[float, float, float]
    room: float


def measure(
    context: bpy.types.Context,
    resolution: int = RESOLUTION,
    seed: int = 0,
    progress: Callable[[Progress], None] = lambda _: None,
    names: Sequence[str] = tuple(WAYS),
    indirect: Callable[..., reference.Reference] = reference.indirect,
) -> dict:
    """The chart's figures, JSON-able. Takes the scene's bake, lamps, sky and emission away: don't save it.

    names: of NAMES, what to measure. indirect: makes the references, or has kept them. "studies": by name what studies.py says of theirs. "lamps": kind, place and room of each. "methods": by name a list of points with "error" (mean over the lamps),
    "errors", "bake_s", "relight_s", "entries", "rays", "bytes" (or "spp"). "default": the bake with default settings, as one
    of those, and "by_hand", one with the budgets that its trials led to. "notes": sentences on what was left out.
    Raises SceneError for scenes that cannot be baked.
    """
    steps = Steps(progress)
    studies = {}
    if "preview" in names:
        steps.begin("Study: preview", 30)
        studies["preview"] = preview_study.measure(context)
    steps.begin("Reading the scene", 2)
    notes: list[str] = []
    if asked := [name for name in STUDIES if name in names]:
        # before glass is blackened: one of them is of caustics
        own = lamps.read_lights(context.evaluated_depsgraph_get(), [])
        scene, _ = _open(context, resolution)
        tests = find_lamps(scene, resolution, seed)
        subject = Subject(scene, resolution, seed, tuple(test.place for test in tests), tuple(own))
        for name in asked:
            steps.begin(f"Study: {name}", 30)
            studies[name] = STUDIES[name](subject)
    if focusing := blacken():
        notes.append(
            f"Black in this chart, for Cycles and for us: {', '.join(focusing)}. What glass and smooth metal focus is not "
            "what panes are for."
        )
    scene, extracting = _open(context, resolution)
    tests = find_lamps(scene, resolution, seed)
    wanted = [WAYS[name] for name in WAYS if name in names]
    found: dict[str, list[dict]] = {}
    truths: list[reference.Reference] = []
    with relight.paused():
        lamp = _put_lamp(context)
        if wanted:
            truths = _truths(context, lamp, tests, resolution, steps, indirect)
            found = _cycles(context, lamp, tests, truths, resolution, steps, wanted, notes)
        shining = [_move(context, lamp, test) for test in tests]
        base = Settings(resolution=resolution, seed=seed)
        bakes = Bakes(scene, base, shining, truths, steps, notes)
        # ours first: what others may take is in times of it
        order = [name for name in reversed(methods.METHODS) if name in wanted]
        ladders = {name: bakes.ladder(name) for name in order}
        ours = next((rung for rung in ladders.get(WAYS["panes"], ()) if rung.given == rungs.DEFAULT), None)
        by_hand = bakes.by_hand(ours) if ours else None
        for _ in range(ROUNDS - 1):
            bakes.again(ladders, by_hand)
    found |= {name: [rung.point(extracting) for rung in ladders[name]] for name in methods.METHODS if name in ladders}
    own = {"default": ours, "by_hand": by_hand}
    own = {name: rung.point(extracting) for name, rung in own.items() if rung}
    progress(Progress("Done", 1.0, 0))
    return {
        "scene": context.blend_data.filepath and bpy.path.display_name_from_filepath(context.blend_data.filepath),
        "resolution": resolution,
        "seed": seed,
        "triangles": len(scene.triangles),
        "error": "RMSE over RGB / mean, 4×4-texel blocks, reference noise subtracted, mean over the lamps",
        "reference_spp": [2 * truth.spp for truth in truths],
        "reference_noise": [round(truth.noise, 5) for truth in truths],
        "lamps": [{"kind": t.kind, "place": [round(x, 4) for x in t.place], "room_m": round(t.room, 4)} for t in tests],
        "methods": found,
        **own,
        "studies": studies,
        "notes": notes,
    }


def _open(context, resolution) -> tuple[Scene, float]:
    """The scene without light, with an atlas; and the seconds that reading it took."""
    scene = context.scene
    baking.preflight(context)
    baking.clear_scene(context)
    _put_out(context)
    with relight.paused():
        objects = [item for item in scene.objects if item.type == "MESH" and store.TAG not in item]
        atlas.make_atlas(context, objects, resolution)
        started = time.perf_counter()
        return extract(context, resolution=resolution), time.perf_counter() - started


def _put_out(context) -> None:
    """Switch off lamps, sky and emissive materials."""
    for obj in context.scene.objects:
        if obj.type == "LIGHT":
            obj.hide_render = True
    for light in bpy.data.lights:
        # lamps of instanced collections
        light.energy = 0.0
    context.scene.world = None
    trees = [m.node_tree for m in bpy.data.materials if m.node_tree] + [g for g in bpy.data.node_groups]
    for tree in (t for t in trees if t.library is None):
        for node in tree.nodes:
            name = {"EMISSION": "Strength", "BSDF_PRINCIPLED": "Emission Strength"}.get(node.type)
            if name is None or name not in node.inputs:
                continue
            for link in list(node.inputs[name].links):
                tree.links.remove(link)
            node.inputs[name].default_value = 0.0
    context.view_layer.update()


def blacken() -> list[str]:
    """Let materials that cast caustics neither reflect nor let anything through; returns their names, in quotes."""
    found = [material for material in bpy.data.materials if caustics.is_made_of(material)]
    for material in found:
        if material.library is None:
            tree = material.node_tree
            output, black = surface_output(tree), tree.nodes.new("ShaderNodeBsdfDiffuse")
            black.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
            tree.links.new(black.outputs["BSDF"], output.inputs["Surface"])
            for link in list(output.inputs["Volume"].links):
                tree.links.remove(link)
    return [f"'{material.name}'" for material in found if material.library is None]


def find_lamps(scene: Scene, resolution: int, seed: int = 0) -> list[TestLamp]:
    """Two places in the scene's air well apart and far from surfaces, and one near a surface.

    Found as training lamps are, but by other random numbers. Raises SceneError where there is no room.
    """
    texels = make_texels(scene, resolution)
    tracer = Tracer(scene)
    patches = make_patches(scene, 1000, seed, tracer)
    bvh = Bvh(patches.corners)
    entries, _, _ = find_entries(scene, patches, bvh, texels.samples, tracer.offset, seed)
    gatherer = make_gatherer(scene, patches, entries, bvh, tracer.offset)
    points = entries.places.take(np.arange(len(entries)) * PLACES)
    extent = scene.extent
    rng = np.random.default_rng(seed + 502)
    share = entries.area / entries.area.sum()
    least, most = scene.positions.min(axis=0), scene.positions.max(axis=0)
    chosen = points.take(rng.choice(len(points), 400, p=share))

    def air(near, low, high):
        found = free_air(chosen, bvh, extent, seed + 503, near)
        room = room_around(found, gatherer)
        inside = ((found > least) & (found < most)).all(axis=1)
        keep = inside & (room > low * extent) & (room < high * extent)
        return found[keep], room[keep]

    # narrow places have no far ones: take what there is
    far, room = air(None, FAR, np.inf)
    if len(far) < 2:
        far, room = air(None, 1e-3, np.inf)
    near, close = air((0.9 * NEAR * extent, 1.1 * NEAR * extent), 0.6 * NEAR, 1.2 * NEAR)
    if len(far) < 2 or not len(near):
        raise SceneError("There is no room in the scene for test lamps: nothing that its texels see is open air.")
    second = int(np.linalg.norm(far - far[0], axis=1).argmax())
    places = [("far", far[0], room[0]), ("far", far[second], room[second]), ("near", near[0], close[0])]
    return [TestLamp(kind, tuple(map(float, place)), float(m)) for kind, place, m in places]


def _put_lamp(context) -> bpy.types.Object:
    data = bpy.data.lights.new("Lightpanes Chart", "POINT")
    data.energy, data.shadow_soft_size = POWER, 0.0
    lamp = bpy.data.objects.new("Lightpanes Chart", data)
    context.scene.collection.objects.link(lamp)
    return lamp


def _move(context, lamp, test) -> tuple:
    """Put the lamp at a test's place; what shines then, as a relighter wants it."""
    lamp.location = test.place
    context.view_layer.update()
    shining = lamps.read_lights(context.evaluated_depsgraph_get(), [])
    return tuple(light for light in shining if light.power.any())


def _truths(context, lamp, tests, resolution, steps, indirect) -> list[reference.Reference]:
    """A reference for each test lamp, of as many samples as its noise asks for, if they take no more than REFERENCE_TIME."""
    rate = resolution**2 / PATHS
    most = max(int(REFERENCE_TIME / (2 * rate)), REFERENCE_SPP)
    truths = []
    for number, test in enumerate(tests, 1):
        _move(context, lamp, test)

        def find(spp, number=number):
            def begin():
                steps.begin(f"Cycles, reference {number} of {len(tests)}", spp * rate)

            found = indirect(context, resolution, spp, 90 + number, progress=begin)
            if not found.image[found.mask].any():
                raise SceneError("The test lamps light nothing: every surface is black, or none scatters light.")
            return found

        truth = find(REFERENCE_SPP)
        more = min(truth.samples_for(REFERENCE_NOISE), most)
        truths.append(find(more) if more > REFERENCE_SPP else truth)
    return truths


def _cycles(context, lamp, tests, truths, resolution, steps, wanted, notes) -> dict[str, list[dict]]:
    """The points of Cycles' ways that are wanted: time of a bake for one lamp, mean over the lamps."""
    plain, clean = WAYS["cycles"], WAYS["denoised"]
    denoises = clean in wanted and denoised.can()
    if clean in wanted and not denoises:
        notes.append("This Blender was built without OpenImageDenoise, so Cycles' bakes are not denoised.")
    rate = resolution**2 / PATHS
    _move(context, lamp, tests[0])
    # the first bake loads kernels
    reference.cycles_bake(context, {"INDIRECT"}, resolution, 1)
    ways = [plain, clean] if denoises else [plain] if plain in wanted else []
    errors = {way: np.zeros((len(CYCLES_SPP), len(tests))) for way in ways}
    seconds = {way: np.full(errors[way].shape, np.inf) for way in ways}
    made_in = np.zeros(len(CYCLES_SPP))
    for turn in range(ROUNDS if ways else 0):
        for row, spp in enumerate(CYCLES_SPP):
            if turn and not 0 < made_in[row] < rungs.LONG:
                continue
            if row and made_in[row - 1] / CYCLES_SPP[row - 1] * spp > rungs.PATIENCE * len(tests):
                notes.append(f"Cycles: {spp} samples left out, a bake takes over {rungs.PATIENCE:.3g} s.")
                break
            steps.begin(f"Cycles, {spp} samples{' again' * (turn > 0)}", len(tests) * (0.2 + spp * rate))
            started = time.perf_counter()
            for column, (test, truth) in enumerate(zip(tests, truths, strict=True)):
                _move(context, lamp, test)
                image, _, spent = reference.cycles_bake(context, {"INDIRECT"}, resolution, spp, 10 + column)
                made = {plain: (image, spent)}
                if denoises:
                    smooth, more = denoised.denoise(image)
                    made[clean] = smooth, spent + more
                for way, (shown, took) in made.items():
                    errors[way][row, column] = truth.compare(shown).error
                    seconds[way][row, column] = min(seconds[way][row, column], took)
            made_in[row] = time.perf_counter() - started
    return {
        way: [
            point(e, s, s, spp=spp)
            for e, s, spp in zip(errors[way], seconds[way].mean(axis=1), CYCLES_SPP, strict=True)
            if np.isfinite(s)
        ]
        for way in ways
        if way in wanted
    }
