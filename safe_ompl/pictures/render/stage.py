"""Robot, paths, scene and floor as surfaces, ready for any number of pictures."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.errors import InputError
from safe_ompl.paths.curve import Curve
from safe_ompl.pictures.render.bodies import RobotBody, painted
from safe_ompl.pictures.render.mitsuba_renderer import Painted
from safe_ompl.pictures.render.tessellation import Surface
from safe_ompl.pictures.style import Colour
from safe_ompl.scene import surfaces
from safe_ompl.scene.shapes.person import Person

if TYPE_CHECKING:
    from safe_ompl.robot.robot import Robot
    from safe_ompl.scene.scene import Scene

_PATH_SAMPLES = 121  # of a path
_NEARBY = 1.1  # sizes of the robot's motion within which the scene must be in view
_GROUND = 1.2  # sizes of the robot's motion from which the lowest slab is the ground, and not a thing on it
_PEDESTAL: Colour = (0.62, 0.63, 0.65)
_DANGER_POINT: Colour = (0.85, 0.12, 0.12)


class Stage:
    """A robot, its paths and its scene, tessellated once for any number of pictures.

    Parameters
    ----------
    robot : Robot
        Who moves.
    scene : Scene
        What stands around it.
    paths : sequence of (N, n) array
        All paths that will be shown; they decide what must be in view.
    danger_points : bool
        Whether the scene's danger points are drawn.

    Attributes
    ----------
    body : RobotBody
    samples : list of (S, n) array
        Each path at equal steps of its length.
    ends : Surface
        The robot at start and goal of all paths, coarsely.
    hazards, things : list of Painted
        What is dangerous to approach, and everything else but the robot.
    pedestal : list of Painted
        Of the things, what stands under a robot whose base stands on nothing.
    floor : float
        Height of the floor [m].
    size : float
        Diagonal of the box around the robot's motion [m].

    Raises
    ------
    InputError
        If there is no path, or one is empty, has the wrong number of joints or is not finite.
    """

    def __init__(
        self, robot: Robot, scene: Scene, paths: Sequence[FloatArray], *, danger_points: bool = False
    ) -> None:
        if not len(paths):
            raise InputError("no path to draw; give at least one")
        self.robot = robot
        self.body = RobotBody(robot)
        self.samples = [resampled(robot, path) for path in paths]
        coarse = RobotBody(robot, coarse=True)
        self._actors = np.vstack(
            [coarse.posed(q).vertices for s in self.samples for q in s[:: _PATH_SAMPLES // 6]]
        )
        self.ends = Surface.merged(coarse.posed(q) for s in self.samples for q in (s[0], s[-1]))
        self.size = float(np.linalg.norm(np.ptp(self._actors, axis=0)))
        self._set_scene(scene)
        if danger_points:
            dots = _dots(scene.danger_points()[0], 0.006 * self.size)
            self.things.append(Painted(dots, _DANGER_POINT))

    @property
    def props(self) -> list[Painted]:
        """Everything but the robot."""
        return self.hazards + self.things

    def props_without(self, names: Collection[str]) -> list[Painted]:
        """Return everything but the robot and some obstacles."""
        left = [group for name, group in self._groups.items() if name not in names]
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
        around = np.vstack([np.empty((0, 3))] + [thing.surface.vertices for thing in self.props]) - centre
        far = np.linalg.norm(around, axis=1, keepdims=True) / (_NEARBY * self.size)
        return np.vstack([self._actors, centre + around / np.maximum(far, 1.0)])

    def is_level(self) -> bool:
        """Return whether the robot moves in a level plane, which is best seen from above."""
        return bool(np.ptp(self.skeletons()[:, 2]) < 0.01 * self.size)

    def _set_scene(self, scene: Scene) -> None:
        """Sort the scene into what is dangerous, what is not, and the ground, on which all else stands."""
        marked = any(o.weight == 0 or isinstance(o.shape, Person) for o in scene.obstacles)
        groups = [painted(obstacle, marked) for obstacle in scene.obstacles]
        lowest = min(
            [float(self._actors[:, 2].min())] + [_lowest(thing) for group in groups for thing in group]
        )
        self.floor = lowest
        self.hazards: list[Painted] = []
        self.things: list[Painted] = []
        self._groups: dict[str, list[Painted]] = {}
        for obstacle, group in zip(scene.obstacles, groups, strict=True):
            if _lowest(group[0]) == lowest and self._is_slab(group[0]):
                self.floor = float(group[0].surface.vertices[:, 2].max())
                continue
            self._groups[obstacle.name] = group
            if marked and obstacle.weight > 0:
                self.hazards += group
            else:
                self.things += group
        self.pedestal = self._pedestal()
        self.things += self.pedestal

    def _is_slab(self, thing: Painted) -> bool:
        """Whether a thing is level, thin, and wider than the robot's motion."""
        extent = np.ptp(thing.surface.vertices, axis=0)
        return bool((extent[:2] > _GROUND * self.size).all() and extent[2] < 0.1 * self.size)

    def _pedestal(self) -> list[Painted]:
        """Return a column under a robot whose base neither stands on the floor nor on an obstacle."""
        centre, radius, bottom = self.body.footprint()
        gap = bottom - self.floor
        if gap < 0.03 * self.size or any(_carries(thing, centre, bottom, gap) for thing in self.props):
            return []
        vertices, faces = surfaces.revolved_triangles(surfaces.cylinder_profile(radius, gap, np.inf), 64)
        place = np.array([centre[0], centre[1], self.floor + gap / 2])
        return [Painted(Surface.from_triangles(vertices + place, faces), _PEDESTAL)]


def resampled(robot: Robot, path: FloatArray, count: int = _PATH_SAMPLES) -> FloatArray:
    """Return `count` configurations (count, n) at equal steps along `path: (N, n)`.

    Raises
    ------
    InputError
        If the path is empty, has the wrong number of joints or is not finite.
    """
    path = finite_array(path, (None, robot.n), "path")
    if not len(path):
        raise InputError("path must have at least one configuration, got none")
    curve = Curve(robot, path)
    return curve.at(np.linspace(0.0, curve.length, count))


def _lowest(thing: Painted) -> float:
    return float(thing.surface.vertices[:, 2].min())


def _carries(thing: Painted, centre: FloatArray, bottom: float, gap: float) -> bool:
    """Whether a thing reaches up to (almost) the bottom of what stands at `centre: (2,)`."""
    low, high = thing.surface.vertices.min(axis=0), thing.surface.vertices.max(axis=0)
    beneath = bool((low[:2] < centre).all() and (centre < high[:2]).all())
    return beneath and low[2] < bottom + 0.01 and high[2] > bottom - 0.3 * gap


def _dots(points: FloatArray, radius: float) -> Surface:
    ball = Surface.from_triangles(
        *surfaces.revolved_triangles(surfaces.sphere_profile(radius, radius / 2), 12)
    )
    return Surface.merged(ball.moved(np.eye(3), point) for point in points)
