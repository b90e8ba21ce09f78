"""Danger as an OMPL optimisation objective, and how planners read any objective as a cost."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
from ompl import base as ob

from safe_ompl.arrays import FloatArray
from safe_ompl.models.danger import DangerField
from safe_ompl.plugins.states import ScratchState, StateBridge

_log = logging.getLogger(__name__)

_MOTION_STEP = 0.1  # [rad] between the samples of a motion's cost


class DangerObjective(ob.OptimizationObjective):  # type: ignore[misc]
    """The danger field of a robot as a cost: of a state CDF(q), of a motion ∫ CDF(q(s)) ds.

    Parameters
    ----------
    si : ob.SpaceInformation
        Its space must have the robot's joints as coordinates (see `joint_space`).
    field : DangerField
        The danger.
    """

    def __init__(self, si: Any, field: DangerField) -> None:
        super().__init__(si)
        self.field = field
        self._bridge = StateBridge(si.getStateSpace())

    def getDescription(self) -> str:
        """Return a line about the objective."""
        return "integral of the danger field (Lacevic & Rocco 2013)"

    def stateCost(self, state: Any) -> Any:
        """Return the danger at a state."""
        return ob.Cost(self.field.value(self._bridge.read(state)))

    def motionCost(self, start: Any, end: Any) -> Any:
        """Return the integral of the danger over the straight motion, by the trapezoidal rule."""
        q_start, q_end = self._bridge.read(start), self._bridge.read(end)
        delta = self._bridge.difference(q_start, q_end)
        length = float(np.linalg.norm(delta))
        t = np.linspace(0.0, 1.0, 2 + int(length / _MOTION_STEP))
        return ob.Cost(float(np.trapezoid(self.values(q_start + t[:, None] * delta), t)) * length)

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the danger (B,) at a batch of configurations `Q: (B, n)`."""
        return self.field.values(Q)

    def values_and_gradients(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the danger (B,) and its C-space gradients (B, n) at `Q: (B, n)`."""
        return self.field.values_and_gradients(Q)


class StateCost:
    """The cost of configurations as planners read it from a problem's objective.

    Objectives that answer batches (`values(Q)`, as `DangerObjective` does) are asked for batches; any other
    `ob.OptimizationObjective` is asked state by state. Without an objective, or with path length, every
    configuration costs nothing and planning is classical.

    Parameters
    ----------
    objective : ob.OptimizationObjective or None
        The problem's objective.
    bridge : StateBridge
        The space.
    """

    def __init__(self, objective: Any, bridge: StateBridge) -> None:
        self._objective = objective
        self._bridge = bridge
        self._scratch = ScratchState(bridge)
        self.is_zero = objective is None or isinstance(objective, ob.PathLengthOptimizationObjective)

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the cost (B,) of configurations `Q: (B, n)`."""
        if self.is_zero:
            return np.zeros(len(Q))
        if hasattr(self._objective, "values"):
            return np.asarray(self._objective.values(Q), dtype=np.float64)
        return np.array([self._objective.stateCost(self._scratch.set(q)).value() for q in Q])

    @property
    def has_gradients(self) -> bool:
        """Whether the objective offers exact gradients (`values_and_gradients(Q)`)."""
        return not self.is_zero and hasattr(self._objective, "values_and_gradients")

    def value_and_gradient(self, q: FloatArray) -> tuple[float, FloatArray]:
        """Return the cost and its exact gradient (n,) at `q: (n,)`; only where `has_gradients`."""
        values, gradients = self._objective.values_and_gradients(q[None])
        return float(values[0]), gradients[0]

    def gradient_norms(self, Q: FloatArray) -> FloatArray:
        """Return ‖∇c‖ (B,) at `Q: (B, n)`: exact where the objective offers gradients, else by central differences."""
        if self.is_zero:
            return np.zeros(len(Q))
        if self.has_gradients:
            gradients = self._objective.values_and_gradients(Q)[1]
        else:
            step = 1e-5 * np.eye(self._bridge.n)
            rises = [(self.values(Q + h) - self.values(Q - h)) / 2e-5 for h in step]
            gradients = np.stack(rises, axis=1)
        norms: FloatArray = np.linalg.norm(gradients, axis=1)
        return norms
