"""The lamps' light that glass and metal focus, in the image `Lightpanes Caustics`, as long as there is any.

How it follows lamps, coarsely or in full, is `live_image`'s. Where it falls it lights the entries, too, so that it
bounces on (`relight`). Scenes without smooth glass or metal have no such image, and nothing is done for them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, fields
from functools import cached_property
from itertools import count

import bpy
import numpy as np

from ..core import caustics as core
from ..core.bake.photons import FEWEST, trace_lamps
from ..core.caustics import CausticAtlas, casters
from ..core.panes import Panes
from ..core.rays import Tracer
from ..core.scene import Light, Scene, SceneError
from . import live_image, nodes, store, vertices
from .lamps import lamp_key
from .live_image import LiveImage, lock
from .optics import read_optics

EXACT = 0.05
"""Error for which a lamp gets `core.PHOTONS`; half the error asks for twice as many."""

MOST = 2_000_000

SHARE, PHOTON = 0.15, 2e-5
"""Of a time budget, caustics take no more than this part, nor more than so many s for each photon that is asked for."""

PHOTONS = "photons"
"""In a bake's meta: of each lamp, where a time budget left no more."""

SLICE = 0.04
"""s that a picture is refined while a lamp is dragged."""

UNTRACED = 0.02
"""Part of the lamps' light that may be lost on the way without a word."""

STREAM = 0.1
"""s between two pictures that are shown on the way to the finest."""

READING = 0.1
"""s that reading the scene may take for caustics to follow glass that is dragged, and not only once it rests."""

_numbers = count(1)

Read = Callable[[], tuple[Panes, Scene]]
"""The bake's panes, and the scene's surfaces as they are now."""


@dataclass(frozen=True)
class Asked:
    """What an image is to show. photons: of each lamp. key: of it all."""

    lights: tuple[Light, ...]
    photons: int
    key: str


@dataclass
class Held(live_image.Held):
    """casters: names of the objects that focus light, None where that is not known. landed: where it fell when an image
    was last worked out in full. reading: s that the surfaces took to read. energy: W, where the light went. most: photons
    of a lamp, None where that is not known."""

    casters: tuple[str, ...] | None = None
    landed: Landed = field(default_factory=lambda: Landed())
    reading: float = 0.0
    energy: dict[str, float] = field(default_factory=dict)
    most: int | None = None


@dataclass(frozen=True)
class Landed:
    """Where the photons of lamps fall: (lamp, its `core.Landings`) each. key: another one each time. asked: key of what
    was asked for."""

    landings: tuple[tuple[Light, core.Landings], ...] = ()
    key: int = 0
    asked: str = ""

    @classmethod
    def of(cls, atlas: CausticAtlas, asked: Asked) -> Landed:
        """As the atlas has them."""
        return cls(tuple((light, atlas.landings(light)) for light in asked.lights), next(_numbers), asked.key)


class Traced:
    """The texels of a bake, where photons land; made when first asked for, which may be beside Blender."""

    def __init__(self, panes: Panes, surfaces: Scene):
        self._panes, self._surfaces = panes, surfaces

    @property
    def casters(self) -> tuple[str, ...]:
        """Names of the objects that focus light."""
        found = casters(self._surfaces)
        return () if found is None else found.objects

    @cached_property
    def atlas(self) -> CausticAtlas:
        panes, own = self._panes, self._panes.own
        if own is None:
            own = np.zeros(panes.resolution**2, bool)
            own[panes.texel] = True
        return CausticAtlas(self._surfaces, panes.resolution, own)


class _Caustics(LiveImage):
    role = store.CAUSTICS
    held_as = Held
    keeps = False

    def is_baked(self, scene):
        return is_baked(scene)

    def begin(self, scene):
        if store.find_image(scene, store.CAUSTICS) is not None:
            return
        size = store.find_image(scene, store.IRRADIANCE)
        if size is None:
            raise SceneError(f"The image '{store.IRRADIANCE}' has been deleted; bake again.")
        width, height = size.size
        store.add_image(scene, store.CAUSTICS, store.opaque(np.zeros((height, width, 3), np.float32)))
        nodes.rebuild(scene)
        nodes.show_in_cycles(scene)

    def make_atlas(self, panes, surfaces):
        return Traced(panes, surfaces)

    def images(self, atlas, asked, full) -> Iterator[np.ndarray | None]:
        steps, begin = atlas.atlas.refine(asked.lights, asked.photons), time.perf_counter()
        due = begin + (STREAM if full else SLICE)
        for step in steps:
            now = time.perf_counter()
            if step.done >= 1 or now > due:
                yield step.image
                if not full:
                    return
                due = time.perf_counter() + STREAM
            else:
                yield None

    def image(self, atlas, asked):
        return atlas.atlas.image(asked.lights, asked.photons)

    def show(self, scene, mine, asked, image, full):
        store.write_image(scene, store.CAUSTICS, image)

    def rested(self, scene, mine, asked):
        from . import relight

        atlas = mine.atlas.atlas
        mine.energy, mine.landed = _energy(atlas, asked.lights), Landed.of(atlas, asked)
        relight.bounce(scene)


_image = _Caustics()
held, known, forget = _image.held, _image.known, _image.forget
finish, note_packed = _image.finish, _image.note_packed


def is_baked(scene: bpy.types.Scene) -> bool:
    """Whether the scene has a bake, wants caustics in it, and has something that may cast them."""
    if not scene.lightpanes.caustics or store.find_entries(scene) is None:
        return False
    mine = held(scene)
    if mine.casters is None:
        mine.casters = _perhaps(scene)
    return bool(mine.casters)


def _perhaps(scene) -> tuple[str, ...]:
    """The casters that the bake found, or, where it did not look, objects that by their materials may be some."""
    report = read_report(scene)
    if report is not None and store.find_image(scene, store.CAUSTICS) is not None:
        return tuple(report["casters"])
    return _by_materials(scene)


def _by_materials(scene) -> tuple[str, ...]:
    looks: dict[bpy.types.Material, bool] = {}

    def made_of(material):
        own = material.original
        if own not in looks:
            looks[own] = is_made_of(own)
        return looks[own]

    names = [
        item.name
        for item in scene.objects
        if store.TAG not in item and any(made_of(slot.material) for slot in item.material_slots if slot.material)
    ]
    if scene == bpy.context.scene:
        # instances, and what modifiers give a material
        for instance in bpy.context.evaluated_depsgraph_get().object_instances:
            item = instance.object
            if item.type != "MESH" or store.TAG in item.original:
                continue
            slots = [slot.material for slot in item.material_slots]
            if any(made_of(material) for material in {*slots, *item.data.materials} if material is not None):
                owner = f"{instance.parent.original.name}: " if instance.is_instance else ""
                names.append(owner + item.original.name)
    return tuple(dict.fromkeys(names))


def may_come_back(scene: bpy.types.Scene) -> bool:
    """Whether what cast the scene's caustics was edited or hidden, so that it casts none just now."""
    mine = known(scene)
    return scene.lightpanes.caustics and mine is not None and mine.casters == () and bool(mine.surfaces)


def is_made_of(material: bpy.types.Material) -> bool:
    """Whether caustics may come of a material."""
    optics = read_optics(material, [])
    return optics is not None and optics.roughness <= core.SHARP


def concerns(scene: bpy.types.Scene, material: bpy.types.Material) -> bool:
    """Whether caustics may come of a material, or came of it until now."""
    if is_made_of(material):
        return True
    mine = known(scene)
    owners = (
        bpy.data.objects.get(name.rpartition(": ")[2]) for name in (mine.casters or () if mine is not None else ())
    )
    return any(slot.material == material for item in owners if item is not None for slot in item.material_slots)


def make_tracer(surfaces: Scene) -> Tracer:
    """Shadow rays, which what casts caustics blocks: the light that passes it is in these."""
    found = casters(surfaces)
    return Tracer(surfaces) if found is None else Tracer(surfaces, solid=found.triangles)


def photons_asked(scene: bpy.types.Scene) -> int:
    """Photons of each lamp that Photons or Error ask for."""
    asked = scene.lightpanes
    return asked.photons or round(float(np.clip(core.PHOTONS * EXACT / asked.error_target, FEWEST, MOST)) / 100) * 100


def photons_for(scene: bpy.types.Scene) -> int:
    """Photons of each lamp in the scene's bake: no more than its time budget left, where Photons is not set."""
    asked = scene.lightpanes
    if asked.photons or not asked.time_budget or store.find_entries(scene) is None:
        return photons_asked(scene)
    mine = held(scene)
    if mine.most is None:
        mine.most = (store.read_meta(scene) or {}).get(PHOTONS, MOST)
    return min(photons_asked(scene), mine.most)


def ask(scene: bpy.types.Scene, lights: Iterable[Light], baked_in: Iterable[Light]) -> Asked:
    """What the image is to show under these lamps. baked_in: those that are not live, as they were baked."""
    chosen, photons = (*lights, *baked_in), photons_for(scene)
    return Asked(chosen, photons, f"{lamp_key(chosen)} {photons}")


def ask_of(scene: bpy.types.Scene, surfaces: Scene) -> Asked | None:
    """What a bake of these surfaces is going to show; None where nothing is focused or where that is not wanted."""
    if not scene.lightpanes.caustics or casters(surfaces) is None:
        return None
    return Asked(tuple(surfaces.lights), photons_asked(scene), "")


def reserve(scene: bpy.types.Scene, asked: Asked | None) -> float:
    """s of a time budget that are kept for them."""
    if asked is None:
        return 0.0
    return min(SHARE * scene.lightpanes.time_budget, PHOTON * asked.photons * len(asked.lights))


def trace(
    panes: Panes, surfaces: Scene, asked: Asked, tell: Callable[[float], object], seconds: float = np.inf
) -> tuple[Traced, int]:
    """Work them out, so that a window need not wait; and how many photons of each lamp there was time for. Nothing of
    Blender is read. tell: called with the part in [0, 1] that is done; an exception that it raises ends the work. seconds:
    that there are."""
    begin, traced = time.perf_counter(), Traced(panes, surfaces)
    tell(0.0)
    atlas = traced.atlas
    return traced, trace_lamps(atlas, asked.lights, asked.photons, tell, seconds - (time.perf_counter() - begin))


def adopt(scene: bpy.types.Scene, traced: Traced | None, fingerprint: dict[str, str]) -> None:
    """Use what a bake has just made of these surfaces (`extract.fingerprint`), None where nothing casts caustics."""
    _image.adopt(scene, traced, fingerprint)
    held(scene).casters = () if traced is None else traced.casters


def update(context: bpy.types.Context, scene: bpy.types.Scene, asked: Asked, read: Read, at_once: bool) -> bool:
    """Show what is asked for, True where it is not shown already.

    at_once: in full before this returns; else soon, coarsely first. Raises SceneError where it can't be shown.
    """
    with lock:
        mine = held(scene)
        if asked.key == mine.shown and store.find_image(scene, store.CAUSTICS) is not None:
            mine.asked = None
            return False
        if not _prepare(context, scene, mine, read):
            return False
        _image.bring(context, scene, asked, read, at_once)
        return True


def values(context: bpy.types.Context, scene: bpy.types.Scene, asked: Asked, read: Read) -> np.ndarray | None:
    """(H, W, 3) float32 W/m²: what `update` would show, without showing it; None without casters."""
    with lock:
        mine = held(scene)
        if not _prepare(context, scene, mine, read):
            return None
        image = _image.value(context, scene, asked, read)
        mine.landed = Landed.of(mine.atlas.atlas, asked)
        return image[..., :3]


def _prepare(context, scene, mine: Held, read: Read) -> bool:
    """Read the surfaces where that is to be done; False where there turn out to be no casters."""
    if mine.atlas is not None:
        return True
    begin = time.perf_counter()
    panes, surfaces = read()
    found = casters(surfaces)
    mine.casters = () if found is None else found.objects
    if found is None:
        drop(scene)
        return False
    _image.prepare(context, mine, lambda: (panes, surfaces))
    mine.reading = time.perf_counter() - begin
    return True


def look_again(scene: bpy.types.Scene, fingerprint: dict[str, str]) -> bool:
    """After surfaces may have changed: True where the image shows others than these (`extract.fingerprint`)."""
    with lock:
        mine = known(scene)
        key = live_image.surfaces_key(fingerprint)
        if mine is None or mine.surfaces == key:
            return False
        former, mine.surfaces = mine.surfaces, key
        if not former:
            # a file that was just opened shows what it was saved with
            return False
        _image.drop_atlas(mine)
        mine.surfaces, mine.casters = key, _by_materials(scene)
        return True


def look_anew(scene: bpy.types.Scene) -> None:
    """Before light is worked out anew: where nothing cast caustics so far a material may have become glass, and of a file
    that was just opened it is not known where they fall."""
    mine = known(scene)
    if mine is not None and not mine.casters:
        mine.casters = None
    need_landings(scene)


def need_landings(scene: bpy.types.Scene) -> None:
    """Before the irradiance is worked out anew: it needs to know where the light falls that the image shows."""
    if is_baked(scene) and held(scene).landed.asked != held(scene).shown:
        # not known, or those of a frame that was only written to a file
        held(scene).shown = ""


def can_follow(scene: bpy.types.Scene, item: bpy.types.ID) -> bool:
    """Whether something that was moved casts caustics which are read fast enough to follow it."""
    mine = known(scene)
    if mine is None or not mine.casters or mine.reading >= READING:
        return False
    # of an instance: what makes it, and what it is one of
    return any(
        item.name == name or item.name in (name.partition(": ")[0], name.rpartition(": ")[2]) for name in mine.casters
    )


def landed(scene: bpy.types.Scene) -> Landed:
    """Where the light fell that the image shows, or showed when it was last worked out in full."""
    mine = known(scene)
    return mine.landed if mine is not None and is_baked(scene) else Landed()


def is_shown(scene: bpy.types.Scene) -> bool:
    """Whether the scene's bake has the image."""
    return store.find_image(scene, store.CAUSTICS) is not None


def drop(scene: bpy.types.Scene) -> None:
    """Take the image out of the bake, where it is."""
    if is_shown(scene):
        store.drop_image(scene, store.CAUSTICS)
        nodes.rebuild(scene)
        nodes.show_in_cycles(scene)


def end(scene: bpy.types.Scene) -> None:
    """Caustics are not wanted any more: forget them, and take the image out of the bake."""
    with lock:
        if (mine := known(scene)) is not None:
            live_image.settle(mine)
        forget(scene)
    drop(scene)


def _energy(atlas: CausticAtlas, lights: Iterable[Light]) -> dict[str, float]:
    """W, where the light went that lamps sent towards what casts caustics; suns are left out, whose power is W/m²."""
    total: dict[str, float] = {}
    for light in lights:
        if light.kind != "SUN":
            found, power = atlas.energy(light), float(light.power.mean())
            for part in fields(found):
                total[part.name] = total.get(part.name, 0.0) + power * getattr(found, part.name)
    return {name: round(value, 6) for name, value in total.items()}


def read_report(scene: bpy.types.Scene) -> dict | None:
    """What the bake says of its caustics."""
    return (store.read_meta(scene) or {}).get("report", {}).get("caustics")


def report(scene: bpy.types.Scene) -> dict | None:
    """For people and programs: casters, photons of each lamp, milliseconds of the last image, energy in W by where it went;
    None where nothing is focused."""
    if not is_baked(scene):
        return None
    mine = held(scene)
    return {
        "casters": list(mine.casters),
        "photons": photons_for(scene),
        "milliseconds": round(mine.milliseconds, 2),
        "energy": mine.energy,
    }


def sentences(scene: bpy.types.Scene) -> list[str]:
    """What the user should know about the scene's caustics."""
    mine = known(scene)
    told = [mine.error] if mine is not None and mine.error else []
    energy = mine.energy if mine is not None else {}
    if energy.get("untraced", 0.0) > UNTRACED * energy.get("emitted", 0.0):
        told.append(
            f"{100 * energy['untraced'] / energy['emitted']:.0f} % of the light that lamps send to what casts caustics is "
            "lost in it, after too many mirrors or sheets of glass: the caustics are that much too dark."
        )
    lit = sorted(item.name for item in vertices.lit(scene))
    if lit:
        names = ", ".join(f"'{name}'" for name in lit)
        told.append(f"Lit at their vertices, which hold no caustics: {names}.")
    return told
