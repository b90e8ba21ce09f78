"""Proofs of motions by lower bounds of distances, without coal (`safe_ompl.collision.kernels.motion_bounds`)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin

from safe_ompl.collision.broad_phase import DISTANCE_ERROR
from safe_ompl.collision.kernels.motion_bounds import Pairs, pair_bounds, prove_curve
from safe_ompl.common import Counts, FloatArray, IntArray, PerThread
from safe_ompl.robot import ConvexBodies, Robot

# [m] By this much more than it must, everything that is proven is apart: coal, at most DISTANCE_ERROR off, then never
# calls a configuration of the motion too near, and its certificate can be issued. Rounding is far below.
ALLOWANCE = 2 * DISTANCE_ERROR

_INTERVALS = 64  # that wait to be proven, at most
_NOTHING = np.zeros(0)


# Coefficients c_k (n,) of a motion q(t) = Σ_k c_k t^k, t in [0, 1]; of an edge its start and the way to its end.
Curve: TypeAlias = Sequence[FloatArray]


class BoundsProof(NamedTuple):
    """What lower bounds of distances prove of a motion.

    Attributes
    ----------
    proven : bool
        Whether the whole motion keeps the distances required.
    at : float
        A fraction of the motion where the convex bodies that hold some pair seem to be nearer than required, or −1.
    left : list of [float, float]
        Parts of the motion, from one fraction to another, that are not proven.
    """

    proven: bool
    at: float
    left: list[list[float]]

    def covers(self, low: float, high: float) -> bool:
        """Return whether the motion is proven from one fraction to another."""
        return not any(first < high and last > low for first, last in self.left)


_UNKNOWN = BoundsProof(False, -1.0, [[0.0, 1.0]])
_FREE = BoundsProof(True, -1.0, [])


class DistanceBounds:
    """Lower bounds of the distances of pairs of bodies, by the convex bodies that hold them.

    Every bound holds, whatever the configuration. Nothing is kept from one question to the next: an edge is always
    decided alike.

    Parameters
    ----------
    robot : Robot
        The robot.
    geometry : pin.GeometryModel
        Its bodies and, after them, the parts of the obstacles.
    pairs : ndarray of int, shape (P, 2)
        The pairs.
    radii : ndarray, shape (P, m)
        Their displacement radii by the joints of Pinocchio's model.
    counts : Counts
        Counts the places at which bounds are looked at.
    """

    def __init__(
        self,
        robot: Robot,
        geometry: pin.GeometryModel,
        pairs: IntArray,
        radii: FloatArray,
        counts: Counts,
    ) -> None:
        own = robot.bounds.convex_bodies
        links = len(own.bodies)
        bodies = own.joined(ConvexBodies.of(list(geometry.geometryObjects)[links:]))
        moved = np.zeros((len(bodies.bodies), robot.bounds.joint_radii.shape[1]), dtype=bool)
        moved[:links] = robot.bounds.joint_radii > 0
        self._bodies = bodies.bodies
        self._data = (
            robot.kinematics.joints,
            self._bodies,
            bodies.starts,
            bodies.vertices,
            Pairs(np.array(pairs), np.array(radii), moved),
        )
        # Kernels are compiled anew for arrays that are read-only or strided: they are given none.
        self._memory = PerThread(partial(_memory, radii.shape[1]))
        self._bounded, self._coupling, self._counts = bodies.bounded, robot.coupling, counts

    def of(self, Q: FloatArray, pairs: IntArray, enough: float) -> FloatArray:
        """Return lower bounds (B, K) [m] of the distances of some of the pairs, (K,), at `Q: (B, n)`.

        They are no better than they need be: as good as `enough`, or good enough to show that the convex bodies are
        not farther apart than about that.
        """
        bounds = np.full((len(Q), len(pairs)), -np.inf)
        if self._bounded and bounds.size:
            joints, bodies, starts, vertices, all_pairs = self._data
            values = np.require(self._coupling.values(Q), requirements=("C", "W"))
            pair_bounds(joints, bodies, starts, vertices, all_pairs.bodies[pairs], values, enough, bounds)
            self._counts.bound_queries += len(Q)
        return bounds

    def prove(
        self, curve: Curve, required: FloatArray, growth: FloatArray | None, floor: float
    ) -> BoundsProof:
        """Try to prove a motion.

        Parameters
        ----------
        curve : sequence of ndarray (n,)
            Its coefficients.
        required : ndarray, shape (P,)
            [m] What pairs must keep at the start. `ALLOWANCE` should be in it.
        growth : ndarray, shape (P,), or None
            [m] How much more at the end.
        floor : float
            [m] Give up on an interval in whose halves the bodies move less than this.
        """
        if not self._bounded:
            return _UNKNOWN
        edge, left = self._memory.own
        coefficients = edge if len(curve) == 2 else np.empty((len(curve), edge.shape[1]))
        coefficients[0] = self._coupling.values(curve[0])
        for k in range(1, len(curve)):
            coefficients[k] = self._coupling.motions(curve[k])
        number, at, places = prove_curve(
            *self._data,
            coefficients,
            required,
            _NOTHING if growth is None else growth,
            floor,
            left,
        )
        self._counts.bound_queries += places
        return BoundsProof(False, at, left[:number].tolist()) if number else _FREE


def _memory(joints: int) -> tuple[FloatArray, FloatArray]:
    """Return arrays for an edge (2, m), and for the intervals that are not proven."""
    return np.empty((2, joints)), np.empty((_INTERVALS, 2))
