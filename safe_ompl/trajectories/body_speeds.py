"""Bounds of the speeds of a robot's bodies along a curve, proven for whole cells."""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled
from safe_ompl.robot import Hull, Robot, bounding_hull, plain
from safe_ompl.robot.kernels import move_joints, place_joints
from safe_ompl.trajectories.curve import Cells, Curve


class _Boxes(NamedTuple):
    """Boxes about G bodies: Pinocchio's number of the joint, corners in its frame (G, 8, 3) and what is added [m]."""

    carriers: IntArray
    corners: FloatArray
    pads: FloatArray


@compiled
def box_speeds(joints: Any, boxes: _Boxes, values: FloatArray, rates: FloatArray) -> FloatArray:
    """Return how fast the points (B, G) of boxes are at most, at `values` and `rates` (B, m) of the joints."""
    B, m = values.shape
    found, twists = np.zeros((B, len(boxes.carriers))), np.empty((m, 6))
    rotation, origin, axis = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    for b in range(B):
        place_joints(joints, values[b], rotation, origin, axis)
        move_joints(joints, rates[b], origin, axis, twists)
        for g in range(len(boxes.carriers)):
            joint = boxes.carriers[g] - 1
            if joint < 0:
                continue
            w, R, o = twists[joint], rotation[joint], origin[joint]
            most = 0.0
            for k in range(8):
                p = boxes.corners[g, k]
                x = o[0] + R[0, 0] * p[0] + R[0, 1] * p[1] + R[0, 2] * p[2]
                y = o[1] + R[1, 0] * p[0] + R[1, 1] * p[1] + R[1, 2] * p[2]
                z = o[2] + R[2, 0] * p[0] + R[2, 1] * p[1] + R[2, 2] * p[2]
                u, v = w[3] + w[1] * z - w[2] * y, w[4] + w[2] * x - w[0] * z
                most = max(most, u * u + v * v + (w[5] + w[0] * y - w[1] * x) ** 2)
            turning = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
            found[b, g] = sqrt(most) + boxes.pads[g] * turning
    return found


class BodySpeeds:
    """Bounds of the speed of every point of a body, per unit of arc length, over the cells of a curve.

    At the centre of a cell it is exact for the corners of the body's bounding box, and convex between them. Away from
    it, it changes no faster than the acceleration allows: with r_j = R̄_j|q′_j|, w_j = |q′_j| where joint j turns and
    W_j the sum of w over the joints beneath, Σ r_j (2W_j + w_j) + Σ R̄_j |q″_j|; see
    `safe_ompl.danger.motion_rates.KeypointRates`.

    Parameters
    ----------
    robot : Robot
        The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        frame = robot.shared.model.frames[robot.tip_frame]
        tip = Hull(np.array(frame.placement.translation, dtype=np.float64)[None], 0.0)
        parts = list(robot.shared.collision_model.geometryObjects)
        hulls = [bounding_hull(part.geometry, coarse=True).moved(part.placement) for part in parts] + [tip]
        carriers: IntArray = np.array([*(part.parentJoint for part in parts), frame.parentJoint], dtype=np.intp)
        corners = np.array([np.resize(hull.points, (8, 3)) for hull in hulls])
        self._boxes = _Boxes(carriers, corners, np.array([hull.radius for hull in hulls]))
        chain = robot.shared.chain
        tip_radii = chain.radii(chain.regions(int(frame.parentJoint), tip))[None]
        self._radii: FloatArray = np.vstack([robot.bounds.joint_radii, tip_radii])
        self._turned: BoolArray = np.zeros(self._radii.shape, dtype=bool)
        for row, joint in enumerate(carriers.tolist()):
            self._turned[row, chain.path_to_root(joint)] = True
        self._turned &= ~chain.prismatic

    def bounds(self, curve: Curve, cells: Cells) -> FloatArray:
        """Return the bounds (N, G + 1) [m/rad]: of the G bodies of `collision_model`, and of the tip."""
        place = curve.at(cells.centres)
        half = cells.sizes[:, None] / 2
        values, rates = (plain(self._robot.coupling.values(place.q)), plain(self._robot.coupling.motions(place.slope)))
        found = box_speeds(self._robot.kinematics.joints, self._boxes, values, rates)
        return found + half * self.accelerations(cells)

    def accelerations(self, cells: Cells) -> FloatArray:
        """Return bounds (N, G + 1) of ‖x″‖ of all points of the bodies and of the tip [m/rad²]."""
        steps, bends = (plain(self._robot.coupling.reach(bound)) for bound in (cells.slopes, cells.bends))
        return acceleration_bounds(self._radii, self._turned, steps, bends)


@compiled
def acceleration_bounds(radii: FloatArray, turned: BoolArray, steps: FloatArray, bends: FloatArray) -> FloatArray:
    """Return bounds (N, G) of ‖x″‖ of every point of G bodies along a curve, by arc length; see `BodySpeeds`.

    Parameters
    ----------
    radii, turned : (G, m)
        Displacement radii R̄ by the m joints of the model, and which of them turn each body.
    steps, bends : (N, m)
        Bounds of |q′| and |q″| of these joints.
    """
    (N, m), G = steps.shape, len(radii)
    found = np.zeros((N, G))
    for k in range(N):
        for g in range(G):
            below = 0.0
            for j in range(m):
                turn = steps[k, j] if turned[g, j] else 0.0
                found[k, g] += radii[g, j] * (steps[k, j] * (2 * below + turn) + bends[k, j])
                below += turn
    return found
