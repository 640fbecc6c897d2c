"""What stands in the way of a bake, as far as Blender's data tell without a mesh being evaluated.

Each obstacle is a sentence for the user and, where one click can mend it, the label of that button; `fixes` holds what
the buttons do. What only a bake finds out (charts that don't fit, vertices that are not numbers) is not here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import bpy

from . import foreign, materials, refusals, store, vertices, visibility
from .extract import GEOMETRY, NOT_TRACED
from .refusals import is_linked, named

ERROR, WARNING = "ERROR", "WARNING"

MOST_REAL = 1000
"""Instances that one click may turn into objects."""


@dataclass(frozen=True)
class Obstacle:
    """kind: its name, and that of its fix. severity: ERROR where a bake can't be made or would hold nothing, else
    WARNING. about: names of the objects that it is about, and the numbers that tell them apart, since a linked and a
    local one may share a name. button: label of the one-click fix, "" without one. target: what tells obstacles of one
    kind apart, the object's number for those that a button mends, "" where one stands for all objects."""

    kind: str
    severity: str
    sentence: str
    about: tuple[tuple[str, int], ...] = ()
    button: str = ""
    target: str = ""

    OPERATOR = "lightpanes.fix"

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(name for name, _ in self.about)

    @property
    def properties(self) -> dict[str, str]:
        """Of OPERATOR, for this obstacle's button."""
        return {"kind": self.kind, "target": self.target}


class Facts:
    """What the finders of obstacles and the forecast both need to know, read once.

    surfaces: objects with a shape, but ours. rendered: all that render. shown: surfaces that render. receivers: those
    that get light. instancers: of collections, empty ones included. lamps: that render.
    """

    def __init__(self, context: bpy.types.Context):
        self.context = context
        self.scene: bpy.types.Scene = context.scene
        self.rendered = visibility.rendered_objects(context.view_layer)
        self.surfaces, self.instancers, self.all_lamps = [], [], []
        for item in self.scene.objects:
            if item.type == "LIGHT":
                self.all_lamps.append(item)
            elif item.type in GEOMETRY and store.TAG not in item:
                self.surfaces.append(item)
            if item.instance_collection is not None:
                self.instancers.append(item)
        self.shown = [item for item in self.surfaces if item in self.rendered]
        self.lamps = [item for item in self.all_lamps if item in self.rendered]
        self.receivers = [item for item in self.shown if _receives(item)]

    @cached_property
    def at_vertices(self) -> list[bpy.types.Object]:
        """Receivers that ask for light at their vertices and can have it, as far as their modifiers allow."""
        asking = [item for item in self.receivers if item.lightpanes.target == "VERTICES"]
        return [item for item in asking if self.sharer(item) is None and not _has_own_light(item)]

    def sharer(self, item: bpy.types.Object) -> bpy.types.Object | None:
        """Another receiver that has the same mesh."""
        return next((other for other in self._users[item.data] if other != item), None)

    @cached_property
    def _users(self) -> dict[bpy.types.Mesh, list[bpy.types.Object]]:
        users: dict[bpy.types.Mesh, list[bpy.types.Object]] = {}
        for item in self.receivers:
            users.setdefault(item.data, []).append(item)
        return users


def _receives(item) -> bool:
    return (
        item.type == "MESH"
        and not item.lightpanes.exclude
        and not is_linked(item)
        and (item.mode == "EDIT" or len(item.data.polygons) > 0)
    )


def _has_own_light(item) -> bool:
    """Whether the user's own attribute stands where light at vertices would go."""
    return vertices.LIGHT in item.data.attributes and vertices.OURS not in item.data


def find(facts: Facts) -> list[Obstacle]:
    """All of them, those that stop a bake first."""
    found = [obstacle for finder in FINDERS for obstacle in finder(facts)]
    return sorted(found, key=lambda obstacle: obstacle.severity != ERROR)


def about(*items: bpy.types.ID) -> tuple[tuple[str, int], ...]:
    return tuple((item.name, item.session_uid) for item in items)


def _nothing(facts) -> Iterator[Obstacle]:
    """The scene has nothing that a bake could light: the first reason that holds."""
    begin, scene = "There is nothing to bake:", facts.scene.name
    shown = facts.shown
    if not facts.surfaces and not facts.instancers:
        yield Obstacle("NO_MESH", ERROR, f"{begin} scene '{scene}' has no mesh. Add one.")
    elif not shown and not facts.rendered.intersection(facts.instancers):
        yield Obstacle(
            "ALL_HIDDEN",
            ERROR,
            f"{begin} every mesh in scene '{scene}' is hidden from renders. "
            "Turn on its camera icon in the Outliner, or that of its collection.",
            about(*facts.surfaces),
            "Show in Renders",
        )
    elif shown and all(item.lightpanes.exclude for item in shown):
        sentence = f"{begin} every mesh in scene '{scene}' is excluded from Lightpanes."
        yield Obstacle("ALL_EXCLUDED", ERROR, sentence, about(*shown), "Include All")
    elif shown and all(item.type == "MESH" and not item.data.polygons for item in shown):
        sentence = f"{begin} '{shown[0].name}' has no faces. Add some."
        yield Obstacle("NO_FACES", ERROR, sentence, about(*shown))
    elif not facts.receivers:
        sentence = "No object can receive light: add a mesh with faces that renders, or clear Exclude on one."
        yield Obstacle("NO_RECEIVER", ERROR, sentence)


def _mode(facts) -> Iterator[Obstacle]:
    editing = [item for item in facts.surfaces if item.type == "MESH" and item.data.is_editmode]
    if editing:
        sentence = refusals.in_edit_mode(editing[0])
        yield Obstacle("EDIT_MODE", ERROR, sentence, about(*editing), "Leave Edit Mode")
    elif facts.context.mode != "OBJECT":
        sentence = "Bakes start in Object Mode only, and another mode is on."
        yield Obstacle("OTHER_MODE", ERROR, sentence, button="To Object Mode")


def _layers(facts) -> Iterator[Obstacle]:
    """Meshes in which the UV layer finds no place."""
    lit = set(facts.at_vertices)
    for item in facts.receivers:
        if item in lit or item.data.is_editmode:
            continue
        target = str(item.session_uid)
        if refusals.has_no_layer_left(item):
            yield Obstacle("UV_LAYERS", ERROR, refusals.no_layer_left(item), about(item), "Exclude", target)
        if refusals.has_foreign_attribute(item):
            yield Obstacle("ATTRIBUTE", ERROR, refusals.foreign_attribute(item), about(item), "Rename", target)


def _exits(facts) -> Iterator[Obstacle]:
    if facts.scene.lightpanes.exits == "ATLAS" and facts.at_vertices:
        yield Obstacle(
            "EXITS",
            ERROR,
            f"'Points, Spread to Texels' has no place for light at vertices, as {named(facts.at_vertices)} would have it.",
            about(*facts.at_vertices),
            "Light At: Automatic",
        )


def _lamps(facts) -> Iterator[Obstacle]:
    lamps = facts.lamps
    if not lamps and not facts.instancers:
        yield Obstacle(
            "NO_LAMP",
            WARNING,
            f"Scene '{facts.scene.name}' has no visible lamp; the light follows as soon as you add or show one.",
            about(*facts.all_lamps),
            "Show Lamps" if facts.all_lamps else "Add Lamp",
        )
    dark = [item for item in lamps if item.data.energy == 0 and item.data.animation_data is None]
    # one live lamp that is off among others is how lamps are used
    if len(dark) < len(lamps):
        dark = [item for item in dark if not item.data.lightpanes.live]
    if dark:
        sentence = f"The power of {named(dark)} is 0, so that there is no light to bake."
        button = "Set Power" if any(item.data.library is None for item in dark) else ""
        yield Obstacle("NO_POWER", WARNING, sentence, about(*dark), button)


def _not_meshes(facts) -> Iterator[Obstacle]:
    """Curves and the like, which have faces but no UVs."""
    curved = [item for item in facts.shown if item.type != "MESH" and not item.lightpanes.exclude and has_surface(item)]
    simple = [item for item in curved if converts_safely(item)]
    for items, button in ((simple, "Convert to Mesh"), ([item for item in curved if item not in simple], "")):
        if items:
            one = len(items) == 1
            what = "is not a mesh: it blocks and reflects" if one else "are not meshes: they block and reflect"
            kind = "CONVERT" if button else "NOT_A_MESH"
            sentence = f"{named(items)} {what} light but receive{'s' * one} none. Use Object > Convert > Mesh."
            yield Obstacle(kind, WARNING, sentence, about(*items), button)


def has_surface(item: bpy.types.Object) -> bool:
    """Whether a curve or text has faces and not only a line; modifiers might make some."""
    data = item.data
    if item.type not in {"CURVE", "FONT"} or len(item.modifiers):
        return True
    filled = data.fill_mode != "NONE" and (item.type == "FONT" or data.dimensions == "2D")
    return filled or data.extrude > 0 or data.bevel_depth > 0 or data.bevel_object is not None


def converts_safely(item: bpy.types.Object) -> bool:
    """Whether Convert to Mesh loses nothing but the handles: no other user, no animation of the shape, no family."""
    data = item.data
    return (
        item.type in {"CURVE", "SURFACE", "FONT"}
        and not is_linked(item)
        and data.users == 1
        and data.animation_data is None
        and data.shape_keys is None
    )


def _instances(facts) -> Iterator[Obstacle]:
    for item in facts.scene.objects:
        kind = item.instance_type
        if kind == "NONE" or item not in facts.rendered or not _makes_meshes(item):
            continue
        count = {"VERTS": "vertices", "FACES": "polygons"}.get(kind)
        few = count is None or len(getattr(item.data, count)) <= MOST_REAL
        yield Obstacle(
            "INSTANCES",
            WARNING,
            refusals.instances(item),
            about(item),
            "Make Real" if few and item.library is None else "",
            str(item.session_uid),
        )


def _makes_meshes(item) -> bool:
    if item.instance_type == "COLLECTION":
        collection = item.instance_collection
        return collection is not None and any(part.type in GEOMETRY for part in collection.all_objects)
    return item.type == "MESH" and any(child.type in GEOMETRY for child in item.children)


def _particles(facts) -> Iterator[Obstacle]:
    instancing, strands = [], []
    for item in facts.shown:
        kinds = {system.settings.render_type for system in item.particle_systems}
        if kinds & {"OBJECT", "COLLECTION"}:
            instancing.append(item)
        if kinds - {"OBJECT", "COLLECTION", "NONE"}:
            strands.append(item)
    if instancing:
        sentence = f"Particles of {named(instancing)} block and reflect light but receive none."
        yield Obstacle("PARTICLES", WARNING, sentence, about(*instancing))
    if strands:
        sentence = f"Hair or particles of {named(strands)} are not objects: they neither block nor reflect light."
        yield Obstacle("HAIR", WARNING, sentence, about(*strands))


def _linked(facts) -> Iterator[Obstacle]:
    linked = [item for item in facts.shown if item.type == "MESH" and not item.lightpanes.exclude and is_linked(item)]
    if linked:
        yield Obstacle("LINKED", WARNING, refusals.linked(linked), about(*linked), "Make Local")


def _missing(facts) -> Iterator[Obstacle]:
    """Files of the bake that are not where they were; the irradiance is made anew."""
    lost = [
        item for item in store.images_of(facts.scene) if item[store.TAG] != store.IRRADIANCE and store.is_lost(item)
    ]
    if lost:
        paths = sorted(str(store.path_of(image)) for image in lost)
        if len(paths) == 1:
            sentence = f"The file '{paths[0]}' of this bake is missing: put it back, or bake again."
        else:
            sentence = f"The file '{paths[0]}' and {len(paths) - 1} more of this bake are missing: put them back, or bake again."
        yield Obstacle("MISSING_FILE", WARNING, sentence)


def _foreign(facts) -> Iterator[Obstacle]:
    """Objects that show light of other bakes than the scene's."""
    groups: dict[tuple, list] = {}
    for item in foreign.carriers(facts.scene):
        groups.setdefault((foreign.source(item, facts.scene), item.library), []).append(item)
    for (source, library), items in groups.items():
        show = f"{named(items)} show{'s' * (len(items) == 1)} the light of"
        button = ""
        if source is not None:
            sentence = f"{show} scene '{source.name}', as its lamps are. Bake here to replace it."
        elif library is not None:
            sentence = f"{show} a bake in '{bpy.path.basename(library.filepath)}', as it was when that was saved."
        elif foreign.adoptable(facts.scene) is not None:
            sentence, button = f"{show} a bake that came along from another file.", "Use That Bake"
        else:
            sentence = f"{show} a bake that is not in this file, as it was last shown. Bake to replace it."
            button = "Remove That Light" if store.find_entries(facts.scene) is None else ""
        yield Obstacle("FOREIGN_LIGHT", WARNING, sentence, about(*items), button, str(items[0].session_uid))


def _faceless(facts) -> Iterator[Obstacle]:
    """Among objects that have faces; modifiers might make some."""
    empty = [
        item
        for item in facts.shown
        if item.type == "MESH" and not (item.data.polygons or item.modifiers or item.mode == "EDIT")
    ]
    if empty and facts.receivers:
        sentence = f"{named(empty)} {'has' if len(empty) == 1 else 'have'} no faces and so no part in the bake."
        yield Obstacle("FACELESS", WARNING, sentence, about(*empty), "Hide from Renders")


def _untraced(facts) -> Iterator[Obstacle]:
    met: dict[str, list] = {}
    for item in facts.rendered:
        if item.type in NOT_TRACED:
            met.setdefault(item.type, []).append(item)
    for kind in sorted(met):
        items = sorted(met[kind], key=lambda item: item.name)
        sentence = f"{named(items)}: {NOT_TRACED[kind]} neither blocks nor reflects light in a bake."
        yield Obstacle("UNTRACED", WARNING, sentence, about(*items), target=kind)


def _vertices(facts) -> Iterator[Obstacle]:
    """Objects that ask for light at their vertices and would take a texture instead."""
    for item in facts.receivers:
        if item.lightpanes.target != "VERTICES" or item.mode == "EDIT":
            continue
        target, other = str(item.session_uid), facts.sharer(item)
        if other is not None:
            sentence = refusals.shares_mesh(item, other)
            yield Obstacle("SHARED_MESH", WARNING, sentence, about(item), "Make Single User", target)
        elif _has_own_light(item):
            sentence = refusals.has_own_light(item, vertices.LIGHT)
            yield Obstacle("LIGHT_ATTRIBUTE", WARNING, sentence, about(item), "Rename", target)


def _looks(facts) -> Iterator[Obstacle]:
    """Materials that do what a bake does not know."""
    told: list[str] = []
    for material in {slot.material: None for item in facts.shown for slot in item.material_slots if slot.material}:
        materials.look(material, told)
    for sentence in dict.fromkeys(told):
        yield Obstacle("MATERIAL", WARNING, sentence, target=sentence)


FINDERS: tuple[Callable[[Facts], Iterator[Obstacle]], ...] = (
    _nothing,
    _mode,
    _layers,
    _exits,
    _lamps,
    _not_meshes,
    _instances,
    _linked,
    _missing,
    _foreign,
    _faceless,
    _vertices,
    _particles,
    _untraced,
    _looks,
)
