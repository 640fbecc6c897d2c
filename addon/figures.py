"""Numbers as people read them."""

from __future__ import annotations


def duration(seconds: float) -> str:
    """As people say it: 0.4 s, 12 s, 3 min 20 s."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    whole = int(seconds + 0.5)
    return f"{whole} s" if whole < 60 else f"{whole // 60} min {whole % 60} s"


def size(count: float) -> str:
    """Bytes in the unit that suits."""
    for unit in ("B", "KB", "MB"):
        if count < 1000:
            return f"{count:.0f} {unit}"
        count /= 1000
    return f"{count:.1f} GB"


def percent(value: float) -> str:
    return f"{100 * value:.1f} %"
