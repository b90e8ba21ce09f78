"""Distances of links and obstacles: exact where they may be small, nearest points (witnesses), and gradients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.kernels.distances import hinge_costs
from safe_ompl.collision.queries import DISTANCE_ERROR
from safe_ompl.common import BoolArray, FloatArray, IntArray
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

    Lower bounds by the convex bodies that hold links and obstacles come first, for all pairs and configurations at
    once (`DistanceBounds`). Pairs that these cannot tell from near ones are measured, by the same kernels where both
    are convex, else by coal. `joints: (K,)` has Pinocchio's number of the joint that carries the link of each pair.
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
        rows, pairs = np.nonzero(self._bounds(Q, within) < within)
        found = self._set.measured(Q, rows, self._indices[pairs])
        near = found[:, 0] < within
        found = found[near]
        return NearPairs(rows[near], pairs[near], found[:, 0], found[:, 1:4], found[:, 4:7], found[:, 7])

    def witnesses(self, Q: FloatArray, within: float) -> Witnesses:
        """Return the witnesses of all pairs that are nearer than a distance [m] at `Q: (B, n)`, but not in contact."""
        found = self.near(Q, within)
        apart = found.distances > 0  # in contact there is no way from one to the other
        nearest = (plain(part[apart]) for part in (found.points, found.normals, found.offsets))
        return Witnesses(self._robot, found.rows[apart], self.joints[found.pairs[apart]], *nearest)

    def least(self, Q: FloatArray, within: float) -> float:
        """Return the least distance [m] at any of `Q: (B, n)`, or `within` where that is less."""
        bounds = self._bounds(Q, within)
        rows, pairs = np.nonzero(bounds < within)
        candidates = bounds[rows, pairs]
        exact = self._exact[pairs]
        for most in (candidates.min(initial=np.inf), within):
            chosen = exact & (candidates <= min(most, within))
            found = self._set.bounds.nearest(Q, rows[chosen], self._indices[pairs[chosen]])
            within = min(within, float(found[:, 0].min(initial=np.inf)))
        others = np.flatnonzero(~exact)
        for k in others[np.argsort(candidates[others], kind="stable")].tolist():
            if candidates[k] >= within:
                break
            within = min(within, float(self._set.measured(Q, rows[[k]], self._indices[pairs[[k]]])[0, 0]))
        return within

    @property
    def _exact(self) -> BoolArray:
        """Which pairs (K,) are of two convex bodies."""
        return self._set.bounds.exact[self._indices]

    def _bounds(self, Q: FloatArray, enough: float) -> FloatArray:
        """Return lower bounds (B, K) [m] of what coal calls the distances."""
        return self._set.bounds.of(Q, self._indices, enough + DISTANCE_ERROR) - DISTANCE_ERROR


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
