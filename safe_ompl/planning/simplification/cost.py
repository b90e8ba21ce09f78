"""The cost functional of a path: length, and densities such as danger along it; with the exact gradient."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from safe_ompl.collision import CollisionChecker, MotionProver, NearPairs, PairDistances, hinge_costs
from safe_ompl.common import BoolArray, FloatArray, IntArray, caller, compiled, number
from safe_ompl.danger import DangerField
from safe_ompl.danger.kernels import PointDanger, dangers
from safe_ompl.planning.simplification.measures import Curve, spread
from safe_ompl.robot import Robot, plain
from safe_ompl.robot.kernels import way

STEP = 0.05  # [rad] between the samples of the cost of a path, as in its report
WEIGHT = 5.0  # of danger against length
_REFERENCE_SAMPLES = 64

_TINY = 1e-12  # [rad]
_SHORT = 0.1  # shorter segments than this share of the mean count as such a share


class DangerTerms(NamedTuple):
    """What kernels need of J: danger, λ, and the model's joints, matrix (m, n)·q + shift (m,)."""

    danger: PointDanger
    weight: float
    matrix: FloatArray
    shift: FloatArray


class Densities(NamedTuple):
    """What kernels need of the cost near a path: of J, and of obstacles as `hinge_costs` does."""

    terms: DangerTerms
    carriers: IntArray
    near: FloatArray
    hinges: FloatArray


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

    def terms(self, chosen: BoolArray | None = None) -> DangerTerms:
        """Return what kernels need of the density, or of that of the danger points which are chosen (M,)."""
        coupling, weight = self.field.robot.coupling, self.weight / self.reference**2
        danger = self.field.for_kernels(chosen)
        return DangerTerms(danger, weight, np.array(coupling.matrix), np.array(coupling.offsets))


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
        samples = curve.spread(self.step)
        total = np.ones(len(samples))
        for density in self.densities:
            total += density.values(samples)
        return float(0.5 * (total[1:] + total[:-1]).mean() * curve.length)


_OBSTACLE_WEIGHT = 20.0
_STEEPNESS = 10.0
_STEP = 0.03  # [rad] between the samples at which the least clearance along a path is looked for


class ObstacleCost:
    """Obstacle cost of a radian of path, w Σ ((1 − d/D)₊² + 10 (1 − d/d₀)₊²) over pairs of link and obstacle.

    d [m] is the distance of the two, D > 0 where obstacles begin to count; d₀ ≤ D what the ends of a path allow, 0 at
    first. Exact distances cost most: their witnesses move with the links, and serve for paths near the first one.
    """

    def __init__(self, checker: CollisionChecker, distance: float) -> None:
        self.distance = number("clearance", distance, above=0.0)
        self.allowed = 0.0
        self._checker, self._distances = checker, PairDistances(checker, self.distance)

    def afresh(self, allowed: float) -> ObstacleCost:
        """Return the same for another path; `allowed` is its d₀ [m], at most D."""
        other = copy(self)
        other.allowed = max(0.0, min(self.distance, allowed))
        return other

    def clearances(self, path: FloatArray) -> tuple[float, float]:
        """Return the least clearance [m] of the ends of a path (N, n), and at samples along it; ≥ 0."""
        checker, ends = self._checker, self._distances.least(path[[0, -1]], self.distance)
        if ends == self.distance:  # only then those of all pairs are needed
            ends = PairDistances(checker, np.inf).least(path[[0, -1]], np.inf)
        ends = max(0.0, ends)
        if not 0 < ends < np.inf:
            return ends, ends
        distances = self._distances if ends <= self.distance else PairDistances(checker, ends)
        return ends, max(0.0, distances.least(Curve(checker.robot, path).spread(_STEP), ends))

    def near(self, Q: FloatArray) -> NearPairs:
        """Return what is nearer than D at `Q: (B, n)`."""
        return self._distances.near(Q, self.distance)

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the density (B,) at `Q: (B, n)`."""
        return self.near(Q).hinge_costs(Q, self.hinges)[0]

    @property
    def hinges(self) -> FloatArray:
        """D and w, and d₀ and 10 w if that counts, (1 or 2, 2)."""
        hinges = [(self.distance, _OBSTACLE_WEIGHT), (self.allowed, _STEEPNESS * _OBSTACLE_WEIGHT)]
        return np.array(hinges[: 1 + (self.allowed > 0)])


_SCAN = 0.5  # [rad] between the configurations at which all danger points are looked at
_COARSE = 0.15  # [rad] between the samples of J: thrice those of a report, a third of the work
_DOUBT = 0.02  # share by which J must differ from that of the given path for these to be enough
_SHARE = 0.85  # of the greatest danger: points that reach it somewhere matter


class ActiveSetCost:
    """J of a path for the danger points that matter near the path last looked at: others can only add to it.

    `terms` are J alone, a `model` has the obstacle cost, too; `everywhere` is the density of all danger points, and
    `ceiling` J of the first path.
    """

    def __init__(self, danger: DangerDensity, obstacles: ObstacleCost | None, path: FloatArray) -> None:
        self.everywhere, self.robot = danger, danger.field.robot
        self._obstacles = obstacles
        self._active: BoolArray | None = None
        self._near: tuple[IntArray, FloatArray] = np.zeros(0, dtype=np.intp), np.zeros((0, 10))
        self._hinges = np.zeros((0, 2)) if obstacles is None else obstacles.hinges
        self.look_at(path)
        self.ceiling, samples = path_cost(self.terms, plain(path), STEP)
        self.count(samples)

    def look_at(self, path: FloatArray, besides: FloatArray | None = None) -> bool:
        """Take the danger points that matter near a path (N, n), and besides; return whether they are others now."""
        field, (samples, _) = self.everywhere.field, spread(plain(path), _SCAN)
        if besides is not None:
            samples = np.concatenate([samples, besides])
        active = field.high_points(samples, _SHARE)
        if self._active is not None and np.array_equal(active, self._active):
            return False
        self._active, self.terms = active, self.everywhere.terms(active)
        return True

    def count(self, configurations: int) -> None:
        """Count so many evaluations of the danger."""
        self.everywhere.field.count(configurations, len(self.terms.danger.points.charges))

    def of(self, path: FloatArray) -> float:
        """Return J of an unrolled path (N, n), without obstacle cost; as in its report where that is near `ceiling`."""
        cost, samples = path_cost(self.terms, plain(path), _COARSE)
        self.count(samples)
        if abs(cost - self.ceiling) < _DOUBT * cost:
            cost, samples = path_cost(self.terms, plain(path), STEP)
            self.count(samples)
        return cost

    def anchor(self, path: FloatArray) -> None:
        """From here on take the witnesses of obstacles along a path (N, n)."""
        if self._obstacles is not None:
            near = self._obstacles.near(gauss_points(plain(path)))
            self._near = near.carriers, near.table

    def densities(self) -> Densities:
        """Return what kernels need of both costs near the path that was last anchored."""
        return Densities(self.terms, *self._near, self._hinges)

    def model(self, path: FloatArray, known: tuple[FloatArray, FloatArray] | None = None) -> QuadraticModel:
        """Return J and obstacle cost, by two Gauss points on each segment of an unrolled path (N, n).

        Length resists bending like springs, Σ f/2ℓ·‖x_{k+1} − x_k‖² with the path's mean density f. What the
        densities add is their Gauss-Newton part; so the whole is positive. Danger (B,) and its gradients (B, m) at the
        Gauss points may be `known`.
        """
        self.count(0 if known else 2 * len(path) - 2)
        nothing = np.empty(0), np.empty((0, len(self.terms.shift)))
        model: QuadraticModel = modelled(self.densities(), plain(path), *(known or nothing))
        return model


# ------------------------------------------------------------------------------------------------------------ kernels

# Of a segment Δ of length ℓ = ‖Δ‖ with nodes at the shares t_j of its way J is ℓ·mean_j f_j. With way points x_k it has
# the gradients mean f·Δ/ℓ + ℓ·mean_j t_j ∇f_j at its end and −mean f·Δ/ℓ + ℓ·mean_j (1 − t_j) ∇f_j at its start.

_OFFSET = 0.5 / sqrt(3.0)
_FIRST, _SECOND = 0.5 - _OFFSET, 0.5 + _OFFSET  # t_j: exact to the third order


@compiled
def gauss_points(path: FloatArray) -> FloatArray:
    """Return the Gauss points (2N − 2, n) of the segments of a path (N, n)."""
    out = np.empty((2 * len(path) - 2, path.shape[1]))
    for b in range(len(out)):
        t = _SECOND if b % 2 else _FIRST
        for i in range(path.shape[1]):
            out[b, i] = path[b // 2, i] + t * (path[b // 2 + 1, i] - path[b // 2, i])
    return out


@compiled
def joint_values(Q: FloatArray, matrix: FloatArray, shift: FloatArray) -> FloatArray:
    """Return matrix (m, n)·q + shift (m,) at `Q: (B, n)`."""
    out = np.empty((len(Q), len(shift)))
    for b in range(len(Q)):
        for j in range(len(shift)):
            out[b, j] = shift[j]
            for i in range(Q.shape[1]):
                out[b, j] += matrix[j, i] * Q[b, i]
    return out


@caller
def danger_at(terms: DangerTerms, Q: FloatArray, slopes: FloatArray) -> FloatArray:
    """Return the danger (B,) at `Q: (B, n)`, and write its gradients by the model's joints, (B or 0, m)."""
    tables, points, aggregate = terms.danger
    if len(points.charges) == 0:
        return np.zeros(len(Q))
    return dangers(tables, joint_values(Q, terms.matrix, terms.shift), points, aggregate, slopes)


@caller
def path_cost(terms: DangerTerms, path: FloatArray, step: float) -> tuple[float, int]:
    """Return J of an unrolled path (N, n) by the trapezoidal rule, and from how many samples [rad] apart."""
    samples, length = spread(path, step)
    danger, total = danger_at(terms, samples, np.empty((0, len(terms.shift)))), 0.0
    count = len(danger) - 1
    for k in range(count + 1):
        total += (0.5 if k == 0 or k == count else 1.0) * danger[k] ** 2
    return length * (1.0 + terms.weight * total / count), count + 1


_SPACING = 0.8  # [rad] between the samples of an edge's cost
_FEWEST, _MOST = 2, 4  # samples of an edge


@caller
def edge_costs(terms: DangerTerms, path: FloatArray, wanted: BoolArray, wraps: BoolArray) -> tuple[FloatArray, int]:
    """Return J (N, N) by the midpoint rule of edges between way points (N, n), and from how many samples.

    Of edges to earlier way points, and of those that are not `wanted: (N, N)`, it is ∞.
    """
    N, n = path.shape
    samples, costs, total = np.empty((_MOST * np.sum(wanted), n)), np.full((N, N), inf), 0
    numbers = np.zeros((N, N), np.int64)
    for a in range(N):
        for b in range(a + 1, N):
            if not wanted[a, b]:
                continue
            squares = 0.0
            for i in range(n):
                squares += way(path[a, i], path[b, i], wraps[i]) ** 2
            costs[a, b] = sqrt(squares)
            numbers[a, b] = min(_MOST, max(_FEWEST, int(np.ceil(costs[a, b] / _SPACING))))
            for s in range(numbers[a, b]):
                for i in range(n):
                    samples[total, i] = path[a, i] + (s + 0.5) / numbers[a, b] * way(path[a, i], path[b, i], wraps[i])
                total += 1
    danger, s = danger_at(terms, samples[:total], np.empty((0, len(terms.shift)))), 0
    for a in range(N):
        for b in range(a + 1, N):
            squares = 0.0
            for _ in range(numbers[a, b]):
                squares += danger[s] ** 2
                s += 1
            costs[a, b] *= 1.0 + terms.weight * squares / max(1, numbers[a, b])
    return costs, total


@caller
def at_nodes(densities: Densities, path: FloatArray, danger: FloatArray, slopes: FloatArray) -> AtNodes:
    """Return what the densities are at the Gauss points of a path (N, n); the danger may be known, with its slopes."""
    terms, nodes = densities.terms, gauss_points(path)
    values = joint_values(nodes, terms.matrix, terms.shift)
    if len(danger) == 0:
        slopes = np.zeros(values.shape)
        danger = danger_at(terms, nodes, slopes)
    near, pushes, bends = hinge_costs(
        terms.danger.tables.joints, values, densities.carriers, densities.near, densities.hinges
    )
    return AtNodes(danger, slopes, near, pushes, bends)


@compiled
def integrated(
    path: FloatArray, found: AtNodes, densities: Densities, blocks: FloatArray, beside: FloatArray
) -> tuple[float, float, FloatArray]:
    """Return the cost of a path (N, n), the part of it that obstacles are, and its gradient (N, n).

    Where there is room, about the Hessian is added to blocks (N or 0, n, n), and (N − 1 or 0, n, n) beside them.
    """
    (N, n), matrix, rate = path.shape, densities.terms.matrix, 2.0 * densities.terms.weight
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
    whole = 0.0
    for k in range(N - 1):
        whole += lengths[k]
    whole = max(whole, _TINY)
    for k in range(len(beside)):
        stiffness = total / whole / max(lengths[k], _SHORT * whole / (N - 1))
        for i in range(n):
            blocks[k, i, i] += stiffness
            blocks[k + 1, i, i] += stiffness
            beside[k, i, i] -= stiffness
    for c in range(2 * len(beside) + len(found.bends) if len(beside) > 0 else 0):
        b = c if c < 2 * len(beside) else int(densities.near[c - 2 * len(beside), 0])
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


@caller
def modelled(densities: Densities, path: FloatArray, danger: FloatArray, slopes: FloatArray) -> QuadraticModel:
    """Return the model of the cost of a path (N, n); the danger at its Gauss points may be known, with its slopes."""
    (N, n), found = path.shape, at_nodes(densities, path, danger, slopes)
    blocks, beside = np.zeros((N, n, n)), np.zeros((N - 1, n, n))
    value, near, gradient = integrated(path, found, densities, blocks, beside)
    return QuadraticModel(value, near, gradient, blocks, beside)


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
