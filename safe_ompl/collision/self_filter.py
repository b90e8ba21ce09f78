"""Remove the points of the robot itself from the point clouds of a scene."""

from __future__ import annotations

import logging
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import BoolArray, FloatArray, finite_array, number
from safe_ompl.geometry import PointCloud, bounding_box, hull_planes, placed
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

_log = logging.getLogger(__name__)

# Radius of the ball that represents a point in a query.
_POINT_RADIUS = 1e-6  # [m]
# Points within this distance of a hull count as on the hull.
_ON = 1e-9  # [m]
_BLOCK = 2048  # points at once


def without_robot(scene: Scene, robot: Robot, q: ArrayLike, margin: float) -> Scene:
    """Return a scene whose clouds have no points of the robot. The log reports how many points are removed.

    A point is removed if it is inside one of the robot's collision bodies, or nearer than `margin` to one. The rest of
    the cloud keeps its other properties. A cloud without remaining points is removed from the scene. Other obstacles
    are unchanged. Points of a person's hand on the robot are removed, too, so the margin should be small.

    Parameters
    ----------
    scene, robot : Scene, Robot
        The scene, with clouds, and the robot that the camera saw.
    q : array_like, shape (n,)
        The robot's configuration at that time [rad or m].
    margin : float
        Points nearer than this to a body belong to the robot, ≥ 0 [m]. It covers the errors of camera and joints.
    """
    obstacles = []
    for obstacle in scene:
        if not isinstance(obstacle.shape, PointCloud):
            obstacles.append(obstacle)
            continue
        points = obstacle.shape.centres
        own = robot_points(placed(obstacle.pose.se3, points), robot, q, margin)
        _log.info("%s: %d of %d points belong to the robot and are left out", obstacle.name, own.sum(), len(own))
        if not own.any():
            obstacles.append(obstacle)
        elif not own.all():
            kept = replace(obstacle.shape, points=points[~own], file=None)
            obstacles.append(replace(obstacle, shape=kept))
    return Scene(tuple(obstacles), scene.spacing)


def robot_points(points: ArrayLike, robot: Robot, q: ArrayLike, margin: float) -> BoolArray:
    """Return which of `points: (M, 3)`, in the world frame [m], are within `margin` of the robot's bodies at `q`.

    Raises InputError if points or `q` have the wrong shape or are not finite, or the margin is negative.
    """
    places = finite_array(points, (None, 3), "points")
    configuration = finite_array(q, (robot.n,), "q")
    reach = number("margin", margin, at_least=0.0)
    data, bodies = robot.shared.model.createData(), robot.shared.collision_model
    pin.forwardKinematics(robot.shared.model, data, robot.pinocchio_configuration(configuration))
    own = np.zeros(len(places), dtype=bool)
    for body in bodies.geometryObjects:
        placement = data.oMi[int(body.parentJoint)] * body.placement
        local = placed(placement.inverse(), places)
        box = bounding_box(body.geometry)
        candidates = np.flatnonzero(~own & (np.abs(local - box[:3]) <= box[3:] + reach).all(axis=1))
        own[candidates] = _within(body.geometry, local[candidates], reach)
    return own


def _within(shape: coal.CollisionGeometry, points: FloatArray, margin: float) -> BoolArray:
    """Return which points are within a margin of a shape, in the shape's frame. Meshes are hollow."""
    near, unknown = np.zeros(len(points), dtype=bool), np.arange(len(points))
    if isinstance(shape, coal.Convex):
        near, beyond = _within_faces(*hull_planes(shape), points, margin)
        unknown = np.flatnonzero(~near & ~beyond)
    near[unknown] = [_distance(shape, point) <= margin for point in points[unknown]]
    return near


def _within_faces(
    normals: FloatArray, heights: FloatArray, points: FloatArray, margin: float
) -> tuple[BoolArray, BoolArray]:
    """Return which points are within a margin of a hull, and which are beyond it. Near edges neither may be known.

    The distance of a point from the hull is at least its distance from the farthest plane of the hull. Both are equal
    if the point's projection on this plane is on the hull.
    """
    near, beyond = np.zeros(len(points), dtype=bool), np.zeros(len(points), dtype=bool)
    for first in range(0, len(points), _BLOCK):
        part = slice(first, first + _BLOCK)
        above = points[part] @ normals.T - heights
        farthest = above.argmax(axis=1)
        height = np.take_along_axis(above, farthest[:, None], axis=1)[:, 0]
        foot = points[part] - height[:, None] * normals[farthest]
        on_hull = (foot @ normals.T - heights).max(axis=1) <= _ON
        near[part] = (height <= 0) | (on_hull & (height <= margin))
        beyond[part] = height > margin
    return near, beyond


def _distance(shape: coal.CollisionGeometry, point: FloatArray) -> float:
    """Return the distance of a point from a shape, in the shape's frame [m]; zero or less inside."""
    ball, here, there = coal.Sphere(_POINT_RADIUS), coal.Transform3s(), coal.Transform3s(np.eye(3), point)
    result = coal.DistanceResult()
    return float(coal.distance(shape, here, ball, there, coal.DistanceRequest(), result)) + _POINT_RADIUS
