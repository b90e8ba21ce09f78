"""SafeJTRRT: a tree that grows towards a place of the tip along the arm's Jacobian."""

from __future__ import annotations

import logging
from heapq import heapify, heappop, heappush
from itertools import count
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.errors import InputError
from safe_ompl.planners.base import fraction, non_negative
from safe_ompl.planners.parts.growing import Extension
from safe_ompl.planners.parts.rrt import SafeRRT
from safe_ompl.plugins.goals import WorkspaceGoal
from safe_ompl.robot.kinematics import Place, StepLimits, limited_step, pseudoinverse_step, transpose_step

_log = logging.getLogger(__name__)

_STALLED = 0.995  # a step that leaves more than this share of the distance makes no progress
_AT_RANDOM = 0.3  # share of the starts towards the goal from any node: the best may lie in one dead end
_SAME_SLOPE = 4  # steps for which the gradient of the danger, the dearest part of a step, is kept


class SafeJTRRT(SafeRRT):
    """One tree from the start that grows towards a place of the tip, a goal in the workspace (SAFE_JT-RRT).

    Some extensions go towards a random configuration, as in SafeRRTConnect. The others start from a safe node
    near the goal and follow the pseudoinverse of the arm's Jacobian, which brings the tip straight there;
    what freedom that leaves to the arm, its null space, turns the links away from danger. The goal must be a
    `WorkspaceGoal`; no inverse kinematics is needed.

    Parameters
    ----------
    si : ob.SpaceInformation
        Its space must have the robot's joints as coordinates (see `joint_space`).
    name : str
        Name in logs and benchmarks.
    range, alpha, nearest_fraction, slide, threshold_rise
        Of the random extensions, as for `SafeRRTConnect`. α also weighs the danger in the choice of the node
        from which to go to the goal; there the distance is the tip's, and a radian counts as many metres as
        it typically moves the tip (`Place.lever`).
    step : float
        Largest length ‖Δq‖ of one step towards the goal [rad]. It takes the place of the paper's gain k₂: far
        from the goal all steps are this long, near it they are the pseudoinverse's own.
    goal_bias : float
        p_g: share of the extensions that go towards the goal. More is faster, less is safer.
    null_space_gain : float
        k₁: length of the posture motion Δq₀ in terms of the motion that the tip's way needs. It goes down the
        gradient of the danger, Δq₀ ∝ −∇CDF: the paper's Σ Jᵀ CDF, with the share of every link in the field.
        It needs an objective with gradients (`DangerObjective`).
    danger_threshold : float
        CDF_Threshold: nodes as dangerous as this, in the field's units, are not added, unless they are safer
        than the node that they grow from (a start may be in danger). Infinite by default.
    transpose : bool
        Take Jᵀ in place of J† and leave the null space alone. With α = 0 this is the classical JT-RRT [2].

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.3.
    .. [2] M. Vande Weghe, D. Ferguson, S. Srinivasa: Randomized path planning for redundant manipulators
       without inverse kinematics. Humanoids 2007.
    """

    def __init__(
        self,
        si: Any,
        name: str = "SafeJTRRT",
        *,
        range: float = 0.0,
        alpha: float = 1.0,
        nearest_fraction: float = 0.1,
        slide: float = 0.8,
        threshold_rise: float = 0.05,
        step: float = 0.1,
        goal_bias: float = 0.05,
        null_space_gain: float = 1.0,
        danger_threshold: float = np.inf,
        transpose: bool = False,
    ) -> None:
        self._goal: Any = None
        self._place: Place
        self._limits: StepLimits
        self._arrived: int | None = None  # the first node at the goal
        super().__init__(si, name)
        self.setRange(range)
        self.setAlpha(alpha)
        self.setNearestFraction(nearest_fraction)
        self.setSlide(slide)
        self.setThresholdRise(threshold_rise)
        self.setStep(step)
        self.setGoalBias(goal_bias)
        self.setNullSpaceGain(null_space_gain)
        self.setDangerThreshold(danger_threshold)
        self.setTranspose(transpose)

    def setStep(self, step: float) -> None:
        """Set the largest length of one step towards the goal [rad]."""
        if not non_negative("step", step) > 0:
            raise InputError(f"step must be positive, got {step!r}")
        self._step = float(step)

    def getStep(self) -> float:
        """Return the largest length of one step towards the goal [rad]."""
        return self._step

    def setGoalBias(self, share: float) -> None:
        """Set the share p_g in [0, 1] of extensions towards the goal."""
        self._goal_bias = fraction("goal_bias", share)

    def getGoalBias(self) -> float:
        """Return the share p_g of extensions towards the goal."""
        return self._goal_bias

    def setNullSpaceGain(self, k1: float) -> None:
        """Set the gain k₁ of the posture motion; 0 leaves the posture alone."""
        self._null_space_gain = non_negative("null_space_gain", k1)

    def getNullSpaceGain(self) -> float:
        """Return the gain k₁ of the posture motion."""
        return self._null_space_gain

    def setDangerThreshold(self, danger: float) -> None:
        """Set the danger from which on no node is added; `math.inf` for none."""
        if not (isinstance(danger, (int, float, np.number)) and danger > 0):
            raise InputError(f"danger_threshold must be positive, got {danger!r}")
        self._danger_threshold = float(danger)

    def getDangerThreshold(self) -> float:
        """Return the danger from which on no node is added."""
        return self._danger_threshold

    def setTranspose(self, transpose: bool) -> None:
        """Set whether to take Jᵀ in place of J†, without posture motion."""
        self._transpose = bool(transpose)

    def getTranspose(self) -> bool:
        """Return whether Jᵀ takes the place of J†."""
        return self._transpose

    # ------------------------------------------------------------------------------- the paper's pseudocode

    def _search(self, ptc: Any) -> FloatArray | None:
        while self._arrived is None and not ptc():  # WS_DISTANCE(Q, x_g) ≥ D_Threshold
            if self._rng.random() < self._goal_bias:
                self._extend_towards_goal(ptc)
            else:
                self._extend_randomly()
        return None if self._arrived is None else self._start_tree.branch(self._arrived)

    def _extend_towards_goal(self, ptc: Any) -> None:
        """EXTEND_TOWARDS_GOAL: from the best node not chosen before, step by step as long as it goes well."""
        old = self._best_for_goal()
        if old is None:
            self._extend_randomly()
            return
        for k in count():
            if k % _SAME_SLOPE == 0:
                downhill = self._downhill(old)
            q_old = self._start_tree.configurations[old]
            q_new = self._bridge.inside(q_old + self._step_towards_goal(old, downhill))
            if self._place.distance(q_new) > _STALLED * self._distances[old]:
                return
            if not self._motion_is_free(q_old, q_new):  # COLLISION_FREE, and ‖CDF(q_new)‖ < CDF_Threshold
                return
            old = self._grow(old, q_new)
            if self._arrived is not None or ptc():
                return

    def _extend_randomly(self) -> None:
        """EXTEND_RANDOMLY: one step towards a random configuration from the node with the least ρ + α·CDF."""
        q_rand = self._random_configuration()
        outcome, new = self._extend(self._start_tree, self._select(self._start_tree, q_rand), q_rand)
        if outcome is not Extension.TRAPPED:
            self._measure_new_nodes()
            self._untried.append(new)

    def _best_for_goal(self) -> int | None:
        """Return argmin of WS_DISTANCE + α·CDF over the nodes not chosen before; None if there is none.

        Nodes that a step towards the goal has added count as chosen: going on from them is what was done. Now and
        then any node is chosen, or the best ones, all in the same dead end, would have to be tried one by one.
        """
        self._rank()
        if not self._ranked:
            return None
        if self._rng.random() >= _AT_RANDOM:
            return heappop(self._ranked)[1]
        _, node = self._ranked.pop(int(self._rng.integers(len(self._ranked))))
        heapify(self._ranked)
        return node

    def _rank(self) -> None:
        """Put the new nodes among those ranked by WS_DISTANCE + α·CDF."""
        weight = self._danger_weight * self._place.lever
        danger = self._start_tree.costs if weight and self._untried else np.zeros(len(self._start_tree))
        for node in self._untried:
            heappush(self._ranked, (self._distances[node] + weight * float(danger[node]), node))
        self._untried.clear()

    def _step_towards_goal(self, old: int, downhill: FloatArray | None) -> FloatArray:
        """Return Δq = k₂ [J†Δx + (I − J†J)Δq₀] at node `old`; classical: JᵀΔx.

        Δq₀ goes to zero together with the way that the tip has left, or the tip would not come to rest:
        motions in the null space move it to second order.
        """
        rule = transpose_step if self._transpose else pseudoinverse_step
        wanted = self._null_space_gain * self._distances[old] / self._place.lever
        posture = None if downhill is None else wanted * downhill
        return limited_step(
            rule, self._place, self._start_tree.configurations[old], self._limits, self._step, posture
        )

    def _downhill(self, old: int) -> FloatArray | None:
        """Return the direction (n,) in which the danger falls at node `old`, short if it hardly does.

        None where there is nothing to gain: no null space, no danger, or no gain k₁.
        """
        if self._transpose or not (self._null_space_gain and self._place.redundancy):
            return None
        if not (self._cost_scale and self._cost.has_gradients):
            return None
        slope = self._start_tree.gradient(old) / self._cost_scale
        steepness = float(np.sqrt(slope @ slope))
        return -slope / max(1.0, steepness) if steepness < np.inf else None

    def _motion_is_free(self, start: FloatArray, end: FloatArray) -> bool:
        """Return whether a motion is free, and its end less dangerous than the threshold or than its start."""
        if not super()._motion_is_free(start, end):
            return False
        if np.isinf(self._danger_threshold):
            return True
        before, after = self._cost.values(np.array([start, end]))
        return bool(after < max(self._danger_threshold, before))

    # ---------------------------------------------------------------------------------------- tree and goal

    def _accepts(self, goal: Any) -> bool:
        if isinstance(goal, WorkspaceGoal):
            return True
        _log.error(
            "%s plans to a WorkspaceGoal, not to a %s: set one, or plan with SafeRRTConnect",
            self.getName(),
            type(goal).__name__,
        )
        return False

    def _take_goals(self, ptc: Any) -> None:
        """Take the place from the problem; no goal configurations are drawn."""
        goal = self.getProblemDefinition().getGoal()
        if goal is not self._goal:
            self._aim(goal)
        self._untried += range(len(self._distances), len(self._start_tree))
        self._measure_new_nodes()

    def _aim(self, goal: WorkspaceGoal) -> None:
        """Turn to another goal; the tree stays, and all of its nodes may be tried for it."""
        self._goal, self._place = goal, goal.place
        self._limits = StepLimits.of_motion(self._place.robot)
        self._forget_goal()
        if not self._place.redundancy and not self._transpose:
            _log.info(
                "%s: the goal takes all %d joints and leaves no null space: on the way to it the posture "
                "cannot turn from danger",
                self.getName(),
                self._place.robot.n,
            )

    def _grow(self, old: int, q_new: FloatArray) -> int:
        self.counts.nodes += 1
        new = self._start_tree.add(q_new, old)
        self._measure_new_nodes()
        return new

    def _measure_new_nodes(self) -> None:
        """Note how far the tip is from the goal at new nodes, and whether it is there."""
        for node in range(len(self._distances), len(self._start_tree)):
            self._distances.append(self._place.distance(self._start_tree.configurations[node]))
            if self._arrived is None and self._distances[node] < self._goal.tolerance:
                self._arrived = node

    def _forget(self) -> None:
        super()._forget()
        self._forget_goal()

    def _graph(self) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
        vertices, edges, starts, _ = super()._graph()
        return (
            vertices,
            edges,
            starts,
            np.array([] if self._arrived is None else [self._arrived], dtype=np.intp),
        )

    def _forget_goal(self) -> None:
        self._distances: list[float] = []  # of the tip from the goal, for each node
        self._untried: list[int] = []  # nodes not yet ranked,
        self._ranked: list[tuple[float, int]] = []  # and those that are, a heap
        self._arrived = None

    def _has_goals(self) -> bool:
        return self._goal is not None
