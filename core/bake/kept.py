"""What a cancelled bake had finished: the next one of the same scene with the same settings goes on from there."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import TypeVar

import numpy as np

from ..planner import Settings
from ..scene import Scene
from .cache import VERSION, Cache

T = TypeVar("T")


class Cancelled(Exception):
    """Raised in a progress callback to cancel a bake; what is finished by then may be kept."""


class Kept:
    """Finished parts of one bake, by name: in memory, and after a cancel in `cache` too, where there is one.

    seconds: that the cancelled bakes took, all together; reached: how far they came, a fraction of the whole.
    """

    def __init__(self, cache: Cache | None = None):
        self.cache = cache
        self._forget()

    def open(self, scene: Scene, settings: Settings) -> None:
        """Forget everything that belongs to another scene or to other settings."""
        key = digest(_what_counts(scene), settings)
        if key != self.key:
            self._forget()
            self.key = key

    def clear(self) -> None:
        """The bake is done, or can't be: forget its parts, those in files too."""
        if self.cache is not None and self.key:
            self.cache.forget(self._file_key)
        self._forget()

    def _forget(self) -> None:
        self.key = b""
        self.parts: dict[str, object] = {}
        # what the memory needs no more and a file would
        self._dropped: dict[str, object] = {}
        self.seconds = self.reached = 0.0

    def drop(self, *names: str) -> None:
        """Forget parts that another one holds by now."""
        for name in names:
            part = self.parts.pop(name, None)
            if part is not None and self.cache is not None:
                self._dropped[name] = part

    def only(self, name: str) -> None:
        """Forget all other parts, and what they took."""
        self.parts, self._dropped = {name: self.parts[name]}, {}
        self.seconds = self.reached = 0.0

    def part(self, name: str, make: Callable[[], T]) -> T:
        """What `make` returned when it first finished."""
        if name not in self.parts:
            part = self.cache.load(self._file_key, digest(name)) if self.cache is not None else None
            self.parts[name] = make() if part is None else part
        return self.parts[name]

    def save(self) -> None:
        """Write to files what is finished by now, as far as it can be."""
        if self.cache is not None and self.key:
            for name, part in (self._dropped | self.parts).items():
                self.cache.save(self._file_key, digest(name), part)

    @property
    def _file_key(self) -> bytes:
        """Other versions may count otherwise."""
        return digest(self.key, VERSION, np.__version__)


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
