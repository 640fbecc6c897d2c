"""The panel in Properties > Render, and the small ones of objects and lamps."""

from __future__ import annotations

import textwrap

import bpy

from . import operators, relight, store


class _Panel:
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_label = "Lightpanes"


class LIGHTPANES_PT_render(_Panel, bpy.types.Panel):
    bl_context = "render"

    def draw(self, context):
        layout, scene = self.layout, context.scene
        settings = scene.lightpanes
        baked = store.find_entries(scene) is not None
        layout.use_property_split = True
        layout.use_property_decorate = False

        row = layout.row(align=True)
        row.scale_y = 1.4
        row.operator("lightpanes.bake", text="Bake Again" if baked else "Bake", icon="LIGHT")
        if baked:
            row.operator("lightpanes.clear", text="", icon="TRASH")

        column = layout.column()
        column.prop(settings, "error_target")
        column.prop(settings, "time_budget")
        column.prop(settings, "resolution")
        column.prop(settings, "exits")
        column.prop(settings, "seed")
        if baked:
            column = layout.column(heading="Show")
            column.prop(settings, "live")
            column.prop(settings, "cycles", text="In Cycles")
            if store.find_points(scene) is not None:
                column.prop(settings, "show_points")
            if not settings.live:
                layout.operator("lightpanes.relight", icon="FILE_REFRESH")
            self._draw_result(layout, context)

    def _draw_result(self, layout, context):
        meta, current = store.read_meta(context.scene), relight.session(context.scene)
        box = layout.box().column(align=True)
        if meta is None:
            _sentence(box, context, "The bake is damaged; bake again.", "ERROR")
            return
        report = meta.get("report", {})
        _sentence(box, context, operators.summary(report), "INFO")
        if current.milliseconds:
            box.label(text=f"Last relight {current.milliseconds:.1f} ms", icon="TIME")
        if current.error:
            _sentence(box, context, current.error, "ERROR")
        for sentence in current.stale:
            _sentence(box, context, sentence, "ERROR")
        for sentence in report.get("warnings", [])[:8]:
            _sentence(box, context, sentence, "DOT")


class LIGHTPANES_PT_object(_Panel, bpy.types.Panel):
    bl_context = "object"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return context.object is not None and context.object.type == "MESH"

    def draw(self, context):
        self.layout.use_property_split = True
        settings = context.object.lightpanes
        self.layout.prop(settings, "exclude")
        column = self.layout.column()
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
        self.layout.use_property_split = True
        self.layout.prop(context.light.lightpanes, "live")


def _sentence(layout, context, text: str, icon: str):
    """Labels don't wrap by themselves."""
    width = max(24, int(context.region.width / (7.5 * context.preferences.system.ui_scale)) - 6)
    for number, line in enumerate(textwrap.wrap(text, width)):
        layout.label(text=line, icon=icon if number == 0 else "BLANK1")


CLASSES = (LIGHTPANES_PT_render, LIGHTPANES_PT_object, LIGHTPANES_PT_light)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
