"""The moving bodies of a robot, as the replanner's proofs take them."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.danger.joint_motions import JointMotions
from safe_ompl.robot.bodies.reach import bounding_hull
from safe_ompl.robot.robot import Robot
from safe_ompl.trajectories.body_speeds import BodySpeeds
from safe_ompl.trajectories.curve import BlendedCurve, Cells


class RobotBodies:
    """The moving bodies of a robot as hulls in the frames of their joints, with balls about them.

    Parameters
    ----------
    robot : Robot
        The robot.

    Attributes
    ----------
    links : tuple of str
        The link of each of the G moving bodies.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        parts = list(robot.shared.collision_model.geometryObjects)
        self._moving = [k for k, part in enumerate(parts) if part.parentJoint != 0]
        hulls = [bounding_hull(parts[k].geometry).moved(parts[k].placement) for k in self._moving]
        self.links = tuple(parts[k].name.rsplit("_", 1)[0] for k in self._moving)
        carriers: IntArray = np.array([parts[k].parentJoint - 1 for k in self._moving], dtype=np.intp)
        first: IntArray = np.cumsum([0] + [len(hull.points) for hull in hulls]).astype(np.intp)
        middles = np.array([hull.points.mean(axis=0) for hull in hulls]).reshape(-1, 3)
        extents = [np.linalg.norm(h.points - c, axis=1).max() for h, c in zip(hulls, middles, strict=True)]
        self.arrays = (
            carriers,
            np.ascontiguousarray(np.concatenate([np.zeros((0, 3)), *(hull.points for hull in hulls)])),
            first,
            np.array([hull.radius for hull in hulls]),
            middles,
            np.array(extents),
        )
        self._joints = JointMotions(robot)
        self._speeds = BodySpeeds(robot)

    def frames(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rotations (B, m, 3, 3) and origins (B, m, 3) of the joints at `Q: (B, n)`."""
        rotations, origins, _ = self._joints.frames(Q)
        return rotations, origins

    def speeds(self, curve: BlendedCurve, cells: Cells) -> FloatArray:
        """Return the bounds of `BodySpeeds` (N, all bodies and the tip) [m/rad]."""
        return self._speeds.bounds(curve, cells)

    def travel(self, speeds: FloatArray, cells: Cells) -> FloatArray:
        """Return how far (N, G) the moving bodies get from where they are at the centres of cells, at most [m]."""
        found: FloatArray = np.ascontiguousarray(speeds[:, self._moving] * cells.sizes[:, None] / 2)
        return found
