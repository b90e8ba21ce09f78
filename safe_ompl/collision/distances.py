"""Distances of links and obstacles: exact where they may be small, nearest points (witnesses), and gradients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.kernels.distances import hinge_costs
from safe_ompl.common import FloatArray, IntArray
from safe_ompl.robot import Robot, plain


class NearPairs(NamedTuple):
    """C pairs of a link and an obstacle that are near each other: rows and pairs (C,), distances (C,) [m].

    And the nearest points: `points: (C, 3)` of the link, in the frame of the joint that carries it [m]; unit `normals:
    (C, 3)` from the obstacle to the link, in the world; `offsets: (C,)`, the abscissa of the obstacle's point along the
    normal [m]. Of pairs in contact only the distance, ≤ 0, means something.
    """

    rows: IntArray
    pairs: IntArray
    distances: FloatArray
    points: FloatArray
    normals: FloatArray
    offsets: FloatArray


class PairDistances:
    """Distances of the K pairs of a link and an obstacle that may come nearer to each other than a reach [m].

    Pairs of convex bodies are measured by a kernel, for all configurations at once (`DistanceBounds`), others by coal
    where a lower bound by the convex bodies that hold them cannot tell them from near ones. `joints: (K,)` has
    Pinocchio's number of the joint that carries the link of each pair.
    """

    def __init__(self, checker: CollisionChecker, reach: float) -> None:
        self._robot = checker.robot
        self._set = checker.pairs_within(reach)
        self._indices: IntArray = np.flatnonzero(self._set.meets_obstacle)
        self.joints: IntArray = self._set.carriers[self._indices, 0]

    def __len__(self) -> int:
        return len(self._indices)

    def __repr__(self) -> str:
        return f"PairDistances({self._robot.name!r}, {len(self)} pairs)"

    def near(self, Q: FloatArray, within: float) -> NearPairs:
        """Return the pairs that are nearer than a distance [m] at `Q: (B, n)`, row by row."""
        known = self._set.bounds.near(Q, self._indices, within)
        rows, pairs = known[:, :2].T.astype(np.intp)
        found, others = known[:, 2:], np.flatnonzero(~self._set.bounds.exact[self._indices[pairs]])
        if len(others):
            found[others] = self._set.measured(Q, rows[others], self._indices[pairs[others]])
            near = found[:, 0] < within
            rows, pairs, found = rows[near], pairs[near], found[near]
        return NearPairs(rows, pairs, found[:, 0], found[:, 1:4], found[:, 4:7], found[:, 7])

    def witnesses(self, Q: FloatArray, within: float) -> Witnesses:
        """Return the witnesses of all pairs that are nearer than a distance [m] at `Q: (B, n)`, but not in contact."""
        found = self.near(Q, within)
        apart = found.distances > 0  # in contact there is no way from one to the other
        nearest = (plain(part[apart]) for part in (found.points, found.normals, found.offsets))
        return Witnesses(self._robot, found.rows[apart], self.joints[found.pairs[apart]], *nearest)

    def least(self, Q: FloatArray, within: float) -> float:
        """Return the least distance [m] at any of `Q: (B, n)`, or `within` where that is less."""
        known = self._set.bounds.near(Q, self._indices, within, least=True)
        rows, pairs = known[:, :2].T.astype(np.intp)
        distances, exact = known[:, 2], self._set.bounds.exact[self._indices[pairs]]
        within, others = float(distances[exact].min(initial=within)), np.flatnonzero(~exact)
        for k in others[np.argsort(distances[others], kind="stable")].tolist():
            if distances[k] >= within:
                break
            within = min(within, float(self._set.measured(Q, rows[[k]], self._indices[pairs[[k]]])[0, 0]))
        return within


@dataclass(frozen=True)
class Witnesses:
    """Nearest points of C pairs of a link and an obstacle, at some of B configurations.

    `rows: (C,)` is the configuration of each, `joints: (C,)` Pinocchio's number of the joint that carries the link; all
    else is as in `NearPairs`.
    """

    robot: Robot
    rows: IntArray
    joints: IntArray
    points: FloatArray
    normals: FloatArray
    offsets: FloatArray

    def hinge_costs(self, Q: FloatArray, hinges: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return Σ_c Σ_h w_h (1 − d_c/D_h)₊² (B,) of the distances d at `Q: (B, n)`, near where witnesses were found.

        The link's witness moves with the link, the obstacle stays behind the plane at its own: exact to the first
        order where the witnesses were found, and for moves in which they remain the nearest points. `hinges: (H, 2)`
        are D > 0 [m] and w. Besides the costs there are their gradients (B, n), and vectors v (C, n): the costs bend
        like Σ vvᵀ (Gauss-Newton).
        """
        coupling = self.robot.coupling
        joints, values = self.robot.kinematics.joints, plain(coupling.values(Q))
        witnesses = self.rows, self.joints, self.points, self.normals, self.offsets
        costs, gradients, bends = hinge_costs(joints, values, *witnesses, hinges)
        return costs, coupling.columns(gradients), coupling.columns(bends)
