"""Settings of Blender's own that a fix changed on request, and that Clear gives back.

Each is remembered on the data-block that it belongs to, a scene or an object, so it is saved, copied and undone
with it.
"""

from __future__ import annotations

import contextlib
import json

import bpy

KEY = "lightpanes_former"


def change(owner: bpy.types.ID, path: str, value) -> None:
    """Set the property at an RNA path of a data-block to a plain value and remember what it was."""
    memory = _memory(owner)
    was = owner.path_resolve(path)
    if was != value:
        # what a first fix found is the user's own
        memory[path] = [memory.get(path, [was])[0], value]
        _set(owner, path, value)
        owner[KEY] = json.dumps(memory)


def give_back(scene: bpy.types.Scene) -> None:
    """Undo all that `change` did to the scene and its objects, but for what the user has changed again since."""
    for owner in _owners(scene):
        for path, (was, ours) in _memory(owner).items():
            # settings of an add-on that is switched off are not there
            with contextlib.suppress(ValueError):
                if owner.path_resolve(path) == ours:
                    _set(owner, path, was)
        del owner[KEY]


def is_any(scene: bpy.types.Scene) -> bool:
    """Whether there is anything to give back."""
    return bool(_owners(scene))


def _owners(scene) -> list[bpy.types.ID]:
    return [owner for owner in (scene, *scene.objects) if KEY in owner and owner.library is None]


def _memory(owner) -> dict[str, list]:
    return json.loads(owner.get(KEY, "{}"))


def _set(owner, path, value) -> None:
    holder, _, name = path.rpartition(".")
    setattr(owner.path_resolve(holder) if holder else owner, name, value)
