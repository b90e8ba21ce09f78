"""Clouds without the robot: removes the points of a scan that show the robot itself."""

from __future__ import annotations

import logging
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.arrays import BoolArray, FloatArray, finite_array
from safe_ompl.inputs import number
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.pose import placed
from safe_ompl.scene.scene import Scene
from safe_ompl.scene.shapes.cloud import PointCloud

_log = logging.getLogger(__name__)

_POINT = 1e-6  # [m] radius of the ball that stands for a point in a query


def without_robot(scene: Scene, robot: Robot, q: ArrayLike, margin: float) -> Scene:
    """Return a scene whose clouds have no points of the robot; the log says how many are left out.

    A point goes if it is inside one of the robot's collision bodies, or nearer than `margin` to one. What remains of a
    cloud keeps all else; a cloud of which nothing remains leaves the scene. Other obstacles stay as they are.

    Parameters
    ----------
    scene : Scene
        The scene, with clouds.
    robot : Robot
        The robot that the camera saw.
    q : array_like, shape (n,)
        Where it stood then [rad or m].
    margin : float
        How near to its bodies points are its own, ≥ 0 [m]: what the camera and the joints may be off.

    Returns
    -------
    Scene
        A person's hand on the robot is a part of the robot for this function: keep the margin small.

    Raises
    ------
    InputError
        If `q` has the wrong shape or is not finite, or the margin is negative.
    """
    obstacles = []
    for obstacle in scene:
        if not isinstance(obstacle.shape, PointCloud):
            obstacles.append(obstacle)
            continue
        points = obstacle.shape.centres
        own = robot_points(placed(obstacle.pose.se3, points), robot, q, margin)
        _log.info("%s: %d of %d points are of the robot, and left out", obstacle.name, own.sum(), len(own))
        if not own.any():
            obstacles.append(obstacle)
        elif not own.all():
            kept = replace(obstacle.shape, points=points[~own], file=None)
            obstacles.append(
                type(obstacle)(obstacle.name, kept, obstacle.pose, obstacle.weight, obstacle.color)
            )
    return Scene(tuple(obstacles), scene.spacing)


def robot_points(points: ArrayLike, robot: Robot, q: ArrayLike, margin: float) -> BoolArray:
    """Return which of `points: (M, 3)`, in the world frame [m], are within `margin` of the robot's bodies at `q`.

    Raises
    ------
    InputError
        If points or `q` have the wrong shape or are not finite, or the margin is negative.
    """
    places = finite_array(points, (None, 3), "points")
    configuration = finite_array(q, (robot.n,), "q")
    reach = number("margin", margin, at_least=0.0)
    data, bodies = robot.model.createData(), robot.collision_model
    pin.forwardKinematics(robot.model, data, robot.pinocchio_configuration(configuration))
    own = np.zeros(len(places), dtype=bool)
    for body in bodies.geometryObjects:
        placement = data.oMi[int(body.parentJoint)] * body.placement
        local = placed(placement.inverse(), places)
        candidates = np.flatnonzero(~own & _in_box(body.geometry, local, reach))
        own[candidates] = [_distance(body.geometry, point) <= reach for point in local[candidates]]
    return own


def _in_box(shape: coal.CollisionGeometry, points: FloatArray, margin: float) -> BoolArray:
    """Return which points are within a margin of the bounding box of a shape, in the shape's frame."""
    shape.computeLocalAABB()
    low, high = np.ravel(shape.aabb_local.min_) - margin, np.ravel(shape.aabb_local.max_) + margin
    return np.asarray(((points >= low) & (points <= high)).all(axis=1), dtype=bool)


def _distance(shape: coal.CollisionGeometry, point: FloatArray) -> float:
    """Return the distance of a point from a shape, in the shape's frame [m]; zero or less inside."""
    ball, here, there = coal.Sphere(_POINT), coal.Transform3s(), coal.Transform3s(np.eye(3), point)
    result = coal.DistanceResult()
    return float(coal.distance(shape, here, ball, there, coal.DistanceRequest(), result)) + _POINT
