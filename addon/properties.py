"""The settings that users and scripts rely on: `scene.lightpanes`, `object.lightpanes`, `light.lightpanes`."""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from ..core.memory import DEFAULT, LEAST_MEMORY


def _cycles_changed(_settings, context):
    from . import direct, nodes, store

    if store.find_entries(context.scene) is not None:
        nodes.show_in_cycles(context.scene)
        direct.link(context.scene)


def _live_changed(settings, context):
    from . import relight

    if settings.live:
        relight.update(context.scene, context.evaluated_depsgraph_get())


def _direct_changed(settings, context):
    from . import preflight, relight

    preflight.forget()
    relight.switch_direct(context, settings.id_data)


def _caustics_changed(settings, context):
    from . import preflight, relight

    preflight.forget()
    relight.switch_caustics(context, settings.id_data)


def _photons_changed(settings, context):
    _live_changed(settings, context)


def _samples_changed(_settings, context):
    _live_changed(context.scene.lightpanes, context)


def _plan_changed(_settings, _context):
    from . import preflight

    # Blender reports changes by the interface alone, not those by scripts
    preflight.forget()


def _show_points_changed(_settings, _context):
    from . import areas

    areas.redraw_viewports()


class SceneSettings(bpy.types.PropertyGroup):
    error_target: FloatProperty(
        name="Error",
        description="Relative error of the indirect light to bake for: smaller is more exact and slower",
        default=0.05,
        min=0.002,
        max=0.5,
        precision=3,
    )
    time_budget: FloatProperty(
        name="Time",
        description="Seconds that a bake may take, 0 for no limit. The error then is what the time allows",
        default=0.0,
        min=0.0,
        soft_max=600.0,
        unit="TIME_ABSOLUTE",
    )
    memory_budget: FloatProperty(
        name="Memory",
        description="GiB of memory that a bake may take beside what Blender has already. It works in smaller chunks and "
        "with fewer threads where that is little, and says so before it starts where it can't do with it",
        default=DEFAULT,
        min=LEAST_MEMORY,
        soft_max=64.0,
        max=4096.0,
        precision=2,
    )
    resolution: IntProperty(
        name="Resolution",
        description="Width and height of the atlas in pixels, shared by all baked objects",
        default=256,
        min=16,
        max=4096,
        subtype="PIXEL",
    )
    exits: EnumProperty(
        name="Light At",
        description="Where the bake gathers light",
        items=(
            ("AUTO", "Automatic", "At points where that is less work than at every texel"),
            ("POINTS", "Points", "At points, dense where light changes, between which texels are interpolated"),
            ("TEXELS", "Texels", "At every texel. Objects that are lit at their vertices need points all the same"),
            (
                "ATLAS",
                "Points, Spread to Texels",
                "At points, whose panes every texel then gets, as game engines read them",
            ),
        ),
        default="AUTO",
    )
    live: BoolProperty(
        name="Live",
        description="Let the indirect light follow the lamps at once when they move or change",
        default=True,
        update=_live_changed,
    )
    direct: EnumProperty(
        name="Direct Light",
        description="What brings the lamps' direct light to baked objects. Objects lit at their vertices, and those that "
        "are not baked, get it from the engine either way",
        items=(
            ("OFF", "Engine", "The engine that renders: the lamps shine as ever"),
            (
                "BAKED",
                "Baked",
                "The image Lightpanes Direct, soft shadows included, live as lamps move. Lamps then leave baked objects "
                "alone, by light linking",
            ),
        ),
        default="OFF",
        update=_direct_changed,
    )
    caustics: BoolProperty(
        name="Caustics",
        description="Follow the lamps' light through glass and off metals to where it is focused, in the image Lightpanes "
        "Caustics. A scene without smooth glass or metal does nothing for it",
        default=True,
        update=_caustics_changed,
    )
    photons: IntProperty(
        name="Photons",
        description="Photons of each lamp that caustics are made of. 0: as many as the error asks for",
        default=0,
        min=0,
        soft_max=1_000_000,
        max=100_000_000,
        update=_photons_changed,
    )
    seed: IntProperty(name="Seed", description="The same seed gives the same bake", default=0, min=0, max=2**31 - 1)
    cycles: BoolProperty(
        name="Show in Cycles",
        description="Cycles shows the baked indirect light too. While this is on, Cycles' own diffuse bounces are set "
        "to 0, so that no light counts twice",
        default=False,
        update=_cycles_changed,
    )
    samples: IntProperty(
        name="Samples",
        description="Frames of one sample a pixel that a render with the engine Lightpanes adds up",
        default=64,
        min=1,
        soft_max=1024,
        max=65536,
    )
    viewport_samples: IntProperty(
        name="Viewport",
        description="Frames that a viewport adds up before it rests",
        default=256,
        min=1,
        soft_max=4096,
        max=65536,
    )
    bounces: IntProperty(
        name="Bounces",
        description="Diffuse bounces of indirect light where no bake knows it, at most",
        default=8,
        min=0,
        soft_max=16,
        max=64,
    )
    show_points: EnumProperty(
        name="Points",
        description="Draw the points that hold the light in the 3D viewports",
        items=(
            ("NONE", "None", "No points"),
            ("RADIUS", "Radius", "Coloured by the distance that they keep: dark where they are dense"),
            ("AO", "Occlusion", "Coloured by ambient occlusion: dark where things are near"),
            ("IRRADIANCE", "Irradiance", "Coloured by the light that they hold now"),
        ),
        default="NONE",
        update=_show_points_changed,
    )
    storage: EnumProperty(
        name="Images",
        description="Where the images of a bake are kept when the .blend is saved",
        items=(
            ("PACKED", "In the .blend", "Packed: one file holds everything"),
            ("BESIDE", "Beside the .blend", "As 32-bit OpenEXR files in a folder that is named after the .blend"),
        ),
        default="PACKED",
    )
    # Cycles' diffuse bounces before `cycles` set them to 0; -1 while it has not.
    diffuse_bounces: IntProperty(default=-1, options={"HIDDEN"})
    # Cycles' caustics before they were switched off: 1 reflective + 2 refractive; -1 while they have not been.
    cycles_caustics: IntProperty(default=-1, options={"HIDDEN"})
    # What lamps leave alone while `direct` is BAKED, as excluded members (see linking).
    receivers: PointerProperty(type=bpy.types.Collection, options={"HIDDEN"})
    # The bake that belongs to the scene: changing this one pointer is the swap from the old bake to the new.
    entries: PointerProperty(type=bpy.types.Object, options={"HIDDEN"})


class ObjectSettings(bpy.types.PropertyGroup):
    exclude: BoolProperty(
        name="Exclude",
        description="Keep this object out of the atlas: it gets no baked light, but still blocks and reflects it",
        default=False,
        update=_plan_changed,
    )
    target: EnumProperty(
        name="Light In",
        description="Where this object keeps its baked light",
        items=(
            ("TEXTURE", "Texture", "In its place in the atlas"),
            (
                "VERTICES",
                "Vertices",
                "In the colour attribute lightpanes_irradiance of its mesh: no UV layer, no place in the atlas",
            ),
        ),
        default="TEXTURE",
        update=_plan_changed,
    )
    weight: FloatProperty(
        name="Weight",
        description="Texels that this object gets in the atlas, relative to its area; 2 doubles their density",
        default=1.0,
        min=0.01,
        soft_max=10.0,
        max=100.0,
    )


class LightSettings(bpy.types.PropertyGroup):
    live: BoolProperty(
        name="Live",
        description="Follow this lamp after the bake. Off: its light is baked in, which is faster and more exact, and "
        "changes with the next bake only",
        default=True,
        update=_plan_changed,
    )
    group: StringProperty(
        name="Group",
        description="Lamps of one group share an image wherever baked light is written by group",
    )
    samples: IntProperty(
        name="Samples",
        description="Samples of this lamp for its soft shadows where direct light is baked. 0: as many as the error asks "
        "for",
        default=0,
        min=0,
        soft_max=1024,
        max=4096,
        update=_samples_changed,
    )


CLASSES = (SceneSettings, ObjectSettings, LightSettings)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.lightpanes = PointerProperty(type=SceneSettings)
    bpy.types.Object.lightpanes = PointerProperty(type=ObjectSettings)
    bpy.types.Light.lightpanes = PointerProperty(type=LightSettings)


def unregister() -> None:
    del bpy.types.Light.lightpanes
    del bpy.types.Object.lightpanes
    del bpy.types.Scene.lightpanes
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
