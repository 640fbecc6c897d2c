"""Long work as a generator, so that Blender can breathe, and the user press Esc, between its steps.

Such a generator acts on Blender from the main thread. It yields how far it is, or a `Work` that needs no Blender, whose
result is sent back to it; who drives it decides whether that runs on a thread.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass


@dataclass(frozen=True)
class Work:
    """run(progress) needs no Blender; it calls progress with what the generator itself yields. alone: whether the
    generator, too, holds nothing of Blender's meanwhile, so that anything may happen there."""

    run: Callable[[Callable], object]
    alone: bool = False


def run(steps: Generator, progress: Callable | None = None):
    """Drive a generator to its end on this thread; returns what it returns.

    progress: called with all that it yields; an exception that it raises ends the work where it stands.
    """
    progress = progress or (lambda _: None)
    answer = None
    try:
        while True:
            step = steps.send(answer)
            answer = None
            try:
                if isinstance(step, Work):
                    answer = step.run(progress)
                else:
                    progress(step)
            except BaseException as error:
                steps.throw(error)
                raise
    except StopIteration as end:
        return end.value


def mapped(steps: Generator, change: Callable) -> Generator:
    """The same work, with all that it yields as progress changed."""
    answer = None
    try:
        while True:
            try:
                step = steps.send(answer)
            except StopIteration as end:
                return end.value
            if isinstance(step, Work):
                step = Work(lambda progress, part=step: part.run(lambda value: progress(change(value))), step.alone)
            else:
                step = change(step)
            try:
                answer = yield step
            except BaseException as error:
                steps.throw(error)
                raise
    finally:
        steps.close()
