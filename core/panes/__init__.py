"""Compress the transport into panes, and re-weight them at run time (the PRM of Szécsi & Szirmay-Kalos)."""

from .relighter import Panes, Relighter

__all__ = ["Panes", "Relighter"]
