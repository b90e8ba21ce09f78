"""The cost functional of a path: length, and densities such as danger along it; with the exact gradient."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from math import sqrt
from typing import NamedTuple

import numpy as np

from safe_ompl.collision import CollisionChecker, PairDistances, Witnesses
from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled, number
from safe_ompl.danger import DangerField
from safe_ompl.paths.measures import Curve
from safe_ompl.robot import Robot, plain

STEP = 0.05  # [rad] between the samples of the cost of a path, as in its report
WEIGHT = 5.0  # of danger against length
_REFERENCE_SAMPLES = 64

_TINY = 1e-12  # [rad]
_SHORT = 0.1  # shorter segments than this share of the mean count as such a share


class Expansion(NamedTuple):
    """A density (B,), its gradients (B, n), and vectors v (C, n): at `rows: (C,)` it bends like Σ vvᵀ."""

    values: FloatArray
    gradients: FloatArray
    rows: IntArray
    bends: FloatArray


class QuadraticModel(NamedTuple):
    """Cost, gradient (N, n), about the Hessian, blocks (N, n, n) and (N − 1, n, n) beside; the densities' shares."""

    value: float
    gradient: FloatArray
    blocks: FloatArray
    beside: FloatArray
    shares: tuple[float, ...]


class DangerDensity:
    """λ·CDF(q)² with λ = weight/reference(CDF)², so that one weight ≥ 0 serves all robots and scenes."""

    def __init__(self, field: DangerField, reference: float, weight: float = WEIGHT) -> None:
        self.field = field
        self.reference = number("reference", reference, above=0.0)
        self.weight = number("weight", weight, at_least=0.0)
        self._last: tuple[FloatArray, int, FloatArray, FloatArray] | None = None

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the density (B,) at `Q: (B, n)`."""
        density: FloatArray = self.weight * (self.field.values(Q) / self.reference) ** 2
        return density

    def values_and_gradients(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the density (B,) and its gradients (B, n) at `Q: (B, n)`."""
        revision = self.field.revision
        self._last = Q.copy(), revision, *self.field.values_and_gradients(Q)
        return self._graded(*self._last[2:])

    def expansion(self, Q: FloatArray) -> Expansion:
        """Return the density and its derivatives at `Q: (B, n)`, the second ones as if the danger were linear."""
        last = self._last  # a descent asks for its last path again
        known = last is not None and last[1] == self.field.revision and np.array_equal(last[0], Q)
        danger, slopes = last[2:] if last is not None and known else self.field.values_and_gradients(Q)
        bends = np.sqrt(2.0 * self.weight) / self.reference * slopes
        return Expansion(*self._graded(danger, slopes), np.arange(len(Q)), bends)

    def _graded(self, danger: FloatArray, slopes: FloatArray) -> tuple[FloatArray, FloatArray]:
        relative = danger / self.reference
        rates = self.weight * 2.0 / self.reference * relative
        return self.weight * relative**2, rates[:, None] * slopes

    def restricted(self, field: DangerField) -> DangerDensity:
        """Return the same density of another field, such as one of fewer danger points."""
        return DangerDensity(field, self.reference, self.weight)


def reference_danger(field: DangerField, checker: CollisionChecker) -> float:
    """Return the median danger over valid configurations, the scale of robot and scene; 1 if nothing is dangerous."""
    robot, rng = checker.robot, np.random.default_rng(0)  # the same scale at any time
    samples = rng.uniform(robot.lower, robot.upper, (_REFERENCE_SAMPLES, robot.n))
    valid = samples[[not checker.in_collision(q) for q in samples]]
    return float(np.median(field.values(valid if len(valid) else samples))) or 1.0


class PathCost:
    """J = ∫ (1 + Σ density(q(s))) ds over a path's arc length in joint space."""

    def __init__(self, robot: Robot, densities: Sequence[DangerDensity | ObstacleCost]) -> None:
        self.robot = robot
        self.densities = tuple(densities)

    def of(self, path: FloatArray) -> float:
        """Return J of a path (N, n), by the trapezoidal rule."""
        curve = Curve(self.robot, path)
        s = np.linspace(0.0, curve.length, 2 + int(curve.length / STEP))
        return float(np.trapezoid(self._total(curve.at(s)), s))

    def of_edges(self, starts: FloatArray, ends: FloatArray, samples: IntArray) -> FloatArray:
        """Return J (E,) of motions from `starts` to `ends: (E, n)`, by the midpoint rule on `samples: (E,)` each."""
        deltas = self.robot.difference(starts, ends)
        edge = np.repeat(np.arange(len(samples)), samples)
        first = np.concatenate([[0], np.cumsum(samples)[:-1]])
        t = (np.arange(len(edge)) - first[edge] + 0.5) / samples[edge]
        total = self._total(starts[edge] + t[:, None] * deltas[edge])
        costs: FloatArray = np.add.reduceat(total, first) / samples * np.linalg.norm(deltas, axis=1)
        return costs

    def value_and_gradient(self, path: FloatArray) -> tuple[float, FloatArray]:
        """Return J with two Gauss points on each segment of an unrolled path (N, n), and its exact gradient (N, n)."""
        nodes = self.nodes(path)
        found = [density.values_and_gradients(nodes) for density in self.densities]
        return self._integrated(path, found)

    def model(self, path: FloatArray) -> QuadraticModel:
        """Return the same with about the Hessian of J.

        Length resists bending like springs, Σ f/2ℓ·‖x_{k+1} − x_k‖² with the path's mean density f. What the
        densities add is their Gauss-Newton part; so the whole is positive.
        """
        nodes = self.nodes(path)
        expansions = [density.expansion(nodes) for density in self.densities]
        value, gradient = self._integrated(path, [expansion[:2] for expansion in expansions])
        lengths = np.linalg.norm(path[1:] - path[:-1], axis=1)
        mean = value / max(lengths.sum(), _TINY)
        blocks, beside = _springs(mean / np.maximum(lengths, max(_SHORT * lengths.mean(), _TINY)), path.shape[1])
        for expansion in expansions:
            _add_bends(plain(path), expansion.rows, plain(expansion.bends), blocks, beside)
        each = np.repeat(0.5 * lengths, 2)
        shares = tuple(float(each @ expansion.values) for expansion in expansions)
        return QuadraticModel(value, gradient, blocks, beside, shares)

    def nodes(self, path: FloatArray) -> FloatArray:
        """Return the Gauss points (2N − 2, n) of the segments of a path (N, n)."""
        return gauss_points(plain(path))

    def _integrated(self, path: FloatArray, found: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[float, FloatArray]:
        values, slopes = np.ones(2 * len(path) - 2), np.zeros((2 * len(path) - 2, path.shape[1]))
        for more, steeper in found:
            values += more
            slopes += steeper
        return _integrated(plain(path), values, slopes)

    def _total(self, Q: FloatArray) -> FloatArray:
        total = np.ones(len(Q))
        for density in self.densities:
            total += density.values(Q)
        return total


def _springs(stiffness: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Return the Hessian of springs of stiffness (N − 1,) between way points: on the diagonal and beside it."""
    blocks, beside = np.zeros((len(stiffness) + 1, n, n)), np.zeros((len(stiffness), n, n))
    joint = np.arange(n)
    blocks[:-1, joint, joint] += stiffness[:, None]
    blocks[1:, joint, joint] += stiffness[:, None]
    beside[:, joint, joint] -= stiffness[:, None]
    return blocks, beside


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
        curve = Curve(checker.robot, path)
        samples = curve.at(np.linspace(0.0, curve.length, 2 + int(curve.length / _STEP)))
        return ends, max(0.0, distances.least(samples, ends))

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
        return self.values_and_gradients(Q)[0]

    def values_and_gradients(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the density (B,) and its gradients (B, n) at `Q: (B, n)`."""
        return self.expansion(Q)[:2]

    def expansion(self, Q: FloatArray) -> Expansion:
        """Return the density and its derivatives at `Q: (B, n)`, the second ones by Gauss-Newton."""
        witnesses = self._anchored or self._distances.witnesses(Q, self.distance)
        hinges = [(self.distance, _OBSTACLE_WEIGHT)]
        if self.allowed > 0:
            hinges.append((self.allowed, _STEEPNESS * _OBSTACLE_WEIGHT))
        values, gradients, bends = witnesses.hinge_costs(Q, np.array(hinges))
        return Expansion(values, gradients, witnesses.rows, bends)


_SCAN = 0.5  # [rad] between the configurations at which all danger points are looked at
_SHARE = 0.85  # of the greatest danger: points that reach it somewhere matter


class ActiveSetCost:
    """J of a path for the danger points that matter near the path last looked at: others can only add to it.

    `danger` is J alone; `total` has the obstacle cost, by the witnesses of the path that was last anchored;
    `everywhere` is the density of all danger points.
    """

    def __init__(self, danger: DangerDensity, obstacles: ObstacleCost | None, path: FloatArray) -> None:
        self.everywhere = danger
        self._obstacles = obstacles
        self._active: bytes | None = None
        self.look_at(path)

    def look_at(self, path: FloatArray, besides: FloatArray | None = None) -> bool:
        """Take the danger points that matter near a path (N, n), and besides; return whether they are others now."""
        robot = self.everywhere.field.robot
        curve = Curve(robot, path)
        samples = curve.at(np.linspace(0.0, curve.length, 2 + int(curve.length / _SCAN)))
        if besides is not None:
            samples = np.concatenate([samples, besides])
        active = self.everywhere.field.active(samples, _SHARE)
        known = active.points.tobytes()
        if known == self._active:
            return False
        self._active = known
        danger = self.everywhere.restricted(active)
        self.danger = PathCost(robot, [danger])
        obstacles = [] if self._obstacles is None else [self._obstacles]
        self.total = PathCost(robot, [danger, *obstacles])
        return True

    def of(self, path: FloatArray) -> float:
        """Return J of a path (N, n), without obstacle cost."""
        return self.danger.of(path)

    def anchored(self, path: FloatArray) -> tuple[float, QuadraticModel]:
        """Return the obstacle cost of a path (N, n), and the model of `total` there; it is anchored then."""
        self.anchor(path)
        model = self.total.model(path)
        return sum(model.shares[1:]), model

    def anchor(self, path: FloatArray) -> None:
        """From here on take the witnesses of obstacles along a path (N, n)."""
        if self._obstacles is not None:
            self._obstacles.anchor(self.total.nodes(path))

    def value_and_gradient(self, path: FloatArray) -> tuple[float, FloatArray]:
        """Return value and gradient (N, n) of both costs together at a path (N, n), by the witnesses."""
        return self.total.value_and_gradient(path)

    def model(self, path: FloatArray) -> QuadraticModel:
        """Return the same, and about the Hessian."""
        return self.total.model(path)


# ------------------------------------------------------------------------------------------------------------ kernels

# Of a segment Δ of length ℓ = ‖Δ‖ with nodes at the shares t_j of its way J is ℓ·mean_j f_j. With way points x_k it has
# the gradients mean f·Δ/ℓ + ℓ·mean_j t_j ∇f_j at its end and −mean f·Δ/ℓ + ℓ·mean_j (1 − t_j) ∇f_j at its start. Row i
# of a band holds the entries (i, i − w) … (i, i) of the lower triangle, w = 2n − 1 for blocks (n, n).


@compiled
def factored(blocks: FloatArray, beside: FloatArray) -> FloatArray:
    """Return the factor's band (N·n, 2n) of a matrix with blocks (N, n, n), and (N − 1, n, n) right of them."""
    count, n = blocks.shape[:2]
    w = 2 * n - 1
    band = np.zeros((count * n, 2 * n))
    for k in range(count):
        for a in range(n):
            row = band[k * n + a]
            for b in range(a + 1):
                row[w + b - a] = blocks[k, a, b]
            if k > 0:
                for b in range(n):
                    row[w - n + b - a] = beside[k - 1, b, a]
    for i in range(len(band)):
        for j in range(max(0, i - w), i + 1):
            rest = band[i, j - i + w]
            for k in range(max(0, i - w), j):
                rest -= band[i, k - i + w] * band[j, k - j + w]
            band[i, j - i + w] = sqrt(rest) if i == j else rest / band[j, w]
    return band


@compiled
def solved(band: FloatArray, right: FloatArray) -> FloatArray:
    """Return x with L Lᵀ x = `right: (N·n,)`, L given by its band (N·n, 2n)."""
    w, x = band.shape[1] - 1, right.copy()
    for i in range(len(x)):
        for j in range(max(0, i - w), i):
            x[i] -= band[i, j - i + w] * x[j]
        x[i] /= band[i, w]
    for i in range(len(x) - 1, -1, -1):
        x[i] /= band[i, w]
        for j in range(max(0, i - w), i):
            x[j] -= band[i, j - i + w] * x[i]
    return x


_OFFSET = 0.5 / sqrt(3.0)
_FIRST, _SECOND = 0.5 - _OFFSET, 0.5 + _OFFSET  # t_j: exact to the third order


@compiled
def gauss_points(path: FloatArray) -> FloatArray:
    """Return the Gauss points (2N − 2, n) of the segments of a path (N, n)."""
    out = np.empty((2 * len(path) - 2, path.shape[1]))
    for k in range(len(path) - 1):
        for i in range(path.shape[1]):
            delta = path[k + 1, i] - path[k, i]
            out[2 * k, i] = path[k, i] + _FIRST * delta
            out[2 * k + 1, i] = path[k, i] + _SECOND * delta
    return out


@compiled
def _integrated(path: FloatArray, values: FloatArray, slopes: FloatArray) -> tuple[float, FloatArray]:
    """Return the cost of a path (N, n), and its gradient (N, n), from f (2N − 2,) and ∇f (2N − 2, n) at the nodes."""
    total, gradient = 0.0, np.zeros(path.shape)
    for k in range(len(path) - 1):
        squared = 0.0
        for i in range(path.shape[1]):
            squared += (path[k + 1, i] - path[k, i]) ** 2
        length, mean = sqrt(squared), 0.5 * (values[2 * k] + values[2 * k + 1])
        total += length * mean
        for i in range(path.shape[1]):
            stretch = mean / max(length, _TINY) * (path[k + 1, i] - path[k, i])
            before, after = 0.5 * length * slopes[2 * k, i], 0.5 * length * slopes[2 * k + 1, i]
            gradient[k, i] += _SECOND * before + _FIRST * after - stretch
            gradient[k + 1, i] += _FIRST * before + _SECOND * after + stretch
    return total, gradient


@compiled
def _add_bends(path: FloatArray, rows: IntArray, bends: FloatArray, blocks: FloatArray, beside: FloatArray) -> None:
    """Add to the Hessian's blocks on and beside the diagonal what bends at nodes, rows (C,), like Σ vvᵀ: v (C, n)."""
    for c in range(len(rows)):
        k, t = rows[c] // 2, _SECOND if rows[c] % 2 else _FIRST
        squared = 0.0
        for i in range(path.shape[1]):
            squared += (path[k + 1, i] - path[k, i]) ** 2
        share = 0.5 * sqrt(squared)
        for a in range(path.shape[1]):
            for b in range(path.shape[1]):
                square = share * bends[c, a] * bends[c, b]
                blocks[k, a, b] += (1.0 - t) ** 2 * square
                blocks[k + 1, a, b] += t**2 * square
                beside[k, a, b] += t * (1.0 - t) * square


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
