"""What a path costs by the danger points and obstacles near it: all that a descent has to look at."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.paths.simplify.cost import DangerDensity, PathCost
from safe_ompl.paths.simplify.division import divided, path_length
from safe_ompl.paths.simplify.nearness import NearnessDensity

_SCAN = 0.15  # [rad] between the configurations at which all danger points are looked at
_SHARE = 0.85  # of the greatest danger: points that reach it somewhere matter


class NearbyCost:
    """J of a path, and nearness, for the danger points that matter near the path that was last looked at.

    Paths that have moved far may be near other danger points: these can only add to what is said here.

    Parameters
    ----------
    danger : DangerDensity
        Of all danger points.
    nearness : NearnessDensity or None
        None where nearness does not count.
    path : ndarray, shape (N, n)
        What to look at first.

    Attributes
    ----------
    danger : PathCost
        J = ∫ (1 + λ·CDFᵖ) ds.
    total : PathCost
        With nearness, whose witnesses are those of the path that was last anchored.
    """

    def __init__(self, danger: DangerDensity, nearness: NearnessDensity | None, path: FloatArray) -> None:
        self._everywhere = danger
        self._nearness = nearness
        self.look_at(path)

    def look_at(self, path: FloatArray, besides: FloatArray | None = None) -> None:
        """Take the danger points that matter near a path (N, n), and at some configurations (B, n) besides."""
        samples = divided(path, _SCAN)
        if besides is not None:
            samples = np.concatenate([samples, besides])
        robot = self._everywhere.field.robot
        danger = self._everywhere.restricted(self._everywhere.field.active(samples, _SHARE))
        self.danger = PathCost(robot, [danger])
        self.total = PathCost(robot, [danger, *([] if self._nearness is None else [self._nearness])])

    def of(self, path: FloatArray) -> float:
        """Return J of a path (N, n), without nearness."""
        return self.danger.of(path)

    def level(self, path: FloatArray) -> float:
        """Return what a path (N, n) costs, nearness included; it is anchored then."""
        if self._nearness is None:
            return self.of(path)
        self.anchor(path)
        nearness = PathCost(self.total.robot, [self._nearness]).value_and_gradient(path)[0]
        return self.of(path) + nearness - path_length(path)

    def anchor(self, path: FloatArray) -> None:
        """From here on take the witnesses of nearness along a path (N, n)."""
        if self._nearness is not None:
            self._nearness.anchor(self.total.nodes(path))
