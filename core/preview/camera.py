"""Cameras as Blender means them, and the rays through their pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..scene import SceneError

FITS = ("AUTO", "HORIZONTAL", "VERTICAL")


@dataclass(frozen=True)
class Camera:
    """A projection of the world onto an image.

    view: (4, 4) float64 from world to camera space, m; it looks along −Z. projection: (4, 4) float64 to clip space, as
    OpenGL has it. width, height: of the image, px. window: (left, bottom, right, top), px, the part of it that is
    looked at; None for all.
    """

    view: np.ndarray
    projection: np.ndarray
    width: int
    height: int
    window: tuple[int, int, int, int] | None = None

    def __post_init__(self):
        for name in ("view", "projection"):
            matrix = np.asarray(getattr(self, name), np.float64).reshape(4, 4)
            if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-300:
                raise SceneError("The camera's place or lens is not a number, or is scaled to nothing; reset it.")
            object.__setattr__(self, name, matrix)
        if self.window is None:
            object.__setattr__(self, "window", (0, 0, self.width, self.height))

    @classmethod
    def from_lens(
        cls,
        matrix: np.ndarray,
        width: int,
        height: int,
        *,
        orthographic: bool = False,
        lens: float = 50.0,
        scale: float = 6.0,
        sensor: tuple[float, float] = (36.0, 24.0),
        fit: str = "AUTO",
        shift: tuple[float, float] = (0.0, 0.0),
        clip: tuple[float, float] = (0.1, 1000.0),
        aspect: tuple[float, float] = (1.0, 1.0),
    ) -> Camera:
        """A camera with Blender's settings.

        matrix: (4, 4) to the world, its scale is ignored. lens, sensor: mm. scale: of an orthographic camera, m over
        the fitted side. fit: one of FITS, which side the sensor or scale belongs to. shift: in fitted sides. clip: m.
        aspect: of a pixel, X and Y. Raises SceneError for an unknown fit.
        """
        if fit not in FITS:
            raise SceneError(f"Unknown sensor fit {fit!r}, use one of {', '.join(FITS)}.")
        if width < 1 or height < 1:
            raise SceneError(f"An image of {width} × {height} pixels has nothing to show.")
        tall = aspect[1] / aspect[0]
        across = fit == "HORIZONTAL" or (fit == "AUTO" and width >= tall * height)
        side = width if across else tall * height
        near, far = clip
        # Blender takes the sensor's width for AUTO, whichever side it is fitted to
        chip = sensor[1] if fit == "VERTICAL" else sensor[0]
        pixel = (scale if orthographic else chip * near / lens) / side
        middle = np.array(shift, np.float64) * side
        half = np.array([width, tall * height]) / 2
        left, bottom = (middle - half) * pixel
        right, top = (middle + half) * pixel
        world = np.array(matrix, np.float64)
        world[:3, :3] /= np.maximum(np.linalg.norm(world[:3, :3], axis=0), 1e-300)
        frustum = _parallel if orthographic else _frustum
        return cls(np.linalg.inv(world), frustum(left, right, bottom, top, near, far), width, height)

    def part(self, left: int, bottom: int, right: int, top: int) -> Camera:
        """The same camera, of whose image only a part is looked at."""
        return replace(self, window=(left, bottom, right, top))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the part that is looked at, px."""
        left, bottom, right, top = self.window
        return right - left, top - bottom

    @property
    def is_orthographic(self) -> bool:
        return bool(self.projection[3, 3] != 0)

    def rays(
        self, offset: tuple[float, float] = (0.5, 0.5), rows: slice = slice(None)
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Through each pixel of the window, or of some of its rows, from the bottom up.

        offset: place in the pixel, (0.5, 0.5) its middle. Returns origins on the near plane (n, 3), unit directions
        (n, 3) and the way to the far plane (n,), float32.
        """
        left, bottom, right, top = self.window
        x = (np.arange(left, right) + offset[0]) * 2 / self.width - 1
        y = (np.arange(bottom, top)[rows] + offset[1]) * 2 / self.height - 1
        back = np.linalg.inv(self.projection @ self.view)

        def plane(depth):
            # on a plane of one depth places are linear in x and y: a corner, along, up
            corners = np.array([[0, 0, depth, 1], [1, 0, depth, 1], [0, 1, depth, 1]], np.float64) @ back.T
            corners = corners[:, :3] / corners[:, 3:]
            return corners - [[0, 0, 0], corners[0], corners[0]]

        def spread(parts, scale=1.0):
            # sums in float32 of what is near the places themselves
            up = ((parts[0] + y[:, None] * parts[2]) / scale).astype(np.float32)
            along = (x[:, None] * parts[1] / scale).astype(np.float32)
            made = np.empty((len(y), len(x), 3), np.float32)
            for k in range(3):
                np.add(up[:, k, None], along[None, :, k], out=made[..., k])
            return made.reshape(-1, 3)

        near = plane(-1.0)
        away = plane(1.0) - near
        farthest = np.linalg.norm(away[0])
        way = spread(away, farthest)
        length = np.sqrt(np.einsum("nk,nk->n", way, way))
        for k in range(3):
            way[:, k] /= length
        return spread(near), way, length * np.float32(farthest)

    def depth(self, positions: np.ndarray) -> np.ndarray:
        """(n,) float32 m, distance of (n, 3) places from the plane of the camera."""
        return -(positions @ self.view[2, :3].astype(np.float32) + np.float32(self.view[2, 3]))

    def footprint(self, depth: np.ndarray) -> np.ndarray:
        """(n,) float32 m, width of a pixel at (n,) depths."""
        wide = np.float32(2 / (abs(self.projection[0, 0]) * self.width))
        return np.full(len(depth), wide, np.float32) if self.is_orthographic else wide * np.abs(depth)


def _frustum(left, right, bottom, top, near, far):
    return np.array(
        [
            [2 * near / (right - left), 0, (right + left) / (right - left), 0],
            [0, 2 * near / (top - bottom), (top + bottom) / (top - bottom), 0],
            [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
            [0, 0, -1, 0],
        ]
    )


def _parallel(left, right, bottom, top, near, far):
    return np.array(
        [
            [2 / (right - left), 0, 0, -(right + left) / (right - left)],
            [0, 2 / (top - bottom), 0, -(top + bottom) / (top - bottom)],
            [0, 0, -2 / (far - near), -(far + near) / (far - near)],
            [0, 0, 0, 1],
        ]
    )
