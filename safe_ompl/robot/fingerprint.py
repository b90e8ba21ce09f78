"""The hash of a robot by which certificates name it: they are refused for any other robot."""

from __future__ import annotations

import json
from hashlib import sha256
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.robot.robot import Robot

_DIGITS = 9  # nanometres and nanoradians: what is the same to the last bit is the same here, on any machine


def robot_hash(robot: Robot) -> str:
    """Return the SHA-256 of joints, limits, placements, bodies, checked pairs and skeleton; file names do not count."""
    chain, geometry = robot.shared.chain, robot.shared.collision_model
    content = {
        "joints": list(robot.joint_names),
        "lower": _numbers(robot.lower),
        "upper": _numbers(robot.upper),
        "continuous": robot.continuous.tolist(),
        "prismatic": robot.prismatic.tolist(),
        "parents": chain.parents,
        "placements": [_numbers(placement.homogeneous) for placement in chain.placements],
        "axes": _numbers(chain.axes),
        "tip": robot.tip,
        "segments": robot.segments.tolist(),
        "keypoints": _numbers(robot.keypoints(np.clip(np.zeros(robot.n), robot.lower, robot.upper))),
        "bodies": [_body(body) for body in geometry.geometryObjects],
        "pairs": sorted((int(pair.first), int(pair.second)) for pair in geometry.collisionPairs),
    }
    if not robot.coupling.trivial:
        content["mimics"] = [_numbers(robot.coupling.matrix), _numbers(robot.coupling.offsets)]
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _body(body: pin.GeometryObject) -> dict[str, Any]:
    return {
        "name": body.name,
        "joint": int(body.parentJoint),
        "placement": _numbers(body.placement.homogeneous),
        "shape": type(body.geometry).__name__,
        "size": _size(body.geometry),
    }


def _size(shape: coal.CollisionGeometry) -> Any:
    if isinstance(shape, coal.ConvexBase):
        return sorted(_numbers(np.asarray(shape.points()).reshape(-1, 3)))
    if isinstance(shape, coal.BVHModelBase):
        return _mesh(shape)
    names = ("halfSide", "radius", "halfLength", "radii")
    known = {name: _numbers(getattr(shape, name)) for name in names if hasattr(shape, name)}
    shape.computeLocalAABB()
    return {**known, "box": [_numbers(np.ravel(corner)) for corner in (shape.aabb_local.min_, shape.aabb_local.max_)]}


def _mesh(mesh: coal.BVHModelBase) -> dict[str, Any]:
    """Return corners and triangles in an order that the mesh's own does not change."""
    rounded = np.array(_numbers(np.asarray(mesh.vertices()).reshape(-1, 3)))
    corners, ranks = np.unique(rounded, axis=0, return_inverse=True)
    indices = [mesh.tri_indices(k) for k in range(mesh.num_tris)]
    triangles = ranks.ravel()[np.array([[t[0], t[1], t[2]] for t in indices], dtype=np.intp)]
    turned = [np.roll(triangle, -int(triangle.argmin())).tolist() for triangle in triangles]
    return {"corners": corners.tolist(), "triangles": sorted(turned)}


def _numbers(values: ArrayLike) -> Any:
    return (np.round(np.asarray(values, dtype=np.float64), _DIGITS) + 0.0).tolist()  # + 0.0: no negative zero
