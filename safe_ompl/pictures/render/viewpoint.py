"""Choice of the camera that shows most of a robot's motion and of what is dangerous to approach."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import BoolArray, FloatArray
from safe_ompl.pictures.render.camera import Camera
from safe_ompl.pictures.render.stage import Stage
from safe_ompl.pictures.render.tessellation import Surface
from safe_ompl.pictures.render.zbuffer import ZBuffer, in_picture

_AZIMUTHS = np.arange(20) * (2 * np.pi / 20)
_ELEVATIONS = np.radians([20.0, 35.0])
_HAZARD_POINTS, _END_POINTS = 200, 500
_NEAREST = 0.2  # share of the hazard's points that counts as its nearest part
_COARSE = (160, 120)  # [px] of the picture in which views are compared
_CELL = 0.02  # sizes of the robot's motion; what is smaller does not decide between views
_TOLERANCE, _FINE = 0.03, 0.012  # relative, of depths; finer than a person is deep


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
    """The merit of a view: what share is seen of motion, its ends and hazards, how far apart they look, how large.

    Of a hazard, such as a person, the part that is nearest to the robot counts most: a hand must not be hidden by the
    back of who holds it out.
    """

    def __init__(self, stage: Stage) -> None:
        self._links = stage.skeletons()
        self._ends = stage.ends.vertices[:: 1 + len(stage.ends.vertices) // _END_POINTS]
        hazards = np.vstack([np.empty((0, 3))] + [thing.surface.vertices for thing in stage.hazards])
        self._points = hazards[:: 1 + len(hazards) // _HAZARD_POINTS]
        gaps = np.linalg.norm(self._points[:, None] - self._links[None], axis=2).min(axis=1, initial=np.inf)
        self._near = self._points[gaps <= np.quantile(gaps, _NEAREST)] if len(gaps) else self._points
        cell = _CELL * stage.size
        self._all, self._things, self._hazards = (
            Surface.merged(thing.surface for thing in things).simplified(cell)
            for things in (stage.props, stage.things, stage.hazards)
        )
        self._everything = Surface.merged([self._all, stage.ends.simplified(cell)])

    def __call__(self, view: Camera) -> float:
        links = _seen(view, self._all, self._links).mean()
        hazards = _seen(view, self._things, self._points).mean() if len(self._points) else 1.0
        near = _seen(view, self._everything, self._near, _FINE).mean() if len(self._near) else 1.0
        ends = _seen(view, self._all, self._ends).mean()
        apart = 1.0 - _before(view, self._hazards, self._links).mean()
        extent = np.linalg.det(np.cov(view.project(self._links), rowvar=False))
        shown = (0.5 + 0.5 * hazards) * near**2
        return float(links**2 * ends**2 * apart * shown * max(extent, 0.0) ** 0.25)


def _seen(view: Camera, solid: Surface, points: FloatArray, tolerance: float = _TOLERANCE) -> BoolArray:
    """Return whether a solid leaves points (P, 3) in view: (P,)."""
    nearest, own = _nearness(view, solid, points)
    return np.asarray(own >= (1.0 - tolerance) * nearest)


def _before(view: Camera, solid: Surface, points: FloatArray) -> BoolArray:
    """Return whether a solid is behind points (P, 3) in the view: (P,)."""
    nearest, own = _nearness(view, solid, points)
    return np.isfinite(nearest) & (own > nearest)


def _nearness(view: Camera, solid: Surface, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return 1/depth of a solid where points (P, 3) are in a coarse picture, -inf beside it, and of the points."""
    buffer = ZBuffer.of(in_picture(view, solid.vertices, _COARSE), solid.faces, _COARSE)
    column, row, own = in_picture(view, points, _COARSE).T
    inside = (column > -0.5) & (column < _COARSE[0] - 0.5) & (row > -0.5) & (row < _COARSE[1] - 0.5)
    column, row = (np.where(inside, np.rint(at), 0.0).astype(np.intp) for at in (column, row))
    return np.where(inside, buffer.nearness[row, column], -np.inf), np.where(inside, own, 0.0)
