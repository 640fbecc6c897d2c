"""The command line: `python -m lightpanes …` and `blender --background FILE.blend --command lightpanes …`.

Exit code 0 only on success; 2 with one line on stderr where the user can help it.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import bpy

from ..core.bake import BakeError
from ..core.files import replacing
from ..core.memory import LEAST_MEMORY
from ..core.planner import EXITS
from ..core.rays import EngineError
from ..core.scene import SceneError
from . import baking, beside, caustics, colours, direct, operators, relight, sequence, sessions, store
from .colours import KINDS
from .terminal import Bar, aside, quiet, silent, unless_it_fails

OK, BAD_INPUT, INTERRUPTED = 0, 2, 130

# The first bytes of a .blend: plain, zstd, gzip.
MAGIC = (b"BLENDER", b"\x28\xb5\x2f\xfd", b"\x1f\x8b")


class UserError(Exception):
    """Something that the user can help; the message says what to do."""


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        raise UserError(f"{message} (see {self.prog} --help)")


def main(arguments: list[str], *, opened: bool = False) -> int:
    """Run a command and return its exit code.

    opened: the .blend is the one that Blender has open, so no FILE is given.
    """
    try:
        options = _parser(opened).parse_args(_spelled_out(arguments))
        if options.json != "-":
            return options.run(options)
        try:
            with aside():
                return options.run(options)
        finally:
            print(options.said, end="")
    except (UserError, SceneError, BakeError, EngineError) as error:
        print(f"lightpanes: {error}", file=sys.stderr)
        return BAD_INPUT
    except SystemExit as leaving:  # --help
        return int(leaving.code or 0)
    except KeyboardInterrupt:
        print("\nlightpanes: cancelled; nothing was written.", file=sys.stderr)
        return INTERRUPTED


def _parser(opened: bool) -> argparse.ArgumentParser:
    name = "blender --background FILE.blend --command lightpanes" if opened else "python -m lightpanes"
    parser = _Parser(prog=name, description="Bake how a scene passes light around once, then relight it live.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(word, run, text):
        made = commands.add_parser(word, help=text, description=text)
        if not opened:
            made.add_argument("file", metavar="FILE.blend")
        made.add_argument("--output", metavar="DIR", help="folder for the results; default: beside the file")
        made.add_argument("--json", metavar="REPORT", help="write the report to this file, '-' for the terminal")
        made.set_defaults(run=run, opened=opened, said="", program=name)
        return made

    bake = command("bake", _bake, "Bake a scene; the result goes to FILE_lightpanes.blend, never over the input.")
    bake.add_argument("--error", type=_number(0.002, 0.5), metavar="E", help="relative error to bake for (0.05)")
    bake.add_argument("--time", type=_number(0, 1e6), metavar="S", help="seconds that the bake may take, 0: no limit")
    bake.add_argument(
        "--memory", type=_number(LEAST_MEMORY, 4096), metavar="GIB", help="memory that the bake may take (4)"
    )
    bake.add_argument("--resolution", type=_number(16, 4096, int), metavar="N", help="atlas size in pixels (256)")
    bake.add_argument("--exits", choices=EXITS, help="where light is gathered (auto: points where that is less work)")
    bake.add_argument(
        "--direct", choices=("off", "baked"), help="the lamps' direct light: the engine's, or baked (the scene's)"
    )
    bake.add_argument(
        "--caustics", choices=("off", "on"), help="the lamps' light that glass and metal focus (the scene's)"
    )
    bake.add_argument("--seed", type=_number(0, 2**31 - 1, int), metavar="N", help="seed of all random numbers (0)")
    bake.add_argument(
        "--storage",
        choices=("packed", "beside"),
        help="images inside the .blend, or as OpenEXR files in a folder beside it",
    )
    again = command("relight", _relight, "Relight a baked scene by its lamps as they are; goes to FILE_relit.blend.")
    again.add_argument("--frame", type=_frame, metavar="N", help="frame to relight for")
    frames = command(
        "animate",
        _animate,
        f"Write the baked light of each frame as images to DIR ({sequence.FOLDER} beside the file).",
    )
    for word in ("start", "end"):
        frames.add_argument(f"--{word}", type=_frame, metavar="N", help=f"{word} frame (the scene's)")
    frames.add_argument("--step", type=_number(1, 1e6, int), metavar="N", help="every Nth frame (the scene's)")
    frames.add_argument(
        "--groups", action="store_true", help="also an image for each group of lamps; they sum up to the whole"
    )
    graph = command("chart", _chart, "Chart error against time, beside Cycles and the paper's method (some minutes).")
    graph.add_argument(
        "--resolution", type=_number(32, 1024, int), default=256, metavar="N", help="atlas size in pixels (256)"
    )
    graph.add_argument("--seed", type=_number(0, 2**31 - 1, int), default=0, metavar="N", help="seed of all (0)")
    graph.add_argument(
        "--methods",
        type=_methods,
        metavar="NAMES",
        help="what to chart, by commas: cycles,denoised,paper,clusters,panes (error against time; these unless said "
        "otherwise), points,compression,penumbra,caustics,preview (charts of their own), or all",
    )
    info = command("info", _info, "Say what a file's bake is and whether it is still valid.")
    info.add_argument(
        "--points",
        nargs="?",
        const=KINDS[0],
        choices=KINDS,
        help="also draw the points of a bake that gathered at points (--exits points), coloured by this (radius), into "
        "FILE_points.png",
    )
    return parser


def _methods(text: str) -> tuple[str, ...]:
    """Names of what to chart."""
    from .chart import NAMES

    given = [name for name in text.replace(",", " ").split() if name != "all"]
    wrong = [name for name in given if name not in NAMES]
    if wrong or not text.strip():
        raise argparse.ArgumentTypeError(f"'{text}': use some of {', '.join(NAMES)}, or all")
    return tuple(NAMES) if "all" in text.replace(",", " ").split() else tuple(given)


def _spelled_out(arguments: list[str]) -> list[str]:
    """`--points FILE.blend` means the default kind of picture, and not one named FILE.blend."""
    result = []
    for word, after in zip(arguments, [*arguments[1:], "--"], strict=True):
        bare = word == "--points" and after not in KINDS and (after.startswith("-") or after.endswith(".blend"))
        result.append(f"--points={KINDS[0]}" if bare else word)
    return result


def _number(low, high, kind=float) -> Callable[[str], float]:
    def read(text):
        try:
            value = kind(text)
        except ValueError:
            value = None
        if value is None or not low <= value <= high:
            what = "a whole number" if kind is int else "a number"
            raise argparse.ArgumentTypeError(f"{text!r} is not {what} from {low:.10g} to {high:.10g}")
        return value

    return read


# the frames that Blender has
_frame = _number(-1048574, 1048574, int)


def _bake(options) -> int:
    path = _open(options)
    target = _target(options, path, "_lightpanes")
    asked = bpy.context.scene.lightpanes
    for setting, value in (
        ("error_target", options.error),
        ("time_budget", options.time),
        ("memory_budget", options.memory),
        ("resolution", options.resolution),
        ("exits", options.exits and options.exits.upper()),
        ("direct", options.direct and options.direct.upper()),
        ("caustics", options.caustics and options.caustics == "on"),
        ("seed", options.seed),
        ("storage", options.storage and options.storage.upper()),
    ):
        if value is not None:
            setattr(asked, setting, value)
    with Bar() as bar:
        report = baking.bake_scene(bpy.context, bar)
    report = {**context_of(path), "settings": _settings(asked), **report}
    save_blend(target)
    report["file"] = str(target)
    _finish(options, path, target, report)
    _say(f"{operators.summary(report)}. Wrote {target}")
    return OK


def _relight(options) -> int:
    path = _open_baked(options)
    target = _target(options, path, "_relit")
    if options.frame is not None:
        bpy.context.scene.frame_set(options.frame)
    milliseconds = relight.relight(bpy.context)
    stale = list(sessions.of(bpy.context.scene).stale)
    scene = bpy.context.scene
    focused = caustics.report(scene)
    told = direct.sentences(scene) if direct.is_baked(scene) else []
    told += [each for each in (caustics.sentences(scene) if focused else []) if each not in told]
    for sentence in stale + told:
        _say(f"Warning: {sentence}")
    save_blend(target)
    report = {**context_of(path), "relight_ms": round(milliseconds, 2), "stale": stale, "file": str(target)}
    if direct.is_baked(bpy.context.scene):
        report["direct_ms"] = round(direct.held(bpy.context.scene).milliseconds, 2)
    if focused:
        report["caustics"] = focused
    if focused or direct.is_baked(scene):
        report["warnings"] = told
    _finish(options, path, target, report)
    _say(f"Relit in {milliseconds:.1f} ms. Wrote {target}")
    return OK


def _animate(options) -> int:
    path = _open_baked(options)
    folder = _target(options, path, "").parent
    if options.output is None:
        folder /= sequence.FOLDER
    frames = sequence.frames_of(bpy.context.scene, options.start, options.end, options.step)
    with Bar() as bar:
        manifest = sequence.write(bpy.context, folder, frames, bar, options.groups)
    for sentence in manifest["warnings"]:
        _say(f"Warning: {sentence}")
    _write_report(options, {**context_of(path), **manifest, "file": str(folder / sequence.MANIFEST)})
    _say(f"Wrote {len(frames)} frames to {folder}")
    return OK


def _info(options) -> int:
    path = _open_baked(options)
    scene = bpy.context.scene
    meta = store.read_meta(scene) or {}
    stale = list(relight.check_stale(bpy.context))
    report = {**context_of(path), "settings": _settings(scene.lightpanes), **meta.get("report", {}), "stale": stale}
    _say(operators.summary(report))
    for key, value in report.items():
        if not isinstance(value, (dict, list)):
            _say(f"  {key}: {value}")
    if "caustics" in report:
        found = report["caustics"]
        _say(f"  caustics of {', '.join(found['casters'])}: {found['photons']} photons a lamp")
    for sentence in stale + report.get("warnings", []):
        _say(f"  Warning: {sentence}")
    try:
        if options.points:
            report["picture"] = str(_draw_points(options, path))
            _say(f"Wrote {report['picture']}")
    finally:
        # where there are no points to draw, the rest is of use all the same
        _write_report(options, report)
    return OK


def _draw_points(options, path: Path) -> Path:
    from . import picture

    target = _target(options, path, "_points").with_suffix(".png")
    pixels = picture.draw(bpy.context, options.points)
    _replacing(target, lambda place: colours.write_png(place, pixels))
    return target


def _chart(options) -> int:
    from . import chart, chart_page

    path = _open(options)
    target = _target(options, path, "_chart")
    figures, picture = target.with_suffix(".json"), target.with_suffix(".png")
    names = tuple(chart.WAYS) if options.methods is None else options.methods
    with Bar() as bar, quiet():
        found = chart.measure(bpy.context, options.resolution, options.seed, bar, names)
    report = {**context_of(path), **chart_page.machine(), **found}
    _replacing(figures, lambda place: place.write_text(json.dumps(report, indent=2) + "\n", "utf-8"))
    for sentence in found["notes"]:
        _say(sentence)
    try:
        from . import plot
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("matplotlib"):
            raise
        _say(f"Wrote {figures}, and no picture: that needs matplotlib (pip install matplotlib).")
    else:
        drawn = []
        if any(report["methods"].values()):
            _replacing(picture, lambda place: plot.draw(report, place))
            drawn.append(picture)
        for name, study in report["studies"].items():
            if "skipped" in study:
                _say(f"{study['title']}: {study['skipped']}")
                continue
            drawn.append(picture.with_name(f"{picture.stem}_{name}.png"))
            _replacing(drawn[-1], lambda place, study=study: plot.draw_study(study, place))
        page = target.with_suffix(".html")
        whole = chart_page.page([report], [[file.read_bytes() for file in drawn]])
        _replacing(page, lambda place: place.write_text(whole, "utf-8"))
        _say(f"Wrote {page}, with {', '.join(file.name for file in (*drawn, figures))} beside it")
    _write_report(options, report)
    return OK


def _open(options) -> Path:
    """The .blend to work on, open in Blender."""
    if options.opened:
        # Blender runs the command on the start-up file when it can't open the one it was given.
        if not bpy.data.filepath:
            raise UserError("No .blend is open: name an existing file before --command.")
        path = Path(bpy.data.filepath)
        _check_report(options, path)
        return path
    path = Path(options.file).expanduser().absolute()
    if not path.exists():
        raise UserError(f"There is no file '{path}'.")
    if not path.is_file():
        raise UserError(f"'{path}' is not a file.")
    try:
        with path.open("rb") as stream:
            head = stream.read(8)
    except OSError as error:
        raise UserError(f"'{path}' can't be read: {error.strerror}.") from error
    if not head.startswith(MAGIC):
        raise UserError(f"'{path.name}' is not a .blend file.")
    _check_report(options, path)
    try:
        with unless_it_fails():
            bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=False)
    except RuntimeError as error:
        raise UserError(f"Blender can't open '{path.name}': {_first_line(error)}") from error
    return path


def _open_baked(options) -> Path:
    """The same, which has a bake."""
    path, scene = _open(options), bpy.context.scene
    if store.find_entries(scene) is None:
        raise UserError(
            f"'{path.name}' has no bake in scene '{scene.name}'. '{options.program} bake{'' if options.opened else ' ' + path.name}' makes "
            f"{path.stem}_lightpanes.blend, which has one."
        )
    return path


def _first_line(error) -> str:
    lines = [line for line in str(error).splitlines() if line.strip()]
    return lines[0].removeprefix("Error: ") if lines else "unknown error"


def _folder(options, path: Path) -> Path:
    """Where results go, made if missing and known to be writable before any work is done."""
    folder = path.parent if options.output is None else Path(options.output).expanduser().absolute()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError as error:
        hint = "" if options.output is not None else "; name another with --output"
        raise UserError(f"Can't write to folder '{folder}': {error.strerror}{hint}.") from error


def _target(options, path: Path, suffix: str) -> Path:
    return _folder(options, path) / f"{path.stem}{suffix}.blend"


def _check_report(options, path: Path) -> None:
    """Know before any work is done that the report can be written."""
    if options.json in (None, "-"):
        return
    report = Path(options.json).expanduser().absolute()
    if report == path:
        raise UserError("--json names the .blend itself.")
    if not report.parent.is_dir():
        raise UserError(f"Can't write the report to '{report}': its folder must exist.")
    if report.is_dir():
        raise UserError(f"Can't write the report to '{report}': it is a folder; name a file.")
    try:
        with tempfile.TemporaryFile(dir=report.parent):
            pass
    except OSError as error:
        raise UserError(f"Can't write the report to '{report}': {error.strerror}.") from error


def _replacing(target: Path, write: Callable[[Path], object]) -> None:
    """Write under a temporary name beside `target`, then put it in place at once."""
    try:
        with silent(), replacing(target) as temporary:
            write(temporary)
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or _first_line(error)
        raise UserError(f"Can't write '{target}': {reason}.") from error


def save_blend(target: Path) -> None:
    def write(path):
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, compress=True, check_existing=False)

    with beside.saving_as(target):
        _replacing(target, write)


def _finish(options, path: Path, target: Path, report: dict) -> None:
    """The report, and with --output also the irradiance, and direct light and caustics where the bake has them, as
    OpenEXR files."""
    if options.output is not None:
        scene = bpy.context.scene
        for role, word in (
            (store.IRRADIANCE, "irradiance"),
            *([(store.DIRECT, "direct")] if direct.is_baked(scene) else []),
            *([(store.CAUSTICS, "caustics")] if store.find_image(scene, store.CAUSTICS) is not None else []),
        ):
            image = store.find_image(scene, role)
            picture = target.with_name(f"{target.stem}_{word}.exr")
            _replacing(picture, lambda place, image=image: image.save(filepath=str(place), save_copy=True))
            if word == "caustics":
                report.setdefault(word, {})["image"] = str(picture)
            else:
                report[word] = str(picture)
        summary = target.with_name(f"{target.stem}_report.json")
        _replacing(summary, lambda place: place.write_text(json.dumps(report, indent=2) + "\n", "utf-8"))
    _write_report(options, report)


def _write_report(options, report: dict) -> None:
    text = json.dumps(report, indent=2) + "\n"
    if options.json == "-":
        options.said = text
    elif options.json is not None:
        _replacing(Path(options.json).expanduser().absolute(), lambda place: place.write_text(text, "utf-8"))


def context_of(path: Path) -> dict:
    from .. import __version__

    return {
        "input": str(path),
        "lightpanes": __version__,
        "blender": bpy.app.version_string,
        "python": platform.python_version(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
    }


def _settings(asked) -> dict:
    return {
        "error_target": round(asked.error_target, 6),
        "time_budget": asked.time_budget,
        "memory_budget": asked.memory_budget,
        "resolution": asked.resolution,
        "exits": asked.exits.lower(),
        "direct": asked.direct.lower(),
        "caustics": asked.caustics,
        "photons": asked.photons,
        "seed": asked.seed,
    }


def _say(text: str) -> None:
    """For people: on stdout, unless the report goes there (`main`)."""
    print(text)


def _in_blender(arguments: list[str]) -> int:
    return main(arguments, opened=True)


_command = None


def register() -> None:
    global _command
    if hasattr(bpy.utils, "register_cli_command"):
        _command = bpy.utils.register_cli_command("lightpanes", _in_blender)


def unregister() -> None:
    global _command
    if _command is not None:
        bpy.utils.unregister_cli_command(_command)
        _command = None
