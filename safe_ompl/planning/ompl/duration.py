"""Duration under limits and caps as an OMPL optimisation objective."""

from __future__ import annotations

from typing import Any

import numpy as np
from ompl import base as ob

from safe_ompl.common import FloatArray, positive
from safe_ompl.planning.ompl.states import StateBridge
from safe_ompl.trajectories import PathTimer

_STEP = 0.2  # [rad] between the first samples of a motion
_REFINEMENTS = 4
_CRAWL = 50.0  # where nobody allows any speed a motion takes so many times the time of its joints


class DurationObjective(ob.OptimizationObjective):  # type: ignore[misc]
    """The time that motions take under joint velocities and beside people, as a cost [s].

    A motion with the direction u costs ∫ ds/V, with V(q) the least of

    * joint velocity: min_i v_i/|u_i|,
    * people: b·τ(q), with τ the time until the first limb may be at the robot, min (d − C)/v_h − T_r over limbs and
      bodies, and the deceleration b = min_i a_i/|u_i|: a stop that begins here ends before that.

    Parameters
    ----------
    si : ob.SpaceInformation
        Its space must have the robot's joints as coordinates (see `joint_space`).
    timer : PathTimer
        Limits, and people where there are any.
    tolerance : float
        Relative error of a motion's cost.

    Raises
    ------
    InputError
        If the tolerance is not positive.

    Notes
    -----
    A bound is `motionCostHeuristic`, max_i |Δ_i|/v_i: no way between two states takes less. The cost itself is no
    bound of a trajectory's duration. Corners take time and joints must accelerate: that is left out and makes it too
    low. The path goes on while a stop lasts: so it is too low on the way towards people, too high on the way from them.
    Contact, danger, and speeds of tool and links do not count. Where people allow no speed at all it is 50 times the
    time of the joints, not infinite, so that planners find a way out. The duration of a path is what `PathTimer` says;
    `SafeSetup.plan(cost="duration")` minimises that.
    """

    def __init__(self, si: Any, timer: PathTimer, tolerance: float = 0.02) -> None:
        super().__init__(si)
        self.timer = timer
        self.tolerance = positive(tolerance, "tolerance")
        self._bridge = StateBridge(si.getStateSpace())

    def __repr__(self) -> str:
        return f"DurationObjective({self.timer!r}, tolerance={self.tolerance:g})"

    def getDescription(self) -> str:
        """Return a line about the objective."""
        return "duration within joint velocities and beside people"

    def stateCost(self, state: Any) -> Any:
        """Return the time of a radian in the slowest direction [s/rad]."""
        return ob.Cost(float(self.values(self._bridge.read(state)[None])[0]))

    def motionCost(self, start: Any, end: Any) -> Any:
        """Return the time of the straight motion [s], to within the tolerance."""
        q_start, delta, length = self._motion(start, end)
        if not length:
            return ob.Cost(0.0)
        direction = np.abs(delta) / length
        panels = 1 + int(length / _STEP)
        slowness = self._slowness(q_start + np.linspace(0, 1, panels + 1)[:, None] * delta, direction)
        integral = float(np.trapezoid(slowness)) / panels
        for _ in range(_REFINEMENTS if self.timer.distances is not None else 0):
            middles = q_start + ((np.arange(panels) + 0.5) / panels)[:, None] * delta
            refined = (integral + float(self._slowness(middles, direction).mean())) / 2
            panels *= 2
            done = abs(refined - integral) <= 3 * self.tolerance * refined
            integral = refined
            if done:
                break
        return ob.Cost(integral * length)

    def motionCostHeuristic(self, start: Any, end: Any) -> Any:
        """Return a time that no way between two states goes below [s]."""
        delta = self._motion(start, end)[1]
        return ob.Cost(float((np.abs(delta) / self.timer.limits.velocity).max(initial=0.0)))

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the time of a radian in the slowest direction (B,) at `Q: (B, n)` [s/rad]."""
        return self._slowness(Q, np.ones(Q.shape[1]))

    def _slowness(self, Q: FloatArray, direction: FloatArray) -> FloatArray:
        """Return 1/V (B,) at `Q: (B, n)` in a direction |u| (n,)."""
        limits = self.timer.limits
        free = float((direction / limits.velocity).max())
        if self.timer.distances is None:
            return np.full(len(Q), free)
        brake = 1 / float((direction / limits.acceleration).max())
        left = np.maximum(self.timer.distances.times_at(Q), 1e-12)
        found: FloatArray = np.clip(1 / (brake * left), free, _CRAWL * free)
        return found

    def _motion(self, start: Any, end: Any) -> tuple[FloatArray, FloatArray, float]:
        q_start, q_end = self._bridge.read(start), self._bridge.read(end)
        delta = self._bridge.difference(q_start, q_end)
        return q_start, delta, float(np.linalg.norm(delta))
