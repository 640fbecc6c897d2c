"""python -m tests.bench [NAME…], or python tests/bench [NAME…]: see harness.py."""

import importlib.util
import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# the root for `tests.bench`, ahead of any other package called tests
sys.path.insert(0, str(ROOT))

if importlib.util.find_spec("lightpanes") is None:
    spec = importlib.util.spec_from_file_location(
        "lightpanes", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)]
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules["lightpanes"] = module
    spec.loader.exec_module(module)

from tests.bench import harness  # noqa: E402

code = harness.main(sys.argv[1:])
sys.stdout.flush()
sys.stderr.flush()
# Blender 4.5 as a module can hang in its exit handlers
os._exit(code)
