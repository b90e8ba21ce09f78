"""The danger of configurations as a planner weighs it against lengths."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.planners.parts.task import Task
from safe_ompl.plugins.objective import StateCost


class WeightedDanger:
    """The cost of a task and its weight α in a planner's decisions, in the robot's own scale.

    Parameters
    ----------
    task : Task
        The problem.

    Attributes
    ----------
    alpha : float
        α; 0 plans classically.
    is_raw : bool
        Whether α multiplies the danger as it is, in length per danger, as the paper writes it; else in the robot's
        own scale, the usual slope of the danger.
    heed : float
        In [0, 1]: how much of α counts now, see `Patience`.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self.alpha = 1.0
        self.is_raw = False
        self.heed = 1.0

    @property
    def cost(self) -> StateCost:
        """The cost of configurations."""
        return self._task.cost

    @property
    def slope(self) -> float:
        """The usual slope of the danger [danger/rad]; 0 where there is none."""
        return self._task.slope

    @property
    def weight(self) -> float:
        """α in units of length per danger; 0 where there is no danger to heed."""
        alpha = self.alpha * self.heed
        if not alpha:  # the slope need not be known
            return 0.0
        if self.is_raw:
            return alpha
        return alpha / self.slope if self.slope else 0.0

    def in_metres(self, costs: FloatArray, rates: FloatArray) -> FloatArray:
        """Return dangers (K,) as lengths [m]: by their usual slope, and on a logarithmic scale; 0 without a scale.

        Parameters
        ----------
        costs : ndarray, shape (K,)
            Dangers.
        rates : ndarray, shape (n,)
            How far a unit of each joint moves the arm [m/rad].
        """
        usual, slope = self._task.cost.usual_value, self._task.slope
        if not (usual > 0 and slope > 0):
            return costs * 0.0
        metres = float(np.sqrt(np.mean(rates**2))) / slope
        scaled: FloatArray = metres * usual * np.log1p(costs / usual)
        return scaled

    def prepare(self) -> None:
        """Measure the slope if it will be needed, so that planning need not."""
        if self.alpha and not self.is_raw:
            _ = self._task.slope
