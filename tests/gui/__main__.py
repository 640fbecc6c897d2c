"""The window's pictures for README and manual: `make pictures` leaves them in out/pictures."""

import sys
import tempfile
from pathlib import Path

from . import window

SAMPLE, RESOLUTION = "cornell", 256


def main() -> int:
    if reason := window.missing():
        print(f"pictures: {reason}", file=sys.stderr)
        return 2
    target = window.ROOT / "out" / "pictures"
    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        found = window.session(folder, window.build(folder, window.python_of_blender(folder)), SAMPLE, RESOLUTION)
        window.cut_pictures(folder, found, target)
    print(f"Wrote the pictures to {target}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
