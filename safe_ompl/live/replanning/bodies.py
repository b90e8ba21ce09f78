"""The moving bodies of a robot, as distances to who moves around it need them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray
from safe_ompl.live.kernels import CellFrames, Hulls
from safe_ompl.motions import BodySpeeds
from safe_ompl.robot import Robot

_NOWHERE: FloatArray = np.zeros((0, 0))


class RobotBodies:
    """The moving bodies of a robot, of `links`, as hulls in the frames of their joints, with balls about them.

    Each is wider by how far it may be from there if joints are elsewhere in a tube of widths (n,), if there is one.
    """

    def __init__(self, robot: Robot, tube: Sequence[float] = ()) -> None:
        self.robot = robot
        joints, links = robot.bounds.body_corners[0], robot.shared.body_links
        self.moving = np.flatnonzero(joints).tolist()
        hulls = [robot.bounds.body_hulls[k] for k in self.moving]
        self.links = tuple(links[k] for k in self.moving)
        carriers = joints[self.moving] - 1
        first: IntArray = np.cumsum([0] + [len(hull.points) for hull in hulls]).astype(np.intp)
        middles = np.array([hull.points.mean(axis=0) for hull in hulls]).reshape(-1, 3)
        extents = [np.linalg.norm(h.points - c, axis=1).max() for h, c in zip(hulls, middles, strict=True)]
        wider = robot.bounds.displacement_radii[self.moving] @ (np.array(tube) if tube else np.zeros(robot.n))
        self.arrays = Hulls(
            carriers,
            np.ascontiguousarray(np.concatenate([np.zeros((0, 3)), *(hull.points for hull in hulls)])),
            first,
            np.array([hull.radius for hull in hulls]) + wider,
            middles,
            np.array(extents),
        )
        self._first_axis = robot.joint_frames(np.zeros((1, robot.n)))[2][0, 0]
        self.speeds = BodySpeeds(robot)  # of all bodies and the tip

    def frames(self, Q: FloatArray, travel: FloatArray = _NOWHERE) -> CellFrames:
        """Return the frames of the joints at `Q: (B, n)`, and how far (B, G) the bodies get from there [m]."""
        return CellFrames(*self.robot.joint_frames(Q)[:2], travel)

    def vertices(self, body: int, frames: CellFrames) -> FloatArray:
        """Return the vertices (B, V, 3) of a body in the world [m], in these frames of the joints."""
        joint, (first, last) = self.arrays.carriers[body], self.arrays.first_vertex[body : body + 2]
        turned = np.einsum("bxy,vy->bvx", frames.rotations[:, joint], self.arrays.vertices[first:last])
        return np.asarray(turned + frames.origins[:, joint, None])

    @cached_property
    def turning(self) -> BoolArray:
        """Which moving bodies (G,) only turn, about the axis of the first joint."""
        return np.asarray((self.arrays.carriers == 0) & ~self.robot.shared.chain.prismatic[0])

    def swept(self, body: int, frames: CellFrames, axes: FloatArray) -> FloatArray:
        """Return how much farther (K,) against `axes: (K, 3)` a turning body comes if it turns by any angle [m]."""
        vertices, turn = self.vertices(body, frames)[0], self._first_axis
        arms = vertices - frames.origins[0, 0]
        along, heights = arms @ turn, axes @ turn
        radii = np.sqrt(np.maximum((arms * arms).sum(axis=1) - along * along, 0.0))
        across = np.sqrt(np.maximum(1.0 - heights * heights, 0.0))
        nearest = (np.outer(along, heights) - np.outer(radii, across)).min(axis=0)
        return np.asarray((arms @ axes.T).min(axis=0) - nearest)
