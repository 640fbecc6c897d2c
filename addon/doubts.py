"""What to tell the user about lamps where they are now: the bake may not know light there, or they light nothing."""

from __future__ import annotations

from collections.abc import Sequence

from ..core.panes import Relighter
from ..core.panes.trust import Expected, trust
from ..core.scene import Light
from . import figures


def sentences(relighter: Relighter, lights: Sequence[Light], expected: Expected) -> tuple[str, ...]:
    """For the lamps that were just relit."""
    found = trust(relighter, lights, expected)
    told = [
        f"Lamp '{light.name}' lights nothing that was baked: it is inside of a thing, or outside of the room."
        for light in found.nowhere
    ]
    if found.warns(expected):
        name, error, target = found.worst.name, figures.percent(found.error), figures.percent(expected.target)
        if found.close:
            told.append(
                f"Lamp '{name}' is so close to a surface that the light it bounces is wrong by about {error}, where "
                f"{target} was asked for: move it away, or switch its Live off and bake again."
            )
        else:
            told.append(
                f"Lamp '{name}' shines where this bake is wrong by about {error}, where {target} was asked for: lower "
                "Error, or switch its Live off, and bake again."
            )
    return tuple(told)
