"""The cost functional of a path: length, and densities such as danger along it; with the exact gradient."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from math import sqrt
from typing import NamedTuple

import numpy as np

from safe_ompl.collision import CollisionChecker, MotionProver, PairDistances, Witnesses, hinge_costs
from safe_ompl.common import BoolArray, FloatArray, IntArray, caller, compiled, number
from safe_ompl.danger import DangerField
from safe_ompl.danger.kernels import PointDanger, dangers
from safe_ompl.paths.measures import Curve
from safe_ompl.robot import Robot, plain

STEP = 0.05  # [rad] between the samples of the cost of a path, as in its report
WEIGHT = 5.0  # of danger against length
_REFERENCE_SAMPLES = 64

_TINY = 1e-12  # [rad]
_SHORT = 0.1  # shorter segments than this share of the mean count as such a share


class Densities(NamedTuple):
    """What kernels need of the cost near a path: danger and λ, witnesses of C pairs, hinges, and coupling."""

    danger: PointDanger
    weight: float
    rows: IntArray
    carriers: IntArray
    places: FloatArray
    normals: FloatArray
    offsets: FloatArray
    hinges: FloatArray
    matrix: FloatArray
    shift: FloatArray


class AtNodes(NamedTuple):
    """Danger (B,) and obstacle cost (B,) at Gauss points, their gradients (B, m), and what bends, (C, m)."""

    danger: FloatArray
    slopes: FloatArray
    near: FloatArray
    pushes: FloatArray
    bends: FloatArray


class QuadraticModel(NamedTuple):
    """Cost, and that of obstacles in it; gradient (N, n); about the Hessian, blocks (N, n, n), (N − 1, n, n) beside."""

    value: float
    near: float
    gradient: FloatArray
    blocks: FloatArray
    beside: FloatArray


class DangerDensity:
    """λ·CDF(q)² with λ = weight/reference(CDF)², so that one weight ≥ 0 serves all robots and scenes."""

    def __init__(self, field: DangerField, reference: float, weight: float = WEIGHT) -> None:
        self.field = field
        self.reference = number("reference", reference, above=0.0)
        self.weight = number("weight", weight, at_least=0.0)

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the density (B,) at `Q: (B, n)`."""
        density: FloatArray = self.weight * (self.field.values(Q) / self.reference) ** 2
        return density

    def restricted(self, field: DangerField) -> DangerDensity:
        """Return the same density of another field, such as one of fewer danger points."""
        return DangerDensity(field, self.reference, self.weight)


def reference_danger(field: DangerField, checker: CollisionChecker) -> float:
    """Return the median danger over valid configurations, the scale of robot and scene; 1 if nothing is dangerous."""
    robot, rng = checker.robot, np.random.default_rng(0)  # the same scale at any time
    samples = rng.uniform(robot.lower, robot.upper, (_REFERENCE_SAMPLES, robot.n))
    valid = samples[MotionProver(checker).are_free(samples, samples)]
    return float(np.median(field.values(valid if len(valid) else samples))) or 1.0


class PathCost:
    """J = ∫ (1 + Σ density(q(s))) ds over a path's arc length in joint space."""

    def __init__(self, robot: Robot, densities: Sequence[DangerDensity | ObstacleCost], step: float = STEP) -> None:
        self.robot, self.step = robot, step
        self.densities = tuple(densities)

    def of(self, path: FloatArray) -> float:
        """Return J of a path (N, n), by the trapezoidal rule."""
        curve = Curve(self.robot, path)
        total = self._total(curve.spread(self.step))
        return float(0.5 * (total[1:] + total[:-1]).mean() * curve.length)

    def of_edges(self, starts: FloatArray, ends: FloatArray, samples: IntArray) -> FloatArray:
        """Return J (E,) of motions from `starts` to `ends: (E, n)`, by the midpoint rule on `samples: (E,)` each."""
        deltas = self.robot.difference(starts, ends)
        edge = np.repeat(np.arange(len(samples)), samples)
        first = np.concatenate([[0], np.cumsum(samples)[:-1]])
        t = (np.arange(len(edge)) - first[edge] + 0.5) / samples[edge]
        total = self._total(starts[edge] + t[:, None] * deltas[edge])
        costs: FloatArray = np.add.reduceat(total, first) / samples * np.linalg.norm(deltas, axis=1)
        return costs

    def _total(self, Q: FloatArray) -> FloatArray:
        total = np.ones(len(Q))
        for density in self.densities:
            total += density.values(Q)
        return total


_OBSTACLE_WEIGHT = 20.0
_STEEPNESS = 10.0
_STEP = 0.03  # [rad] between the samples at which the least clearance along a path is looked for


class ObstacleCost:
    """Obstacle cost of a radian of path, w Σ ((1 − d/D)₊² + 10 (1 − d/d₀)₊²) over pairs of link and obstacle.

    d [m] is the distance of the two, D > 0 where obstacles begin to count; d₀ ≤ D what the ends of a path allow, 0 at
    first. Exact distances cost most: `anchor` keeps their witnesses, which move with the links.
    """

    def __init__(self, checker: CollisionChecker, distance: float) -> None:
        self.distance = number("clearance", distance, above=0.0)
        self.allowed = 0.0
        self._checker, self._distances = checker, PairDistances(checker, self.distance)
        self._anchored: Witnesses | None = None

    def afresh(self, allowed: float) -> ObstacleCost:
        """Return the same for another path, without witnesses; `allowed` is its d₀ [m], at most D."""
        other = copy(self)
        other._anchored = None
        other.allowed = max(0.0, min(self.distance, allowed))
        return other

    def clearances(self, path: FloatArray) -> tuple[float, float]:
        """Return the least clearance [m] of the ends of a path (N, n), and at samples along it; ≥ 0."""
        checker = self._checker
        ends = max(0.0, PairDistances(checker, np.inf).least(path[[0, -1]], np.inf))
        if not 0 < ends < np.inf:
            return ends, ends
        distances = self._distances if ends <= self.distance else PairDistances(checker, ends)
        return ends, max(0.0, distances.least(Curve(checker.robot, path).spread(_STEP), ends))

    def near(self, Q: FloatArray) -> BoolArray:
        """Return whether anything is nearer than D (B,) at `Q: (B, n)`."""
        near = np.zeros(len(Q), dtype=bool)
        near[self._distances.near(Q, self.distance).rows] = True
        return near

    def anchor(self, Q: FloatArray) -> None:
        """From here on take the witnesses at `Q: (B, n)` for those at B configurations near these."""
        self._anchored = self._distances.witnesses(Q, self.distance)

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the density (B,) at `Q: (B, n)`."""
        return self.expansion(Q)[0]

    def expansion(self, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the density (B,) at `Q: (B, n)`, its gradients (B, n), and vectors v (C, n): it bends like Σ vvᵀ."""
        return self.witnesses(Q).hinge_costs(Q, self.hinges)

    def witnesses(self, Q: FloatArray) -> Witnesses:
        """Return the witnesses that were anchored, or else those at `Q: (B, n)`."""
        return self._anchored or self._distances.witnesses(Q, self.distance)

    @property
    def hinges(self) -> FloatArray:
        """D and w, and d₀ and 10 w if that counts, (1 or 2, 2)."""
        hinges = [(self.distance, _OBSTACLE_WEIGHT), (self.allowed, _STEEPNESS * _OBSTACLE_WEIGHT)]
        return np.array(hinges[: 1 + (self.allowed > 0)])


_SCAN = 0.5  # [rad] between the configurations at which all danger points are looked at
_COARSE = 0.1  # [rad] between the samples of J: twice those of a report, half of the work
_SHARE = 0.85  # of the greatest danger: points that reach it somewhere matter


class ActiveSetCost:
    """J of a path for the danger points that matter near the path last looked at: others can only add to it.

    `danger` is J alone, a `model` has the obstacle cost, too; `everywhere` is the density of all danger points.
    """

    def __init__(self, danger: DangerDensity, obstacles: ObstacleCost | None, path: FloatArray) -> None:
        self.everywhere = danger
        self._obstacles = obstacles
        self._active: bytes | None = None
        coupling, none = danger.field.robot.coupling, np.zeros(0, dtype=np.intp)
        self._coupling = np.array(coupling.matrix), np.array(coupling.offsets)
        self._near = Witnesses(danger.field.robot, none, none, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
        self.look_at(path)

    def look_at(self, path: FloatArray, besides: FloatArray | None = None) -> bool:
        """Take the danger points that matter near a path (N, n), and besides; return whether they are others now."""
        robot = self.everywhere.field.robot
        samples = Curve(robot, path).spread(_SCAN)
        if besides is not None:
            samples = np.concatenate([samples, besides])
        active = self.everywhere.field.active(samples, _SHARE)
        known = active.points.tobytes()
        if known == self._active:
            return False
        self._active = known
        self.danger = PathCost(robot, [self.everywhere.restricted(active)], _COARSE)
        self._about_danger = active.for_kernels(), self.everywhere.weight / self.everywhere.reference**2
        return True

    def of(self, path: FloatArray) -> float:
        """Return J of a path (N, n), without obstacle cost."""
        return self.danger.of(path)

    def anchor(self, path: FloatArray) -> None:
        """From here on take the witnesses of obstacles along a path (N, n)."""
        if self._obstacles is not None:
            self._obstacles.anchor(self.nodes(path))
            self._near = self._obstacles.witnesses(path)

    def nodes(self, path: FloatArray) -> FloatArray:
        """Return the Gauss points (2N − 2, n) of the segments of a path (N, n)."""
        n = path.shape[1]
        return gauss_points(plain(path), np.eye(n), np.zeros(n))

    def densities(self) -> Densities:
        """Return what kernels need of both costs near the path that was last anchored."""
        hinges = np.zeros((0, 2)) if self._obstacles is None else self._obstacles.hinges
        near, (danger, weight) = self._near, self._about_danger
        return Densities(
            danger, weight, near.rows, near.joints, near.points, near.normals, near.offsets, hinges, *self._coupling
        )

    def model(self, path: FloatArray, known: tuple[FloatArray, FloatArray] | None = None) -> QuadraticModel:
        """Return J and obstacle cost, by two Gauss points on each segment of an unrolled path (N, n).

        Length resists bending like springs, Σ f/2ℓ·‖x_{k+1} − x_k‖² with the path's mean density f. What the
        densities add is their Gauss-Newton part; so the whole is positive. Danger (B,) and its gradients (B, m) at the
        Gauss points may be `known`.
        """
        path, densities = plain(path), self.densities()
        (N, n), count = path.shape, 0 if known else 2 * len(path) - 2
        self.everywhere.field.count(count, len(densities.danger.points.charges))
        nothing = np.empty(0), np.empty((0, len(densities.shift)))
        found = at_nodes(densities, path, *(known or nothing))
        blocks, beside = np.zeros((N, n, n)), np.zeros((N - 1, n, n))
        value, near, gradient = integrated(path, found, densities, blocks, beside)
        return QuadraticModel(value, near, gradient, blocks, beside)


# ------------------------------------------------------------------------------------------------------------ kernels

# Of a segment Δ of length ℓ = ‖Δ‖ with nodes at the shares t_j of its way J is ℓ·mean_j f_j. With way points x_k it has
# the gradients mean f·Δ/ℓ + ℓ·mean_j t_j ∇f_j at its end and −mean f·Δ/ℓ + ℓ·mean_j (1 − t_j) ∇f_j at its start.

_OFFSET = 0.5 / sqrt(3.0)
_FIRST, _SECOND = 0.5 - _OFFSET, 0.5 + _OFFSET  # t_j: exact to the third order


@compiled
def gauss_points(path: FloatArray, matrix: FloatArray, shift: FloatArray) -> FloatArray:
    """Return the Gauss points q (2N − 2, n) of the segments of a path (N, n), as matrix (m, n)·q + shift (m,)."""
    out, q = np.empty((2 * len(path) - 2, len(shift))), np.empty(path.shape[1])
    for b in range(len(out)):
        for i in range(len(q)):
            q[i] = path[b // 2, i] + (_SECOND if b % 2 else _FIRST) * (path[b // 2 + 1, i] - path[b // 2, i])
        for j in range(len(shift)):
            out[b, j] = shift[j]
            for i in range(len(q)):
                out[b, j] += matrix[j, i] * q[i]
    return out


@caller
def at_nodes(densities: Densities, path: FloatArray, danger: FloatArray, slopes: FloatArray) -> AtNodes:
    """Return what the densities are at the Gauss points of a path (N, n); the danger may be known, with its slopes."""
    nodes = gauss_points(path, densities.matrix, densities.shift)
    if len(danger) == 0:
        danger, slopes = np.zeros(len(nodes)), np.zeros(nodes.shape)
        if len(densities.danger.points.charges) > 0:
            tables, points, aggregate = densities.danger
            danger = dangers(tables, nodes, points, aggregate, slopes)
    near, pushes, bends = hinge_costs(
        densities.danger.tables.joints, nodes, densities.rows, densities.carriers, densities.places, densities.normals,
        densities.offsets, densities.hinges,
    )  # fmt: skip
    return AtNodes(danger, slopes, near, pushes, bends)


@compiled
def integrated(
    path: FloatArray, found: AtNodes, densities: Densities, blocks: FloatArray, beside: FloatArray
) -> tuple[float, float, FloatArray]:
    """Return the cost of a path (N, n), the part of it that obstacles are, and its gradient (N, n).

    Where there is room, about the Hessian is added to blocks (N or 0, n, n), and (N − 1 or 0, n, n) beside them.
    """
    (N, n), matrix, rate = path.shape, densities.matrix, 2.0 * densities.weight
    total, close, gradient, slope, bend = 0.0, 0.0, np.zeros(path.shape), np.zeros((2, n)), np.zeros(n)
    lengths = np.zeros(N - 1)
    for k in range(N - 1):
        for i in range(n):
            lengths[k] += (path[k + 1, i] - path[k, i]) ** 2
        lengths[k] = sqrt(lengths[k])
        mean, slope[:] = 1.0, 0.0
        for side in range(2):
            b = 2 * k + side
            mean += 0.5 * (0.5 * rate * found.danger[b] ** 2 + found.near[b])
            close += 0.5 * lengths[k] * found.near[b]
            for j in range(len(matrix)):
                steepness = rate * found.danger[b] * found.slopes[b, j] + found.pushes[b, j]
                for i in range(n):
                    slope[side, i] += 0.5 * lengths[k] * steepness * matrix[j, i]
        total += lengths[k] * mean
        for i in range(n):
            stretch = mean / max(lengths[k], _TINY) * (path[k + 1, i] - path[k, i])
            gradient[k, i] += _SECOND * slope[0, i] + _FIRST * slope[1, i] - stretch
            gradient[k + 1, i] += _FIRST * slope[0, i] + _SECOND * slope[1, i] + stretch
    whole = max(lengths.sum(), _TINY)
    for k in range(len(beside)):
        stiffness = total / whole / max(lengths[k], _SHORT * whole / (N - 1))
        for i in range(n):
            blocks[k, i, i] += stiffness
            blocks[k + 1, i, i] += stiffness
            beside[k, i, i] -= stiffness
    for c in range(2 * len(beside) + len(found.bends) if len(beside) > 0 else 0):
        b = c if c < 2 * len(beside) else densities.rows[c - 2 * len(beside)]
        k, t = b // 2, _SECOND if b % 2 else _FIRST
        bend[:] = 0.0
        for j in range(len(matrix)):
            each = sqrt(rate) * found.slopes[b, j] if c < 2 * len(beside) else found.bends[c - 2 * len(beside), j]
            for i in range(n):
                bend[i] += each * matrix[j, i]
        for i in range(n):
            for j in range(n):
                square = 0.5 * lengths[k] * bend[i] * bend[j]
                blocks[k, i, j] += (1.0 - t) ** 2 * square
                blocks[k + 1, i, j] += t**2 * square
                beside[k, i, j] += t * (1.0 - t) * square
    return total, close, gradient


@compiled
def chained(costs: FloatArray) -> IntArray:
    """Return what comes before each node (N,) on the cheapest way to it, by the costs (N, N) of edges to later ones."""
    best, before = np.zeros(len(costs)), np.zeros(len(costs), np.int64)
    for j in range(1, len(costs)):
        best[j] = best[0] + costs[0, j]
        for i in range(1, j):
            if best[i] + costs[i, j] < best[j]:
                best[j], before[j] = best[i] + costs[i, j], i
    return before
