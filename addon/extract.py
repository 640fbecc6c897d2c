"""Blender's evaluated scene, read into `core.scene.Scene` as Cycles would render it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np

from ..core.scene import Scene, SceneError, SceneObject
from . import lamps, linking, materials, refusals, visibility
from .meshes import AT_VERTICES, LAYER, Faces, are_numbers, read_attribute, read_faces, weight_of
from .snapshot import rectangle
from .unfolded import Unfolded

GEOMETRY = {"MESH", "CURVE", "SURFACE", "FONT", "META"}
NOT_TRACED = {"VOLUME": "a volume", "CURVES": "hair", "POINTCLOUD": "a point cloud", "GREASEPENCIL": "Grease Pencil"}


@dataclass
class _Part:
    """One object or instance, in world space, with its place in the scene's lists.

    loops: (T, 3) of its mesh, None unless it is lit at its vertices. texture_uv: as of Scene.
    """

    positions: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    material: np.ndarray
    loops: np.ndarray | None = None
    texture_uv: np.ndarray | None = None


def extract(
    context: bpy.types.Context,
    *,
    resolution: int,
    albedo: bool = True,
    looks: bool = True,
    loops: dict[str, np.ndarray] | None = None,
    atlas: Unfolded | None = None,
) -> Scene:
    """Read the scene as a render would show it.

    resolution: width and height of the atlas in pixels. albedo: bake maps of the materials that
    vary over a surface; without it they are their mean where that can be read and grey elsewhere,
    enough for shadow rays. looks: without them materials are not read at all, and only the shapes are right.
    loops: filled with the mesh's loops (T, 3) of the scene's triangles, for each object that is lit at its vertices,
    by name. atlas: the one that objects are to have, None for that which they have. Raises SceneError, naming the object
    and what to do.
    """
    warnings: list[str] = []
    albedo = albedo and looks
    with visibility.as_rendered(context) as depsgraph:
        found = _read_parts(depsgraph, visibility.rendered_objects(context.view_layer), warnings, atlas)
        if not found[0]:
            raise SceneError(_nothing_found(context))
        lights = lamps.read_lights(depsgraph, warnings)
        # a textured world is evaluated by a render, which shadow rays at a relight have no use for
        sky = lamps.read_sky(context.scene.world, warnings) if albedo and context.scene.world else None
    parts, objects, sources, used = found
    scene, starts = _join(parts, objects, used, lights, sky, warnings)
    if loops is not None:
        loops.update(
            {item.name: _loops(scene, k, parts[k], starts[k]) for k, item in enumerate(objects) if item.at_vertices}
        )
    if looks:
        materials.read_materials(context, scene, used, sources, resolution, bake=albedo, atlas=atlas)
    scene.warnings[:] = dict.fromkeys(scene.warnings)
    return scene


def extract_shown(
    depsgraph: bpy.types.Depsgraph, layer_of: Callable[[bpy.types.Material | None], str | None], warnings: list[str]
) -> tuple[Scene | None, list[bpy.types.Material | None]]:
    """The surfaces that a render engine is given to show, and Blender's material for each of the scene's, which are not
    read yet; None for the scene where there is no face.

    Nothing of Blender is changed. A viewport's depsgraph holds what the viewport shows. layer_of: name of the UV layer
    that a material's texture reads, "" for the one that renders, None for no texture. warnings: more are added.
    """
    rendered = None if depsgraph.mode == "VIEWPORT" else visibility.rendered_objects(depsgraph.view_layer)
    parts, objects, _, used = _read_parts(depsgraph, rendered, warnings, None, layer_of)
    if not parts:
        return None, used
    return _join(parts, objects, used, (), None, warnings)[0], used


def _join(parts, objects, used, lights, sky, warnings):
    """The scene of all parts, and the number of each one's first vertex."""
    triangles = np.concatenate([part.triangles for part in parts])
    counts = [len(part.triangles) for part in parts]
    starts = np.cumsum([0] + [len(part.positions) for part in parts[:-1]])
    triangles += np.repeat(starts, counts)[:, None].astype(np.int32)
    texture_uv = None
    if any(part.texture_uv is not None for part in parts):
        nothing = np.full((1, 3, 2), np.nan, np.float32)
        texture_uv = np.concatenate(
            [
                np.repeat(nothing, len(part.triangles), axis=0) if part.texture_uv is None else part.texture_uv
                for part in parts
            ]
        )
    scene = Scene(
        positions=np.concatenate([part.positions for part in parts]),
        triangles=triangles,
        corner_normals=np.concatenate([part.normals for part in parts]),
        atlas_uv=np.concatenate([part.uv for part in parts]),
        triangle_material=np.concatenate([part.material for part in parts]),
        triangle_object=np.repeat(np.arange(len(parts)), counts),
        materials=[materials.PLACEHOLDER] * len(used),
        objects=objects,
        lights=lights,
        sky=sky,
        warnings=warnings,
        texture_uv=texture_uv,
    )
    return scene, starts


def _loops(scene, index, part, start):
    """Loops of the object's triangles that the scene kept: it drops those without area."""
    first, last = np.searchsorted(scene.triangle_object, [index, index + 1])
    kept = scene.triangles[first:last].astype(np.int64) - start
    if len(kept) == len(part.loops):
        return part.loops
    base = np.array([len(part.positions) ** 2, len(part.positions), 1], np.int64)
    return part.loops[np.isin(part.triangles @ base, kept @ base)]


def _read_parts(depsgraph, rendered, warnings, atlas, layer_of=None):
    """All that renders: parts, their SceneObjects, their Blender objects, and the materials in use.

    rendered: objects that render in their own right, None for all that the depsgraph shows.
    """
    members: dict[bpy.types.Object, set] = {}
    cache: dict[int, Faces] = {}
    index: dict[bpy.types.Material | None, int] = {}
    parts, objects, sources = [], [], []
    override = depsgraph.view_layer.material_override
    for instance in depsgraph.object_instances:
        obj = instance.object
        original = obj.original
        if not _renders(instance, original, rendered, members):
            continue
        if not instance.is_instance:
            _warn_unsupported(original, warnings)
        if obj.type != "MESH":
            continue
        if instance.is_instance and not instance.show_self and not instance.show_particles:
            continue
        name = original.name if not instance.is_instance else f"{instance.parent.original.name}: {original.name}"
        faces = _faces(obj, cache, original, layer_of is not None)
        if faces is None:
            if not instance.is_instance:
                warnings.append(f"'{name}' has no faces; it is left out.")
            continue
        _check(faces, instance.matrix_world, name)
        slots = _slot_materials(obj, faces, override)
        lookup = np.array([index.setdefault(slot, len(index)) for slot in slots], np.int32)
        # where it is in the atlas: custom properties, or what they are to be
        place = original if atlas is None else atlas.place(original)
        takes = _takes_light(instance, original, place, warnings)
        at_vertices = takes and AT_VERTICES in place
        uv = None
        if takes and not at_vertices:
            uv = faces.uv if atlas is None else atlas.uv(original, faces.uv, faces.loops, faces.corners)
            if uv is None:
                warnings.append(
                    f"'{name}' loses its UV layer '{LAYER}' in a modifier, so it receives no light: apply the modifier."
                )
        receives = at_vertices or uv is not None
        if uv is not None:
            scale, offset = rectangle(place)
            uv = uv * scale + offset
        textures = _texture_uv(faces, slots, layer_of) if layer_of is not None else None
        parts.append(_place(faces, instance.matrix_world, uv, lookup, at_vertices, textures))
        objects.append(
            SceneObject(
                name,
                receives=receives,
                casts_shadow=bool(original.visible_shadow),
                reflects=bool(original.visible_diffuse),
                weight=weight_of(original),
                at_vertices=at_vertices,
                seen=bool(original.visible_camera),
            )
        )
        sources.append(original)
    return parts, objects, sources, list(index)


def _texture_uv(faces, slots, layer_of):
    """(T, 3, 2) of the layers that the slots' materials read, None where none does."""
    found = None
    for number, material in enumerate(slots):
        layer = layer_of(material)
        if layer is None or layer not in faces.layers:
            continue
        if found is None:
            found = np.full((len(faces.triangles), 3, 2), np.nan, np.float32)
        rows = np.minimum(faces.slots, len(slots) - 1) == number
        found[rows] = faces.layers[layer][rows]
    return found


def _renders(instance, original, rendered, members) -> bool:
    if rendered is None:
        return True
    if not instance.is_instance:
        return original in rendered
    parent = instance.parent.original
    if parent not in rendered:
        return False
    if parent.instance_type == "COLLECTION" and parent.instance_collection and original is not parent:
        if parent not in members:
            members[parent] = _members_through(parent.instance_collection, set())
        return original in members[parent]
    return True


def _members_through(collection, seen):
    """What an instance of a collection renders, instances inside it included."""
    if collection in seen:
        return set()
    seen.add(collection)
    shown = visibility.rendered_members(collection)
    for obj in list(shown):
        if obj.instance_type == "COLLECTION" and obj.instance_collection:
            shown |= _members_through(obj.instance_collection, seen)
    return shown


def _nothing_found(context) -> str:
    meshes = [obj for obj in context.scene.objects if obj.type in GEOMETRY]
    if not meshes:
        return "The scene has no mesh to light. Add one and bake again."
    if all(obj.type == "MESH" and not obj.data.polygons for obj in meshes):
        return f"No object has faces ('{meshes[0].name}' has none). Add faces and bake again."
    return (
        f"All meshes are hidden from renders ('{meshes[0].name}' is one): turn on their camera icons in the "
        "Outliner, and those of their collections."
    )


def _warn_unsupported(obj, warnings) -> None:
    """Say what Cycles honours on the object and a bake does not."""
    if obj.type in NOT_TRACED:
        warnings.append(f"'{obj.name}' is {NOT_TRACED[obj.type]}, which neither blocks nor reflects light in a bake.")
        return
    if linking.is_users(obj):
        warnings.append(f"'{obj.name}' uses light linking, which is not honoured: it lights and shadows everything.")
    if obj.type not in GEOMETRY:
        return
    if getattr(obj, "is_holdout", False) or getattr(obj, "is_shadow_catcher", False):
        warnings.append(
            f"'{obj.name}' is a holdout or shadow catcher, which is not honoured: it is an ordinary surface."
        )
    if any(system.settings.render_type not in {"OBJECT", "COLLECTION", "NONE"} for system in obj.particle_systems):
        warnings.append(
            f"'{obj.name}' has hair or particles that are not objects: they neither block nor reflect light."
        )
    if obj.type == "MESH" and any(
        modifier.type == "SUBSURF" and getattr(modifier, "use_adaptive_subdivision", False)
        for modifier in obj.modifiers
    ):
        warnings.append(f"'{obj.name}' uses adaptive subdivision; its ordinary subdivision is baked.")


def _faces(obj, cache, original, layers) -> Faces | None:
    key = obj.data.as_pointer()
    if key not in cache:
        # in Edit Mode the evaluated mesh is a wrapper without arrays; to_mesh fills them
        editing = original.data.is_editmode
        mesh = obj.to_mesh() if editing else obj.data
        cache[key] = read_faces(mesh, layers) if mesh is not None else None
        if editing:
            obj.to_mesh_clear()
    return cache[key]


def _check(faces, matrix, name) -> None:
    if not (are_numbers(faces.positions) and are_numbers(np.array(matrix))):
        raise SceneError(
            f"'{name}' has vertices that are not numbers (NaN or infinite): undo the edit or repair the modifier "
            "or transform that broke it, or hide the object from renders."
        )


def _slot_materials(obj, faces, override) -> list:
    """Original material of each slot that the triangles use; None for an empty one."""
    count = int(faces.slots.max()) + 1
    if override:
        return [override.original] * count
    # slots of the object win over the mesh's: they may be linked to the object
    slots = [slot.material for slot in obj.material_slots] or list(obj.data.materials)
    slots = [material.original if material else None for material in slots] or [None]
    # Blender clamps an index past the last slot
    return [slots[min(i, len(slots) - 1)] for i in range(count)]


def _takes_light(instance, original, place, warnings) -> bool:
    """Whether the object, itself or through an instance, has a place for light."""
    name = original.name
    if getattr(getattr(original, "lightpanes", None), "exclude", False):
        return False
    if instance.is_instance:
        if original.type in GEOMETRY - {"MESH"}:
            warnings.append(
                f"'{name}' is not a mesh: it blocks and reflects light but receives none. Use Object > Convert > Mesh."
            )
        else:
            warnings.append(refusals.instances(instance.parent.original))
        return False
    return bool(place.get("lightpanes_baked", 0.0))


def _place(faces: Faces, matrix, uv, lookup, at_vertices, textures=None) -> _Part:
    """Faces in world space, with their atlas coordinates if they have some; a mirroring matrix turns the winding, so that geometric normals stay outside."""
    world = np.array(matrix, np.float64)
    linear = world[:3, :3]
    mirrored = np.linalg.det(linear) < 0
    # cofactors are the inverse transpose times the determinant, and exist for flattened objects too
    cofactors = np.stack([np.cross(linear[(i + 1) % 3], linear[(i + 2) % 3]) for i in range(3)])
    positions = (faces.positions @ linear.T + world[:3, 3]).astype(np.float32)
    normals = faces.normals @ (cofactors * (-1.0 if mirrored else 1.0)).T
    triangles, loops = faces.triangles.copy(), faces.loops
    if uv is None:
        uv = np.full((*triangles.shape, 2), np.nan, np.float32)
    if mirrored:
        triangles, normals, uv = triangles[:, ::-1].copy(), normals[:, ::-1], uv[:, ::-1]
        loops = loops[:, ::-1]
        textures = None if textures is None else textures[:, ::-1]
    a, b, c = (positions[triangles[:, k]].astype(np.float64) for k in range(3))
    face_normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=2)
    flat = faces.flat | (lengths < 1e-20).any(axis=1)
    normals = np.where(flat[:, None, None], face_normals[:, None], normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-30)
    slots = np.minimum(faces.slots, len(lookup) - 1)
    loops = loops if at_vertices else None
    return _Part(
        positions, triangles, normals.astype(np.float32), uv.astype(np.float32), lookup[slots], loops, textures
    )


def fingerprint(context: bpy.types.Context) -> dict[str, str]:
    """Object name → short hash of its geometry, transform and materials, instances it makes included.

    Of all that renders. An object that the viewport hides cannot be read cheaply, and one in Edit Mode not before it
    leaves that: its value is "".
    """
    rendered = visibility.rendered_objects(context.view_layer)
    hashes = {obj.name: None for obj in rendered if obj.type in GEOMETRY}
    edited: set[str] = set()
    meshes: dict[int, bytes] = {}
    looks: dict[bpy.types.Material, bytes] = {}
    for instance in context.evaluated_depsgraph_get().object_instances:
        obj = instance.object
        owner = (instance.parent if instance.is_instance else obj).original
        if obj.type != "MESH" or owner not in rendered:
            continue
        if obj.original.data.is_editmode:
            edited.add(owner.name)
            continue
        digest = hashes.get(owner.name) or hashlib.blake2b(digest_size=8)
        hashes[owner.name] = digest
        key = obj.data.as_pointer()
        if key not in meshes:
            meshes[key] = _mesh_digest(obj.data)
        digest.update(meshes[key])
        digest.update(np.array(instance.matrix_world, np.float32).tobytes())
        if not obj.original.visible_shadow:
            digest.update(b"no shadow")
        for slot in obj.material_slots:
            if slot.material is not None and slot.material.original not in looks:
                looks[slot.material.original] = materials.digest(slot.material.original)
            digest.update(looks[slot.material.original] if slot.material else b"-")
    return {name: digest.hexdigest() if digest and name not in edited else "" for name, digest in hashes.items()}


def changed_objects(before: dict[str, str], after: dict[str, str]) -> list[str]:
    """Names whose geometry, place or materials differ between two fingerprints, removed and added ones
    included; those that one of them could not read are taken as unchanged."""
    names = sorted(before.keys() | after.keys())
    return [n for n in names if (n in before) != (n in after) or (before[n] != after[n] and before[n] and after[n])]


def _mesh_digest(mesh) -> bytes:
    digest = hashlib.blake2b(digest_size=8)
    digest.update(
        read_attribute(mesh, "position", len(mesh.vertices), 3, "vector", np.float32).tobytes()
        if len(mesh.vertices)
        else b""
    )
    if len(mesh.loops):
        digest.update(read_attribute(mesh, ".corner_vert", len(mesh.loops), 1, "value", np.int32).tobytes())
    # how it is shaded; without any of them it is smooth
    for name, kind, count in (
        ("sharp_face", "BOOLEAN", len(mesh.polygons)),
        ("sharp_edge", "BOOLEAN", len(mesh.edges)),
        ("custom_normal", "INT16_2D", len(mesh.loops)),
    ):
        held = mesh.attributes.get(name)
        if held is not None and held.data_type == kind and count:
            values = np.empty(count * (2 if kind == "INT16_2D" else 1), bool if kind == "BOOLEAN" else np.int32)
            held.data.foreach_get("value", values)
            if values.any():
                digest.update(name.encode() + values.tobytes())
    if "material_index" in mesh.attributes and len(mesh.polygons):
        digest.update(read_attribute(mesh, "material_index", len(mesh.polygons), 1, "value", np.int32).tobytes())
    return digest.digest()
