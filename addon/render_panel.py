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


# Of the panels that all engines share, those that say nothing here, by parts of their names.
SILENT = ("freestyle", "grease_pencil", "stereoscopy", "DATA_PT_light", "NODE_DATA_PT_light", "TEXTURE_PT", "volume")
# By which EEVEE's users edit materials, worlds and lamps.
EEVEES = {
    "EEVEE_MATERIAL_PT_context_material",
    "EEVEE_MATERIAL_PT_surface",
    "EEVEE_WORLD_PT_surface",
    "DATA_PT_EEVEE_light",
}


def _panels():
    """Blender's panels that work with this engine as with others."""
    for panel in _subclasses(bpy.types.Panel):
        engines, name = getattr(panel, "COMPAT_ENGINES", None), panel.__name__
        if not isinstance(engines, set) or panel is LIGHTPANES_PT_sampling:
            continue
        if name in EEVEES or ("BLENDER_RENDER" in engines and not any(part in name for part in SILENT)):
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
    for panel in _panels():
        panel.COMPAT_ENGINES.discard(ENGINE)
    bpy.utils.unregister_class(LIGHTPANES_PT_sampling)
