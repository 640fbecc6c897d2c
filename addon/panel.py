"""The panels in Properties > Render, and the small ones of objects and lamps."""

from __future__ import annotations

import json
import textwrap
from functools import lru_cache

import bpy
from bpy.app.translations import pgettext_iface as iface_

from . import (
    animation,
    beside,
    caustics,
    direct,
    engine,
    figures,
    groups,
    job,
    obstacles,
    preflight,
    sessions,
    store,
    vertices,
)

MOST_OBSTACLES = 8
MOST_LAMPS = 24
MOST_SENTENCES = 8
MOST_CASTERS = 6

LAMP_ICONS = {"POINT": "LIGHT_POINT", "SUN": "LIGHT_SUN", "SPOT": "LIGHT_SPOT", "AREA": "LIGHT_AREA"}

# What the parts of a bake's error are called in its report → what the panel calls them.
ERROR_PARTS = {
    "panes": "Panes",
    "gather noise": "Noise",
    "points": "Points",
    "entries": "Entries",
    "lamps": "Lamp Sampling",
}
BOUNDS = {"error": "Error", "time": "Time", "most": "Size"}


class _Panel:
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_label = "Lightpanes"

    def begin(self) -> bpy.types.UILayout:
        """The panel's layout, in Blender's own style."""
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        return self.layout


class _SubPanel(_Panel):
    bl_context = "render"
    bl_parent_id = "LIGHTPANES_PT_render"
    bl_options = {"DEFAULT_CLOSED"}


class LIGHTPANES_PT_render(_Panel, bpy.types.Panel):
    bl_context = "render"

    def draw(self, context):
        layout, scene = self.begin(), context.scene
        if job.running():
            job.draw(layout, context)
            return
        if animation.running():
            layout.progress(factor=animation.progress(), type="BAR", text=iface_("Writing frames, Esc cancels"))
            return
        reason, found = engine.unusable(), preflight.inspect(context)
        baked = store.find_entries(scene) is not None
        _draw_buttons(layout, baked, reason is None, baked or found.can_give_back)
        if reason is not None:
            _sentence(layout, context, reason, "ERROR")
        _draw_preflight(layout, context, found)


def _draw_buttons(layout, baked: bool, can_bake: bool, can_clear: bool):
    row = layout.row(align=True)
    row.scale_y = 1.4
    button = row.row(align=True)
    button.enabled = can_bake
    button.operator("lightpanes.bake", text="Bake Again" if baked else "Bake", icon="LIGHT")
    if can_clear:
        row.operator("lightpanes.clear", text="", icon="TRASH")


def _draw_preflight(layout, context, found):
    box = layout.box().column(align=True)
    if found.forecast is not None:
        _fact(box, "Objects", _objects(found))
        _fact(box, "Light At", _places(found.forecast))
        _fact(box, "Lamps", _lamps(found))
        _fact(box, "Time", f"~ {figures.duration(found.forecast.seconds)}")
        _fact(box, "Memory", f"~ {figures.size(found.forecast.bytes)}")
    for obstacle in found.obstacles[:MOST_OBSTACLES]:
        part = box.column(align=True)
        part.separator()
        _sentence(part, context, obstacle.sentence, "CANCEL" if obstacle.severity == obstacles.ERROR else "ERROR")
        if obstacle.button:
            row = part.row()
            row.alignment = "RIGHT"
            button = row.operator(obstacle.OPERATOR, text=obstacle.button)
            for name, value in obstacle.properties.items():
                setattr(button, name, value)
    left = len(found.obstacles) - MOST_OBSTACLES
    if left > 0:
        box.label(text=iface_("{} more").format(left), icon="BLANK1")


def _objects(found) -> str:
    parts = [f"{found.objects:,}"]
    if found.at_vertices:
        parts.append(iface_("{} at vertices").format(f"{found.at_vertices:,}"))
    if found.excluded:
        parts.append(iface_("{} excluded").format(f"{found.excluded:,}"))
    if found.blockers > found.excluded:
        parts.append(iface_("{} only block light").format(f"{found.blockers - found.excluded:,}"))
    return ", ".join(parts)


def _places(forecast) -> str:
    if forecast.points:
        return iface_("{} points").format(f"{forecast.points:,}")
    return iface_("{} texels").format(f"{forecast.texels:,}")


def _lamps(found) -> str:
    parts = [iface_("{} live").format(f"{found.live:,}")]
    if found.static:
        parts.append(iface_("{} baked in").format(f"{found.static:,}"))
    return ", ".join(parts)


class LIGHTPANES_PT_quality(_SubPanel, bpy.types.Panel):
    bl_label = "Quality"
    bl_options = set()

    def draw(self, context):
        layout, settings = self.begin(), context.scene.lightpanes
        column = layout.column(align=True)
        column.prop(settings, "error_target")
        column.prop(settings, "time_budget")
        layout.prop(settings, "resolution")


class LIGHTPANES_PT_advanced(_SubPanel, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "LIGHTPANES_PT_quality"

    def draw(self, context):
        layout, settings = self.begin(), context.scene.lightpanes
        layout.prop(settings, "exits")
        row = layout.row()
        row.active = settings.caustics
        row.prop(settings, "photons")
        layout.prop(settings, "memory_budget")
        layout.prop(settings, "seed")


class LIGHTPANES_PT_lamps(_SubPanel, bpy.types.Panel):
    bl_label = "Lamps"

    def draw(self, context):
        layout, scene = self.layout, context.scene
        layout.use_property_split = False
        current, names = sessions.of(scene), preflight.inspect(context).lamps
        column = layout.column(align=True)
        if not names:
            column.label(text="No lamps", icon="INFO")
        items = [item for name in names if (item := bpy.data.objects.get(name)) is not None and item.type == "LIGHT"]
        # those without one come last
        items.sort(key=lambda item: (not (group := groups.group_of(item.data)), group))
        shown = None if items and groups.group_of(items[0].data) else ""
        for item in items[:MOST_LAMPS]:
            group = groups.group_of(item.data)
            if group != shown:
                shown = group
                column.label(text=group or iface_("No Group"), icon="GROUP", translate=False)
            row = column.split(factor=0.45, align=True)
            row.active = not item.hide_render
            row.label(text=item.name, icon=LAMP_ICONS.get(item.data.type, "LIGHT"), translate=False)
            row = row.split(factor=0.5, align=True)
            row.label(text="Baked In" if current is not None and item.name in current.static else "")
            row.prop(item.data.lightpanes, "live", toggle=True)
        if len(names) > MOST_LAMPS:
            column.label(text=iface_("{} more").format(len(names) - MOST_LAMPS), icon="BLANK1")


class LIGHTPANES_PT_results(_SubPanel, bpy.types.Panel):
    bl_label = "Results"
    bl_options = set()

    @classmethod
    def poll(cls, context):
        return store.find_entries(context.scene) is not None

    def draw(self, context):
        layout, scene = self.begin(), context.scene
        settings, current, report = scene.lightpanes, sessions.of(scene), _report(scene)
        layout.column(heading="Relight").prop(settings, "live")
        if not settings.live:
            layout.operator("lightpanes.relight", icon="FILE_REFRESH")
        column = layout.column(align=True)
        if report is None:
            _sentence(column, context, "The bake is damaged; bake again.", "ERROR")
            return
        if report.get("error") is not None:
            _fact(column, "Error", figures.percent(report["error"]))
            if report.get("error_95") is not None:
                _fact(column, "Worst 5 %", figures.percent(report["error_95"]), part=True)
            for name, value in report.get("error_parts", {}).items():
                _fact(column, ERROR_PARTS.get(name, name), figures.percent(value), part=True)
        if report.get("bound") in BOUNDS:
            _fact(column, "Bound By", iface_(BOUNDS[report["bound"]]))
        _fact(column, "Time", figures.duration(report.get("total_seconds", 0)))
        _fact(column, "Size", figures.size(report.get("bytes", 0)))
        _fact(column, "Rays", f"{report.get('rays', 0) / 1e6:.1f} M")
        if current.milliseconds:
            _fact(column, "Last Relight", f"{current.milliseconds:.1f} ms")
        told = [(sentence, "ERROR") for sentence in (current.error, *current.stale, *current.doubts) if sentence]
        told += [(sentence, "DOT") for sentence in report.get("warnings", [])]
        column = layout.column(align=True)
        for sentence, icon in told[:MOST_SENTENCES]:
            _sentence(column, context, sentence, icon)
        if len(told) > MOST_SENTENCES:
            column.label(text=iface_("{} more").format(len(told) - MOST_SENTENCES), icon="BLANK1")


class LIGHTPANES_PT_output(_SubPanel, bpy.types.Panel):
    bl_label = "Output"

    def draw(self, context):
        layout, scene = self.begin(), context.scene
        item = context.view_layer.objects.active
        if item is not None and item.type == "MESH" and store.TAG not in item:
            layout.prop(item.lightpanes, "target", text=item.name, translate=False)
        layout.prop(scene.lightpanes, "direct")
        layout.column(heading="Caustics").prop(scene.lightpanes, "caustics", text="")
        layout.prop(scene.lightpanes, "storage")
        if beside.problem():
            _sentence(layout, context, beside.problem(), "ERROR")
        if store.find_entries(scene) is None:
            return
        column = layout.column(align=True)
        for role in (store.IRRADIANCE, store.DIRECT, store.CAUSTICS, store.ALBEDO):
            image = store.find_image(scene, role)
            if image is not None:
                column.label(text=image.name, icon="IMAGE_DATA", translate=False)
        if (_report(scene) or {}).get("vertices"):
            column.label(text=vertices.LIGHT, icon="GROUP_VERTEX", translate=False)
        if direct.is_baked(scene):
            if milliseconds := direct.held(scene).milliseconds:
                _fact(column, "Last Direct Light", f"{milliseconds:.0f} ms")
            for sentence in direct.sentences(scene)[:MOST_SENTENCES]:
                _sentence(column, context, sentence, "DOT")
        if caustics.is_baked(scene):
            _draw_caustics(layout, context, caustics.held(scene))
        layout.prop(scene.lightpanes, "cycles")
        column = layout.column(align=True)
        column.operator("lightpanes.save_images", icon="IMAGE_DATA")
        column.operator("lightpanes.bake_animation", icon="RENDER_ANIMATION")


def _draw_caustics(layout, context, known):
    column = layout.column(align=True)
    names = ", ".join(known.casters[:MOST_CASTERS])
    if len(known.casters) > MOST_CASTERS:
        names += f", {iface_('{} more').format(len(known.casters) - MOST_CASTERS)}"
    _fact(column, "Caustics Of", names)
    if known.milliseconds:
        _fact(column, "Photons", f"{caustics.photons_for(context.scene):,}")
        _fact(column, "Last Caustics", f"{known.milliseconds:.0f} ms")
    for sentence in caustics.sentences(context.scene)[:MOST_SENTENCES]:
        _sentence(column, context, sentence, "DOT")


class LIGHTPANES_PT_debug(_SubPanel, bpy.types.Panel):
    bl_label = "Debug Views"

    @classmethod
    def poll(cls, context):
        return store.find_entries(context.scene) is not None

    def draw(self, context):
        layout, scene = self.begin(), context.scene
        row = layout.row()
        row.enabled = store.find_points(scene) is not None
        row.prop(scene.lightpanes, "show_points")
        layout.operator("lightpanes.show_error", icon="IMAGE_DATA")
        report = _report(scene) or {}
        column = layout.column(align=True)
        for label, key in (("Triangles", "triangles"), ("Entries", "entries"), ("Regions", "regions"),
                           ("Panes", "panes_per_texel"), ("Texels", "texels"), ("Points", "stored_points")):  # fmt: skip
            if report.get(key):
                _fact(column, label, f"{report[key]:,}")
        column = layout.column(align=True)
        for stage, seconds in report.get("stages", {}).items():
            _fact(column, stage, figures.duration(seconds))


class LIGHTPANES_PT_object(_Panel, bpy.types.Panel):
    bl_context = "object"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return context.object is not None and context.object.type == "MESH"

    def draw(self, context):
        layout, settings = self.begin(), context.object.lightpanes
        layout.prop(settings, "exclude")
        column = layout.column()
        column.active = not settings.exclude
        column.prop(settings, "target")
        row = column.row()
        row.active = settings.target == "TEXTURE"
        row.prop(settings, "weight")


class LIGHTPANES_PT_light(_Panel, bpy.types.Panel):
    bl_context = "data"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return context.light is not None

    def draw(self, context):
        layout, settings = self.begin(), context.light.lightpanes
        layout.prop(settings, "live")
        layout.prop(settings, "group")
        row = layout.row()
        row.active = context.scene.lightpanes.direct == "BAKED"
        row.prop(settings, "samples")


def _report(scene) -> dict | None:
    """The report of the scene's bake, None where it is damaged."""
    raw = store.find_entries(scene).data.get(store.META)
    return _parsed(raw) if isinstance(raw, str) else None


@lru_cache(maxsize=4)
def _parsed(raw: str) -> dict | None:
    """It holds a hash for each object of the scene, too much to read anew at every drawing."""
    try:
        return json.loads(raw).get("report", {})
    except (ValueError, AttributeError):
        return None


def _fact(layout, label: str, value: str, part: bool = False):
    """A name and its value, aligned as properties are. part: of the fact above."""
    split = layout.split(factor=0.4)
    left, right = split.row(), split.row()
    left.alignment = "RIGHT"
    left.active = not part
    left.label(text=label)
    right.active = not part
    right.label(text=value, translate=False)


def _sentence(layout, context, text: str, icon: str):
    """Labels don't wrap by themselves."""
    width = max(24, int(context.region.width / (7.5 * context.preferences.system.ui_scale)) - 6)
    for number, line in enumerate(textwrap.wrap(text, width)):
        layout.label(text=line, icon=icon if number == 0 else "BLANK1", translate=False)


CLASSES = (
    LIGHTPANES_PT_render,
    LIGHTPANES_PT_quality,
    LIGHTPANES_PT_advanced,
    LIGHTPANES_PT_lamps,
    LIGHTPANES_PT_results,
    LIGHTPANES_PT_output,
    LIGHTPANES_PT_debug,
    LIGHTPANES_PT_object,
    LIGHTPANES_PT_light,
)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
