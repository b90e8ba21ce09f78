"""Cells of motions, and bounds of the speeds of a robot's bodies that are proven for whole cells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.motions.bodies import BodyCorners, acceleration_bounds
from safe_ompl.robot import Robot, plain

if TYPE_CHECKING:
    from safe_ompl.motions.motion import Motion


class CurvePoints(NamedTuple):
    """Configurations and their derivatives with respect to the parameter of a motion, each (S, n): q, q′, q″ and q‴."""

    q: FloatArray
    dq_ds: FloatArray
    d2q_ds2: FloatArray
    d3q_ds3: FloatArray


class Boxes(NamedTuple):
    """Ranges of q′ and q″ over N cells, each (N, n)."""

    dq_ds_low: FloatArray
    dq_ds_high: FloatArray
    d2q_ds2_low: FloatArray
    d2q_ds2_high: FloatArray


@dataclass(frozen=True)
class Cells:
    """N cells of a motion: ranges of q′ and q″ over whole cells, and bounds (N, n) of |q‴|.

    `stops` are the edges at which the robot is at rest.
    """

    edges: FloatArray
    boxes: Boxes
    d3q_ds3: FloatArray
    stops: IntArray

    def __len__(self) -> int:
        return len(self.edges) - 1

    @property
    def sizes(self) -> FloatArray:
        """Lengths (N,) of the cells."""
        return np.asarray(self.edges[1:] - self.edges[:-1])

    @property
    def centres(self) -> FloatArray:
        """Parameters (N,) at the centres of the cells."""
        return np.asarray(0.5 * (self.edges[1:] + self.edges[:-1]))

    @cached_property
    def last_before_stop(self) -> IntArray:
        """For each cell (N,) the last cell before the robot is next at rest."""
        stops = np.append(self.stops, len(self))
        return np.asarray(stops[np.searchsorted(stops, np.arange(len(self)), side="right")] - 1)

    @cached_property
    def dq_ds(self) -> FloatArray:
        """Bounds (N, n) of |q′|."""
        return np.asarray(np.maximum(np.abs(self.boxes.dq_ds_low), np.abs(self.boxes.dq_ds_high)))

    @cached_property
    def d2q_ds2(self) -> FloatArray:
        """Bounds (N, n) of |q″|."""
        return np.asarray(np.maximum(np.abs(self.boxes.d2q_ds2_low), np.abs(self.boxes.d2q_ds2_high)))


def divided_edges(edges: FloatArray, parts: IntArray) -> FloatArray:
    """Return the edges of cells after dividing each cell into `parts: (N,)` equal parts."""
    inside = np.arange(int(parts.sum())) - np.repeat(np.cumsum(parts) - parts, parts)
    starts = np.repeat(edges[:-1], parts) + inside / np.repeat(parts, parts) * np.repeat(np.diff(edges), parts)
    return np.append(starts, edges[-1])


# ------------------------------------------------------------------------------------ how fast bodies are along it


class BodySpeeds:
    """Bounds of the speed of every point of a robot's bodies over the cells of a motion, per unit of the parameter.

    At the centre of a cell the speed is exact for the corners of the body's bounding box, and convex between them. Away
    from the centre, it changes at most by the acceleration: with r_j = R̄_j|q′_j|, w_j = |q′_j| for revolute joints j
    and W_j the sum of w over the joints beneath, Σ r_j (2W_j + w_j) + Σ R̄_j |q″_j|; see
    `safe_ompl.danger.certified.KeypointRates`.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        joints, corners, pads, _ = robot.bounds.body_corners
        carriers = np.append(joints, robot.tip_joint)
        tip = np.tile(robot.tip_placement.translation, (1, 8, 1))
        corners, table = np.concatenate([corners, tip]), robot.kinematics.table
        self._corners = BodyCorners(table, carriers, corners, np.append(pads, 0.0))
        self._radii: FloatArray = np.vstack([robot.bounds.joint_radii, robot.bounds.tip_radii])
        self._turned = robot.supporting_joints(carriers) & ~robot.joint_prismatic

    def bounds(self, motion: Motion, cells: Cells) -> FloatArray:
        """Return speed bounds (N, G + 1) [m/rad] of the G bodies of `collision_model`, and of the tip."""
        place = motion.places(cells.centres)
        half = cells.sizes[:, None] / 2
        values, rates = (plain(self._robot.coupling.values(place.q)), plain(self._robot.coupling.motions(place.dq_ds)))
        return self._corners.speeds(values, rates) + half * self.accelerations(cells)

    def accelerations(self, cells: Cells) -> FloatArray:
        """Return bounds (N, G + 1) of ‖x″‖ of all points of the bodies and of the tip [m/rad²]."""
        dq_ds, d2q_ds2 = (plain(self._robot.coupling.reach(bound)) for bound in (cells.dq_ds, cells.d2q_ds2))
        return acceleration_bounds(self._radii, self._turned, dq_ds, d2q_ds2)
