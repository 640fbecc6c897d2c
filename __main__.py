"""python -m lightpanes bake FILE.blend …: the command line, on the pip bpy."""

import sys


def main() -> int:
    try:
        import bpy  # noqa: F401
    except ImportError:
        sys.stderr.write(
            "lightpanes: this Python has no bpy. Install it (pip install bpy), or run the same in Blender: "
            "blender --background FILE.blend --command lightpanes bake\n"
        )
        return 2
    from .addon import commands, register

    register()
    return commands.main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
