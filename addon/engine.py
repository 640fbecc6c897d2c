"""Whether this Blender can trace rays, and what to tell the user where it can't."""

from __future__ import annotations

import platform
import sys

from ..core import rays

# What Python calls the systems that embreex exists for → what people call them.
SYSTEMS = {
    ("Linux", "x86_64"): "Linux x64",
    ("Windows", "AMD64"): "Windows x64",
    ("Darwin", "arm64"): "macOS arm64",
}

_said = False


def unusable() -> str | None:
    """One sentence that says why nothing can be baked or relit here and what to do; None where all is well."""
    if not rays.UNUSABLE:
        return None
    system = SYSTEMS.get((platform.system(), platform.machine()))
    if system is None:
        *most, last = SYSTEMS.values()
        known = f"{', '.join(most)} and {last}"
        return f"Lightpanes can't bake or relight here: its library embreex exists for {known} only; use one of these."
    if __package__.startswith("bl_ext."):
        cure = f"install the Lightpanes zip for {system} and restart Blender"
    else:
        cure = "install it (pip install embreex) and start again"
    return f"Lightpanes can't bake or relight, because its library embreex does not load ({rays.UNUSABLE}); {cure}."


def ready() -> bool:
    """Whether rays can be traced. For handlers: the first time that they can't, the console says why."""
    global _said
    reason = unusable()
    if reason is not None and not _said:
        _said = True
        print(f"Lightpanes: {reason}", file=sys.stderr)
    return reason is None
