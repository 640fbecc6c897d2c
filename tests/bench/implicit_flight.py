"""A camera that moves: views along its path, one ray a pixel each, and references for the last of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from lightpanes.core.files import replacing
from lightpanes.core.preview.camera import Camera
from lightpanes.core.rays import Bvh

from . import harness, implicit_views
from .implicit_scenes import STAGES, Stage
from .implicit_views import HEIGHT, WIDTH, View, camera, look, openness, reference

FRAMES, MEASURED = 32, 5
STEP, TURN = 0.01, 0.25
"""m sideways and degrees a frame."""

RAYS = 256
"""Rays a pixel of references."""


@dataclass(frozen=True)
class Flight:
    """views and frames: of all; references: of those from `first` on, (n,) each."""

    stage: Stage
    views: list[View]
    frames: list[np.ndarray]
    references: list[np.ndarray]

    @property
    def first(self) -> int:
        return len(self.views) - len(self.references)

    def project(self, position: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Row and column, in pixels between their middles, of world positions (n, 3) in the picture of that number."""
        through = camera_at(self.stage, number)
        onto = through.projection @ through.view
        place = position @ onto[:, :3].T + onto[:, 3]
        across, up = place[:, 0] / place[:, 3], place[:, 1] / place[:, 3]
        return (1 - up) * HEIGHT / 2 - 0.5, (1 + across) * WIDTH / 2 - 0.5


def camera_at(stage: Stage, number: int) -> Camera:
    """That of a frame."""
    right, _, back = camera(stage).view[:3, :3]
    ahead = -back
    away = np.linalg.norm(np.subtract(stage.target, stage.eye))
    angle = np.radians(TURN * number)
    eye = np.array(stage.eye) + STEP * number * right
    return camera(stage, eye, eye + away * (np.cos(angle) * ahead - np.sin(angle) * right))


def fly(name: str) -> Flight:
    """Over a stage; references are kept in out/bench."""
    stage = STAGES[name]()
    bvh = Bvh(stage.corners)
    views = [look(stage, bvh, camera_at(stage, k)) for k in range(FRAMES)]
    frames = [openness(view, bvh, stage.reach, k) for k, view in enumerate(views)]
    path = harness.OUT / "implicit" / f"{name}-flight-{implicit_views.mark(stage)}-{FRAMES}-{MEASURED}-{RAYS}.npz"
    if not path.exists():
        made = [reference(view, bvh, stage.reach, RAYS) for view in views[-MEASURED:]]
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as part:
            np.savez(part, **{str(k): value for k, value in enumerate(made)})
    with np.load(path) as found:
        references = [found[str(k)] for k in range(MEASURED)]
    return Flight(stage, views, frames, references)
