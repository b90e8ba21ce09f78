"""Choice of the camera that shows most of a robot's motion and of what is dangerous to approach."""

from __future__ import annotations

import numpy as np

from safe_ompl.pictures.render.camera import Camera
from safe_ompl.pictures.render.mitsuba_renderer import Sight
from safe_ompl.pictures.render.stage import Stage

_AZIMUTHS = np.arange(20) * (2 * np.pi / 20)
_ELEVATIONS = np.radians([20.0, 35.0])
_HAZARD_POINTS = 200


def best_view(
    stage: Stage, size: tuple[int, int], azimuth: float | None = None, elevation: float | None = None
) -> Camera:
    """Return the camera that shows most of the robot's motion and of what it has to keep away from.

    Parameters
    ----------
    stage : Stage
        What is seen.
    size : (int, int)
        Width and height of the picture [px].
    azimuth, elevation : float, optional
        Direction from the scene to the camera [rad], where it is not to be chosen.
    """
    landmarks = stage.landmarks()
    if elevation is None and stage.is_level():
        elevation = np.pi / 2
    if elevation is not None and elevation > 0.99 * np.pi / 2 and azimuth is None:
        azimuth = -np.pi / 2
    views = [
        Camera.framing(landmarks, turn, height, size)
        for height in (_ELEVATIONS if elevation is None else [elevation])
        for turn in (_AZIMUTHS if azimuth is None else [azimuth])
    ]
    return views[0] if len(views) == 1 else max(views, key=_Merit(stage))


class _Merit:
    """The merit of a view: what share is seen of motion and hazards, how far apart they look, how large."""

    def __init__(self, stage: Stage) -> None:
        self._links = stage.skeletons()
        hazards = np.vstack([np.empty((0, 3))] + [thing.surface.vertices for thing in stage.hazards])
        self._points = hazards[:: 1 + len(hazards) // _HAZARD_POINTS]
        self._all = Sight(thing.surface for thing in stage.props)
        self._things = Sight(thing.surface for thing in stage.things)
        self._hazards = Sight(thing.surface for thing in stage.hazards)

    def __call__(self, view: Camera) -> float:
        links = self._all.clear(view.eye, self._links).mean()
        hazards = self._things.clear(view.eye, self._points).mean() if len(self._points) else 1.0
        beyond = self._links + (self._links - view.eye)
        apart = self._hazards.clear(self._links, beyond).mean()
        extent = np.linalg.det(np.cov(view.project(self._links), rowvar=False))
        return float(links**2 * apart * (0.5 + 0.5 * hazards) * max(extent, 0.0) ** 0.25)
