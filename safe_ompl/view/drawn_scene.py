"""Robot, paths, scene and floor as surfaces, and the camera that shows most of them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, InputError, finite_array
from safe_ompl.geometry import surfaces
from safe_ompl.paths import Curve
from safe_ompl.view.camera import Camera, in_picture
from safe_ompl.view.rasteriser import nearest_triangles
from safe_ompl.view.style import Colour
from safe_ompl.view.surfaces import ColouredSurface, RobotBody, Surface, scene_surfaces

if TYPE_CHECKING:
    from safe_ompl.robot import Robot
    from safe_ompl.scene import Scene

_DETAIL = 5e-4  # sizes of the robot's motion; half a pixel of a picture of a thousand rows
_PATH_SAMPLES = 121  # of a path
_NEARBY = 1.1  # sizes of the robot's motion within which the scene must be in view
_GROUND = 1.2  # sizes of the robot's motion from which the lowest slab is the ground, and not a thing on it
_PEDESTAL: Colour = (0.62, 0.63, 0.65)


class DrawnScene:
    """A robot, its paths and its scene, tessellated once for any number of pictures.

    The paths, (N, n) each, decide what must be in view. InputError if there is none, or one is no path of the robot.
    """

    def __init__(self, robot: Robot, scene: Scene, paths: Sequence[FloatArray]) -> None:
        if not len(paths):
            raise InputError("no path to draw; give at least one")
        self.robot = robot
        self.samples = [resampled(robot, path) for path in paths]  # (S, n) each, at equal steps
        coarse = RobotBody(robot, coarse=True)
        self._actors = np.vstack([coarse.posed(q).vertices for s in self.samples for q in s[:: _PATH_SAMPLES // 6]])
        # The robot at start and goal of all paths, coarsely
        self.ends = Surface.merged(coarse.posed(q) for s in self.samples for q in (s[0], s[-1]))
        # Diagonal of the box around the robot's motion [m]
        self.size = float(np.linalg.norm(np.ptp(self._actors, axis=0)))
        self.body = RobotBody(robot, detail=_DETAIL * self.size)
        self._set_scene(scene)

    def surroundings(self, without: Collection[str] = ()) -> list[ColouredSurface]:
        """Return everything but the robot, and without some obstacles."""
        left = [group for name, group in self.groups.items() if name not in without]
        return [thing for group in left for thing in group] + self.pedestal

    def trace(self, samples: FloatArray) -> FloatArray:
        """Return the way of the tip (S, 3) [m] through configurations `samples: (S, n)`."""
        return np.asarray(self.robot.keypoints_batch(samples)[:, -1])

    def skeletons(self) -> FloatArray:
        """Return points (P, 3) along the links of the robot, on its way along all paths."""
        points = np.concatenate([self.robot.keypoints_batch(samples[::10]) for samples in self.samples])
        ends = points[:, self.robot.segments]
        shares = np.array([0.25, 0.5, 0.75, 1.0])[:, None]
        return np.asarray(ends[:, :, None, 0] * (1.0 - shares) + ends[:, :, None, 1] * shares).reshape(-1, 3)

    def landmarks(self) -> FloatArray:
        """Return the points (P, 3) that a picture must show: the robot's motion, and the scene near it."""
        centre = (self._actors.min(axis=0) + self._actors.max(axis=0)) / 2
        vertices = [np.empty((0, 3)), *(thing.surface.vertices for thing in self.surroundings())]
        around = np.vstack(vertices) - centre
        far = np.linalg.norm(around, axis=1, keepdims=True) / (_NEARBY * self.size)
        return np.vstack([self._actors, centre + around / np.maximum(far, 1.0)])

    def _set_scene(self, scene: Scene) -> None:
        """Sort the scene into what is dangerous, what is not, and the ground, on which all else stands."""
        drawn, self.hazards = scene_surfaces(scene)
        lows = [_lowest(thing) for group in drawn.values() for thing in group]
        self.floor = lowest = min([float(self._actors[:, 2].min()), *lows])  # [m]
        self.groups: dict[str, list[ColouredSurface]] = {}  # what is drawn of each obstacle but the ground
        for name, group in drawn.items():
            extent = np.ptp(group[0].surface.vertices, axis=0)
            is_slab = (extent[:2] > _GROUND * self.size).all() and extent[2] < 0.1 * self.size
            if _lowest(group[0]) == lowest and is_slab:
                self.floor = float(group[0].surface.vertices[:, 2].max())
            else:
                self.groups[name] = group
        self.pedestal: list[ColouredSurface] = []
        self.pedestal = self._pedestal()

    def _pedestal(self) -> list[ColouredSurface]:
        """Return a column under a robot whose base neither stands on the floor nor on an obstacle."""
        centre, radius, bottom = self.body.footprint()
        gap = bottom - self.floor
        if gap < 0.03 * self.size or any(_carries(thing, centre, bottom, gap) for thing in self.surroundings()):
            return []
        vertices, faces = surfaces.revolved_triangles(surfaces.cylinder_profile(radius, gap, np.inf), 64)
        place = np.array([centre[0], centre[1], self.floor + gap / 2])
        return [ColouredSurface(Surface.from_triangles(vertices + place, faces), _PEDESTAL)]


def resampled(robot: Robot, path: FloatArray) -> FloatArray:
    """Return configurations (S, n) at equal steps along `path: (N, n)`, or raise InputError."""
    path = finite_array(path, (None, robot.n), "path")
    if not len(path):
        raise InputError("path must have at least one configuration, got none")
    curve = Curve(robot, path)
    return curve.at(np.linspace(0.0, curve.length, _PATH_SAMPLES))


def _lowest(thing: ColouredSurface) -> float:
    return float(thing.surface.vertices[:, 2].min())


def _carries(thing: ColouredSurface, centre: FloatArray, bottom: float, gap: float) -> bool:
    """Whether a thing reaches up to (almost) the bottom of what stands at `centre: (2,)`."""
    low, high = thing.surface.vertices.min(axis=0), thing.surface.vertices.max(axis=0)
    beneath = bool((low[:2] < centre).all() and (centre < high[:2]).all())
    return beneath and low[2] < bottom + 0.01 and high[2] > bottom - 0.3 * gap


_AZIMUTHS = np.arange(20) * (2 * np.pi / 20)
_ELEVATIONS = np.radians([20.0, 35.0])
_HAZARD_POINTS = 200
_NEAREST = 0.2  # share of the hazard's points that counts as its nearest part
_COARSE = (160, 120)  # [px] of the picture in which views are compared
_CELL = 0.02  # sizes of the robot's motion; what is smaller does not decide between views
_TOLERANCE, _FINE = 0.03, 0.012  # relative, of depths; finer than a person is deep


def best_view(drawn: DrawnScene, size: tuple[int, int]) -> Camera:
    """Return the camera that shows most of the robot's motion and of what it keeps away from; `size` is in pixels."""
    landmarks = drawn.landmarks()
    if np.ptp(drawn.skeletons()[:, 2]) < 0.01 * drawn.size:  # best seen from above
        return Camera.framing(landmarks, -np.pi / 2, np.pi / 2, size)
    views = [Camera.framing(landmarks, turn, height, size) for height in _ELEVATIONS for turn in _AZIMUTHS]
    return max(views, key=_Merit(drawn))


class _Merit:
    """The merit of a view: how much is seen of motion and hazards, most of all of the nearest part of these."""

    def __init__(self, drawn: DrawnScene) -> None:
        self._links = drawn.skeletons()
        things = drawn.surroundings(drawn.hazards)
        dangerous = [thing for name in drawn.hazards for thing in drawn.groups.get(name, [])]
        hazards = np.vstack([np.empty((0, 3))] + [thing.surface.vertices for thing in dangerous])
        self._points = hazards[:: 1 + len(hazards) // _HAZARD_POINTS]
        gaps = np.linalg.norm(self._points[:, None] - self._links[None], axis=2).min(axis=1, initial=np.inf)
        self._near = self._points[gaps <= np.quantile(gaps, _NEAREST)] if len(gaps) else self._points
        cell = _CELL * drawn.size
        self._all, self._things, self._hazards = (
            Surface.merged(thing.surface for thing in group).simplified(cell)
            for group in (dangerous + things, things, dangerous)
        )
        self._everything = Surface.merged([self._all, drawn.ends.simplified(cell)])

    def __call__(self, view: Camera) -> float:
        links = _seen(view, self._all, self._links).mean()
        hazards = near = 1.0
        if len(self._points):
            hazards = _seen(view, self._things, self._points).mean()
            near = _seen(view, self._everything, self._near, _FINE).mean()
        nearest, own = _nearness(view, self._hazards, self._links)
        apart = 1.0 - (np.isfinite(nearest) & (own > nearest)).mean()  # links that are before no hazard
        extent = np.linalg.det(np.cov(in_picture(view, self._links, _COARSE)[:, :2], rowvar=False))
        shown = (0.5 + 0.5 * hazards) * near**2
        return float(links**2 * apart * shown * max(extent, 0.0) ** 0.25)


def _seen(view: Camera, solid: Surface, points: FloatArray, tolerance: float = _TOLERANCE) -> BoolArray:
    """Return whether a solid leaves points (P, 3) in view: (P,)."""
    nearest, own = _nearness(view, solid, points)
    return np.asarray(own >= (1.0 - tolerance) * nearest)


def _nearness(view: Camera, solid: Surface, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return 1/depth of a solid where points (P, 3) are in a coarse picture, -inf beside it, and of the points."""
    nearness, _ = nearest_triangles(in_picture(view, solid.vertices, _COARSE), solid.faces, *_COARSE)
    column, row, own = in_picture(view, points, _COARSE).T
    inside = (column > -0.5) & (column < _COARSE[0] - 0.5) & (row > -0.5) & (row < _COARSE[1] - 0.5)
    column, row = (np.where(inside, np.rint(at), 0.0).astype(np.intp) for at in (column, row))
    return np.where(inside, nearness[row, column], -np.inf), np.where(inside, own, 0.0)
