"""The preview engine: frames of one sample a pixel, the caches that they share, and the images that they make."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..implicit_cache import Cache
from ..sampling import PLASTIC, hash_uniform
from ..scene import Light, SceneError, Sky
from ..threads import in_threads
from ..vectors import put
from .accumulation import Film, PixelCache
from .camera import Camera
from .gbuffer import GBuffer, make_gbuffer, pieces
from .light import MOST_LAMPS, Baked, Lamps
from .paths import PathTracer
from .pixel_filter import offsets
from .surfaces import Surfaces

PASSES = {
    "Combined": 4,
    "Diffuse Color": 3,
    "Diffuse Direct": 3,
    "Diffuse Indirect": 3,
    "AO": 3,
    "Normal": 3,
    "Depth": 1,
}
"""Images that a preview makes, and their channels."""

LATER = 2
"""Where views are not kept, frame k's view of the cached light counts as k to this power: later ones know more."""

FINE = (5.0, 20.0, 80.0)
"""Cells' edges of the cache that is seen, in widths of a pixel: larger than occlusion alone would want, for light that
bounces has three to six times its noise. Against Cycles, two_rooms, 64 frames, SSIM of indirect light: 4 gives 0.954,
5 gives 0.957, 8 gives 0.954."""

COARSE = 12.0
"""Cells' edges of the cache that ends paths, in widths of a pixel."""

KEPT_BYTES = 1e9
"""Of the views of all places in a pixel, which are kept for a camera at rest where they fit."""

AGAIN = 4
"""At places in a pixel that were seen before, one pixel in so many asks the lamps once more: most of what these bring there is
known by then, and penumbrae have the other places too."""

TILE = 4
"""Pixels along each side of a tile whose samples are spread together."""

_F = np.float32
# In which order the pixels of a tile take their turns: neighbours far apart (Bayer's matrix)
_ORDER = np.array([0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5])
# Kronecker sequences, one a dimension: bounces, places on lamps, which lamp, places on lamps where the bounce lands
_STEPS = (PLASTIC, (2**0.5 - 1, 3**0.5 - 1), (5**0.5 - 2, 7**0.5 - 2), (11**0.5 - 3, 13**0.5 - 3))


@dataclass(frozen=True)
class Settings:
    """bounces: of indirect light, at most. places: in a pixel, that a camera at rest goes through, 1 for its middle
    alone; where mirrors or glass are seen every frame has its own.
    filter_width: of a pixel, px. ao_distance: m, beyond which nothing occludes. transparent: the camera does not see the
    sky. passes: of PASSES, those that are wanted beside Combined; direct and indirect light are kept apart for theirs alone.
    cached: share light between pixels, in the world-space cache; else every pixel has its own mean."""

    bounces: int = 8
    places: int = 8
    filter_width: float = 1.5
    ao_distance: float = 10.0
    transparent: bool = False
    passes: Collection[str] = tuple(PASSES)
    cached: bool = True
    seed: int = 0


@dataclass
class _View:
    """One look through the camera. reflectance: (m, 3) radiance for irradiance at the G-buffer's places. known: (k,) rows of
    its m whose indirect light a bake holds, rest: the others. baked: (k, C) of the known ones, first and indirect light
    where these are apart. places: of the rest, in the cache. direct: (pixels, 3), mean over its visits. turns: of the m,
    which of AGAIN they have, and the rows of each turn. shown: what the film has of it, by name.
    """

    buffer: GBuffer
    reflectance: np.ndarray
    known: np.ndarray
    rest: np.ndarray
    baked: np.ndarray | None
    places: object = None
    direct: np.ndarray | None = None
    visits: int = 0
    turns: list[np.ndarray] | None = None
    shown: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def bytes(self) -> int:
        return 460 * len(self.buffer.rows) + 84 * len(self.buffer.depth)


class Preview:
    """Frames of a scene through a camera, each of one sample a pixel. The same seed gives the same images."""

    def __init__(
        self,
        surfaces: Surfaces,
        camera: Camera,
        lights: Sequence[Light] = (),
        sky: Sky | None = None,
        settings: Settings | None = None,
        baked: Baked | None = None,
    ):
        self.surfaces, self.camera = surfaces, camera
        self.settings = settings or Settings()
        self.sky, self.baked = sky, baked
        scene = surfaces.scene
        self._bounds = np.stack([scene.positions.min(axis=0), scene.positions.max(axis=0)]).astype(np.float64)
        self._film = Film()
        self._views: dict[int, _View] = {}
        self._shifts: dict[int, np.ndarray] = {}
        self.frames = 0
        """Since the camera last moved or the light changed."""
        self._drawn = 0
        wanted = set(self.settings.passes)
        self._split = not wanted.isdisjoint(("Diffuse Direct", "Diffuse Indirect"))
        self._channels = {"first": 3, "indirect": 3} if self._split else {"light": 3}
        if "AO" in wanted:
            self._channels["ao"] = 1
        self._cache = self._make_cache()
        coarse = None
        if self.settings.cached:
            coarse = Cache(3, fine=COARSE, coarse=None, slots=1 << 18, seed=self.settings.seed)
        # what mirrors and glass show is picked anew at each frame
        self._comes_back = surfaces.is_plain
        self._span = 0.0
        self._lamps = self._make_lamps(lights)
        self._tracer = PathTracer(surfaces, self._lamps, sky, baked, coarse, self.settings.seed)

    def _make_lamps(self, lights):
        focused = self.baked is not None and self.baked.caustics is not None
        return Lamps(lights, self.surfaces.shadows(focused), self._bounds)

    def _make_cache(self):
        channels = sum(self._channels.values())
        if self.settings.cached:
            return Cache(channels, fine=FINE[0], coarse=FINE[1:], seed=self.settings.seed)
        width, height = self.camera.size
        return PixelCache(channels, width * height)

    # ---- what may change ----

    def look(self, camera: Camera) -> None:
        """Look through another camera: the caches stay."""
        if camera.size != self.camera.size:
            self._shifts.clear()
        self.camera = camera
        self._views.clear()
        if not self.settings.cached:
            self._cache = self._make_cache()
        self._start_again()

    def light(self, lights: Sequence[Light], sky: Sky | None, baked: Baked | None = None) -> None:
        """Light the scene otherwise: what is cached counts for little from now on."""
        self.sky, self.baked = sky, baked
        self._lamps = self._make_lamps(lights)
        self._tracer = PathTracer(self.surfaces, self._lamps, sky, baked, self._tracer.coarse, self.settings.seed)
        for cache in (self._cache, self._tracer.coarse):
            if cache is not None:
                cache.drop()
        self._views.clear()
        self._start_again()

    def _start_again(self):
        self._film.clear()
        self.frames = 0

    # ---- a frame ----

    def frame(self) -> None:
        """One more sample for every pixel."""
        self._lamps.darkness.settle()
        view = self._view(self.frames)
        buffer = view.buffer
        self._add_direct(view)
        parts = self._cached_light(view)
        self.frames += 1
        self._drawn += 1
        film, weight = self._film, float(self.frames) ** LATER
        kept = bool(self._views)
        # what a place in the pixel shows by itself stays: once all have been seen, the mean of them is final
        fresh = not self._comes_back or self.frames <= self.settings.places
        if fresh:
            film.add("seen", np.concatenate([buffer.seen, buffer.alpha[:, None]], axis=1))
        images = {
            name: _spread(buffer, values, None if name == "ao" else view.reflectance) for name, values in parts.items()
        }
        if kept:
            # places count alike however often each was seen, or edges would shake
            for name, image in images.items():
                film.replace(name, image, view.shown.get(name))
                view.shown[name] = image
        else:
            for name, image in images.items():
                film.add(name, image, weight)
        wanted = self.settings.passes
        if fresh and (self._split or "Diffuse Color" in wanted):
            film.add("colour", _spread(buffer, buffer.reflectance))
        if fresh and "Normal" in wanted:
            film.add("normal", buffer.shown_normal)
        if "Depth" in wanted and "depth" not in film:
            film.add("depth", buffer.depth[:, None])

    def image(self, name: str = "Combined") -> np.ndarray:
        """(height, width, channels) float32 of one of PASSES, row 0 at the bottom; linear, W/(m² sr) where it is light.

        Combined is premultiplied by its alpha. Raises SceneError before the first frame, or for a pass that is not made.
        """
        if not self.frames:
            raise SceneError("There is no image before the first frame.")
        names = ["Combined", *(own for own in PASSES if own != "Combined" and own in self.settings.passes)]
        if name not in names:
            raise SceneError(f"The preview makes no pass {name!r}; it makes {', '.join(names)}.")
        film = self._film
        if name == "Combined":
            made = film.mean("seen")
            shown = ["direct", "light"] if "light" in film else ["direct", "first", "indirect"]
            made[:, :3] += sum(film.mean(part) for part in shown)
            if not self.settings.transparent:
                made[:, 3] = 1
        elif name in ("Diffuse Direct", "Diffuse Indirect"):
            light = film.mean("indirect") if name == "Diffuse Indirect" else film.mean("direct") + film.mean("first")
            colour = film.mean("colour")
            made = np.where(colour > 1e-6, light / np.maximum(colour, 1e-6), 0)
        else:
            made = film.mean({"Diffuse Color": "colour", "AO": "ao", "Normal": "normal", "Depth": "depth"}[name])
            if name == "AO":
                made = np.repeat(made, 3, axis=1)
        width, height = self.camera.size
        return made.reshape(height, width, -1).astype(np.float32)

    def _view(self, number: int) -> _View:
        """The view of a frame; those that a camera at rest comes back to are kept."""
        settings = self.settings
        place = number % settings.places if self._comes_back else number
        if place in self._views:
            return self._views[place]
        offset = offsets(place + 1, settings.filter_width, settings.seed)[place]
        buffer = make_gbuffer(self.surfaces, self.camera, self.sky, offset, place, settings.seed, settings.transparent)
        known, rest, baked = np.zeros(0, np.int64), np.arange(len(buffer.rows)), None
        if self._tracer.bake is not None:
            held = self._tracer.bake.holds(buffer.triangle, buffer.flat)
            known, rest = np.flatnonzero(held), np.flatnonzero(~held)
            baked = self._read_bake(buffer, known)
        view = _View(buffer, buffer.reflectance * _F(1 / np.pi), known, rest, baked)
        if len(buffer.footprint):
            span = float(np.median(buffer.footprint[::16]))
            # another unit is another cache, so it stays while it is about right
            if not 0.4 < self._span / max(span, 1e-30) < 2.5:
                self._span = span
        if self._comes_back and settings.places * view.bytes <= KEPT_BYTES:
            self._views[place] = view
        return view

    def _read_bake(self, buffer, known):
        """(k, C) of the light that the bake holds at the G-buffer's `known` rows."""
        bake, split = self._tracer.bake, self._split
        made = np.empty((len(known), 6 if split else 3), np.float32)
        whole = len(known) == len(buffer.rows)

        def part(piece):
            rows = piece if whole else known[piece]
            first, indirect = bake.read(buffer.triangle[rows], buffer.u[rows], buffer.v[rows])
            for k in range(3):
                if split:
                    made[piece, k], made[piece, 3 + k] = first[k], indirect[k]
                else:
                    np.add(first[k], indirect[k], out=made[piece, k])

        in_threads(part, pieces(len(known)))
        return made

    def _numbers(self, pixels: np.ndarray, dimension: int) -> np.ndarray:
        """(2, n) in [0, 1) for pixels (n,): those of a tile, frame after frame, go through one sequence together, so that
        what they share is sampled evenly; tiles differ by hashes."""
        step = np.array(_STEPS[dimension])[:, None]
        if dimension not in self._shifts:
            width, height = self.camera.size
            row, column = np.divmod(np.arange(width * height, dtype=np.int32), np.int32(width))
            tile = (row // TILE * 65536 + column // TILE).astype(np.uint32)
            turn = _ORDER[row % TILE * TILE + column % TILE]
            shift = [hash_uniform(tile, 50 + 2 * dimension + k, self.settings.seed) for k in (0, 1)]
            self._shifts[dimension] = ((np.stack(shift) + turn * step) % 1).astype(np.float32)
        # float64: the product's fraction is what counts
        turn = self._drawn * TILE * TILE * step % 1
        shift = self._shifts[dimension]
        numbers = (
            shift + turn.astype(np.float32)
            if len(pixels) == shift.shape[1]
            else shift.take(pixels, axis=1, mode="clip")
        )
        if len(pixels) != shift.shape[1]:
            numbers += turn.astype(np.float32)
        numbers -= np.floor(numbers)
        return np.minimum(numbers, _F(1 - 2**-24), out=numbers)

    def _add_direct(self, view: _View) -> None:
        """Show the lamps' light, with one more sample of each for every pixel, or, where the view was seen before, for those
        whose turn it is."""
        buffer, film = view.buffer, self._film
        kept, view.visits = bool(self._views), view.visits + 1
        if view.visits == 1:
            image = np.zeros((len(buffer.depth), 3), np.float32)
            self._sample_lamps(view, np.arange(len(buffer.rows)), lambda pixels, light: _put(image, pixels, light))
            film.add("direct", image)
            view.direct = image if kept else None
            return
        if not len(self._lamps):
            return
        if view.turns is None:
            row, column = np.divmod(buffer.rows, self.camera.size[0])
            turn = _ORDER[row % TILE * TILE + column % TILE] % AGAIN
            view.turns = [np.flatnonzero(turn == k) for k in range(AGAIN)]
        again = view.visits - 2
        share = _F(1 / (2 + again // AGAIN))

        def improve(pixels, light):
            light -= view.direct.take(pixels, axis=0, mode="clip")
            light *= share
            view.direct[pixels] += light
            film.change("direct", pixels, light)

        self._sample_lamps(view, view.turns[again % AGAIN], improve)

    def _sample_lamps(self, view: _View, rows: np.ndarray, use) -> None:
        """Call use(pixels, light) with (k, 3) radiance by one sample of each lamp at parts of the rows of the G-buffer."""
        buffer, few = view.buffer, len(self._lamps) <= MOST_LAMPS
        if not len(self._lamps):
            return
        whole = len(rows) == len(buffer.rows)

        def part(s):
            own = s if whole else rows[s]
            pixels = buffer.rows[own]
            pick = None if few else self._numbers(pixels, 2)[0]
            light = self._lamps.irradiance(buffer.position[own], buffer.normal[own], self._numbers(pixels, 1), pick)
            light *= view.reflectance[own]
            use(pixels, light)

        for dimension in (1, 2):
            self._numbers(buffer.rows[:1], dimension)
        in_threads(part, pieces(len(rows)))

    def _cached_light(self, view: _View) -> dict[str, np.ndarray]:
        """(m, C) of each cache's light, as it is known after this frame's samples; nothing where it is as it was."""
        buffer, rest = view.buffer, view.rest
        occluded = "ao" in self._channels
        whole = len(rest) == len(buffer.rows)

        def part(values):
            return values if whole else values[rest]

        if view.baked is not None and not len(rest) and not self._split and not occluded:
            return {} if "light" in view.shown else {"light": view.baked}
        made = None
        if view.baked is not None or not len(rest):
            made = np.zeros((len(buffer.rows), sum(self._channels.values())), np.float32)
        if view.baked is not None:
            made[view.known, : view.baked.shape[1]] = view.baked
            if occluded:
                made[view.known, -1] = self._occlusion(view)
        if len(rest):
            position, normal, owner = part(buffer.position), part(buffer.normal), part(buffer.object_id)
            pixel = part(buffer.rows)
            light = self._tracer.gather(
                position, normal, normal if buffer.flat is buffer.normal else part(buffer.flat), pixel.astype(np.uint32),
                self._span, self._numbers(pixel, 0), self._numbers(pixel, 3), self._drawn, self.settings.bounces,
            )  # fmt: skip
            values = [light.first, light.indirect] if self._split else [light.total]
            if occluded:
                values.append((light.way > self.settings.ao_distance).astype(np.float32)[:, None])
            values = np.concatenate(values, axis=1) if len(values) > 1 else values[0]
            if not self.settings.cached:
                view.places = pixel
            elif view.places is None or not self._cache.holds(view.places):
                view.places = self._cache.look_up(position, normal, owner, part(buffer.footprint))
            self._cache.add(view.places, values)
            read = self._cache.read(view.places)
            if made is None:
                made = read
            else:
                made[rest] = read
        ends = np.cumsum(list(self._channels.values()))[:-1]
        return dict(zip(self._channels, np.split(made, ends, axis=1), strict=True))

    def _occlusion(self, view: _View) -> np.ndarray:
        """(k,) 1 where a ray from a place whose light a bake knows meets nothing, one sample each."""
        buffer, tracer = view.buffer, self.surfaces.tracer
        self._numbers(buffer.rows[:1], 0)

        def part(piece):
            rows = view.known[piece]
            normal = buffer.normal[rows]
            ways = self.surfaces.scatter(normal, buffer.flat[rows], self._numbers(buffer.rows[rows], 0))
            free = tracer.visibility(buffer.position[rows], ways * _F(self.settings.ao_distance))
            return free if free.ndim == 1 else free.mean(axis=1)

        parts = in_threads(part, pieces(len(view.known)))
        return np.concatenate(parts) if parts else np.zeros(0, np.float32)


def _put(image, pixels, values):
    if image.shape[1] == 3:
        put(image, _within(pixels), values)
    else:
        image[_within(pixels)] = values


def _within(rows):
    """A slice in place of growing row numbers where these leave none out."""
    return slice(int(rows[0]), int(rows[-1]) + 1) if rows[-1] - rows[0] == len(rows) - 1 else rows


def _spread(buffer: GBuffer, values: np.ndarray, factor: np.ndarray | None = None) -> np.ndarray:
    """(pixels, C) image: values (m, C), times a factor, at the G-buffer's pixels, 0 elsewhere."""
    image = np.zeros((len(buffer.depth), values.shape[1]), np.float32)

    def part(s):
        _put(image, buffer.rows[s], values[s] if factor is None else values[s] * factor[s])

    in_threads(part, pieces(len(buffer.rows)))
    return image
