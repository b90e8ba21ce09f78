"""Bounds of the speeds of a robot's bodies along a curve, proven for whole cells."""

from __future__ import annotations

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray
from safe_ompl.danger import JointMotions
from safe_ompl.robot import Hull, Robot, bounding_hull
from safe_ompl.trajectories.curve import Cells, Curve


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
        self._joints = JointMotions(robot)
        frame = robot.shared.model.frames[robot.tip_frame]
        tip = Hull(np.array(frame.placement.translation, dtype=np.float64)[None], 0.0)
        parts = list(robot.shared.collision_model.geometryObjects)
        hulls = [bounding_hull(part.geometry, coarse=True).moved(part.placement) for part in parts]
        hulls.append(tip)
        carriers = [part.parentJoint for part in parts] + [frame.parentJoint]
        self._carriers: IntArray = np.array(carriers, dtype=np.intp)
        corners = np.array([np.resize(hull.points, (8, 3)) for hull in hulls])
        self._corners: FloatArray = np.ascontiguousarray(corners.swapaxes(1, 2))
        self._pads: FloatArray = np.array([hull.radius for hull in hulls])
        chain = robot.shared.chain
        tip_radii = chain.radii(chain.regions(int(frame.parentJoint), tip))[None]
        self._radii: FloatArray = np.vstack([robot.bounds.joint_radii, tip_radii])
        self._moved: FloatArray = np.zeros((len(hulls), robot.bounds.joint_radii.shape[1]))
        for row, joint in enumerate(carriers):
            self._moved[row, chain.path_to_root(int(joint))] = 1.0

    def bounds(self, curve: Curve, cells: Cells) -> FloatArray:
        """Return the bounds (N, G + 1) [m/rad]: of the G bodies of `collision_model`, and of the tip."""
        place = curve.at(cells.centres)
        half = cells.sizes[:, None] / 2
        found: FloatArray = self._at(place.q, place.slope) + half * self.accelerations(cells)
        return found

    def _at(self, Q: FloatArray, rates: FloatArray) -> FloatArray:
        rotation, origin, axes = self._joints.frames(Q)
        angular, linear = self._joints.twists(origin, axes, rates)
        angular, linear = self._moved @ angular, self._moved @ linear
        still = self._carriers == 0
        carried = np.maximum(self._carriers - 1, 0)
        # R x + o moves with ω × (R x + o) + v.
        turn, middle = _cross(angular), origin[:, carried, :, None]
        velocities = (turn @ rotation[:, carried]) @ self._corners + (turn @ middle + linear[..., None])
        x, y, z = np.moveaxis(velocities * velocities, 2, 0)
        speeds = np.sqrt((x + y + z).max(axis=2))
        speeds += self._pads * np.sqrt((angular * angular).sum(axis=2))
        found: FloatArray = np.where(still, 0.0, speeds)
        return found

    def accelerations(self, cells: Cells) -> FloatArray:
        """Return bounds (N, G + 1) of ‖x″‖ of all points of the bodies and of the tip [m/rad²]."""
        steps, bends = (self._robot.coupling.reach(bound) for bound in (cells.slopes, cells.bends))
        return acceleration_bounds(self._radii, self._moved, self._joints.prismatic, steps, bends)


def _cross(vectors: FloatArray) -> FloatArray:
    """Return the matrices (…, 3, 3) that take the cross product with vectors (…, 3) from the left."""
    found = np.zeros((*vectors.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        found[..., i, k], found[..., k, i] = vectors[..., j], -vectors[..., j]
    return found


def acceleration_bounds(
    radii: FloatArray,
    moved: FloatArray | BoolArray,
    prismatic: BoolArray,
    steps: FloatArray,
    bends: FloatArray,
) -> FloatArray:
    """Return bounds (N, G) of ‖x″‖ of every point of G bodies along a curve, by arc length; see `BodySpeeds`.

    Parameters
    ----------
    radii, moved : ndarray, shape (G, m)
        Displacement radii R̄ by the m joints of the model, and which of them move each body.
    prismatic : ndarray of bool, shape (m,)
        Which joints slide.
    steps, bends : ndarray, shape (N, m)
        Bounds of |q′| and |q″| of these joints.
    """
    turn = np.where(prismatic, 0.0, steps[:, None] * moved)
    below = np.cumsum(turn, axis=2) - turn
    found: FloatArray = (steps[:, None] * radii * (2 * below + turn)).sum(axis=2) + bends @ radii.T
    return found
