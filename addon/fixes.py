"""What the buttons beside obstacles do: the operator `lightpanes.fix` and a function for each kind of obstacle."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import contextmanager

import bpy
from mathutils import Vector

from ..core.scene import SceneError
from . import baking, foreign, former, glassware, preflight, relight, vertices, world_light
from .meshes import LAYER
from .obstacles import Facts, Obstacle
from .twice import NO_LIGHT

LAMP_POWER = 10.0
"""W for each m² of the extent of what is lit: a lamp in the middle of a room lights it as a bright lamp would."""

SUN_POWER = 1.0  # W/m²


class LIGHTPANES_OT_fix(bpy.types.Operator):
    bl_idname = "lightpanes.fix"
    bl_label = "Fix"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    kind: bpy.props.StringProperty(options={"HIDDEN"})
    target: bpy.props.StringProperty(options={"HIDDEN"})

    @classmethod
    def description(cls, _context, properties):
        return HELP.get(properties.kind, "")

    def execute(self, context):
        obstacle = _find(context, self.kind, self.target)
        if obstacle is None:
            preflight.forget()
            self.report({"INFO"}, "Nothing is left to fix here")
            return {"CANCELLED"}
        try:
            left = FIXES[self.kind](context, obstacle) or []
        except SceneError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            preflight.forget()
        for sentence in left:
            self.report({"WARNING"}, sentence)
        # what was mended can be undone only by an operator that has finished
        return {"FINISHED"}


def _find(context, kind, target) -> Obstacle | None:
    """The obstacle as it is now, which may differ from what the panel drew."""
    for obstacle in preflight.examine(context).obstacles:
        if (obstacle.kind, obstacle.target) == (kind, target) and obstacle.button:
            return obstacle
    return None


def _objects(context, obstacle) -> list[bpy.types.Object]:
    uids = {uid for _, uid in obstacle.about}
    return [item for item in context.scene.objects if item.session_uid in uids]


def _each(items: Iterable, mend: Callable) -> list[str]:
    """Mend one object after the other; returns what is to be said of those for which that raised a SceneError. Where
    none could be mended, and so nothing has changed, raises the first."""
    items, left = list(items), []
    for item in items:
        try:
            mend(item)
        except SceneError as error:
            left.append(error)
    if left and len(left) == len(items):
        raise left[0]
    return [str(error) for error in left]


def _editable(items: Iterable) -> list[bpy.types.Object]:
    return [item for item in items if item.library is None]


def _show(context, obstacle):
    """Let objects render: themselves, and the collections that hide them."""
    wanted = set(_objects(context, obstacle))
    for item in _editable(wanted):
        item.hide_render = False

    def visit(layer):
        inside = bool(wanted.intersection(layer.collection.objects))
        for child in layer.children:
            inside |= visit(child)
        if inside:
            layer.exclude = False
            if layer.collection.library is None:
                layer.collection.hide_render = False
        return inside

    for child in context.view_layer.layer_collection.children:
        visit(child)
    context.scene.collection.hide_render = False


def _include(context, obstacle):
    for item in _editable(_objects(context, obstacle)):
        item.lightpanes.exclude = False


def _exclude(context, obstacle):
    for item in _editable(_objects(context, obstacle)):
        item.lightpanes.exclude = True


def _hide(context, obstacle):
    for item in _editable(_objects(context, obstacle)):
        item.hide_render = True


def _object_mode(context, obstacle):
    if context.active_object is None or context.active_object.mode == "OBJECT":
        for item in _objects(context, obstacle):
            context.view_layer.objects.active = item
            bpy.ops.object.mode_set(mode="OBJECT")
    else:
        bpy.ops.object.mode_set(mode="OBJECT")


def _rename_layer(context, obstacle):
    for item in _objects(context, obstacle):
        _rename(item.data, LAYER)


def _rename_light(context, obstacle):
    for item in _objects(context, obstacle):
        _rename(item.data, vertices.LIGHT)


def _rename(mesh, name):
    """Give the user's attribute the first free name after its own."""
    number = 1
    while f"{name}.{number:03d}" in mesh.attributes:
        number += 1
    mesh.attributes[name].name = f"{name}.{number:03d}"


def _exits(context, _obstacle):
    context.scene.lightpanes.exits = "AUTO"


def _light(context, obstacle):
    """Show the lamps that there are, or add one in the middle of all that renders."""
    if obstacle.about:
        _show(context, obstacle)
        return
    middle, extent = _bounds(context)
    data = bpy.data.lights.new("Lamp", "POINT")
    data.energy = LAMP_POWER * max(extent, 1.0) ** 2
    lamp = bpy.data.objects.new("Lamp", data)
    lamp.location = middle
    context.scene.collection.objects.link(lamp)


def _power(context, obstacle):
    _, extent = _bounds(context)
    for item in _objects(context, obstacle):
        if item.data.library is None and item.data.energy == 0:
            item.data.energy = SUN_POWER if item.data.type == "SUN" else LAMP_POWER * max(extent, 1.0) ** 2


def _bounds(context) -> tuple[Vector, float]:
    """Middle and largest side, in metres, of the box around all that can be lit."""
    corners = [
        item.matrix_world @ Vector(corner)
        for item in Facts(context).shown
        for corner in item.bound_box
    ]  # fmt: skip
    if not corners:
        return Vector(), 1.0
    low = Vector(min(corner[k] for corner in corners) for k in range(3))
    high = Vector(max(corner[k] for corner in corners) for k in range(3))
    return (low + high) / 2, max(high - low)


def _convert(context, obstacle):
    def convert(item):
        with _alone(context, item):
            bpy.ops.object.convert(target="MESH")

    return _each(_objects(context, obstacle), convert)


def _make_real(context, obstacle):
    for item in _objects(context, obstacle):
        with _alone(context, item):
            bpy.ops.object.duplicates_make_real()


@contextmanager
def _alone(context, item):
    """One object selected and active: some operators take the selection and nothing else."""
    layer = context.view_layer
    selected, active = list(context.selected_objects), layer.objects.active
    hidden, switched_off = item.hide_get(view_layer=layer), item.hide_viewport
    try:
        item.hide_viewport = False
        item.hide_set(False, view_layer=layer)
        for other in selected:
            other.select_set(False, view_layer=layer)
        item.select_set(True, view_layer=layer)
        layer.objects.active = item
        if not item.select_get(view_layer=layer):
            raise SceneError(f"'{item.name}' is hidden in the viewport by its collection: show that first.")
        yield
    finally:
        for other in list(context.selected_objects):
            other.select_set(False, view_layer=layer)
        item.hide_viewport = switched_off
        item.hide_set(hidden, view_layer=layer)
        for other in selected:
            if other.name in layer.objects:
                other.select_set(True, view_layer=layer)
        layer.objects.active = active


def _make_local(context, obstacle):
    def make(item):
        if item.library is not None:
            local = item.make_local()
            if local is None or local.library is not None:
                raise SceneError(
                    f"'{item.name}' is in a linked collection: use Object > Library Override > Make first."
                )
            item = local
        if item.data.library is not None:
            item.data = item.data.copy()

    return _each(_objects(context, obstacle), make)


def _foreign_light(context, _obstacle):
    entries = foreign.adoptable(context.scene)
    if entries is not None:
        context.scene.lightpanes.entries = entries
        relight.update(context.scene, context.evaluated_depsgraph_get())
    else:
        baking.clear_scene(context)


def _single_user(context, obstacle):
    for item in _objects(context, obstacle):
        item.data = item.data.copy()


def _world_light(context, _obstacle):
    world_light.hide(context.scene.world)


def _world_outdated(context, _obstacle):
    world_light.follow(context.scene.world)


def _fast_gi(context, _obstacle):
    scene = context.scene
    former.change(scene, "eevee.use_fast_gi", True)
    former.change(scene, "eevee.fast_gi_method", NO_LIGHT)
    if scene.eevee.ray_tracing_options.trace_max_roughness >= 1:
        former.change(scene, "eevee.ray_tracing_options.trace_max_roughness", 0.5)


def _probes(context, obstacle):
    for item in _editable(_objects(context, obstacle)):
        former.change(item, "hide_render", True)
        former.change(item, "hide_viewport", True)


def _lamps_to_engine(context, _obstacle):
    context.scene.lightpanes.direct = "OFF"


def _cycles_bounces(context, _obstacle):
    # what they were before Show in Cycles is remembered by the setting itself
    context.scene.cycles.diffuse_bounces = 0


def _cycles_fast_gi(context, _obstacle):
    former.change(context.scene, "cycles.use_fast_gi", False)


def _cycles_caustics(context, _obstacle):
    # what they were before Show in Cycles is remembered by the setting itself
    cycles = context.scene.cycles
    cycles.caustics_reflective = cycles.caustics_refractive = False


def _shadow_caustics(context, obstacle):
    for item in _objects(context, obstacle):
        if item.data.library is None and item.library is None:
            former.change(item, "data.cycles.is_caustics_light", False)


def _solidify(context, obstacle):
    for item in _editable(_objects(context, obstacle)):
        added = item.modifiers.new("Solidify", "SOLIDIFY")
        added.thickness = glassware.THICK * max(
            side / abs(scale or 1.0) for side, scale in zip(item.dimensions, item.scale, strict=True)
        )


def _photons(context, obstacle):
    context.scene.lightpanes.photons = glassware.photons_needed(len(obstacle.about))


# Each returns what it could not mend, if anything; it raises SceneError only where it has changed nothing.
FIXES: dict[str, Callable[[bpy.types.Context, Obstacle], list[str] | None]] = {
    "ALL_HIDDEN": _show,
    "ALL_EXCLUDED": _include,
    "EDIT_MODE": _object_mode,
    "OTHER_MODE": _object_mode,
    "UV_LAYERS": _exclude,
    "ATTRIBUTE": _rename_layer,
    "EXITS": _exits,
    "NO_LAMP": _light,
    "NO_POWER": _power,
    "CONVERT": _convert,
    "INSTANCES": _make_real,
    "LINKED": _make_local,
    "FOREIGN_LIGHT": _foreign_light,
    "FACELESS": _hide,
    "SHARED_MESH": _single_user,
    "LIGHT_ATTRIBUTE": _rename_light,
    "WORLD_LIGHT": _world_light,
    "WORLD_OUTDATED": _world_outdated,
    "FAST_GI": _fast_gi,
    "LIGHT_PROBES": _probes,
    "LAMPS": _lamps_to_engine,
    "CYCLES_BOUNCES": _cycles_bounces,
    "CYCLES_FAST_GI": _cycles_fast_gi,
    "CYCLES_CAUSTICS": _cycles_caustics,
    "SHADOW_CAUSTICS": _shadow_caustics,
    "OPEN_GLASS": _solidify,
    "MANY_CASTERS": _photons,
}

HELP = {
    "ALL_HIDDEN": "Turn on the camera icons of all meshes and of the collections that they are in",
    "ALL_EXCLUDED": "Clear Exclude on all of these objects",
    "EDIT_MODE": "Leave Edit Mode",
    "OTHER_MODE": "Go back to Object Mode",
    "UV_LAYERS": "Keep this object out of the bake: it gets no baked light, but still blocks and reflects it",
    "ATTRIBUTE": "Give the attribute another name, which nodes and drivers that use it then need too",
    "EXITS": "Let the bake choose where it gathers light",
    "NO_LAMP": "Show the lamps that are hidden from renders, or add a point lamp in the middle of the scene",
    "NO_POWER": "Give these lamps a power that suits the size of the scene",
    "CONVERT": "Turn these objects into meshes, which keep their shape and lose its curve or text",
    "INSTANCES": "Turn the instances into objects of their own, so that each gets its place in the atlas",
    "LINKED": "Copy these objects and their meshes into this file",
    "FOREIGN_LIGHT": "Let the light follow this file's lamps where its bake is here, else take it off the objects, as "
    "Clear does",
    "FACELESS": "Hide these objects from renders",
    "SHARED_MESH": "Give this object a mesh of its own",
    "LIGHT_ATTRIBUTE": "Give the attribute another name, which nodes that use it then need too",
    "WORLD_LIGHT": "EEVEE shows the world where the camera sees it and lights and reflects nothing with it. "
    "Clear takes that back",
    "WORLD_OUTDATED": "Let EEVEE show the camera what the world's own output shows now",
    "FAST_GI": "Ray tracing goes on for reflections, and diffuse surfaces get ambient occlusion only. "
    "Clear gives the settings back",
    "LIGHT_PROBES": "Hide the volume probes from renders and viewports. Clear shows them again",
    "LAMPS": "Take the lamps' direct light out of the bake",
    "CYCLES_BOUNCES": "Leave diffuse bounces to the baked light. Turning Show in Cycles off gives them back",
    "CYCLES_CAUSTICS": "Leave caustics to the baked ones. Turning Show in Cycles off gives them back",
    "OPEN_GLASS": "Give the glass a thickness, a hundredth of its size, by a modifier",
    "MANY_CASTERS": "Raise Photons, which also makes caustics slower to follow lamps",
    "SHADOW_CAUSTICS": "Leave caustics to the baked ones. Clear gives the lamps' setting back",
    "CYCLES_FAST_GI": "Leave ambient light to the baked light. Clear gives the setting back",
}


def register() -> None:
    bpy.utils.register_class(LIGHTPANES_OT_fix)


def unregister() -> None:
    bpy.utils.unregister_class(LIGHTPANES_OT_fix)
