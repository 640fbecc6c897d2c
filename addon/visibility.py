"""What a render shows, whatever the viewport hides.

Blender gives Python only the viewport's depsgraph. It hides what the viewport hides and evaluates
modifiers at the viewport's settings, so `as_rendered` sets those to the render's for a moment.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import bpy


def rendered_objects(view_layer: bpy.types.ViewLayer) -> set[bpy.types.Object]:
    """Objects that Cycles renders in their own right: not excluded from the view layer, and neither
    they nor every collection they are in hidden from renders."""
    shown: set[bpy.types.Object] = set()

    def visit(layer, hidden):
        hidden = hidden or layer.collection.hide_render
        if not (hidden or layer.exclude):
            shown.update(obj for obj in layer.collection.objects if not obj.hide_render)
        for child in layer.children:
            visit(child, hidden)

    visit(view_layer.layer_collection, False)
    return shown


def rendered_members(collection: bpy.types.Collection) -> set[bpy.types.Object]:
    """Objects that an instance of the collection renders."""
    if collection.hide_render:
        return set()
    shown = {obj for obj in collection.objects if not obj.hide_render}
    for child in collection.children:
        shown |= rendered_members(child)
    return shown


class _Switches:
    """Sets properties and puts them back in reverse order."""

    def __init__(self):
        self.undo = []

    def set(self, owner, name: str, value) -> None:
        old = getattr(owner, name)
        if old != value:
            setattr(owner, name, value)
            self.undo.append((setattr, owner, name, old))

    def unhide(self, obj, view_layer) -> None:
        if obj.hide_get(view_layer=view_layer):
            obj.hide_set(False, view_layer=view_layer)
            self.undo.append((lambda o, _, layer: o.hide_set(True, view_layer=layer), obj, None, view_layer))

    def restore(self) -> None:
        for action, owner, name, old in reversed(self.undo):
            action(owner, name, old)


def _modifiers(switches, obj):
    for modifier in obj.modifiers:
        switches.set(modifier, "show_viewport", modifier.show_render)
        if modifier.type in {"SUBSURF", "MULTIRES"} and obj.mode == "OBJECT":
            switches.set(modifier, "levels", modifier.render_levels)


def _collections(switches, layer):
    if not layer.collection.hide_render:
        switches.set(layer, "hide_viewport", False)
        switches.set(layer.collection, "hide_viewport", False)
    for child in layer.children:
        _collections(switches, child)


def _instanced(switches, collection, seen):
    """The instanced collection's members, shown as a render shows them, and their own instances."""
    if collection in seen:
        return
    seen.add(collection)
    for part in (collection, *collection.children_recursive):
        if not part.hide_render:
            switches.set(part, "hide_viewport", False)
    for obj in rendered_members(collection):
        switches.set(obj, "hide_viewport", False)
        _modifiers(switches, obj)
        if obj.instance_type == "COLLECTION" and obj.instance_collection:
            _instanced(switches, obj.instance_collection, seen)


@contextmanager
def as_rendered(
    context: bpy.types.Context, objects: Iterable[bpy.types.Object] | None = None
) -> Iterator[bpy.types.Depsgraph]:
    """The depsgraph with all that renders, or those of the objects that do, made visible and modifiers at their render
    settings.

    Only settings that differ are touched, and all are put back. What the viewport shows and a
    render does not is still in the depsgraph: filter it by `rendered_objects`.
    """
    view_layer = context.view_layer
    switches = _Switches()
    try:
        _collections(switches, view_layer.layer_collection)
        seen: set[bpy.types.Collection] = set()
        wanted = rendered_objects(view_layer)
        for obj in wanted if objects is None else wanted.intersection(objects):
            switches.set(obj, "hide_viewport", False)
            switches.unhide(obj, view_layer)
            switches.set(obj, "show_instancer_for_viewport", obj.show_instancer_for_render)
            _modifiers(switches, obj)
            if obj.instance_type == "COLLECTION" and obj.instance_collection:
                _instanced(switches, obj.instance_collection, seen)
        if switches.undo:
            view_layer.update()
        yield context.evaluated_depsgraph_get()
    finally:
        switches.restore()
        if switches.undo:
            view_layer.update()


@contextmanager
def awake(view_layer: bpy.types.ViewLayer) -> Iterator[None]:
    """Lamps that render follow their animation meanwhile, whatever the viewport hides.

    Blender leaves an object that the viewport hides where it was when last seen: lamps, unlike meshes, are read from
    the viewport's depsgraph at each frame. Nothing is touched where no lamp sleeps.
    """
    shown = rendered_objects(view_layer)
    lamps = {obj for obj in shown if obj.type == "LIGHT" and obj.library is None}
    switches, woken = _Switches(), set()

    def visit(layer, hidden) -> bool:
        """Show lamps in a collection that is in the viewport; whether any was hidden."""
        hidden = hidden or layer.collection.hide_viewport
        found = False
        if not layer.exclude:
            here = [obj for obj in layer.collection.objects if obj in lamps and (hidden or obj.hide_viewport)]
            for obj in here:
                switches.set(obj, "hide_viewport", False)
            woken.update(here)
            found = bool(here)
        for child in layer.children:
            found = visit(child, hidden) or found
        if found and layer.collection.library is None:
            switches.set(layer.collection, "hide_viewport", False)
        return found

    try:
        visit(view_layer.layer_collection, False)
        if switches.undo:
            for item in _movers(woken):
                # what is new in the depsgraph comes with the values of the frame at which it was last in it
                item.update_tag(refresh={"TIME"})
            view_layer.update()
        yield
    finally:
        switches.restore()
        if switches.undo:
            view_layer.update()


def _movers(objects) -> set[bpy.types.ID]:
    """The objects, their data, and all objects that move them as parents or targets of constraints."""
    found, pending = set(), list(objects)
    while pending:
        item = pending.pop()
        if item is None or item in found:
            continue
        found.add(item)
        if isinstance(item, bpy.types.Object):
            pending += [item.data, item.parent, *(getattr(each, "target", None) for each in item.constraints)]
    return found
