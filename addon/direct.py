"""The lamps' direct light in `Lightpanes Direct`, where the scene asks for it: its soft shadows follow the lamps, too.

How it follows them, coarsely or in full, is `live_image`'s.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import bpy
import numpy as np

from ..core.direct_atlas import DirectAtlas
from ..core.panes import Panes
from ..core.penumbra import samples_for
from ..core.rays import Tracer
from ..core.scene import Light, Scene, SceneError
from . import claims, linking, live_image, nodes, store, vertices
from .lamps import lamp_key, read_lights
from .live_image import PACKED, SURFACES, LiveImage, lock
from .meshes import AT_VERTICES

Read = Callable[[], tuple[Panes, Scene, Tracer]]
"""The bake's panes, and the scene's surfaces as they are now, with their shadow rays."""

# On `Lightpanes Direct`: the names of the objects of the lamps that it shows.
OWNERS = "lightpanes_owners"


@dataclass(frozen=True)
class Asked:
    """What an image is to show. samples, owners: by lamp's name; owners are objects' names. key: of it all."""

    lights: tuple[Light, ...]
    samples: dict[str, int]
    owners: tuple[str, ...]
    key: str


@dataclass
class Held(live_image.Held):
    """linked: what `link` last went by. left_out: sentences about lamps that the image does not show."""

    linked: tuple = ()
    left_out: tuple[str, ...] = ()


class _Direct(LiveImage):
    role = store.DIRECT
    held_as = Held

    def is_baked(self, scene):
        return is_baked(scene)

    def begin(self, scene):
        begin(scene)

    def make_atlas(self, panes, surfaces, tracer):
        return make_atlas(panes, surfaces, tracer)

    def images(self, atlas, asked, full) -> Iterator[np.ndarray]:
        yield (atlas.image if full else atlas.coarse)(asked.lights, asked.samples)

    def show(self, scene, mine, asked, image, full):
        store.write_image(scene, store.DIRECT, _with_steady(scene, image))
        shown = store.find_image(scene, store.DIRECT)
        if shown.get(OWNERS) != (names := json.dumps(asked.owners)):
            shown[OWNERS] = names
        # objects may have come or gone; while a lamp is dragged the same ones are taken to be there
        if full or mine.linked != _basis(scene, asked.owners):
            link(scene)

    def undone(self):
        super().undone()
        for mine in self._held.values():
            mine.linked = ()


_image = _Direct()
held, forget, adopt = _image.held, _image.forget, _image.adopt
finish, note_packed, look_again = _image.finish, _image.note_packed, _image.look_again


def is_baked(scene: bpy.types.Scene) -> bool:
    """Whether the scene has a bake and wants the lamps' direct light in it."""
    return scene.lightpanes.direct == "BAKED" and store.find_entries(scene) is not None


def make_atlas(panes: Panes, surfaces: Scene, tracer: Tracer, asked: Asked | None = None) -> DirectAtlas:
    """The texels of a bake. asked: lamps to cast at once. Nothing of Blender is read: it may run beside it."""
    own = panes.own
    if own is None:
        own = np.zeros(panes.resolution**2, bool)
        own[panes.texel] = True
    atlas = DirectAtlas(surfaces, panes.resolution, tracer, own)
    if asked is not None:
        atlas.image(asked.lights, asked.samples)
    return atlas


def forget_surfaces(scene: bpy.types.Scene) -> None:
    """Glass lets other light pass now."""
    with lock:
        if (mine := _image.known(scene)) is not None:
            _image.drop_atlas(mine)


def ask_now(context: bpy.types.Context) -> Asked:
    """What a bake of the context's scene is going to show."""
    owners: dict[str, bpy.types.Object] = {}
    lights = read_lights(context.evaluated_depsgraph_get(), [], owners)
    return ask(context.scene, lights, (), owners)[0]


def begin(scene: bpy.types.Scene) -> None:
    """Make room for the lamps' light in the bake's images; it is not in them yet."""
    if store.find_image(scene, store.STEADY) is not None:
        return
    image = store.find_image(scene, store.DIRECT)
    if store.holds_direct(scene):
        if image is None:
            raise SceneError(f"The image '{store.DIRECT}' has been deleted; bake again.")
        store.add_image(scene, store.STEADY, store.read_image(scene, store.DIRECT))
    elif image is None:
        size = store.find_image(scene, store.IRRADIANCE)
        if size is None:
            raise SceneError(f"The image '{store.IRRADIANCE}' has been deleted; bake again.")
        width, height = size.size
        store.add_image(scene, store.DIRECT, store.opaque(np.zeros((height, width, 3), np.float32)))
    else:
        return
    nodes.rebuild(scene)


def end(scene: bpy.types.Scene) -> None:
    """Leave the lamps' direct light to the engine again; the bake's images are then as they were baked."""
    linking.give_back(scene)
    with lock:
        forget(scene)
    image = store.find_image(scene, store.DIRECT)
    if store.find_entries(scene) is None or image is None:
        return
    steady = store.read_image(scene, store.STEADY)
    if steady is not None:
        store.write_image(scene, store.DIRECT, steady)
        image.pack()
        for key in (PACKED, SURFACES, OWNERS):
            if key in image:
                del image[key]
        store.drop_image(scene, store.STEADY)
        nodes.rebuild(scene)
    elif not store.holds_direct(scene):
        store.drop_image(scene, store.DIRECT)
        nodes.rebuild(scene)
    elif image.is_dirty:
        # undo took away what was beside the packed pixels, which are what was baked
        image.reload()


def ask(
    scene: bpy.types.Scene,
    lights: Iterable[Light],
    baked_in: Iterable[Light],
    owners: dict[str, bpy.types.Object],
) -> tuple[Asked, tuple[str, ...]]:
    """What the image is to show under these lamps, and sentences about those that it leaves out.

    baked_in: lamps that are not live, as they were baked. owners: each lamp's object, by the lamp's name.
    """
    few = samples_for(scene.lightpanes.error_target)
    chosen, samples, names, told = [], {}, [], []
    for light in (*lights, *baked_in):
        owner = owners.get(light.name)
        # a lamp that was baked in and is gone shines on, as its indirect light does
        reason = linking.obstacle(owner) if owner is not None else ""
        if reason:
            told.append(f"Lamp '{light.name}' {reason}, so its direct light is left to the engine.")
            continue
        own = owner.data.lightpanes.samples if owner is not None else 0
        chosen.append(light)
        samples[light.name] = own or few
        if owner is not None:
            names.append(owner.name)
    key = f"{lamp_key(chosen)} {list(samples.values())}"
    return Asked(tuple(chosen), samples, tuple(dict.fromkeys(names)), key), tuple(told)


def update(
    context: bpy.types.Context, scene: bpy.types.Scene, asked: tuple[Asked, tuple[str, ...]], read: Read, at_once: bool
) -> bool:
    """Show what is asked for (see `ask`), True where it is not shown already.

    at_once: in full before this returns; else soon, coarsely first. Raises SceneError where it can't be shown.
    """
    what, left_out = asked
    with lock:
        mine = held(scene)
        mine.left_out = left_out
        if what.key == mine.shown and store.find_image(scene, store.DIRECT) is not None:
            mine.asked = None
            if mine.linked != _basis(scene, what.owners):
                link(scene)
            return False
        _image.bring(context, scene, what, read, at_once)
        return True


def values(
    context: bpy.types.Context, scene: bpy.types.Scene, asked: tuple[Asked, tuple[str, ...]], read: Read
) -> np.ndarray:
    """(H, W, 3) float32 W/m²: what `update` would show, without showing it."""
    with lock:
        return _with_steady(scene, _image.value(context, scene, asked[0], read))[..., :3]


def link(scene: bpy.types.Scene) -> None:
    """Keep lamps off the objects that show their light already, in the engine that the scene renders with."""
    image = store.find_image(scene, store.DIRECT)
    if not is_baked(scene) or image is None or not _is_shown(scene):
        linking.give_back(scene)
        names = ()
    else:
        names = tuple(json.loads(image.get(OWNERS, "[]")))
        owners = (bpy.data.objects.get(name) for name in names)
        lamps = [item for item in owners if item is not None and item.type == "LIGHT" and not linking.obstacle(item)]
        objects = claims.baked_objects(scene)
        linking.keep_off(
            scene, lamps, [item for item in objects if AT_VERTICES not in item and nodes.shows(item, scene)]
        )
    if (mine := _image.known(scene)) is not None:
        mine.linked = _basis(scene, names)


def sentences(scene: bpy.types.Scene) -> list[str]:
    """What the user should know about the scene's direct light."""
    mine = _image.known(scene)
    told = [mine.error] * bool(mine.error) + list(mine.left_out) if mine is not None else []
    lit = sorted(item.name for item in vertices.lit(scene))
    if lit:
        names = ", ".join(f"'{name}'" for name in lit)
        told.append(f"Lit at their vertices, which hold no direct light of lamps: {names}.")
    return told


def _is_shown(scene) -> bool:
    """Whether the engine shows the bake."""
    return scene.render.engine != "CYCLES" or scene.lightpanes.cycles


def _basis(scene, names) -> tuple:
    return scene.render.engine, scene.lightpanes.cycles, names


def _with_steady(scene, image: np.ndarray) -> np.ndarray:
    """The image, (H, W, 4), with what sky and emissive faces bring added in place."""
    steady = store.read_image(scene, store.STEADY)
    if steady is not None:
        image[..., :3] += steady[..., :3]
    return image
