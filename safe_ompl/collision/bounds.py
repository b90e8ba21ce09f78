"""Lower bounds of the distances of pairs of bodies, by the convex bodies that hold them, and what these prove."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np

from safe_ompl.collision.kernels.distances import near_pairs, pair_bounds, pairs_within
from safe_ompl.collision.kernels.proofs import prove_curve, prove_curves
from safe_ompl.collision.kernels.tables import GROUP, EdgeTables, Pairs
from safe_ompl.collision.queries import DISTANCE_ERROR
from safe_ompl.common import BoolArray, Counts, FloatArray, IntArray, PerThread
from safe_ompl.geometry import ConvexBodies
from safe_ompl.geometry.kernels import Records
from safe_ompl.robot import JointLimits, Robot, plain

# [m] Proofs require this much more than pairs must keep. coal errs by at most DISTANCE_ERROR, so it never calls a
# configuration of a proven motion too near, and a certificate of the motion can be issued. Rounding is far below.
ALLOWANCE = 2 * DISTANCE_ERROR

_INTERVALS = 64  # the most that may wait to be proven
_TOGETHER = 256  # motions that a thread proves in one go: Ctrl-C waits for that
_SUSPECTS = 8  # pairs that blocked motions last: they often block the next one
BLOCK = 64  # parts of obstacles that are near each other,
_FEW = 512  # and as many pairs are looked at one by one
ROUNDING = 1e-9  # [m] of distances between balls


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
        reaches = np.zeros((len(bodies.bodies), radii.shape[1]))
        reaches[: len(robot.bounds.joint_radii)] = robot.bounds.joint_radii
        exact = bodies.exact if bodies.bounded else np.zeros_like(bodies.exact)
        self.exact: BoolArray = exact[pairs[:, 0]] & exact[pairs[:, 1]]
        certain = np.where(self.exact, ALLOWANCE, np.inf)
        groups = _groups(bodies, pairs)
        own = len(robot.bounds.joint_radii)
        pair_table = Pairs(np.array(pairs), np.array(radii.T, order="C"), reaches, certain, groups, own)
        self._data = robot.kinematics.joints, bodies.shapes, pair_table
        self._flat = robot.kinematics.joints, *bodies.shapes, *pair_table
        # Kernels are compiled anew for arrays that are read-only or strided: they are given none.
        self._memory = PerThread(partial(edge_memory, radii.shape[1], len(pairs)))
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

    def nearer(self, q: FloatArray, margins: FloatArray) -> tuple[IntArray, bool]:
        """Return the pairs that may be nearer than their margins (P,) [m] at `q: (n,)`; the last one surely is if True.

        Then no others were looked at. What bounds decide coal would decide alike.
        """
        near: IntArray = np.empty(len(self.exact), np.intp)
        known, values = self._data[2], plain(self._coupling.values(q))
        tables = *self._flat[:4], known.bodies, known.certain, known.groups, known.own
        number, surely = near_pairs(*tables, values, plain(margins), ALLOWANCE, near)
        return near[:number], surely

    def near(self, Q: FloatArray, pairs: IntArray, within: float, *, least: bool = False) -> FloatArray:
        """Return which of some pairs, (K,), are nearer than `within` [m] at `Q: (B, n)`, (C, 10), row by row.

        It is what `kernels.distances.pairs_within` returns, with the error of coal's distances.
        """
        if not self._bounded:
            found = np.full((len(Q) * len(pairs), 10), -np.inf)
            found[:, :2] = np.indices((len(Q), len(pairs))).reshape(2, -1).T
            return found
        self._counts.bound_queries += len(Q) if within < np.inf else 0  # else distances are asked for
        (joints, shapes, known), values = self._data, plain(self._coupling.values(Q))
        exact = self.exact[pairs]
        return pairs_within(joints, shapes, known.bodies[pairs], exact, values, within, DISTANCE_ERROR, least)

    def prove(self, curve: Curve, required: FloatArray, floor: float) -> BoundsProof:
        """Try to prove a motion.

        Pairs must keep `required: (P,)` [m], `ALLOWANCE` in it. Intervals in whose halves the bodies move less than the
        floor [m] are given up.
        """
        if not self._bounded:
            return _UNKNOWN
        first, *others = curve
        coupling = self._coupling
        coefficients = np.array([coupling.values(first), *(coupling.motions(other) for other in others)])
        return self._proof(coefficients, required, floor)

    def prove_edge(
        self, ends: tuple[FloatArray, FloatArray], limits: JointLimits, required: FloatArray, floor: float
    ) -> BoundsProof | None:
        """Try to prove the straight motion between two configurations (n,); None if one is not within the limits."""
        edge = self._memory.own[0]
        if not limits.lay_edge(*ends, edge):
            return None
        return self._proof(edge, required, floor) if self._bounded else _UNKNOWN

    def edge_tables(self, limits: JointLimits, required: FloatArray, floor: float) -> EdgeTables | None:
        """Return what the kernel `prove_edge` needs, which does not count its places; None where nothing is bounded."""
        (joints, shapes, pairs), (edge, left, suspects) = self._data, edge_memory(*self._data[2].radii.shape)
        tables = EdgeTables(joints, shapes, pairs, *limits.tables, required, floor, edge, left, suspects)
        return tables if self._bounded else None

    def _proof(self, coefficients: FloatArray, required: FloatArray, floor: float) -> BoundsProof:
        """Return what `prove` does of a motion of the joints of Pinocchio's model, (d + 1, m)."""
        _, left, suspects = self._memory.own
        number, at, places = prove_curve(*self._flat, coefficients, required, floor, left, suspects)
        self._counts.bound_queries += places
        if not number:
            return _FREE
        return BoundsProof(False, at, left[:number].tolist() if number > 0 else _UNKNOWN.left, number < 0)

    def prove_many(self, curves: FloatArray, required: FloatArray, floor: float, workers: int = 1) -> IntArray:
        """Return what `prove` says of motions of the model's joints, of coefficients `curves: (E, d + 1, m)`, (E,).

        That is 1 of those that are proven, −1 of those that are blocked, 0 of others. Each of the workers is a thread.
        """
        found: IntArray = np.zeros(len(curves), np.intp)
        joints, shapes, known = self._data
        nothing: IntArray = np.empty(0, np.intp)  # what blocks the edges of a batch differs: to suspect it costs time

        def prove(some: slice) -> int:
            left = self._memory.own[1]
            return int(prove_curves(joints, shapes, known, curves[some], required, floor, left, nothing, found[some]))

        if self._bounded:
            parts = [slice(k, k + _TOGETHER) for k in range(0, len(curves), _TOGETHER)]
            if workers == 1 or len(parts) == 1:
                self._counts.bound_queries += sum(map(prove, parts))
            else:
                with ThreadPoolExecutor(workers) as pool:
                    self._counts.bound_queries += sum(pool.map(prove, parts))
        return found


def _groups(bodies: ConvexBodies, pairs: IntArray) -> Records:
    """Return groups of pairs as they follow each other, one for all where they are few."""
    cuts = np.array([0, len(pairs)])
    if len(pairs) > _FEW:
        joints, (first, second) = bodies.bodies["joint"], pairs.T
        starts = np.flatnonzero((np.diff(first, prepend=-1) != 0) | (np.diff(joints[second] > 0, prepend=True)))
        cuts = np.unique(np.concatenate([np.arange(a, b, BLOCK) for a, b in pairwise([*starts, len(pairs)])]))
        cuts = np.append(cuts, len(pairs))
    groups = np.zeros(len(cuts) - 1, GROUP)
    groups["begin"], groups["end"], groups["radius"] = cuts[:-1], cuts[1:], np.inf
    if len(groups) > 1:
        placed = bodies.bodies[second]
        centres = placed["translation"] + np.einsum("pxy,py->px", placed["rotation"], placed["centre"])
        middle = np.add.reduceat(centres, cuts[:-1]) / np.diff(cuts)[:, None]
        away = np.linalg.norm(centres - np.repeat(middle, np.diff(cuts), axis=0), axis=1) + placed["reach"]
        still = np.maximum.reduceat(joints[second], cuts[:-1]) == 0
        groups["centre"] = middle
        groups["radius"] = np.where(still, np.maximum.reduceat(away, cuts[:-1]) + ROUNDING, np.inf)
    return groups


def edge_memory(joints: int, pairs: int) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return arrays for an edge (2, m), for the intervals that are not proven, and for pairs that blocked motions."""
    return np.empty((2, joints)), np.empty((_INTERVALS, 2)), np.arange(min(_SUSPECTS, pairs))
