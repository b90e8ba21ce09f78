"""The cost functional of a path: its length, and integrals of densities such as danger, with exact gradients."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from safe_ompl.collision import CollisionChecker, MotionProver, NearPairs, PairDistances
from safe_ompl.common import BoolArray, FloatArray, number, uniform_shares
from safe_ompl.danger import DangerField
from safe_ompl.planning.simplification.costs import DangerTerms
from safe_ompl.planning.simplification.measures import Curve
from safe_ompl.robot import Robot

# The distance between the samples of the cost of a path, as in its report.
STEP = 0.05  # [rad]
WEIGHT = 5.0  # of danger against length
_REFERENCE_SAMPLES = 64


class DangerDensity:
    """Danger cost per radian, λ·CDF(q)² with λ = weight/reference(CDF)², so that one weight ≥ 0 fits all scenes."""

    def __init__(self, field: DangerField, reference: float, weight: float = WEIGHT) -> None:
        self.field = field
        self.reference = number("reference", reference, above=0.0)
        self.weight = number("weight", weight, at_least=0.0)

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the density (B,) at `Q: (B, n)`."""
        density: FloatArray = self.weight * (self.field.values(Q) / self.reference) ** 2
        return density

    def terms(self, chosen: BoolArray | None = None) -> DangerTerms:
        """Return the density, of all danger points or of the `chosen` ones (M,), in the form of the Cython kernels."""
        coupling, weight = self.field.robot.coupling, self.weight / self.reference**2
        return DangerTerms(self.field.point_danger(chosen), weight, coupling.matrix, coupling.offsets)


def reference_danger(field: DangerField, checker: CollisionChecker) -> float:
    """Return the median danger over valid configurations of robot and scene; 1 if the median is 0."""
    robot = checker.robot
    samples = robot.lower + (robot.upper - robot.lower) * uniform_shares(_REFERENCE_SAMPLES, robot.n)
    valid = samples[MotionProver(checker).are_free(samples, samples)]
    danger = np.sort(field.values(valid if len(valid) else samples))
    # The first call of `np.median` would import masked arrays, which takes 20 ms.
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
# The distance between the samples at which the least clearance along a path is searched.
_CLEARANCE_SAMPLE_DISTANCE = 0.03  # [rad]


class ObstacleCost:
    """Obstacle cost per radian of path, w Σ ((1 − d/D)₊² + 10 (1 − d/d₀)₊²) over pairs of link and obstacle.

    d [m] is the distance of a pair, and D > 0 the distance below which obstacles count. d₀ ≤ D depends on the clearance
    of the path's ends, and is 0 at first. Exact distances take most of the time. Therefore their witness points are
    kept, move with the links, and are used again for paths near the first one.
    """

    def __init__(self, checker: CollisionChecker, distance: float) -> None:
        self.distance = number("clearance", distance, above=0.0)
        self.allowed = 0.0
        self._checker, self._distances = checker, PairDistances(checker, self.distance)

    def afresh(self, allowed: float) -> ObstacleCost:
        """Return the obstacle cost for another path; `allowed` is its d₀ [m], which is limited to D."""
        other = copy(self)
        other.allowed = max(0.0, min(self.distance, allowed))
        return other

    def clearances(self, path: FloatArray) -> tuple[float, float]:
        """Return the least clearance [m] of the ends of a path (N, n), and at samples along it; ≥ 0."""
        checker, ends = self._checker, self._distances.least(path[[0, -1]], self.distance)
        # The distances of pairs beyond D are needed only in this case.
        if ends == self.distance:
            ends = PairDistances(checker, np.inf).least(path[[0, -1]], np.inf)
        ends = max(0.0, ends)
        if not 0 < ends < np.inf:
            return ends, ends
        distances = self._distances if ends <= self.distance else PairDistances(checker, ends)
        return ends, max(0.0, distances.least(Curve(checker.robot, path).spread(_CLEARANCE_SAMPLE_DISTANCE), ends))

    def near(self, Q: FloatArray) -> NearPairs:
        """Return the pairs of link and obstacle that are nearer than D at `Q: (B, n)`."""
        return self._distances.near(Q, self.distance)

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the density (B,) at `Q: (B, n)`."""
        return self.near(Q).hinge_costs(Q, self.hinges)[0]

    @property
    def hinges(self) -> FloatArray:
        """The distances [m] and weights of the hinge costs (1 or 2, 2): D and w, and if d₀ > 0 also d₀ and 10 w."""
        hinges = [(self.distance, _OBSTACLE_WEIGHT), (self.allowed, _STEEPNESS * _OBSTACLE_WEIGHT)]
        return np.array(hinges[: 1 + (self.allowed > 0)])
