"""Plain distances of a robot's bodies from obstacles and each other, and a bound of how far they can approach.

One pair at a time by `coal.distance`: to check what certificates claim. The bound: let the joints move by Δ from a
configuration, the one nearest to the base first. When joint i moves, the bodies beyond it still hang on it as they did
before, so that no point of a body moves more than its distance from the joint's axis, times |Δ_i|; if it slides, more
than |Δ_i|. The sum over the joints that move one body of a pair but not the other bounds how far the two can approach
each other.
"""

from __future__ import annotations

from collections.abc import Container, Iterator
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.certificates.claims import Certificate
from safe_ompl.common import FloatArray
from safe_ompl.io import OBSTACLE
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene


class Separations:
    """Distances between bodies and obstacles, each where it is, and how far they can approach each other.

    Parameters
    ----------
    robot, scene
        Whose bodies they are.
    claims : Certificate
        Says what they must keep.

    Attributes
    ----------
    names : list of (str, str)
        All pairs that must be proven apart.
    """

    def __init__(self, robot: Robot, scene: Scene, claims: Certificate) -> None:
        self._robot, self._data = robot, robot.shared.model.createData()
        self._links = list(robot.shared.collision_model.geometryObjects)
        self._points = [corners(link.geometry) for link in self._links]
        self._movers = [joints_below(robot, int(link.parentJoint)) for link in self._links]
        self._obstacles = [
            (f"{OBSTACLE}{name}", obstacle.name, shape, coal.Transform3s(place.rotation, place.translation))
            for obstacle in scene
            for name, shape, place in obstacle.geometries()
        ]
        self._own = [
            (int(pair.first), int(pair.second)) for pair in robot.shared.collision_model.collisionPairs
        ]
        self._axes = robot.shared.chain.axes
        self._request = coal.DistanceRequest()
        self._required = [
            [claims.required(plain_name(link.name), name) for _, name, _, _ in self._obstacles]
            for link in self._links
        ]
        moving = [link.name for link in self._links if link.parentJoint != 0]
        self.names = [(self._links[a].name, self._links[b].name) for a, b in self._own]
        self.names += [(link, name) for name, _, _, _ in self._obstacles for link in moving]

    def examined(
        self, q: FloatArray, steps: FloatArray, only: Container[tuple[str, str]] | None = None
    ) -> Iterator[tuple[tuple[str, str], float, float, float]]:
        """For each pair, or some: names, distance at `q`, how far it can approach in `steps`, what it must keep."""
        robot, links = self._robot, self._links
        steps = robot.coupling.reach(steps)
        pin.forwardKinematics(robot.shared.model, self._data, robot.pinocchio_configuration(q))
        places = [self._data.oMi[int(link.parentJoint)] * link.placement for link in links]
        poses = [coal.Transform3s(place.rotation, place.translation) for place in places]
        radii = self._radii(places)
        for a, b in self._own:
            if only is not None and (links[a].name, links[b].name) not in only:
                continue
            apart = self._distance(links[a].geometry, poses[a], links[b].geometry, poses[b])
            only_a = [i for i in self._movers[a] if i not in self._movers[b]]
            only_b = [i for i in self._movers[b] if i not in self._movers[a]]
            approach = sum(radii[a][i] * steps[i] for i in only_a) + sum(
                radii[b][i] * steps[i] for i in only_b
            )
            yield (links[a].name, links[b].name), apart, float(approach), 0.0
        for k, link in enumerate(links):
            if link.parentJoint == 0:
                continue
            approach = float(sum(radii[k][i] * steps[i] for i in self._movers[k]))
            for (name, _, shape, pose), required in zip(self._obstacles, self._required[k], strict=True):
                if only is not None and (link.name, name) not in only:
                    continue
                apart = self._distance(link.geometry, poses[k], shape, pose)
                yield (link.name, name), apart, approach, required

    def _distance(self, shape: Any, pose: Any, other: Any, other_pose: Any) -> float:
        # A result that is used twice keeps the smaller distance of the two, or overwrites it: never share one.
        result = coal.DistanceResult()
        return float(coal.distance(shape, pose, other, other_pose, self._request, result))

    def _radii(self, places: list[pin.SE3]) -> FloatArray:
        """Return how far each body's farthest point is from the axes of the joints that move it; 1 if one slides."""
        joints = list(self._data.oMi)[1:]
        axes = np.array([joint.rotation @ axis for joint, axis in zip(joints, self._axes, strict=True)])
        origins = np.array([joint.translation for joint in joints])
        radii = np.zeros((len(places), len(self._axes)))
        for k, ((points, pad), place, by) in enumerate(zip(self._points, places, self._movers, strict=True)):
            arms = (points @ place.rotation.T + place.translation)[:, None, :] - origins[by]
            across = arms - (arms * axes[by]).sum(axis=2)[:, :, None] * axes[by]
            radii[k, by] = np.sqrt((across * across).sum(axis=2).max(axis=0)) + pad
        return np.where(self._robot.joint_prismatic, 1.0, radii)


def plain_name(name: str) -> str:
    """Return the name of the link or obstacle that a body belongs to."""
    return name.removeprefix(OBSTACLE) if name.startswith(OBSTACLE) else name.rsplit("_", 1)[0]


def joints_below(robot: Robot, joint: int) -> list[int]:
    """Return the joints, counted from 0, between a joint of Pinocchio's and the base, itself included."""
    found = []
    while joint != 0:
        found.append(joint - 1)
        joint = int(robot.shared.model.parents[joint])
    return found


def corners(shape: coal.CollisionGeometry) -> tuple[FloatArray, float]:
    """Return points, and a radius, such that the balls around the points have the shape in their convex hull."""
    if isinstance(shape, coal.Sphere):
        return np.zeros((1, 3)), float(shape.radius)
    if isinstance(shape, coal.Capsule):
        return np.array([[0, 0, -shape.halfLength], [0, 0, shape.halfLength]]), float(shape.radius)
    if isinstance(shape, coal.ConvexBase):
        return np.array(shape.points(), dtype=float).reshape(-1, 3), 0.0
    if isinstance(shape, coal.BVHModelBase):
        return np.array(shape.vertices(), dtype=float).reshape(-1, 3), 0.0
    shape.computeLocalAABB()
    low, high = np.ravel(shape.aabb_local.min_), np.ravel(shape.aabb_local.max_)
    return np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    ), 0.0
