"""Lower bounds of the distances of pairs of bodies, by the convex bodies that hold them, and what these prove."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from safe_ompl.collision.kernels.distances import near_pairs, pair_bounds, pairs_within
from safe_ompl.collision.kernels.proofs import prove_curve, prove_curves
from safe_ompl.collision.kernels.tables import EdgeTables, Pairs, Required, grouped
from safe_ompl.common import BoolArray, Counts, FloatArray, IntArray, PerThread
from safe_ompl.geometry import DISTANCE_ERROR, ConvexBodies
from safe_ompl.geometry.kernels import POSE, Records
from safe_ompl.robot import JointLimits, Robot, plain

# [m] Proofs require this much more than pairs must keep. coal errs by at most DISTANCE_ERROR, so it never calls a
# configuration of a proven motion too near, and a certificate of the motion can be issued. Rounding is far below.
ALLOWANCE = 2 * DISTANCE_ERROR

_INTERVALS = 64  # the most that may wait to be proven
_TOGETHER = 256  # motions that a thread proves in one go: Ctrl-C waits for that
_SUSPECTS = 8  # pairs that blocked motions last: they often block the next one

# Coefficients c_k (n,) of a motion q(t) = Σ_k c_k t^k, t in [0, 1]; of an edge its start and the way to its end.
Curve: TypeAlias = Sequence[FloatArray]


class BoundsProof(NamedTuple):
    """What lower bounds of distances prove of a motion.

    If it is not all proven, `left` are the parts that are not, each from one fraction of the motion to another. `at` is
    a fraction at which a bound shows that some pair may be nearer than required; −1 if there is none. If the motion is
    `blocked`, some pair certainly is, and what is proven of the rest is not said.
    """

    proven: bool
    at: float
    left: list[list[float]]
    blocked: bool = False

    def covers(self, low: float, high: float) -> bool:
        """Return whether the motion is proven from one fraction to another."""
        return not any(first < high and last > low for first, last in self.left)


class SomePairs(NamedTuple):
    """The bodies (K, 2) of some pairs, and whether both are known exactly, (K,)."""

    bodies: Any
    exact: BoolArray


_UNKNOWN = BoundsProof(False, -1.0, [[0.0, 1.0]])
_FREE = BoundsProof(True, -1.0, [])


class DistanceBounds:
    """Lower bounds of the distances of pairs of bodies, by the convex bodies that hold them.

    Every bound holds, whatever the configuration. Nothing is kept from one question to the next but which pairs blocked
    motions, and are looked at first: whether an edge is free is always decided alike. The `bodies` are the robot's and,
    after them, the parts of obstacles; `pairs: (P, 2)` of them have displacement radii (P, m) by the joints of
    Pinocchio's model.
    """

    def __init__(self, robot: Robot, bodies: ConvexBodies, pairs: IntArray, radii: FloatArray, counts: Counts) -> None:
        own = len(robot.bounds.joint_radii)
        reaches = np.zeros((radii.shape[1], len(bodies.bodies)))
        reaches[:, :own] = robot.bounds.joint_radii.T
        exact = bodies.exact if bodies.bounded else np.zeros_like(bodies.exact)
        self.exact: BoolArray = exact[pairs[:, 0]] & exact[pairs[:, 1]]
        certain = np.where(self.exact, ALLOWANCE, np.inf)
        poses, numbers = _poses(bodies), pairs.astype(np.uintp)
        groups, balls = grouped(numbers, own, bodies.bodies, poses)
        pair_table = Pairs(numbers, np.array(radii.T, order="C"), reaches, certain, groups, own, balls)
        self._data = robot.kinematics.joints, bodies.shapes, pair_table
        self._flat = robot.kinematics.joints, *bodies.shapes, *pair_table
        # Kernels are compiled anew for arrays that are read-only or strided: they are given none.
        self._memory = PerThread(partial(edge_memory, radii.shape[1], len(pairs), poses))
        self._bounded, self._coupling, self._counts = bodies.bounded, robot.coupling, counts

    def of(self, Q: FloatArray, pairs: IntArray, enough: float) -> FloatArray:
        """Return lower bounds (B, K) [m] of the distances of some of the pairs, (K,), at `Q: (B, n)`.

        A bound is not improved any more once it is at least `enough` [m], or once it is clear that it cannot be.
        """
        bounds = np.full((len(Q), len(pairs)), -np.inf)
        if self._bounded and bounds.size:
            joints, shapes, known = self._data
            pair_bounds(joints, shapes, known.bodies[pairs], plain(self._coupling.values(Q)), enough, bounds)
            self._counts.bound_queries += len(Q)
        return bounds

    def nearer(self, q: FloatArray, margins: FloatArray, largest: float) -> tuple[IntArray, bool]:
        """Return the pairs that may be nearer than their margins (P,) [m] at `q: (n,)`; the last one surely is if True.

        No margin is above the largest. Then no others were looked at. What bounds decide coal would decide alike.
        """
        near: IntArray = np.empty(len(self.exact), np.intp)
        known, values = self._data[2], plain(self._coupling.values(q))
        tables = *self._flat[:5], known.bodies, known.certain, known.groups, known.own, known.balls
        number, surely = near_pairs(*tables, values, plain(margins), largest, ALLOWANCE, near, self._memory.own[3])
        return near[:number], surely

    def near(self, Q: FloatArray, some: SomePairs, within: float, *, least: bool = False) -> FloatArray:
        """Return which of `some` pairs are nearer than a distance [m] at `Q: (B, n)`, (C, 10), row by row.

        It is what `kernels.distances.pairs_within` returns, with the error of coal's distances.
        """
        if not self._bounded:
            found = np.full((len(Q) * len(some.exact), 10), -np.inf)
            found[:, :2] = np.indices((len(Q), len(some.exact))).reshape(2, -1).T
            return found
        self._counts.bound_queries += len(Q) if within < np.inf else 0  # else distances are asked for
        (joints, shapes, _), values = self._data, plain(self._coupling.values(Q))
        return pairs_within(joints, shapes, *some, values, within, DISTANCE_ERROR, least)

    def some(self, pairs: IntArray) -> SomePairs:
        """Return some pairs, (K,), to ask for what is near among them."""
        return SomePairs(self._data[2].bodies[pairs], self.exact[pairs])

    def prove(self, curve: Curve, required: Required, floor: float) -> BoundsProof:
        """Try to prove a motion.

        What pairs must keep has `ALLOWANCE` in it. Intervals in whose halves the bodies move less than the floor [m]
        are given up.
        """
        if not self._bounded:
            return _UNKNOWN
        first, *others = curve
        coupling = self._coupling
        coefficients = np.array([coupling.values(first), *(coupling.motions(other) for other in others)])
        return self._proof(coefficients, required, floor)

    def prove_edge(
        self, ends: tuple[FloatArray, FloatArray], limits: JointLimits, required: Required, floor: float
    ) -> BoundsProof | None:
        """Try to prove the straight motion between two configurations (n,); None if one is not within the limits."""
        edge = self._memory.own[0]
        if not limits.lay_edge(*ends, edge):
            return None
        return self._proof(edge, required, floor) if self._bounded else _UNKNOWN

    def edge_tables(self, limits: JointLimits, required: Required, floor: float) -> EdgeTables | None:
        """Return what the kernel `prove_edge` needs, which does not count its places; None where nothing is bounded."""
        joints, shapes, pairs = self._data
        edge, left, suspects, poses = edge_memory(len(pairs.radii), len(pairs.bodies), self._memory.own[3])
        tables = EdgeTables(joints, shapes, pairs, *limits.tables, required, floor, edge, left, suspects, poses)
        return tables if self._bounded else None

    def _proof(self, coefficients: FloatArray, required: Required, floor: float) -> BoundsProof:
        """Return what `prove` does of a motion of the joints of Pinocchio's model, (d + 1, m)."""
        _, left, suspects, poses = self._memory.own
        number, at, places = prove_curve(*self._flat, coefficients, *required, floor, left, suspects, poses)
        self._counts.bound_queries += places
        if not number:
            return _FREE
        return BoundsProof(False, at, left[:number].tolist() if number > 0 else _UNKNOWN.left, number < 0)

    def prove_many(self, curves: FloatArray, required: Required, floor: float, workers: int = 1) -> IntArray:
        """Return what `prove` says of motions of the model's joints, of coefficients `curves: (E, d + 1, m)`, (E,).

        That is 1 of those that are proven, −1 of those that are blocked, 0 of others. Each of the workers is a thread.
        """
        found: IntArray = np.zeros(len(curves), np.intp)
        joints, shapes, known = self._data
        nothing: IntArray = np.empty(0, np.intp)  # what blocks the edges of a batch differs: to suspect it costs time

        def prove(some: slice) -> int:
            _, left, _, poses = self._memory.own
            told = required, floor, left, nothing, poses, found[some]
            return int(prove_curves(joints, shapes, known, curves[some], *told))

        if self._bounded:
            parts = [slice(k, k + _TOGETHER) for k in range(0, len(curves), _TOGETHER)]
            if workers == 1 or len(parts) == 1:
                self._counts.bound_queries += sum(map(prove, parts))
            else:
                from concurrent.futures import ThreadPoolExecutor  # few need it

                with ThreadPoolExecutor(workers) as pool:
                    self._counts.bound_queries += sum(pool.map(prove, parts))
        return found


def _poses(bodies: ConvexBodies) -> Records:
    """Return the poses (G,) of bodies that no joint carries, those of others to be written."""
    known = bodies.bodies
    poses = np.zeros(len(known), POSE)
    poses["rotation"], poses["origin"] = known["rotation"], known["translation"]
    poses["centre"] = known["translation"] + (known["rotation"] @ known["centre"][..., None])[..., 0]
    return poses


def edge_memory(joints: int, pairs: int, poses: Records) -> tuple[FloatArray, FloatArray, IntArray, Records]:
    """Return arrays for an edge (2, m), for the intervals that are not proven, for suspects, and for poses (G,)."""
    return np.empty((2, joints)), np.empty((_INTERVALS, 2)), np.arange(min(_SUSPECTS, pairs)), poses.copy()
