"""A bake as named arrays: what a .blend or a file holds, and the panes rebuilt from it."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..files import replacing
from ..panes import Panes
from ..panes.entry_light import EntrySurface
from ..panes.regions import region_of, starts_of
from ..panes.weights import PaneWeights
from ..point_cache import PointSet
from ..point_cache.codes import decode, encode, weight_bits

FORMAT = 3


class BakeError(ValueError):
    """A bake cannot be read; the message says why and what to do."""


@dataclass
class Bake:
    """images: float32 arrays by the name of their Blender image:
    "Lightpanes Panes": the PRM atlas (k, H, W); with points as exits (n, k), a row per point.
    "Lightpanes Interpolation": (3, H, W): the row-major number of the texel that each texel shows plus one, the region
    of each exit plus one, 0 for none, and a bit for each neighbour on the same smooth surface (`joined`); with points
    as exits (H, W, 4), codes (point_cache.codes) of the points that serve each texel, negative past a chart's border.
    "Lightpanes Vertices": (v, 4) codes of the points that serve each place at a vertex; only where there are some.
    "Lightpanes Weights" (flat), the operators of PaneWeights one after another; "Lightpanes Static" (H, W, 3) or, with
    points, (n, 3), irradiance that no live lamp changes; "Lightpanes Pieces" (p, 3, 3), the triangles that make the
    entries.
    entries: arrays over n × each places on the entries: position, normal, albedo (3 float32), size (float32, m),
    pieces (int32), the entry's number of triangles, and region (int32).
    points: arrays over the stored points, {} where exits are texels: position, normal, radius (m), ao, object (int32,
    index into the report's "objects"), triangle (int32 of the scene), weights (3 float32 of its corners), region.
    direct: (H, W, 3) float32 irradiance of the sky's and emissive faces' first hit, or None.
    meta: JSON-able; "report" is for the user.
    """

    resolution: int
    images: dict[str, np.ndarray]
    entries: dict[str, np.ndarray]
    direct: np.ndarray | None = None
    meta: dict = field(default_factory=dict)
    points: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def report(self) -> dict:
        """Figures for the user: error and its parts, seconds by stage, counts, bytes, warnings."""
        return self.meta.get("report", {})

    @property
    def own(self) -> np.ndarray:
        """(H, W) bool: texels with light of their own, not filled from neighbours past a chart or inside a thing."""
        table = self.images["Lightpanes Interpolation"]
        return table[..., 0] > 0 if self.points else table[1] > 0

    @classmethod
    def from_panes(
        cls, panes: Panes, direct: np.ndarray | None, meta: dict, points: dict[str, np.ndarray] | None = None
    ) -> Bake:
        """Name the arrays."""
        size = panes.resolution
        if panes.shown is None:
            atlas, table, steady = _texel_images(panes)
        else:
            bits = weight_bits(len(panes.rows))
            meta = {**meta, "bits": bits}
            table = encode(panes.shown, bits)
            table[~panes.own] *= -1
            atlas, table, steady = panes.rows, table.reshape(size, size, -1), panes.steady
        weights = panes.weights
        parts = [weights.first, weights.spread, weights.later, weights.field]
        if weights.sketch is not None:
            parts.append(weights.sketch)
        surface = panes.surface
        each = len(surface.position) // max(len(surface), 1)
        entries = {
            "position": surface.position,
            "normal": surface.normal,
            "albedo": np.repeat(surface.albedo, each, axis=0),
            "size": np.repeat(surface.size, each),
            "pieces": np.repeat(surface.counts, each),
            "region": np.repeat(weights.region, each),
        }
        images = {
            "Lightpanes Panes": atlas,
            "Lightpanes Interpolation": table,
            "Lightpanes Weights": np.concatenate([p.reshape(-1) for p in parts]),
            "Lightpanes Static": steady,
            "Lightpanes Pieces": surface.pieces,
        }
        if panes.vertices is not None and len(panes.vertices.point):
            images["Lightpanes Vertices"] = encode(panes.vertices, meta["bits"])
        meta = {**meta, "format": FORMAT, "resolution": size, "regions": len(panes.starts) - 1, "each": each,
                "shapes": [list(p.shape) for p in parts]}  # fmt: skip
        return cls(size, images, entries, direct, meta, points or {})

    def panes(self) -> Panes:
        """Rebuild what relighting reads. Raises BakeError where the arrays do not fit together."""
        try:
            return self._panes()
        except (KeyError, ValueError, IndexError, TypeError) as error:
            raise BakeError(f"The bake is incomplete ({error}); bake again.") from error

    def _panes(self):
        meta = self.meta
        flat = np.ascontiguousarray(self.images["Lightpanes Weights"], np.float32).reshape(-1)
        parts, at = [], 0
        for shape in meta["shapes"]:
            length = int(np.prod(shape))
            parts.append(flat[at : at + length].reshape(shape))
            at += length
        each = int(meta["each"])
        once = {name: np.ascontiguousarray(values[::each]) for name, values in self.entries.items()}
        where = self._at_points() if self.points else self._at_texels()
        return Panes(
            **where,
            resolution=self.resolution,
            surface=EntrySurface(
                position=self.entries["position"],
                normal=self.entries["normal"],
                albedo=once["albedo"],
                size=once["size"],
                pieces=self.images["Lightpanes Pieces"].reshape(-1, 3, 3),
                counts=once["pieces"].astype(np.int32),
            ),
            weights=PaneWeights(*parts[:3], once["region"].astype(np.int32), parts[3], once["albedo"], *parts[4:]),
        )

    def _at_texels(self) -> dict:
        """The parts of Panes whose exits are texels."""
        size = self.resolution
        atlas = self.images["Lightpanes Panes"].reshape(-1, size * size)
        table = self.images["Lightpanes Interpolation"].reshape(3, size * size)
        # float32 holds integers exactly up to 2^24, the texels of a 4096² atlas
        region = np.rint(table[1]).astype(np.int32) - 1
        texel = np.flatnonzero(region >= 0)
        texel = texel[np.argsort(region[texel], kind="stable")]
        row = np.full(size * size + 1, -1, np.int32)
        row[texel] = np.arange(len(texel), dtype=np.int32)
        return {
            "rows": np.ascontiguousarray(atlas[:, texel].T),
            "starts": starts_of(region[texel], int(self.meta["regions"])),
            "steady": self.images["Lightpanes Static"].reshape(-1, 3)[texel],
            "fill": row[np.rint(table[0]).astype(np.int32) - 1],
            "texel": texel,
            "beside": np.unpackbits(table[2, texel].astype(np.uint8)[:, None], axis=1).astype(bool),
        }

    def _at_points(self) -> dict:
        """The parts of Panes whose exits are points."""
        bits, size = int(self.meta["bits"]), self.resolution
        table = self.images["Lightpanes Interpolation"].reshape(size * size, -1)
        vertices = self.images.get("Lightpanes Vertices", np.zeros((0, table.shape[1]), np.float32))
        return {
            "rows": self.images["Lightpanes Panes"],
            "starts": starts_of(self.points["region"], int(self.meta["regions"])),
            "steady": self.images["Lightpanes Static"],
            "shown": decode(table, bits),
            "own": table[:, 0] > 0,
            "vertices": decode(vertices, bits),
        }

    @property
    def bytes(self) -> int:
        """Bytes of all stored arrays."""
        arrays = [*self.images.values(), *self.entries.values(), *self.points.values()]
        return sum(a.nbytes for a in arrays) + (0 if self.direct is None else self.direct.nbytes)

    def save(self, path: str | os.PathLike) -> None:
        """Write an .npz (arrays and JSON only). Written beside `path` first, then put in its place."""
        path = Path(path)
        named = {"image": self.images, "entry": self.entries, "point": self.points}
        arrays = {f"{kind}:{k}": v for kind, held in named.items() for k, v in held.items()}
        if self.direct is not None:
            arrays["direct"] = self.direct
        arrays["meta"] = np.frombuffer(json.dumps(self.meta).encode(), np.uint8)
        with replacing(path) as temporary:
            with open(temporary, "wb") as file:
                np.savez(file, **arrays)

    @classmethod
    def load(cls, path: str | os.PathLike) -> Bake:
        """Read what `save` wrote. Raises BakeError for files that are truncated, foreign or of another version."""
        try:
            with np.load(path, allow_pickle=False) as data:
                arrays = {name: data[name] for name in data.files}
        # a damaged archive makes the readers of zip, of numpy's headers and of Python literals raise nearly anything
        except Exception as error:
            if isinstance(error, OSError) and not Path(path).exists():
                raise BakeError(f"There is no bake file {path}.") from error
            raise BakeError(f"{path} is not a bake of Lightpanes, or it is cut off; bake again. ({error})") from error
        try:
            meta = json.loads(bytes(arrays["meta"]))
            version, size = meta["format"], int(meta["resolution"])
            if not all(isinstance(values, np.ndarray) for values in arrays.values()):
                raise TypeError
        except (KeyError, ValueError, TypeError) as error:
            raise BakeError(f"{path} is not a bake of Lightpanes; bake again.") from error
        if version != FORMAT:
            raise BakeError(f"{path} was baked by another version of Lightpanes (format {version}); bake again.")
        pick = lambda prefix: {k[len(prefix) :]: v for k, v in arrays.items() if k.startswith(prefix)}  # noqa: E731
        result = cls(size, pick("image:"), pick("entry:"), arrays.get("direct"), meta, pick("point:"))
        result.panes()
        return result


def _texel_images(panes):
    """PRM atlas (k, H, W), table (3, H, W) and static light (H, W, 3) of panes whose exits are texels."""
    size, texel = panes.resolution, panes.texel
    k = panes.rows.shape[1]
    atlas = np.zeros((k, size * size), np.float32)
    atlas[:, texel] = panes.rows.T
    table = np.zeros((3, size * size), np.float32)
    table[0] = np.where(panes.fill >= 0, np.append(texel, -1)[panes.fill] + 1, 0)
    table[1, texel] = region_of(panes.starts) + 1
    table[2, texel] = np.packbits(panes.beside, axis=1)[:, 0]
    steady = np.zeros((size * size, 3), np.float32)
    steady[texel] = panes.steady
    return atlas.reshape(k, size, size), table.reshape(3, size, size), steady.reshape(size, size, 3)


def point_arrays(points: PointSet, region: np.ndarray, owner: np.ndarray) -> dict[str, np.ndarray]:
    """What a bake keeps of its stored points. region: (n,) of each; owner: (triangles,) object of each."""
    samples = points.samples
    return {
        "position": samples.position,
        "normal": samples.normal,
        "radius": points.radius,
        "ao": points.ao,
        "object": owner[samples.triangle].astype(np.int32),
        "triangle": samples.triangle,
        "weights": samples.weights,
        "region": region.astype(np.int32),
    }
