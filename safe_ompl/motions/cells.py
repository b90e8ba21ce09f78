"""Cells of motions, and bounds of how fast the bodies of a robot are along them, proven for whole cells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled
from safe_ompl.motions.kernels import Boxes
from safe_ompl.robot import Robot, plain
from safe_ompl.robot.kernels import move_joints, place_joints

if TYPE_CHECKING:
    from safe_ompl.motions.motion import Motion


class CurvePoints(NamedTuple):
    """Configurations and their derivatives by the parameter of a motion, each (S, n): q, q′, q″ and q‴."""

    q: FloatArray
    dq_ds: FloatArray
    d2q_ds2: FloatArray
    d3q_ds3: FloatArray


@dataclass(frozen=True)
class Cells:
    """N cells of a motion: boxes of q′ and q″ over whole cells, bounds (N, n) of |q‴|, and `stops`, edges at rest."""

    edges: FloatArray
    boxes: Boxes
    swings: FloatArray
    stops: IntArray

    def __len__(self) -> int:
        return len(self.edges) - 1

    @property
    def sizes(self) -> FloatArray:
        """Lengths (N,) of the cells."""
        return np.asarray(self.edges[1:] - self.edges[:-1])

    @property
    def centres(self) -> FloatArray:
        """Parameters (N,) in the middle of the cells."""
        return np.asarray(0.5 * (self.edges[1:] + self.edges[:-1]))

    @cached_property
    def slopes(self) -> FloatArray:
        """Bounds (N, n) of |q′|."""
        return np.asarray(np.maximum(np.abs(self.boxes.slope_low), np.abs(self.boxes.slope_high)))

    @cached_property
    def bends(self) -> FloatArray:
        """Bounds (N, n) of |q″|."""
        return np.asarray(np.maximum(np.abs(self.boxes.bend_low), np.abs(self.boxes.bend_high)))


def divided_edges(edges: FloatArray, parts: IntArray) -> FloatArray:
    """Return the edges of cells that are divided, each in as many equal parts as `parts: (N,)` says."""
    inside = np.arange(int(parts.sum())) - np.repeat(np.cumsum(parts) - parts, parts)
    starts = np.repeat(edges[:-1], parts) + inside / np.repeat(parts, parts) * np.repeat(np.diff(edges), parts)
    return np.append(starts, edges[-1])


# ------------------------------------------------------------------------------------ how fast bodies are along it


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
    """Bounds of the speed of every point of a body of a robot, per unit of its parameter, over the cells of a motion.

    At the centre of a cell it is exact for the corners of the body's bounding box, and convex between them. Away from
    it, it changes no faster than the acceleration allows: with r_j = R̄_j|q′_j|, w_j = |q′_j| where joint j turns and
    W_j the sum of w over the joints beneath, Σ r_j (2W_j + w_j) + Σ R̄_j |q″_j|; see
    `safe_ompl.danger.certified.KeypointRates`.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        joints, corners, pads, _ = robot.bounds.body_corners
        carriers = np.append(joints, robot.tip_joint)
        tip = np.tile(robot.tip_placement.translation, (1, 8, 1))
        self._boxes = _Boxes(carriers, np.concatenate([corners, tip]), np.append(pads, 0.0))
        self._radii: FloatArray = np.vstack([robot.bounds.joint_radii, robot.bounds.tip_radii])
        self._turned = robot.supporting_joints(carriers) & ~robot.joint_prismatic

    def bounds(self, motion: Motion, cells: Cells) -> FloatArray:
        """Return the bounds (N, G + 1) [m/rad]: of the G bodies of `collision_model`, and of the tip."""
        place = motion.places(cells.centres)
        half = cells.sizes[:, None] / 2
        values, rates = (plain(self._robot.coupling.values(place.q)), plain(self._robot.coupling.motions(place.dq_ds)))
        found = box_speeds(self._robot.kinematics.joints, self._boxes, values, rates)
        return found + half * self.accelerations(cells)

    def accelerations(self, cells: Cells) -> FloatArray:
        """Return bounds (N, G + 1) of ‖x″‖ of all points of the bodies and of the tip [m/rad²]."""
        steps, bends = (plain(self._robot.coupling.reach(bound)) for bound in (cells.slopes, cells.bends))
        return acceleration_bounds(self._radii, self._turned, steps, bends)


@compiled
def acceleration_bounds(radii: FloatArray, turned: BoolArray, steps: FloatArray, bends: FloatArray) -> FloatArray:
    """Return bounds (N, G) of ‖x″‖ of every point of G bodies along a curve, by arc length; see `BodySpeeds`.

    R̄ of the m joints of the model are `radii: (G, m)`, `turned` says which of them turn each body; `steps` and `bends`,
    (N, m), are bounds of their |q′| and |q″|.
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
