"""What a view says about a configuration: the interval that proves it, and the nearest points."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.certificates import Pairs
from safe_ompl.collision import fresh_data
from safe_ompl.common import FloatArray
from safe_ompl.geometry import Obstacle
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene


@dataclass(frozen=True)
class ProvenInterval:
    """An interval of an edge in which nothing can touch.

    Attributes
    ----------
    edge : int
        Number of the edge, from 0.
    start, end : float
        Where on the edge, from 0 to 1.
    pair : (str, str)
        The two bodies that have least to spare at its centre; empty names where nothing can meet.
    distance : float
        How far they are apart there [m].
    margin : float
        How far they may approach each other within the interval, and what they must keep besides [m].
    """

    edge: int
    start: float
    end: float
    pair: tuple[str, str]
    distance: float
    margin: float

    def __str__(self) -> str:
        where = f"edge {self.edge + 1}, {self.start:.0%} to {self.end:.0%}"
        if not any(self.pair):
            return f"{where}: nothing can meet"
        one, other = (name.removeprefix("obstacle:") for name in self.pair)
        return (
            f"{where}: {one} and {other} are {1e3 * self.distance:.1f} mm apart, "
            f"may approach by {1e3 * self.margin:.1f} mm"
        )


@dataclass(frozen=True)
class Proof:
    """The intervals of a path, in the order in which it is driven.

    Attributes
    ----------
    intervals : tuple of ProvenInterval
    stops : ndarray, shape (I + 1,)
        Where each begins, as a fraction of the path's length; and its end.
    """

    intervals: tuple[ProvenInterval, ...]
    stops: FloatArray

    @classmethod
    def of_certificate(cls, content: Mapping[str, Any], robot: Robot, scene: Scene) -> Proof:
        """Return the intervals of a certificate; they are shown as they are, and not verified."""
        path = np.array(content["path"], dtype=float)
        pairs = Pairs(robot, scene)
        steps = robot.difference(path[:-1], path[1:])
        arcs = np.linalg.norm(steps, axis=1)
        before = np.concatenate([[0.0], np.cumsum(arcs)])
        intervals, stops = [], []
        for edge, proven in enumerate(content["edges"][: len(steps)]):
            reached = 0.0
            for item in proven:
                end = min(1.0, item["centre"] + item["half_length"])
                q = path[edge] + item["centre"] * steps[edge]
                intervals.append(_interval(edge, reached, end, pairs, q, np.array(item["margins"])))
                stops.append(before[edge] + reached * arcs[edge])
                reached = end
        total = float(before[-1]) or 1.0
        return cls(tuple(intervals), np.array([*stops, before[-1]]) / total)

    def at(self, share: float) -> ProvenInterval | None:
        """Return the interval at a fraction of the path's length; None where there is none."""
        if not self.intervals:
            return None
        number = int(np.searchsorted(self.stops, share, side="right")) - 1
        return self.intervals[min(max(number, 0), len(self.intervals) - 1)]


def _interval(
    edge: int, start: float, end: float, pairs: Pairs, q: FloatArray, margins: FloatArray
) -> ProvenInterval:
    if not len(margins):
        return ProvenInterval(edge, start, end, ("", ""), np.inf, 0.0)
    distances = pairs.distances(q)
    least = int(np.argmin(distances - margins))
    return ProvenInterval(
        edge, start, end, pairs.names[least], float(distances[least]), float(margins[least])
    )


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
