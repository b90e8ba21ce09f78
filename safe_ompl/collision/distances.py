"""Distances between links and obstacles: exact if they may be small, with nearest points (witnesses) and gradients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.proofs import DistanceBounds, SomePairs, hinge_costs
from safe_ompl.common import FloatArray, IntArray
from safe_ompl.robot import Robot, plain


@dataclass(frozen=True)
class NearPairs:
    """C pairs of a link and an obstacle that are near each other at some of B configurations, and their nearest points.

    `carriers: (K,)` are Pinocchio's indices of the joints that carry the links of the K pairs. The columns of `table:
    (C, 10)` are the configuration; the pair; the distance [m]; the nearest point of the link (its witness) in the frame
    of the joint that carries it [m]; the unit normal from obstacle to link in the world; and the coordinate of the
    obstacle's point along the normal [m]. For pairs in contact only the distance, ≤ 0, is valid.
    """

    robot: Robot
    carriers: IntArray
    table: FloatArray

    @property
    def rows(self) -> IntArray:
        """The configuration (C,) of each entry."""
        return self.table[:, 0].astype(np.intp)

    @property
    def pairs(self) -> IntArray:
        """The pair (C,) of each entry, as an index into the K pairs."""
        return self.table[:, 1].astype(np.intp)

    def hinge_costs(self, Q: FloatArray, hinges: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return Σ_c Σ_h w_h (1 − d_c/D_h)₊² (B,) of the distances d at `Q: (B, n)`, near where the pairs were found.

        The model moves the link's witness with the link and keeps the obstacle behind the plane at its witness. The
        model is exact to first order, while the witnesses remain the nearest points. Pairs in contact do not count,
        because they have no separating direction. `hinges: (H, 2)` are D > 0 [m] and w. Also returned are the gradients
        (B, n), and vectors v (C, n) for the Gauss-Newton Hessian Σ vvᵀ.
        """
        coupling = self.robot.coupling
        values = plain(coupling.values(Q))
        costs, gradients, curvatures = hinge_costs(
            self.robot.kinematics.table, values, self.carriers, self.table, hinges
        )
        return costs, coupling.columns(gradients), coupling.columns(curvatures)


class PairDistances:
    """Distances of the K pairs of a link and an obstacle that may come nearer to each other than a reach [m].

    A kernel computes the distances of convex bodies for all configurations at once (`DistanceBounds`). For other
    bodies, coal computes the distances if a lower bound from enclosing convex bodies does not show that they are far
    apart. `joints: (K,)` are Pinocchio's indices of the joints that carry the links.
    """

    def __init__(self, checker: CollisionChecker, reach: float) -> None:
        self._robot = checker.robot
        self._set = checker.pairs_within(reach)
        self._indices: IntArray = np.flatnonzero(self._set.meets_obstacle)
        self.joints: IntArray = self._set.carriers[self._indices, 0]
        self._known: tuple[DistanceBounds, SomePairs] | None = None

    def __len__(self) -> int:
        return len(self._indices)

    def __repr__(self) -> str:
        return f"PairDistances({self._robot.name!r}, {len(self)} pairs)"

    def _bounds(self) -> tuple[DistanceBounds, SomePairs]:
        """Return the bounds for the present scene, and the K pairs in their form."""
        bounds = self._set.bounds
        if self._known is None or self._known[0] is not bounds:
            self._known = bounds, bounds.some(self._indices)
        return self._known

    def near(self, Q: FloatArray, within: float) -> NearPairs:
        """Return the pairs that are nearer than a distance [m] at `Q: (B, n)`, row by row."""
        bounds, some = self._bounds()
        table, exact = bounds.near(Q, some, within), some.exact
        if not exact.all():
            rows, pairs = table[:, :2].T.astype(np.intp)
            others = np.flatnonzero(~exact[pairs])
            table[others, 2:] = self._set.measured(Q, rows[others], self._indices[pairs[others]])
            table = plain(table[table[:, 2] < within])
        return NearPairs(self._robot, self.joints, table)

    def least(self, Q: FloatArray, within: float) -> float:
        """Return the least distance [m] at any of `Q: (B, n)`, or `within` if that is less."""
        bounds, some = self._bounds()
        known = bounds.near(Q, some, within, least=True)
        rows, pairs = known[:, :2].T.astype(np.intp)
        distances, exact = known[:, 2], some.exact[pairs]
        within, others = float(distances[exact].min(initial=within)), np.flatnonzero(~exact)
        for k in others[np.argsort(distances[others], kind="stable")].tolist():
            if distances[k] >= within:
                break
            within = min(within, float(self._set.measured(Q, rows[[k]], self._indices[pairs[[k]]])[0, 0]))
        return within
