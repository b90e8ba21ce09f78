"""The obstacle cost of a path: hinges of the distances between links and obstacles, as in CHOMP and TrajOpt.

A danger field of centre lines does not see a finger's width; this does.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from safe_ompl.collision import CollisionChecker, PairDistances, Proximity, Witnesses
from safe_ompl.common import BoolArray, FloatArray, number
from safe_ompl.paths.measures import Curve
from safe_ompl.paths.simplify.cost import DangerDensity, Expansion, PathCost, QuadraticModel
from safe_ompl.paths.simplify.edges import divided, path_length

OBSTACLE_WEIGHT = 20.0
_STEEPNESS = 10.0
_STEP = 0.03  # [rad] between the samples at which the least clearance along a path is looked for


class ObstacleCost:
    """Obstacle cost of a radian of path, w Σ ((1 − d/D)₊² + 10 (1 − d/d₀)₊²) over pairs of link and obstacle.

    d is the distance of the two, D where obstacles begin to count; d₀ ≤ D what the ends of a path allow: where these
    are near an obstacle themselves, the path between them shall at least not come nearer.

    Exact distances cost more than all else. While a path descends, `anchor` keeps their witnesses, and these move with
    the links until it is anchored again.

    Parameters
    ----------
    checker : CollisionChecker
        Robot and scene.
    distance : float
        D [m], > 0
    weight : float
        w > 0, the cost of a radian of path at which one pair touches and d₀ = 0.

    Attributes
    ----------
    allowed : float
        d₀ [m], ≥ 0; 0 at first.

    Raises
    ------
    InputError
        If a number is out of range.
    """

    def __init__(self, checker: CollisionChecker, distance: float, weight: float = OBSTACLE_WEIGHT) -> None:
        self.distance = number("clearance", distance, above=0.0)
        self.weight = number("weight of clearance", weight, above=0.0)
        self.allowed = 0.0
        self._proximity = Proximity(checker, self.distance)
        self._anchored: Witnesses | None = None

    def __repr__(self) -> str:
        return f"ObstacleCost({self._proximity.checker!r}, {self.distance:g}, {self.weight:g})"

    def afresh(self, allowed: float) -> ObstacleCost:
        """Return the same for another path, without witnesses; `allowed` is its d₀ [m], at most D."""
        other = copy(self)
        other._anchored = None
        other.allow(allowed)
        return other

    def allow(self, distance: float) -> None:
        """Set d₀ to a distance [m], no larger than D."""
        self.allowed = max(0.0, min(self.distance, distance))

    def clearances(self, path: FloatArray) -> tuple[float, float]:
        """Return the least clearance [m] of the ends of a path (N, n), and at samples along it; ≥ 0."""
        checker = self._proximity.checker
        ends = least = max(0.0, min(checker.clearance(q).distance for q in path[[0, -1]]))
        if not 0 < ends < np.inf:
            return ends, ends
        distances = self._proximity.distances if ends <= self.distance else PairDistances(checker, ends)
        curve = Curve(checker.robot, path)
        samples = curve.at(np.linspace(0.0, curve.length, 2 + int(curve.length / _STEP)))
        return ends, max(0.0, distances.least(samples, least))

    def near(self, Q: FloatArray) -> BoolArray:
        """Return whether anything is nearer than D (B,) at `Q: (B, n)`."""
        return self._proximity.near(Q)

    def anchor(self, Q: FloatArray) -> None:
        """From here on take the witnesses at `Q: (B, n)` for those at B configurations near these."""
        self._anchored = self._proximity.witnesses(Q)

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the density (B,) at `Q: (B, n)`."""
        return self.values_and_gradients(Q)[0]

    def values_and_gradients(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the density (B,) and its gradients (B, n) at `Q: (B, n)`."""
        return self.expansion(Q)[:2]

    def expansion(self, Q: FloatArray) -> Expansion:
        """Return the density and its derivatives at `Q: (B, n)`, the second ones by Gauss-Newton."""
        witnesses = self._proximity.witnesses(Q) if self._anchored is None else self._anchored
        hinges = [(self.distance, self.weight)]
        if self.allowed > 0:
            hinges.append((self.allowed, _STEEPNESS * self.weight))
        values, gradients, bends = witnesses.hinge_costs(Q, np.array(hinges))
        return Expansion(values, gradients, witnesses.rows, bends)


_SCAN = 0.5  # [rad] between the configurations at which all danger points are looked at
_SHARE = 0.85  # of the greatest danger: points that reach it somewhere matter


class ActiveSetCost:
    """J of a path, and its obstacle cost, for the danger points that matter near the path that was last looked at.

    Paths that have moved far may be near other danger points: these can only add to what is said here.

    Parameters
    ----------
    danger : DangerDensity
        Of all danger points.
    obstacles : ObstacleCost or None
        None where distances to obstacles do not count.
    path : ndarray, shape (N, n)
        What to look at first.

    Attributes
    ----------
    everywhere : DangerDensity
        Of all danger points.
    danger : PathCost
        J = ∫ (1 + λ·CDFᵖ) ds.
    total : PathCost
        With the obstacle cost, whose witnesses are those of the path that was last anchored.
    """

    def __init__(self, danger: DangerDensity, obstacles: ObstacleCost | None, path: FloatArray) -> None:
        self.everywhere = danger
        self._obstacles = obstacles
        self.look_at(path)

    def look_at(self, path: FloatArray, besides: FloatArray | None = None) -> None:
        """Take the danger points that matter near a path (N, n), and at some configurations (B, n) besides."""
        samples = divided(path, _SCAN)
        if besides is not None:
            samples = np.concatenate([samples, besides])
        robot = self.everywhere.field.robot
        danger = self.everywhere.restricted(self.everywhere.field.active(samples, _SHARE))
        self.danger = PathCost(robot, [danger])
        self.total = PathCost(robot, [danger, *([] if self._obstacles is None else [self._obstacles])])

    def of(self, path: FloatArray) -> float:
        """Return J of a path (N, n), without obstacle cost."""
        return self.danger.of(path)

    def near(self, path: FloatArray) -> float:
        """Return the obstacle cost of a path (N, n); it is anchored then."""
        if self._obstacles is None:
            return 0.0
        self.anchor(path)
        lone = PathCost(self.total.robot, [self._obstacles])
        return lone.value_and_gradient(path)[0] - path_length(path)

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
