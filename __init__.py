"""Lightpanes: bake how a scene passes light around once, then relight it live."""

__version__ = "0.1.0"


def register() -> None:
    """Add Lightpanes to the running Blender (works in the pip bpy without preferences, too)."""
    from . import addon

    addon.register()


def unregister() -> None:
    """Remove Lightpanes from the running Blender."""
    from . import addon

    addon.unregister()
