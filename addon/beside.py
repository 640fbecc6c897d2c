"""The bake's images as OpenEXR files in a folder beside the .blend, for scenes that ask for that.

Files are written when the .blend is saved and never in between, so that the two always fit; until then images are
packed, or have the files of the last save. A file's name holds the key of its bake. What a saved .blend needs no more
is deleted when it is closed, for until then undo may bring it back. Where a file can't be written its image stays
packed: no light is lost.
"""

from __future__ import annotations

import contextlib
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ..core.files import replacing
from . import handlers, store
from .pixels import read_pixels

_OURS = re.compile(r"Lightpanes [\w ]+ [0-9a-f]{8}( \d+)?\.exr")


@dataclass
class _Saving:
    """folder: where the files of the .blend that is being saved go. former: (image, its path, whether it was packed)
    of those that changed."""

    folder: Path
    former: list[tuple[bpy.types.Image, str, bool]] = field(default_factory=list)


_saving: _Saving | None = None
# Files that what was saved last does not need.
_left: set[Path] = set()
_named: Path | None = None
_problem = ""


def folder_of(blend: Path) -> Path:
    """Where the files of a .blend lie."""
    return blend.parent / f"{blend.stem}_lightpanes"


def problem() -> str:
    """Why the last save packed what should have gone into files; "" where all is well."""
    return _problem


@contextlib.contextmanager
def saving_as(blend: Path) -> Iterator[None]:
    """Meanwhile files are saved under another name in the same folder and will be renamed to this one."""
    global _named
    _named = blend
    try:
        yield
    finally:
        _named = None


@persistent
def _before(path="", *_):
    """Put the images where they belong; those that can't be written are packed."""
    global _saving, _problem
    _saving, _problem = None, ""
    # the start-up file
    if not path:
        return
    _saving = _Saving(folder_of(_named or Path(path)))
    wanted = _wanted()
    for image, key in wanted.items():
        if key is None and _is_ours(store.path_of(image)) and not store.is_lost(image):
            _saving.former.append((image, image.filepath_raw, False))
            _pack(image)
            image.filepath_raw = ""
    images = [image for image, key in wanted.items() if key is not None]
    try:
        for image, place in _places(images, wanted, _saving.folder).items():
            _write(image, place)
    except OSError as error:
        _problem = (
            f"Can't write to '{error.filename or _saving.folder}' ({error.strerror}): the baked images are packed into "
            "the .blend instead. Make its folder writable and save again."
        )
        print(f"Lightpanes: {_problem}")
        for image in images:
            if image.packed_file is None and not store.is_lost(image):
                _saving.former.append((image, image.filepath_raw, False))
                _pack(image)


def _wanted() -> dict[bpy.types.Image, str | None]:
    """The images of all bakes of this file: the bake's key for those that go into files, None for those to pack."""
    found: dict[bpy.types.Image, str | None] = {}
    for scene in bpy.data.scenes:
        key = store.bake_key(scene) if scene.lightpanes.storage == "BESIDE" else None
        for image in store.images_of(scene):
            if image.library is None:
                # copies of a scene share images
                found[image] = key if image not in found else found[image] and key
    return found


def _places(images, keys, folder: Path) -> dict[bpy.types.Image, Path]:
    """A file for each image: the one that it has in this folder, or a free name."""
    places = {}
    for image in images:
        path = store.path_of(image)
        if path is not None and path.parent == folder and _is_ours(path) and path not in places.values():
            places[image] = path
    for image in images:
        number, name = 1, f"{image[store.TAG]} {keys[image][:8]}"
        while image not in places:
            path = folder / (f"{name}.exr" if number == 1 else f"{name} {number}.exr")
            if path not in places.values():
                places[image] = path
            number += 1
    return places


def _write(image, place: Path) -> None:
    """Let the image live in this file. Raises OSError."""
    path = store.path_of(image)
    if path is not None and not path.exists() and image.has_data:
        _pack(image)
        path = None
    if path is not None and (path == place or not path.exists()):
        return
    place.parent.mkdir(exist_ok=True)
    with replacing(place) as temporary:
        if path is None:
            temporary.write_bytes(image.packed_file.data)
        else:
            shutil.copyfile(path, temporary)
    _saving.former.append((image, image.filepath_raw, path is None))
    image.filepath_raw = _relative(place)
    if path is None:
        image.unpack(method="REMOVE")


def _pack(image) -> None:
    """From its file, or from memory where that was deleted while it was open."""
    path = store.path_of(image)
    if path is not None and not path.exists():
        # only what has changed is packed from memory
        image.pixels.foreach_set(read_pixels(image).reshape(-1))
    image.pack()


def _relative(place: Path) -> str:
    """As Blender, when it saves, expects it: seen from the file that was open so far."""
    if not bpy.data.filepath:
        return f"//{place.parent.name}/{place.name}"
    try:
        return bpy.path.relpath(str(place), start=str(Path(bpy.data.filepath).parent))
    except ValueError:
        # another drive
        return str(place)


@persistent
def _after(path="", *_):
    """Note which files the .blend that was written does not need; after a copy put back how images were."""
    if _saving is None:
        return
    used = {store.path_of(image) for image in bpy.data.images}
    with contextlib.suppress(OSError):
        _left.update(place for place in _saving.folder.iterdir() if _is_ours(place))
    _left.difference_update(used)
    if not bpy.data.filepath or Path(bpy.data.filepath) != Path(path):
        _put_back()


@persistent
def _put_back(*_):
    """Let images be as they were before the save."""
    global _saving
    saving, _saving = _saving, None
    for image, former, packed in reversed(saving.former if saving is not None else ()):
        if packed:
            image.pack()
        elif image.packed_file is not None:
            image.unpack(method="REMOVE")
        image.filepath_raw = former


def _is_ours(place: Path | None) -> bool:
    return place is not None and place.parent.name.endswith("_lightpanes") and bool(_OURS.fullmatch(place.name))


@persistent
def _on_close(*_):
    """Delete what is left, and folders that this empties."""
    global _saving, _problem
    _saving, _problem = None, ""
    for place in _left:
        with contextlib.suppress(OSError):
            place.unlink(missing_ok=True)
    for folder in {place.parent for place in _left}:
        with contextlib.suppress(OSError):
            folder.rmdir()
    _left.clear()


HANDLERS = {"save_pre": _before, "save_post": _after, "save_post_fail": _put_back, "load_pre": _on_close}


def register() -> None:
    handlers.add(HANDLERS)


def unregister() -> None:
    handlers.remove(HANDLERS)
    _on_close()
