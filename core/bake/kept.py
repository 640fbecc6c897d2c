"""What a cancelled bake had finished: the next one of the same scene with the same settings goes on from there."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import TypeVar

import numpy as np

from ..planner import Settings
from ..scene import Scene

T = TypeVar("T")


class Cancelled(Exception):
    """Raised in a progress callback to cancel a bake; what is finished by then may be kept."""


class Kept:
    """Finished parts of one bake, in memory, by name."""

    def __init__(self):
        self.key = b""
        self.parts: dict[str, object] = {}

    def open(self, scene: Scene, settings: Settings) -> None:
        """Forget everything that belongs to another scene or to other settings."""
        key = digest(_what_counts(scene), settings)
        if key != self.key:
            self.clear()
            self.key = key

    def clear(self) -> None:
        self.key = b""
        self.parts = {}

    def drop(self, *names: str) -> None:
        """Forget parts that another one holds by now."""
        for name in names:
            self.parts.pop(name, None)

    def only(self, name: str) -> None:
        """Forget all other parts."""
        self.parts = {name: self.parts[name]}

    def part(self, name: str, make: Callable[[], T]) -> T:
        """What `make` returned when it first finished."""
        if name not in self.parts:
            self.parts[name] = make()
        return self.parts[name]


def _what_counts(scene: Scene) -> list:
    """All of a scene that its bake depends on. Live lamps tell where light gets to, and panes are then for any lamp: so
    their places count, in their order, but not their power, size or name."""
    kept = [getattr(scene, field.name) for field in fields(scene) if field.name != "lights"]
    for light in scene.lights:
        if not light.live:
            kept.append(light)
        elif light.kind == "SUN":
            kept.append("SUN")
        else:
            kept += [light.kind, light.position, light.direction if light.kind == "AREA" else None]
    return kept


def digest(*things: object) -> bytes:
    """16 bytes that differ when any number, array, text or dataclass field in `things` does."""
    total = hashlib.blake2b(digest_size=16)

    def add(thing):
        if isinstance(thing, np.ndarray):
            total.update(f"{thing.dtype}{thing.shape}".encode())
            total.update(np.ascontiguousarray(thing).data)
        elif is_dataclass(thing):
            for field in fields(thing):
                total.update(field.name.encode())
                add(getattr(thing, field.name))
        elif isinstance(thing, (list, tuple)):
            total.update(f"({len(thing)}".encode())
            for item in thing:
                add(item)
        else:
            total.update(repr(thing).encode())

    add(things)
    return total.digest()
