"""What to tell the user about a bake that is not of the scene as it is now."""

from __future__ import annotations

from collections.abc import Iterable

from ..core.scene import Light
from .lamps import lamp_key


def of_lamps(static: dict[str, str], panes: bool, shining: Iterable[Light]) -> tuple[str, ...]:
    """What to tell the user about lamps that the bake holds, and those that it cannot show.

    static: keys of the lamps that are baked in, by name. panes: whether the bake holds any. shining: the lamps now.
    """
    now = {light.name: light for light in shining}
    told = []
    for name, key in static.items():
        if name not in now:
            told.append(f"Lamp '{name}' is baked in, and was deleted, hidden or switched off since; bake again.")
        elif lamp_key([now[name]]) != key:
            told.append(f"Lamp '{name}' is baked in, and was changed since; bake again.")
        elif now[name].live:
            told.append(f"Lamp '{name}' is baked in; bake again to make it live.")
    if not panes:
        others = [f"'{name}'" for name in now if name not in static]
        if others:
            told.append(f"This bake has no live lamp, so it cannot show {', '.join(others)}; bake again.")
    return tuple(told)


def of_objects(before: dict[str, str], now: dict[str, str]) -> tuple[str, ...]:
    """What to tell the user about objects that were added, deleted or edited; fingerprints by object name."""
    gone = [f"'{name}' was deleted or hidden" for name in before if name not in now]
    new = [f"'{name}' was added" for name in now if name not in before]
    # "" is an object that the viewport hides, which can't be read
    edited = [
        f"'{name}' was moved or edited" for name, was in before.items() if was and now.get(name, was) not in (was, "")
    ]
    return tuple(f"{what} since the bake; bake again." for what in gone + edited + new)
