"""Tessellate robot, paths, scene and floor for drawing, and choose the camera that shows most of them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray, finite_array
from safe_ompl.drawing.rendering import nearest_triangles
from safe_ompl.drawing.style import Colour
from safe_ompl.drawing.surfaces import ColouredSurface, RobotBody, Surface, scene_surfaces
from safe_ompl.geometry import surfaces
from safe_ompl.planning.simplification import Curve

if TYPE_CHECKING:
    from safe_ompl.robot import Robot
    from safe_ompl.scene import Scene

# In sizes of the robot's motion: half a pixel of a picture with a thousand rows.
_DETAIL = 5e-4
_PATH_SAMPLES = 121  # of a path
# The scene must be in view within this many sizes of the robot's motion.
_NEARBY = 1.1
# A lowest slab of at least this many sizes of the robot's motion is the ground.
_GROUND = 1.2
_PEDESTAL: Colour = (0.62, 0.63, 0.65)
# The distance in front of the camera at which drawing begins.
_NEAR_PLANE = 0.02  # [m]
# The share of a picture that is left free at each side.
_MARGIN = 0.05


@dataclass(frozen=True)
class Camera:
    """A pinhole camera."""

    # The camera's position, a point that it looks at, and the upward direction of the picture, (3,) each [m].
    eye: FloatArray
    target: FloatArray
    up: FloatArray
    field_of_view: float  # Vertical opening angle [rad]

    @classmethod
    def framing(
        cls, points: FloatArray, azimuth: float, elevation: float, size: tuple[int, int], field_of_view: float = 0.5
    ) -> Camera:
        """Return the nearest camera in a given direction that has all `points: (P, 3)` [m] in view.

        Azimuth about z and elevation [rad] give the direction from the points to the camera. Raises InputError if the
        picture, `size` [px], has no pixels.
        """
        if min(size) < 1:
            raise InputError(f"a picture needs at least 1 pixel; got {size[0]} by {size[1]}")
        ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
        # The directions to the camera, and to the right of the picture.
        back, right = np.array([ce * ca, ce * sa, se]), np.array([-sa, ca, 0.0])
        up = np.cross(back, right)
        x, y, z = points @ right, points @ up, points @ back
        half_height = np.tan(field_of_view / 2) * (1.0 - 2.0 * _MARGIN)
        eye_x, far_x = _fit(x, z, half_height * size[0] / size[1])
        eye_y, far_y = _fit(y, z, half_height)
        eye_z = max(far_x, far_y, float(z.max()) + 1e-3)
        eye = eye_x * right + eye_y * up + eye_z * back
        return cls(eye, eye - (eye_z - float(z.mean())) * back, up, field_of_view)

    def axes(self) -> tuple[FloatArray, FloatArray]:
        """Return the unit vectors (3,) back to the eye and to the right in the picture."""
        back = (self.eye - self.target) / np.linalg.norm(self.eye - self.target)
        return back, np.cross(self.up, back)

    def key_light(self) -> FloatArray:
        """Return the unit vector (3,) to the main light of a picture: high over the left shoulder of the camera."""
        back = (self.eye - self.target - 0.35 * self.up) * (1.0, 1.0, 0.0)
        back = back / np.linalg.norm(back)
        left = np.cross(back, (0.0, 0.0, 1.0))
        key = 0.6 * back + 0.8 * left + (0.0, 0.0, 1.3)
        return np.asarray(key / np.linalg.norm(key))


def _fit(across: FloatArray, depth: FloatArray, slope: float) -> tuple[float, float]:
    """Return the nearest camera (lateral position, depth) that sees all points within ± `slope`.

    |xᵢ − x| ≤ slope · (z − zᵢ) for all i is tight at z = (max(xᵢ + s zᵢ) − min(xᵢ − s zᵢ)) / 2s.
    """
    high, low = float((across + slope * depth).max()), float((across - slope * depth).min())
    return (high + low) / 2.0, (high - low) / (2.0 * slope)


def in_picture(camera: Camera, points: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return columns, rows and 1/depth [1/m] of points (P, 3) in a picture; NaN behind the camera."""
    back, right = camera.axes()
    away = points - camera.eye
    depth = -(away @ back)
    depth = np.where(depth > _NEAR_PLANE, depth, np.nan)
    scale = size[1] / 2 / np.tan(camera.field_of_view / 2) / depth
    x = (size[0] - 1) / 2 + scale * (away @ right)
    y = (size[1] - 1) / 2 - scale * (away @ camera.up)
    return np.column_stack([x, y, 1.0 / depth])


def viewing_rays(camera: Camera, size: tuple[int, int], pixels: IntArray) -> FloatArray:
    """Return the directions (P, 3) of the rays of pixels, per metre of depth. Pixels are numbered row by row."""
    back, right = camera.axes()
    half = np.tan(camera.field_of_view / 2) / (size[1] / 2)
    row, column = np.divmod(pixels, size[0])
    x, y = (column - (size[0] - 1) / 2) * half, ((size[1] - 1) / 2 - row) * half
    return np.asarray(x[:, None] * right + y[:, None] * camera.up - back)


class DrawnScene:
    """A robot, its paths and its scene, tessellated once for any number of pictures.

    The paths, (N, n) each, decide what must be in view. InputError if there is none, or one is no path of the robot.
    """

    def __init__(self, robot: Robot, scene: Scene, paths: Sequence[FloatArray]) -> None:
        if not len(paths):
            raise InputError("no path to draw; give at least one")
        self.robot = robot
        # Samples at equal steps of each path (S, n).
        self.samples = [resampled(robot, path) for path in paths]
        coarse = RobotBody(robot, coarse=True)
        self._actors = np.vstack([coarse.posed(q).vertices for s in self.samples for q in s[:: _PATH_SAMPLES // 6]])
        # The robot at start and goal of all paths, coarsely
        self.ends = Surface.merged(coarse.posed(q) for s in self.samples for q in (s[0], s[-1]))
        # Diagonal of the box around the robot's motion [m]
        self.size = float(np.linalg.norm(np.ptp(self._actors, axis=0)))
        self.body = RobotBody(robot, detail=_DETAIL * self.size)
        self._set_scene(scene)

    def surroundings(self, without: Collection[str] = ()) -> list[ColouredSurface]:
        """Return the surfaces of the scene and the pedestal, without the named obstacles."""
        left = [group for name, group in self.groups.items() if name not in without]
        return [thing for group in left for thing in group] + self.pedestal

    def trace(self, samples: FloatArray) -> FloatArray:
        """Return the positions (S, 3) [m] of the tip at configurations `samples: (S, n)`."""
        return np.asarray(self.robot.keypoints_batch(samples)[:, -1])

    def skeletons(self) -> FloatArray:
        """Return points (P, 3) on the links of the robot, sampled along all paths."""
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
        """Find the dangerous obstacles and the height of the floor. A large flat lowest obstacle becomes the floor."""
        drawn, self.hazards = scene_surfaces(scene)
        lows = [_lowest(thing) for group in drawn.values() for thing in group]
        self.floor = lowest = min([float(self._actors[:, 2].min()), *lows])  # [m]
        # The surfaces of each obstacle except the ground.
        self.groups: dict[str, list[ColouredSurface]] = {}
        for name, group in drawn.items():
            extent = np.ptp(group[0].surface.vertices, axis=0)
            is_slab = (extent[:2] > _GROUND * self.size).all() and extent[2] < 0.1 * self.size
            if _lowest(group[0]) == lowest and is_slab:
                self.floor = float(group[0].surface.vertices[:, 2].max())
            else:
                self.groups[name] = group
        self.pedestal = self._pedestal()

    def _pedestal(self) -> list[ColouredSurface]:
        """Return a column under a robot whose base neither stands on the floor nor on an obstacle."""
        centre, radius, bottom = self.body.footprint()
        gap = bottom - self.floor
        things = (thing for group in self.groups.values() for thing in group)
        if gap < 0.03 * self.size or any(_carries(thing, centre, bottom, gap) for thing in things):
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
    """Return whether a surface lies below `centre: (2,)` and reaches up to almost the height `bottom` [m]."""
    low, high = thing.surface.vertices.min(axis=0), thing.surface.vertices.max(axis=0)
    beneath = bool((low[:2] < centre).all() and (centre < high[:2]).all())
    return beneath and low[2] < bottom + 0.01 and high[2] > bottom - 0.3 * gap


_AZIMUTHS = np.arange(20) * (2 * np.pi / 20)
_ELEVATIONS = np.radians([20.0, 35.0])
_HAZARD_POINTS = 200
# This share of the hazard's points counts as its nearest part.
_NEAREST = 0.2
# The size of the pictures in which views are compared.
_COARSE_SIZE = (160, 120)  # [px]
# In sizes of the robot's motion: smaller details do not decide between views.
_CELL = 0.02
# Relative tolerances of depths, which are smaller than the depth of a person.
_DEPTH_TOLERANCE, _FINE_DEPTH_TOLERANCE = 0.03, 0.012


def best_view(drawn: DrawnScene, size: tuple[int, int]) -> Camera:
    """Return the camera that shows most of the robot's motion and of the dangerous obstacles; `size` is in pixels."""
    landmarks = drawn.landmarks()
    if np.ptp(drawn.skeletons()[:, 2]) < 0.01 * drawn.size:  # best seen from above
        return Camera.framing(landmarks, -np.pi / 2, np.pi / 2, size)
    views = [Camera.framing(landmarks, turn, height, size) for height in _ELEVATIONS for turn in _AZIMUTHS]
    return max(views, key=_Merit(drawn))


class _Merit:
    """Score a view by the visible shares of motion and hazards. The nearest part of the hazards counts most."""

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
            near = _seen(view, self._everything, self._near, _FINE_DEPTH_TOLERANCE).mean()
        nearest, own = _nearness(view, self._hazards, self._links)
        # The share of the links that are not in front of a hazard.
        apart = 1.0 - (np.isfinite(nearest) & (own > nearest)).mean()
        extent = np.linalg.det(np.cov(in_picture(view, self._links, _COARSE_SIZE)[:, :2], rowvar=False))
        shown = (0.5 + 0.5 * hazards) * near**2
        return float(links**2 * apart * shown * max(extent, 0.0) ** 0.25)


def _seen(view: Camera, solid: Surface, points: FloatArray, tolerance: float = _DEPTH_TOLERANCE) -> BoolArray:
    """Return whether a solid leaves points (P, 3) in view: (P,)."""
    nearest, own = _nearness(view, solid, points)
    return np.asarray(own >= (1.0 - tolerance) * nearest)


def _nearness(view: Camera, solid: Surface, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return 1/depth of a solid where points (P, 3) are in a coarse picture, -inf beside it, and of the points."""
    nearness, _ = nearest_triangles(in_picture(view, solid.vertices, _COARSE_SIZE), solid.faces, *_COARSE_SIZE)
    column, row, own = in_picture(view, points, _COARSE_SIZE).T
    inside = (column > -0.5) & (column < _COARSE_SIZE[0] - 0.5) & (row > -0.5) & (row < _COARSE_SIZE[1] - 0.5)
    column, row = (np.where(inside, np.rint(at), 0.0).astype(np.intp) for at in (column, row))
    return np.where(inside, nearness[row, column], -np.inf), np.where(inside, own, 0.0)
