"""The repository's root is the package `lightpanes`; make it importable without installing it, and keep it clean."""

import importlib.util
import os
import sys
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

if importlib.util.find_spec("lightpanes") is None:
    spec = importlib.util.spec_from_file_location(
        "lightpanes", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)]
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules["lightpanes"] = module
    spec.loader.exec_module(module)


def files() -> set[str]:
    """All of the repository, but for what git ignores."""
    ignored = [".git", *(line.rstrip("/") for line in (ROOT / ".gitignore").read_text().split())]
    found = set()
    for folder, folders, names in os.walk(ROOT):
        folders[:] = [name for name in folders if not any(fnmatch(name, pattern) for pattern in ignored)]
        kept = [name for name in names if not any(fnmatch(name, pattern) for pattern in ignored)]
        found |= {os.path.relpath(os.path.join(folder, name), ROOT) for name in kept}
    return found


@pytest.fixture(scope="session", autouse=True)
def clean():
    """Tests write to folders of their own."""
    before = files()
    yield
    left = sorted(files() - before)
    assert not left, f"the tests have left files in the repository: {', '.join(left)}"
