"""The joint step towards a goal in the workspace, in our form and with the paper's own gains."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.danger.field import DangerField
from safe_ompl.planners.parts.task import Task
from safe_ompl.planners.parts.tree import Tree
from safe_ompl.robot.inverse_kinematics import (
    Place,
    StepLimits,
    limited_step,
    pseudoinverse_step,
    transpose_step,
)


def printed_step(
    place: Place, q: FloatArray, k1: float, k2: float, field: DangerField | None, *, transpose: bool = False
) -> FloatArray:
    """Return Δq (n,) of EXTEND_TOWARDS_GOAL, k₂ [J†Δx + (I − J†J)Δq₀], with Δq₀ = k₁ Σ_j Σ_i J_ijᵀ CDF(r_j).

    J† is the pseudoinverse, without damping; where the paper prints Jᵀ in its place, its text says J†. The sum goes
    over all danger points and, as in the paper's own runs, the distal ends of all links.

    Parameters
    ----------
    place : Place
        Where the tip is to go.
    q : ndarray, shape (n,)
        q_old [rad or m].
    k1, k2 : float
        Gains.
    field : DangerField or None
        Gives the vectors CDF(r_j), eq. (8); without it there is no posture motion.
    transpose : bool
        Return k₂ JᵀΔx instead, as the classical JT-RRT.
    """
    jacobian, error = place.jacobian(q), place.error(q)
    if transpose:
        step: FloatArray = k2 * (jacobian.T @ error)
        return step
    inverse = np.linalg.pinv(jacobian)
    step = inverse @ error
    if k1 and field is not None:
        posture = k1 * field.push(q)
        if np.isfinite(posture).all():  # on a danger point the field is infinite
            step += posture - inverse @ (jacobian @ posture)
    return k2 * step


def shortened(step: FloatArray, largest: float) -> FloatArray:
    """Return a step (n,), shortened to a norm of `largest` if it is longer [rad or m]."""
    length = float(np.sqrt(step @ step))
    return step * (largest / length) if length > largest else step


class GoalStep:
    """The step of EXTEND_TOWARDS_GOAL from a node of a tree, in our form or as printed.

    Parameters
    ----------
    task : Task
        Gives the danger.

    Attributes
    ----------
    largest : float
        Largest length of a step [rad].
    null_space_gain, gain : float
        k₁ and k₂; the latter acts where the gains are raw.
    transpose : bool
        Take Jᵀ in place of J†, and leave the null space alone.
    has_raw_gains : bool
        Whether the gains are taken as they are, as printed.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self.largest = self.gain = 0.1
        self.null_space_gain = 1.0
        self.transpose = self.has_raw_gains = False
        self._place: Place
        self._limits: StepLimits

    def aim(self, place: Place) -> None:
        """Turn to another place of the tip."""
        self._place, self._limits = place, StepLimits.of_motion(place.robot)

    def at(self, q: FloatArray, distance: float, downhill: FloatArray | None) -> FloatArray:
        """Return Δq = k₂ [J†Δx + (I − J†J)Δq₀] at `q: (n,)`, classical JᵀΔx, no longer than the largest step.

        Δq₀ goes along `downhill`, and to zero together with the `distance` that the tip has left, or the tip would not
        come to rest: motions in the null space move it to second order.
        """
        rule = transpose_step if self.transpose else pseudoinverse_step
        posture = None if downhill is None else self.null_space_gain * distance / self._place.lever * downhill
        return limited_step(rule, self._place, q, self._limits, self.largest, posture)

    def printed(self, q: FloatArray, field: DangerField | None) -> FloatArray:
        """Return Δq (n,) at `q: (n,)` with the paper's own gains, no longer than the largest step."""
        gains = self.null_space_gain, self.gain
        return shortened(printed_step(self._place, q, *gains, field, transpose=self.transpose), self.largest)

    def downhill(self, tree: Tree, node: int) -> FloatArray | None:
        """Return the direction (n,) in which the danger falls at a node, short if it hardly does.

        None where there is nothing to gain: no null space, no danger, or no gain k₁.
        """
        if self.transpose or not (self.null_space_gain and self._place.redundancy):
            return None
        if not (self._task.cost.has_gradients and self._task.slope):
            return None
        slope = tree.gradient(node) / self._task.slope
        steepness = float(np.sqrt(slope @ slope))
        return -slope / max(1.0, steepness) if steepness < np.inf else None
