"""Where a bake lives in a .blend, and how it is read back.

A bake is one mesh object, `Lightpanes Entries`: its vertices are the entries' positions, its attributes the other
arrays of `bake.entries`, and custom properties of its mesh name the images and hold `bake.meta` as JSON. The scene
points to that object. So everything is found by pointers (renaming is safe, each scene has its own), and a bake
becomes valid by setting one pointer after all of it has been built.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..core.bake import Bake
from ..core.scene import SceneError
from . import attributes, refresh
from .pixels import read_pixels
from .work import run

COLLECTION = "Lightpanes"
ENTRIES = "Lightpanes Entries"
POINTS = "Lightpanes Points"
IRRADIANCE = "Lightpanes Irradiance"
DIRECT = "Lightpanes Direct"
# What `Lightpanes Direct` holds without the lamps; there while their light is in it, too.
STEADY = "Lightpanes Direct Steady"
CAUSTICS = "Lightpanes Caustics"
ALBEDO = "Lightpanes Albedo"
ERROR = "Lightpanes Error"
SHOWN = (IRRADIANCE, DIRECT, CAUSTICS, ALBEDO)

# Custom properties. TAG marks every data-block that is ours to delete; it holds the data-block's role. It is not
# named "lightpanes", which on objects is the PropertyGroup.
TAG = "lightpanes_role"
IMAGES = "lightpanes_images"
META = "lightpanes_meta"
LAYOUT = "lightpanes_layout"
POINTS_KEY = "lightpanes_points"
SHAPE = "lightpanes_shape"
KEY = "lightpanes_key"
# Attributes of the points' mesh that hold what a bake found where `points.follow` has moved the points since.
REST = "rest_{}"

FORMAT = 1
_FLAT_WIDTH = 1024


@dataclass
class Built:
    """A bake's data-blocks, in the file but not yet the bake of a scene. images: by role."""

    entries: bpy.types.Object
    points: bpy.types.Object | None
    images: dict[str, bpy.types.Image]


def store_bake(scene: bpy.types.Scene, bake: Bake, albedo: np.ndarray | None = None) -> bpy.types.Object:
    """Make `bake` the scene's bake, in place of the one it has.

    albedo: (H, W, 3) float, diffuse reflectance over the atlas, or None.
    Everything new is built before anything old is touched; if building fails, the new parts are removed again, the
    old bake stays and the exception goes on.
    """
    return put(scene, run(build_steps(bake, albedo, key_of(bake))))


def build_steps(bake: Bake, albedo: np.ndarray | None, key: str) -> Generator[float, None, Built]:
    """Build a bake's data-blocks, an image at a time; yields the part that is done. What ends it removes them again.

    key: from `key_of`, which takes a while and needs no Blender.
    """
    made: list[bpy.types.ID] = []
    size = (bake.resolution, bake.resolution)
    pictures = dict(bake.images)
    pictures[IRRADIANCE] = np.zeros((*size, 3), np.float32)
    if bake.direct is not None:
        pictures[DIRECT] = bake.direct
    if albedo is not None:
        pictures[ALBEDO] = albedo
    total = sum(array.size for array in pictures.values())
    images, done = {}, 0
    try:
        for role, array in pictures.items():
            images[role] = _opaque_image(role, array, made) if role in SHOWN else _array_image(role, array, made)
            yield (done + array.size / 2) / max(total, 1)
            images[role].pack()
            done += array.size
            yield done / max(total, 1)
        points, specs = _write_points(bake, made)
        entries = _write_entries(bake, images, points, specs, made)
        entries.data[KEY] = key
    except BaseException:
        _remove(made)
        raise
    return Built(entries, points, images)


def put(scene: bpy.types.Scene, built: Built) -> bpy.types.Object:
    """Make what was built the scene's bake, in place of the one it has; the old one is deleted."""
    collection, old = _collection(scene), scene.lightpanes.entries
    collection.objects.link(built.entries)
    if built.points is not None:
        collection.objects.link(built.points)
    scene.lightpanes.entries = built.entries
    for former in {old, *strays(scene)} - {None}:
        _remove_bake(former)
    for role, image in built.images.items():
        image.name = role
    built.entries.name = built.entries.data.name = ENTRIES
    if built.points is not None:
        built.points.name = built.points.data.name = POINTS
    return built.entries


def discard(built: Built) -> None:
    """Delete what was built, unless it is some scene's bake."""
    _remove_bake(built.entries)


def load_bake(scene: bpy.types.Scene) -> Bake | None:
    """The scene's bake, exactly as it was stored, or None where the scene has none.

    Raises SceneError when parts of it are missing or damaged.
    """
    entries = find_entries(scene)
    if entries is None:
        return None
    mesh = entries.data
    try:
        layout, meta = json.loads(mesh[LAYOUT]), json.loads(mesh[META])
        arrays = {name: attributes.read(mesh, name, *spec) for name, spec in layout["entries"].items()}
        points = _read_points(mesh, layout.get("points", {}))
        stored = mesh[IMAGES]
        images = {role: _read_array(stored[role], role) for role in layout["images"]}
        role = STEADY if STEADY in stored else DIRECT
        direct = _read_array(stored[role], role)[..., :3].copy() if layout["direct"] else None
        resolution = int(layout["resolution"])
    except SceneError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SceneError(f"The bake in scene '{scene.name}' is damaged ({error}); bake again.") from error
    return Bake(resolution=resolution, images=images, entries=arrays, direct=direct, meta=meta, points=points)


def find_entries(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The object that holds the scene's bake, whatever it is named now."""
    entries = scene.lightpanes.entries
    if entries is None or entries.type != "MESH" or LAYOUT not in entries.data:
        return None
    return entries


def find_points(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The object whose vertices are the points of the scene's bake, None where its exits are texels."""
    entries = find_entries(scene)
    return entries.data.get(POINTS_KEY) if entries is not None else None


def find_image(scene: bpy.types.Scene, role: str) -> bpy.types.Image | None:
    """The image of the scene's bake that has this role (its default name), whatever it is named now."""
    entries = find_entries(scene)
    images = entries.data.get(IMAGES) if entries is not None else None
    return images.get(role) if images is not None else None


def images_of(scene: bpy.types.Scene) -> list[bpy.types.Image]:
    """All images of the scene's bake that have not been deleted."""
    entries = find_entries(scene)
    images = dict(entries.data.get(IMAGES, {})) if entries is not None else {}
    return [image for image in images.values() if image is not None and TAG in image]


def path_of(image: bpy.types.Image) -> Path | None:
    """The file that holds the image, None where the .blend does."""
    if image.packed_file is not None or image.source != "FILE" or not image.filepath_raw:
        return None
    return Path(os.path.normpath(bpy.path.abspath(image.filepath_raw, library=image.library)))


def is_lost(image: bpy.types.Image) -> bool:
    """Whether the image's file is missing, and with it what the image holds."""
    path = path_of(image)
    return path is not None and not image.has_data and not path.exists()


def need(image: bpy.types.Image) -> bpy.types.Image:
    """The image, whose pixels can be read then. Raises SceneError, naming the file, where that is missing."""
    if is_lost(image):
        raise SceneError(f"The file '{path_of(image)}' of this bake is missing: put it back, or bake again.")
    return image


def add_image(scene: bpy.types.Scene, role: str, pixels: np.ndarray) -> bpy.types.Image:
    """Give the scene's bake one more image, (H, W, 4) float32."""
    image = _new_image(role, pixels, pixels.shape, [])
    image.pack()
    find_entries(scene).data[IMAGES][role] = image
    return image


def drop_image(scene: bpy.types.Scene, role: str) -> None:
    """Take an image out of the scene's bake and delete it; none does no harm."""
    image, images = find_image(scene, role), find_entries(scene).data[IMAGES]
    if role in images:
        del images[role]
    if image is not None:
        _remove([image])


def read_image(scene: bpy.types.Scene, role: str) -> np.ndarray | None:
    """(H, W, 4) float32 that an image of the bake shows, None without it. Raises SceneError where its file is missing."""
    image = find_image(scene, role)
    return None if image is None else read_pixels(need(image))


def holds_direct(scene: bpy.types.Scene) -> bool:
    """Whether sky or emissive faces gave the scene's bake direct light."""
    return bool(json.loads(find_entries(scene).data[LAYOUT])["direct"])


def read_meta(scene: bpy.types.Scene) -> dict | None:
    """`bake.meta` without reading the rest; None without a bake."""
    entries = find_entries(scene)
    if entries is None:
        return None
    try:
        return json.loads(entries.data[META])
    except (KeyError, TypeError, ValueError):
        return None


def write_meta(scene: bpy.types.Scene, meta: dict) -> None:
    """Replace `bake.meta` of the scene's bake."""
    find_entries(scene).data[META] = json.dumps(meta)


def bake_key(scene: bpy.types.Scene) -> str | None:
    """Names the scene's bake: another bake, another key."""
    entries = find_entries(scene)
    return None if entries is None else str(entries.data.get(KEY, ""))


def write_irradiance(scene: bpy.types.Scene, pixels: np.ndarray) -> None:
    """Show `pixels`, (H, W, 4) float32, in the scene's `Lightpanes Irradiance`."""
    write_image(scene, IRRADIANCE, pixels)


def write_image(scene: bpy.types.Scene, role: str, pixels: np.ndarray) -> None:
    """Show `pixels`, (H, W, 4) float32, in an image of the bake; whoever draws it is told."""
    image = find_image(scene, role)
    if image is None:
        raise SceneError(f"The image '{role}' has been deleted; bake again.")
    height, width = pixels.shape[:2]
    cycles = scene.render.engine == "CYCLES"
    if cycles:
        refresh.renew(image)
    if is_lost(image):
        # the lamps make it anew
        image.source, image.use_generated_float = "GENERATED", True
        image.generated_width, image.generated_height = width, height
    if tuple(image.size) != (width, height):
        image.scale(width, height)
    image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).reshape(-1))
    image.update()
    # Cycles keeps its copy of an image until told; EEVEE needs no telling, and a tag costs an update.
    if cycles:
        image.update_tag()


def pack_dirty() -> None:
    """Pack our images that changed since they were packed; unpacked pixels would be lost on saving."""
    for image in bpy.data.images:
        if TAG in image and image.is_dirty:
            image.pack()


def clear(scene: bpy.types.Scene) -> bool:
    """Delete the scene's bake, one that lies in it but belongs to no scene, and nothing else; True when there was one."""
    entries = scene.lightpanes.entries
    scene.lightpanes.entries = None
    found = {entries, *strays(scene)} - {None}
    if not found:
        return False
    for item in found:
        _remove_bake(item)
    for collection in list(scene.collection.children):
        # what of ours is left in it belongs to a copy of the scene
        if TAG in collection and all(TAG in item for item in collection.all_objects):
            scene.collection.children.unlink(collection)
            if not collection.users:
                bpy.data.collections.remove(collection)
    return True


def strays(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Bakes that lie in the scene and belong to none: they were appended from another file."""
    used = {other.lightpanes.entries for other in bpy.data.scenes}
    return [
        item
        for item in scene.objects
        if item.get(TAG) == ENTRIES and item.type == "MESH" and item.library is None and item not in used
    ]


def opaque(rgb: np.ndarray) -> np.ndarray:
    """(H, W, 4) float32 of (H, W, 3), alpha 1."""
    return np.concatenate([rgb[..., :3].astype(np.float32), np.ones((*rgb.shape[:2], 1), np.float32)], axis=2)


def sweep() -> None:
    """Delete images of ours that nothing uses any more."""
    _remove([image for image in bpy.data.images if TAG in image and not image.users and image.library is None])


def _opaque_image(role: str, rgb: np.ndarray, made: list) -> bpy.types.Image:
    """Colours (H, W, 3) as an image that is not packed yet."""
    pixels = opaque(rgb)
    return _new_image(role, pixels, pixels.shape, made)


def _array_image(role: str, array: np.ndarray, made: list) -> bpy.types.Image:
    """Any float32 array as an image that is not packed yet; (H, W, 4) is a picture as it is, others are laid out row by
    row."""
    array = np.ascontiguousarray(array, np.float32)
    if array.ndim == 3 and array.shape[2] == 4 and array.size and max(array.shape) <= 16384:
        return _new_image(role, array, array.shape, made)
    rows = max(1, -(-array.size // (4 * _FLAT_WIDTH)))
    flat = np.zeros(rows * _FLAT_WIDTH * 4, np.float32)
    flat[: array.size] = array.reshape(-1)
    return _new_image(role, flat.reshape(rows, _FLAT_WIDTH, 4), array.shape, made)


def _new_image(role: str, pixels: np.ndarray, shape: tuple, made: list) -> bpy.types.Image:
    """pixels: (H, W, 4) float32. shape: of the array that they hold."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(role, width, height, alpha=True, float_buffer=True, is_data=True)
    made.append(image)
    image[TAG] = role
    image[SHAPE] = json.dumps(list(shape))
    image.alpha_mode = "CHANNEL_PACKED"  # no multiplying by alpha on the way
    image.pixels.foreach_set(pixels.reshape(-1))
    image.update()
    return image


def _read_array(image: bpy.types.Image, role: str) -> np.ndarray:
    if image is None:
        raise ValueError(f"the image '{role}' has been deleted")
    flat = read_pixels(need(image)).reshape(-1)
    shape = tuple(json.loads(image[SHAPE]))
    size = int(np.prod(shape))
    if not image.is_float or flat.size < size:
        raise ValueError(f"the image '{image.name}' has been replaced or scaled")
    return flat[:size].reshape(shape)


def _write_points(bake: Bake, made: list) -> tuple[bpy.types.Object | None, dict]:
    """A mesh of the stored points, with `irradiance` for what they show now, and how to read it back."""
    if not bake.points:
        return None, {}
    mesh, specs = _write_vertices(POINTS, bake.points, made)
    attributes.fill(mesh, "irradiance", "FLOAT_COLOR", np.zeros((len(mesh.vertices), 4), np.float32))
    mesh.update()
    return _hidden_object(POINTS, mesh, made), specs


def _read_points(mesh, specs: dict) -> dict[str, np.ndarray]:
    if not specs:
        return {}
    points = mesh.get(POINTS_KEY)
    if points is None:
        raise ValueError(f"the object '{POINTS}' has been deleted")
    moved = {name: REST.format(name) for name in specs if REST.format(name) in points.data.attributes}
    return {name: attributes.read(points.data, moved.get(name, name), *spec) for name, spec in specs.items()}


def _write_vertices(name: str, arrays: dict, made: list) -> tuple[bpy.types.Mesh, dict]:
    """A tagged mesh of one vertex a row, and how to read its attributes back."""
    mesh = bpy.data.meshes.new(name)
    made.append(mesh)
    mesh[TAG] = name
    mesh.vertices.add(len(arrays["position"]))
    return mesh, {key: attributes.write(mesh, key, array) for key, array in arrays.items()}


def _hidden_object(name: str, mesh, made: list) -> bpy.types.Object:
    item = bpy.data.objects.new(name, mesh)
    made.append(item)
    item[TAG] = name
    item.hide_render = item.hide_viewport = item.hide_select = True
    return item


def _write_entries(bake: Bake, images: dict, points, points_specs: dict, made: list) -> bpy.types.Object:
    mesh, specs = _write_vertices(ENTRIES, bake.entries, made)
    layout = {
        "format": FORMAT,
        "resolution": int(bake.resolution),
        "images": list(bake.images),
        "direct": bake.direct is not None,
        "entries": specs,
        "points": points_specs,
    }
    mesh[LAYOUT] = json.dumps(layout)
    mesh[META] = json.dumps(bake.meta)
    mesh[IMAGES] = images
    if points is not None:
        mesh[POINTS_KEY] = points
    mesh.update()
    return _hidden_object(ENTRIES, mesh, made)


def key_of(bake: Bake) -> str:
    """Differs when any array of the bake does."""
    digest = hashlib.blake2b(digest_size=12)
    for arrays in (bake.images, bake.entries, bake.points):
        for name, array in arrays.items():
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _collection(scene: bpy.types.Scene) -> bpy.types.Collection:
    """The scene's hidden collection; made on first use."""
    for collection in scene.collection.children:
        if collection.get(TAG) == COLLECTION:
            return collection
    collection = bpy.data.collections.new(COLLECTION)
    collection[TAG] = COLLECTION
    collection.hide_render = collection.hide_viewport = True
    scene.collection.children.link(collection)
    return collection


def _remove_bake(entries: bpy.types.Object) -> None:
    """Delete a bake's object, mesh and images, unless another scene uses them (a scene copied with its bake)."""
    if any(scene.lightpanes.entries == entries for scene in bpy.data.scenes):
        return
    mesh = entries.data if entries.type == "MESH" else None
    images = list(dict(mesh.get(IMAGES, {})).values()) if mesh is not None else []
    others = {
        image
        for other in bpy.data.meshes
        if other != mesh and IMAGES in other
        for image in dict(other[IMAGES]).values()
    }
    doomed = [image for image in images if image is not None and TAG in image and image not in others]
    points = mesh.get(POINTS_KEY) if mesh is not None else None
    if points is not None and TAG in points:
        doomed += [points, *([points.data] if points.data.users <= 1 and TAG in points.data else [])]
    _remove([entries, *([mesh] if mesh is not None and mesh.users <= 1 and TAG in mesh else []), *doomed])


def _remove(ids: list) -> None:
    with contextlib.suppress(ReferenceError):  # deleting an object may take its data along
        bpy.data.batch_remove(ids)
