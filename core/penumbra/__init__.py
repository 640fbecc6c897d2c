"""Which samples of an area lamp each receiver sees, exactly as shadow rays would say, at a cost below theirs."""

from .cast import cast
from .casting import cast_rays
from .cost import Cost
from .direct import DirectLight, is_soft, samples_for
from .lamp import LampSamples, sample_ball, sample_lamp, sample_quad
from .masks import AWAY, LIT, UMBRA, Masks, Statistics
from .occluders import Occluders
from .receivers import Receivers
from .shading import shade

__all__ = [
    "AWAY",
    "LIT",
    "UMBRA",
    "Cost",
    "DirectLight",
    "LampSamples",
    "Masks",
    "Occluders",
    "Receivers",
    "Statistics",
    "cast",
    "cast_rays",
    "is_soft",
    "sample_ball",
    "sample_lamp",
    "sample_quad",
    "samples_for",
    "shade",
]
