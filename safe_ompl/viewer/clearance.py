"""The nearest points of robot and scene, what they are on, and lines between them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.queries import fresh_data
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.obstacle import Obstacle
from safe_ompl.viewer import colours

_PEOPLE, _THINGS = (0.80, 0.10, 0.12), (0.10, 0.35, 0.75)


@dataclass(frozen=True)
class NearestPoints:
    """The nearest points of robot and obstacles.

    Attributes
    ----------
    distance : float
        [m]; zero or negative in contact.
    on_robot, on_obstacle : ndarray, shape (3,)
        In the world frame [m].
    link, obstacle : str
        What they are on.
    """

    distance: float
    on_robot: FloatArray
    on_obstacle: FloatArray
    link: str
    obstacle: str


class Nearest:
    """Finds the nearest points of a robot and some obstacles.

    Parameters
    ----------
    robot : Robot
        The robot; its moving bodies count.
    obstacles : iterable of Obstacle
        The obstacles.
    """

    def __init__(self, robot: Robot, obstacles: Iterable[Obstacle]) -> None:
        self._robot = robot
        self._geometry = robot.shared.collision_model.copy()
        self._geometry.removeAllCollisionPairs()
        bodies = list(robot.shared.collision_model.geometryObjects)
        moving = [k for k, body in enumerate(bodies) if body.parentJoint != 0]
        self._names: list[tuple[str, str]] = []
        for obstacle in obstacles:
            for name, shape, placement in obstacle.geometries():
                number = self._geometry.addGeometryObject(pin.GeometryObject(name, 0, placement, shape))
                for k in moving:
                    self._geometry.addCollisionPair(pin.CollisionPair(k, number))
                    self._names.append((bodies[k].name.rsplit("_", 1)[0], obstacle.name))
        self._kinematics, self._data = robot.shared.model.createData(), fresh_data(self._geometry)

    def at(self, q: FloatArray) -> NearestPoints | None:
        """Return the nearest points at `q: (n,)`; None if there is no obstacle."""
        if not self._names:
            return None
        full = self._robot.pinocchio_configuration(q)
        pin.computeDistances(self._robot.shared.model, self._kinematics, self._geometry, self._data, full)
        results = self._data.distanceResults
        least = int(np.argmin([result.min_distance for result in results]))
        result, (link, obstacle) = results[least], self._names[least]
        return NearestPoints(
            float(result.min_distance),
            np.array(result.getNearestPoint1()),
            np.array(result.getNearestPoint2()),
            link,
            obstacle,
        )


class ClearanceLines:
    """Segments from the robot to the nearest person and to the nearest thing, with their lengths.

    Parameters
    ----------
    view : viser.SceneApi
        Where they are shown.
    name : str
        Name of their node.
    nearest : sequence of Nearest
        First of people and what else is dangerous, then of things; either may find nothing.
    """

    def __init__(self, view: Any, name: str, nearest: Sequence[Nearest]) -> None:
        self._nearest = nearest
        self._lines, self._labels = [], []
        for k, _ in enumerate(nearest):
            colour = (_PEOPLE, _THINGS)[k]
            nothing = np.zeros((1, 2, 3))
            self._lines.append(
                view.add_line_segments(f"{name}/{k}", nothing, colours.rgb(colour), thickness=0.01)
            )
            self._labels.append(
                view.add_label(f"{name}/{k}/length", "", anchor="center-left", font_screen_scale=0.8)
            )
        self._visible = True

    def show(self, visible: bool) -> None:
        """Show or hide them."""
        self._visible = visible
        for node in (*self._lines, *self._labels):
            node.visible = visible

    def found(self, q: FloatArray) -> list[NearestPoints]:
        """Return the nearest points at `q: (n,)`, of people and of things, where there are any."""
        return [found for found in (nearest.at(q) for nearest in self._nearest) if found is not None]

    def pose(self, q: FloatArray) -> None:
        """Show where the robot is nearest at `q: (n,)`."""
        if not self._visible:
            return
        for nearest, line, label in zip(self._nearest, self._lines, self._labels, strict=True):
            found = nearest.at(q)
            line.visible = label.visible = found is not None
            if found is not None:
                line.points = np.array([[found.on_robot, found.on_obstacle]], dtype=np.float32)
                label.text = f"{1e3 * found.distance:.0f} mm to {found.obstacle}"
                label.position = 0.5 * (found.on_robot + found.on_obstacle)
