"""The cost of a path by its active set: the danger points that can be the most dangerous near it, and obstacles."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.paths.simplify.cost import DangerDensity, PathCost, QuadraticModel
from safe_ompl.paths.simplify.obstacle_cost import ObstacleCost
from safe_ompl.paths.simplify.resampling import divided, path_length

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
