"""The failure atlas' entries of odd input: their bounds hold."""

import pytest

pytest.importorskip("bpy")

from ..failures import page
from ..failures.registry import input_entries


@pytest.mark.parametrize("entry", input_entries(), ids=lambda entry: entry.slug)
def test_the_bound_holds(entry):
    found = entry.measure()
    assert entry.holds(found.value), f"{page.title(entry)}: {found.value:.4g}, {page.bound_of(entry)}. {found.detail}"
