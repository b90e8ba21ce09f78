"""The cost functional of a path: length, and densities such as danger along it; with the exact gradient."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from safe_ompl.collision import CollisionChecker, MotionProver, NearPairs, PairDistances
from safe_ompl.common import BoolArray, FloatArray, IntArray, number
from safe_ompl.danger import DangerField
from safe_ompl.planning.simplification.costs import DangerTerms, Densities, QuadraticModel, gauss_points, spread
from safe_ompl.planning.simplification.measures import Curve
from safe_ompl.robot import Robot, plain

STEP = 0.05  # [rad] between the samples of the cost of a path, as in its report
WEIGHT = 5.0  # of danger against length
_REFERENCE_SAMPLES = 64


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
        """Return the density, or that of the danger points which are chosen (M,), for compiled code."""
        coupling, weight = self.field.robot.coupling, self.weight / self.reference**2
        return DangerTerms(self.field.point_danger(chosen), weight, coupling.matrix, coupling.offsets)


def reference_danger(field: DangerField, checker: CollisionChecker) -> float:
    """Return the median danger over valid configurations, the scale of robot and scene; 1 if nothing is dangerous."""
    robot, rng = checker.robot, np.random.default_rng(0)  # the same scale at any time
    samples = rng.uniform(robot.lower, robot.upper, (_REFERENCE_SAMPLES, robot.n))
    valid = samples[MotionProver(checker).are_free(samples, samples)]
    danger = np.sort(field.values(valid if len(valid) else samples))
    # The median without NumPy's function, whose first call imports masked arrays, 20 ms of a start.
    return 0.5 * float(danger[(len(danger) - 1) // 2] + danger[len(danger) // 2]) or 1.0


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
        self.ceiling, samples = self.terms.path_cost(plain(path), STEP)
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
        self.everywhere.field.count(configurations, len(self.terms.danger.points))

    def of(self, path: FloatArray) -> float:
        """Return J of an unrolled path (N, n), without obstacle cost; as in its report where that is near `ceiling`."""
        cost, samples = self.terms.path_cost(plain(path), _COARSE)
        self.count(samples)
        if abs(cost - self.ceiling) < _DOUBT * cost:
            cost, samples = self.terms.path_cost(plain(path), STEP)
            self.count(samples)
        return cost

    def anchor(self, path: FloatArray) -> None:
        """From here on take the witnesses of obstacles along a path (N, n)."""
        if self._obstacles is not None:
            near = self._obstacles.near(gauss_points(plain(path)))
            self._near = near.carriers, near.table

    def densities(self) -> Densities:
        """Return both costs near the path that was last anchored, for compiled code."""
        return Densities(self.terms, *self._near, self._hinges)

    def model(self, path: FloatArray, known: tuple[FloatArray, FloatArray] | None = None) -> QuadraticModel:
        """Return the model of J and obstacle cost near an unrolled path (N, n); see `Densities.model`.

        Danger (B,) and its gradients (B, m) at the Gauss points may be `known`.
        """
        self.count(0 if known else 2 * len(path) - 2)
        return self.densities().model(plain(path), *(known or ()))
