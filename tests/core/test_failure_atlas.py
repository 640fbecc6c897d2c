"""The failure atlas (tests/failures): its bounds hold, the tests that it names exist, and the page says the same."""

import ast
from pathlib import Path

import pytest

from ..failures import page
from ..failures.registry import core_entries

TESTS = Path(__file__).resolve().parents[1]

pytestmark = pytest.mark.thorough


@pytest.mark.parametrize("entry", core_entries(), ids=lambda entry: entry.slug)
def test_the_bound_holds(entry):
    found = entry.measure()
    assert entry.holds(found.value), f"{page.title(entry)}: {found.value:.4g}, {page.bound_of(entry)}. {found.detail}"


def functions_of(path: Path) -> set[str]:
    return {node.name for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}


def registered() -> list[tuple[str, tuple[str, ...], float]]:
    """(slug, tests, bound) of all entries, those of input read from their source, since they need Blender."""
    found = [(entry.slug, entry.tests, entry.bound) for entry in core_entries()]
    source = ast.parse((TESTS / "failures" / "input.py").read_text())
    constants = {
        node.targets[0].id: node.value.value
        for node in source.body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
    }
    for node in source.body:
        for call in getattr(node, "decorator_list", ()):
            if isinstance(call, ast.Call) and call.func.id == "entry":
                bound, tests = call.args[4:6]
                value = constants[bound.id] if isinstance(bound, ast.Name) else bound.value
                found.append((node.name, tuple(tests.value.split()), value))
    return found


def test_every_test_that_is_named_exists():
    assert len(registered()) > 40
    for slug, tests, _ in registered():
        assert tests, slug
        for name in tests:
            path, _, function = name.partition("::")
            assert function in functions_of(TESTS / path), f"{slug}: there is no test {name}"


def test_the_page_has_every_entry_with_its_bound_and_picture():
    """Else run `make failures`."""
    text = page.PAGE.read_text()
    for slug, _, bound in registered():
        picture = page.PICTURES / f"{slug}.png"
        assert 500 < picture.stat().st_size < 200_000, slug
        before, _, _ = text.partition(f"](failures/{slug}.png)")
        assert before != text, f"the page lacks {slug}"
        written = before.rpartition("- **Bound** ")[2].splitlines()[0]
        assert float(written.split()[-1]) == bound, slug
    assert {path.stem for path in page.PICTURES.iterdir()} == {slug for slug, *_ in registered()}


def test_the_design_s_list_is_whole():
    """One entry at least of each method's part, as many as the design lists, the sweeps, and a wall that leaks."""
    count = {part: sum(entry.part == part for entry in core_entries()) for part in page.PARTS}
    assert count | {"Input": 13} == {
        "Panes": 10,
        "Point cache": 6,
        "Penumbra casting": 6,
        "Implicit cache": 6,
        "Caustics": 5,
        "Lamp sweeps": 4,
        "Input": 13,
    }
    assert len(registered()) == sum(count.values()) + 13
