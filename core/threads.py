"""Work spread over threads, in an order that does not depend on how many there are."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from itertools import count

from .memory import most_threads

MOST_THREADS = 16
"""More win nothing: the rest of a bake is bound by memory."""

_asked = 0
# Threads are kept, for to begin and end them takes half a millisecond, more than many pieces of work
_helpers = ThreadPoolExecutor(MOST_THREADS, "lightpanes")


def use_threads(count: int) -> None:
    """Let bakes and relights that begin from now on use so many threads, 0 for all cores (at most MOST_THREADS)."""
    global _asked
    _asked = count


def thread_count() -> int:
    """Threads that a bake uses: those asked for, or the cores this process may run on, at most MOST_THREADS, and no more
    than memory allows."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(MOST_THREADS, most_threads(), _asked or cores))


def in_threads(function: Callable, items: Iterable, threads: int | None = None) -> list:
    """[function(item) for item in items], on threads, in order; an exception ends what has not begun, and is raised.

    The calling thread is one of them, and does all by itself where no other is free: so calls may stand in calls.
    """
    items = list(items)
    threads = min(threads or thread_count(), len(items))
    if threads <= 1:
        return [function(item) for item in items]
    results, failed = [None] * len(items), []
    # a count's next is one step for Python: no two threads get the same
    turns = count()

    def work():
        for turn in turns:
            if turn >= len(items) or failed:
                return
            try:
                results[turn] = function(items[turn])
            except BaseException as error:
                failed.append((turn, error))

    helpers = [_helpers.submit(work) for _ in range(threads - 1)]
    try:
        work()
    finally:
        for helper in helpers:
            # those that have not begun have nothing left to do
            if not helper.cancel():
                helper.result()
    if failed:
        raise min(failed, key=lambda found: found[0])[1]
    return results
