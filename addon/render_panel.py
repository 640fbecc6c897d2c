"""The engine's settings, and Blender's own panels, which work with it as with other engines."""

from __future__ import annotations

import bpy

from .render import ENGINE


class LIGHTPANES_PT_sampling(bpy.types.Panel):
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    bl_label = "Sampling"
    bl_order = -1
    COMPAT_ENGINES = {ENGINE}

    @classmethod
    def poll(cls, context):
        return context.engine in cls.COMPAT_ENGINES

    def draw(self, context):
        layout, settings = self.layout, context.scene.lightpanes
        layout.use_property_split = True
        layout.use_property_decorate = False
        column = layout.column(align=True)
        column.prop(settings, "samples")
        column.prop(settings, "viewport_samples")
        layout.prop(settings, "bounces")
        layout.prop(settings, "seed")
        layout.prop(context.scene.render, "filter_size")
        layout.prop(context.scene.render, "film_transparent")


# Panels that EEVEE shows and that would say nothing here.
FOREIGN = ("RENDER_PT_eevee", "RENDER_PT_shadows", "RENDER_PT_simplify_greasepencil", "DATA_PT_EEVEE", "WORLD_PT_eevee",
           "MATERIAL_PT_eevee", "EEVEE_")  # fmt: skip


def _panels():
    """Blender's panels for surfaces, lamps, world, camera and output: those that all engines share, and those by which
    EEVEE's users edit node trees and lamps."""
    shown = {"BLENDER_RENDER", "BLENDER_EEVEE", "BLENDER_EEVEE_NEXT"}
    nodes = {
        "EEVEE_MATERIAL_PT_context_material", "EEVEE_MATERIAL_PT_surface", "EEVEE_WORLD_PT_surface", "DATA_PT_EEVEE_light",
    }  # fmt: skip
    for panel in _subclasses(bpy.types.Panel):
        engines = getattr(panel, "COMPAT_ENGINES", None)
        if not isinstance(engines, set) or not engines & shown or panel.__module__.startswith(__package__):
            continue
        name = panel.__name__
        if "BLENDER_RENDER" in engines and not any(part in name for part in FOREIGN) or name in nodes:
            yield panel


def _subclasses(cls):
    for child in cls.__subclasses__():
        yield child
        yield from _subclasses(child)


def register() -> None:
    bpy.utils.register_class(LIGHTPANES_PT_sampling)
    for panel in _panels():
        panel.COMPAT_ENGINES.add(ENGINE)


def unregister() -> None:
    for panel in _subclasses(bpy.types.Panel):
        engines = getattr(panel, "COMPAT_ENGINES", None)
        if isinstance(engines, set):
            engines.discard(ENGINE)
    bpy.utils.unregister_class(LIGHTPANES_PT_sampling)
