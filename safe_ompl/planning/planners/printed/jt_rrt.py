"""SAFE_JT-RRT as printed, and the classical JT-RRT."""

from __future__ import annotations

from typing import Any

import numpy as np

from safe_ompl.common import FloatArray
from safe_ompl.danger import DangerField
from safe_ompl.planning.ompl import WorkspaceGoal
from safe_ompl.planning.planners.base import SafePlanner
from safe_ompl.planning.planners.parameters import Parameter
from safe_ompl.planning.planners.parts.extend import Extension, straight_extension
from safe_ompl.planning.planners.parts.goal_step import STALLED, Approach
from safe_ompl.planning.planners.parts.tree import Trees


class PaperSafeJTRRT(SafePlanner):
    """SAFE_JT-RRT as it is printed in [1], §4.3; with Jᵀ and α = 0 the classical `PaperJTRRT` [2].

    A step towards the goal is Δq = k₂ [J†Δx + (I − J†J)Δq₀] with Δq₀ = k₁ Σ_j Σ_i J_ijᵀ CDF(r_j), summed over all
    danger points r_j and, as in the paper's own runs, the distal ends of all links. Where the print leaves something
    open or misleads it is read so: Jᵀ in the step is J†; the loop `while 1` ends without progress; steps are bounded
    and kept within the joint limits; a node from which a step was tried counts as chosen before, and where all are,
    an extension is random; the vectors CDF carry the weights of their danger points.

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013.
    .. [2] M. Vande Weghe, D. Ferguson, S. Srinivasa: Randomized path planning for redundant manipulators
       without inverse kinematics. Humanoids 2007.
    """

    plans_to = WorkspaceGoal

    alpha = Parameter(1.0, "Weight of danger α, as length per danger, in rad and in metres alike.")
    goal_bias = Parameter(0.05, "p_g: share of the extensions towards the goal.", at_most=1)
    step = Parameter(0.1, "Largest length of a step towards the goal.", unit="rad", above=0)
    gain = Parameter(0.1, "k₂: gain of a step towards the goal.", above=0)
    null_space_gain = Parameter(
        1.0,
        """k₁: gain of the posture motion. The more danger points, the smaller it must be: a thousandth serves the
        paper's scenes.""",
    )
    danger_threshold = Parameter(
        np.inf, "CDF_Threshold: danger from which on a step towards the goal is refused.", above=0
    )
    transpose = Parameter(False, "Whether the step is k₂JᵀΔx, as in the classical JT-RRT.")

    def _make_parts(self) -> None:
        self._goal: Any = None
        self._approach: Approach

    def _search(self, ptc: Any) -> FloatArray | None:
        """SAFE_JT-RRT."""
        while self._approach.arrived is None and not ptc():  # WS_DISTANCE(Q, x_g) ≥ D_Threshold
            if self._rng.random() < self.goal_bias:
                self._extend_towards_goal(ptc)
            else:
                self._extend_randomly()
        return None if self._approach.arrived is None else self._approach.tree.branch(self._approach.arrived)

    def _extend_towards_goal(self, ptc: Any) -> None:
        """EXTEND_TOWARDS_GOAL."""
        approach, tree = self._approach, self._approach.tree
        old = approach.best(self.alpha, 0.0, self._rng)
        if old is None:
            self._extend_randomly()
            return
        while True:
            q_old = tree.configurations[old]
            q_new = self._bridge.inside(q_old + self._displacement(q_old))
            if self._goal.place.distance(q_new) > STALLED * approach.distances[old]:
                return
            if not (self._problem.motion_is_free(q_old, q_new) and self._is_below_threshold(q_new)):
                return
            old = approach.trees.add(tree, q_new, old)
            approach.measure()
            if approach.arrived is not None or ptc():
                return

    def _extend_randomly(self) -> None:
        """EXTEND_RANDOMLY."""
        q_rand = self._problem.random_configuration(self._rng)
        approach, tree = self._approach, self._approach.tree
        old = tree.best(q_rand, self.alpha)
        outcome, new = straight_extension(self._problem, approach.trees, tree, old, q_rand, self.getRange())
        if outcome is not Extension.TRAPPED:
            approach.measure()
            approach.untried.append(new)

    def _displacement(self, q: FloatArray) -> FloatArray:
        """Return Δq (n,) at `q: (n,)`, shortened to the largest step."""
        place, field = self._goal.place, self._field
        jacobian, error = place.jacobian(q), place.error(q)
        if self.transpose:
            step: FloatArray = self.gain * (jacobian.T @ error)
        else:
            inverse = np.linalg.pinv(jacobian)
            step = inverse @ error
            if self.null_space_gain and field is not None:
                posture = self.null_space_gain * field.push(q)
                if np.isfinite(posture).all():  # on a danger point the field is infinite
                    step += posture - inverse @ (jacobian @ posture)
            step = self.gain * step
        length = float(np.sqrt(step @ step))
        return step * (self.step / length) if length > self.step else step

    def _is_below_threshold(self, q: FloatArray) -> bool:
        """Return whether ‖CDF(q)‖ < CDF_Threshold."""
        level = self.danger_threshold
        return bool(np.isinf(level) or self._problem.cost.values(q[None])[0] < level)

    @property
    def _field(self) -> DangerField | None:
        field = getattr(self.getProblemDefinition().getOptimizationObjective(), "field", None)
        return field if isinstance(field, DangerField) else None

    def _take_goals(self, ptc: Any) -> None:
        """Take the place from the problem; the tree stays, and all of its nodes may be tried for another place."""
        goal = self.getProblemDefinition().getGoal()
        if goal is not self._goal:
            self._goal, self._approach = goal, Approach(self._approach.trees, goal)
        self._approach.take_new()

    @property
    def _structure(self) -> Approach:
        return self._approach

    def _forget(self) -> None:
        self._approach = Approach(Trees(self._bridge, self._problem.cost, self.counts), self._goal)
