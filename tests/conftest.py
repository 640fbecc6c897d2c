"""The repository's root is the package `lightpanes`; make it importable without installing it."""

import importlib.util
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

if importlib.util.find_spec("lightpanes") is None:
    spec = importlib.util.spec_from_file_location(
        "lightpanes", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)]
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules["lightpanes"] = module
    spec.loader.exec_module(module)
