"""SafeJTRRT: a tree that grows towards a target of the tip by the arm's Jacobian."""

from __future__ import annotations

from heapq import heappop, heappush
from itertools import count
from math import sqrt
from typing import Any

import numpy as np

from safe_ompl.common import Counts, FloatArray
from safe_ompl.planning.ompl import StateCost, WorkspaceGoal
from safe_ompl.planning.planners.base import Parameter, Query, SafePlanner
from safe_ompl.planning.planners.growth import Extension, Growth, Tree
from safe_ompl.planning.planners.problem import DangerDecay, DangerWeight, Margin, PlanningProblem
from safe_ompl.planning.planners.tree import PlannerGraph, Trees
from safe_ompl.robot import (
    StateBridge,
    StepLimits,
    TargetPose,
    limited_step,
    motion_limits,
    pseudoinverse_step,
    transpose_step,
)

# The clearance at the goal is unknown, so few steps are tried before the margin ends.
_LEAST_MARGIN = 0.01  # [m]
# The share of extensions towards the goal that begin at a random node.
_RANDOM_STARTS = 0.3
# The default lengths of one step. The tip's way along J† is straight for longer than along Jᵀ, so twice as long steps
# arrive as often; longer ones are trapped more often.
_PSEUDOINVERSE_STEP, _TRANSPOSE_STEP = 0.4, 0.2  # [rad]
# The gradient of the danger, the most expensive part of a step, is kept for this many steps.
_SAME_SLOPE = 4


class SafeJTRRT(SafePlanner):
    """A tree from the start that grows towards a target pose of the tip (SAFE_JT-RRT).

    Some extensions go towards a random configuration, as in SafeRRTConnect. The others start from a safe node near the
    goal and use the pseudoinverse of the arm's Jacobian, so that the tip moves straight to the goal. Motions in the
    null space of the Jacobian move the links away from danger. The goal must be a `WorkspaceGoal`. No inverse
    kinematics is needed.

    Parameters
    ----------
    range : float >= 0, default 0.0 [rad]
        Largest length of one random extension, before the sideways motion; 0 takes 7.5 % of the space's extent.
    alpha : float >= 0, default 1.0
        Weight of danger α, as for `SafeRRTConnect`. It also weights the danger in the choice of the start node of an
        extension towards the goal. There the distance is that of the tip, and joint motion is converted to metres by
        the typical lever arm (`TargetPose.lever_arm`). 0 plans classically.
    nearest_fraction : float >= 0, <= 1, default 0.1
        ε: share of the random extensions that start at the nearest node, regardless of danger. Any ε > 0 keeps the
        planner probabilistically complete: a node in a dangerous passage would otherwise never be chosen again.
    slide : float >= 0, <= 1, default 0.8
        Largest sideways motion of a new node down the gradient of the danger, as a fraction of the range; 0 gives the
        paper's straight extension. Used only if α > 0 and the objective has gradients (as `DangerObjective`).
    threshold_rise : float >= 0, default 0.05
        A node is refused if its danger is above the danger of its parent and above a threshold. The threshold begins at
        the danger of start or goal, whichever is larger, because no path can avoid it. It rises by this share after
        every eight refusals. It keeps the peak of the danger low. 0 for no threshold.
    step : float >= 0, default 0.0 [rad]
        Largest length ‖Δq‖ of one step towards the goal, instead of the paper's gain k₂; 0 means 0.4, or 0.2 with
        `transpose`. Far from the goal all steps have this length. Near the goal a step is that of the pseudoinverse.
    goal_bias : float >= 0, <= 1, default 0.05
        p_g: share of the extensions that go towards the goal. More is faster, less is safer.
    null_space_gain : float >= 0, default 1.0
        k₁: length of the posture motion Δq₀ relative to the joint motion that moves the tip. The posture motion follows
        the negative gradient of the danger, Δq₀ ∝ −∇CDF. This is the paper's Σ Jᵀ CDF with the shares of all links in
        the field. It needs an objective with gradients (`DangerObjective`). 0 for no posture motion.
    transpose : bool, default False
        Whether Jᵀ is used instead of J†, without posture motion. With α = 0 this is the classical JT-RRT [2].
    danger_decay : float >= 0, default 100.0
        Number of iterations after which half of the iterations ignore danger and margin; after three times as many
        nearly all do. So danger delays the way into a narrow passage by about this number of iterations at most. 0 for
        no decay.
    clearance : float >= 0, default 0.05 [m]
        Largest margin that motions keep from all obstacles, as for `SafeRRTConnect`. It is at most 80 % of the
        clearance of the start, and ends below 10 mm. 0 for none.

    Notes
    -----
    `PaperSafeJTRRT` is the planner as printed in [1], `PaperJTRRT` the classical planner with k₂JᵀΔx. This planner
    differs as follows:

    * k₁ and k₂ are relative. The same gains serve all robots, without oscillation.
    * Δq₀ follows the negative gradient of the maximum danger, with the shares of all links in the field. So the danger
      of the configuration decreases, which a sum over all points does not ensure.
    * The gradient is reused for a few steps. The field is evaluated less often.
    * Joints at their limits stop, and the other joints compensate, so that the tip reaches the target.
    * Some extensions begin at a random node, and some choices ignore danger (`nearest_fraction`). The planner leaves
      dead ends.
    * Random steps move sideways and keep a threshold (`slide`, `threshold_rise`). The danger is lower.
    * CDF_Threshold applies to random steps. `max_danger` is proven for every motion.
    * The path is contracted like an elastic band as long as neither peak nor integral of the danger rises, and its
      edges are moved sideways (`slide`). The path is shorter and less dangerous.
    * Motions keep a margin while possible (`clearance`), also from obstacles that are not dangerous.
    * Danger and margin lose weight while no path is found (`danger_decay`), so that no solution is lost.
    * α is relative to the typical slope of the danger. One default serves all robots.

    References
    ----------
    1. B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.3.
    2. M. Vande Weghe, D. Ferguson, S. Srinivasa: Randomized path planning for redundant manipulators
       without inverse kinematics. Humanoids 2007.

    Examples
    --------
    >>> setup = setup_scenario("planar2")
    >>> setup.setPlanner(SafeJTRRT(setup.getSpaceInformation()))
    >>> bool(setup.solve(5.0))
    True
    """

    plans_to = WorkspaceGoal

    alpha = Parameter(1.0)
    setAlpha, getAlpha = alpha.methods()
    nearest_fraction = Parameter(0.1, at_most=1)
    setNearestFraction, getNearestFraction = nearest_fraction.methods()
    slide = Parameter(0.8, at_most=1)
    setSlide, getSlide = slide.methods()
    threshold_rise = Parameter(0.05)
    setThresholdRise, getThresholdRise = threshold_rise.methods()
    step = Parameter(0.0)
    setStep, getStep = step.methods()
    goal_bias = Parameter(0.05, at_most=1)
    setGoalBias, getGoalBias = goal_bias.methods()
    null_space_gain = Parameter(1.0)
    setNullSpaceGain, getNullSpaceGain = null_space_gain.methods()
    transpose = Parameter(False)
    setTranspose, getTranspose = transpose.methods()
    danger_decay = Parameter(100.0)
    setDangerDecay, getDangerDecay = danger_decay.methods()
    clearance = Parameter(0.05)
    setClearance, getClearance = clearance.methods()

    _trees: Approach

    def _make_parts(self) -> None:
        self._danger = DangerWeight(self._problem)
        self._margin = Margin(self._problem, self._danger, _LEAST_MARGIN)
        self._decay = DangerDecay(self._danger, self._margin)
        self._growth = Growth(self._problem, self._danger, self._margin)
        self._step = GoalStep(self._problem)
        self._goal: Any = None
        self._target: TargetPose

    def _apply_parameters(self) -> None:
        self._danger.alpha = self.alpha
        self._growth.slide = self.slide
        self._growth.rise = self.threshold_rise
        self._step.largest = self.step or (_TRANSPOSE_STEP if self.transpose else _PSEUDOINVERSE_STEP)
        self._step.null_space_gain = self.null_space_gain
        self._step.transpose = self.transpose
        self._decay.half_life = self.danger_decay
        self._margin.largest = self.clearance

    def _search(self, ptc: Any) -> FloatArray | None:
        """Run the paper's SAFE_JT-RRT."""
        while self._trees.arrived is None and not ptc():  # WS_DISTANCE(Q, x_g) ≥ D_Threshold
            self._decay.turn(self._rng)
            self._margin.begin(self._trees)
            if self._rng.random() < self.goal_bias:
                self._extend_towards_goal(ptc)
            else:
                self._extend_randomly()
        if self._trees.arrived is None:
            return None
        path = self._trees.start.branch(self._trees.arrived)
        if not self._danger.whole_weight:
            return path
        # The last turn may have ignored danger.
        self._danger.scale = 1.0
        return self._growth.settled(path, self.getRange(), ptc, self._margin.wanted, 1)

    def _extend_towards_goal(self, ptc: Any) -> None:
        """EXTEND_TOWARDS_GOAL: extend from the best node not chosen before, while steps make progress."""
        old = self._trees.best(self._danger.weight * self._target.lever_arm, _RANDOM_STARTS, self._rng)
        if old is None:
            self._extend_randomly()
            return
        approach, tree = self._trees, self._trees.start
        for k in count():
            if k % _SAME_SLOPE == 0:
                downhill = self._step.downhill(tree, old)
            q_old, distance = tree.configurations[old], approach.distances[old]
            q_new = self._bridge.inside(q_old + self._step.at(q_old, distance, downhill))
            left = self._target.distance(q_new)
            if left > STALLED * distance:
                return
            if not self._margin.motion_is_free(q_old, q_new):  # COLLISION_FREE
                return
            old = approach.add(tree, q_new, old)
            approach.note(left)
            if approach.arrived is not None or ptc():
                return

    def _extend_randomly(self) -> None:
        """EXTEND_RANDOMLY: one step towards a random configuration from the node with the least ρ + α·CDF."""
        q_rand = self._problem.random(self._rng)
        approach, tree = self._trees, self._trees.start
        ignores_danger = self.nearest_fraction > 0 and self._rng.random() < self.nearest_fraction
        old = tree.best(q_rand, 0.0 if ignores_danger else self._danger.weight)
        outcome, new = self._growth.extend(approach, tree, old, q_rand, self.getRange())
        if outcome is not Extension.TRAPPED:
            approach.measure()
            approach.untried.append(new)

    def _still_serves(self, before: Query, now: Query) -> bool:
        """Return whether the tree is valid for the new query; it grows from the start, so the goal may change."""
        return super()._still_serves(before._replace(goal=now.goal), now)

    def _take_goals(self, ptc: Any, samples: int = 1) -> None:
        """Read the target from the problem; for a new target the tree is kept, and all nodes may be chosen again."""
        goal = self.getProblemDefinition().getGoal()
        if goal is not self._goal:
            self._goal, self._target = goal, goal.target
            self._step.aim(goal.target)
        self._trees.take(goal)

    def _forget(self) -> None:
        self._structure = self._trees = Approach(self._bridge, self._problem.cost, self.counts, self._goal)
        self._growth.reset()
        self._margin.reset()
        self._decay.reset()


# A step that leaves more than this share of the distance makes no progress.
STALLED = 0.995


class Approach(Trees):
    """A tree towards a goal in the workspace, with the order in which its nodes are chosen.

    The tree of the goals stays empty. `distances` has the distance of the tip from the goal, WS_DISTANCE, for each
    node. `untried` are nodes that may be chosen and are not ranked yet. `arrived` is the first node at the goal.
    """

    def __init__(self, bridge: StateBridge, cost: StateCost, counts: Counts, goal: WorkspaceGoal | None) -> None:
        super().__init__(bridge, cost, counts)
        self.aim(goal)

    def aim(self, goal: WorkspaceGoal | None) -> None:
        """Set a new goal. The tree is kept, and all nodes may be chosen again."""
        self._goal = goal
        self.distances: list[float] = []
        self.untried: list[int] = []
        self.arrived: int | None = None
        self._ranked: list[tuple[float, int]] = []  # a heap
        # The nodes in it that were chosen at random.
        self._drawn: set[int] = set()

    def measure(self) -> None:
        """Compute the distance of the tip from the goal at new nodes, and note the first node at the goal."""
        if self._goal is None:
            return
        for node in range(len(self.distances), len(self.start)):
            self.note(self._goal.target.distance(self.start.configurations[node]))

    def note(self, distance: float) -> None:
        """Store the distance of the tip from the goal for the first node without a distance."""
        if self._goal is not None and self.arrived is None and distance < self._goal.tolerance:
            self.arrived = len(self.distances)
        self.distances.append(distance)

    def take(self, goal: WorkspaceGoal) -> None:
        """Set the goal, measure new nodes, and let them be chosen. After a new goal all nodes may be chosen again."""
        if goal is not self._goal:
            self.aim(goal)
        self.untried += range(len(self.distances), len(self.start))
        self.measure()

    def best(self, weight: float, at_random: float, rng: np.random.Generator) -> int | None:
        """Return argmin of WS_DISTANCE + weight·CDF over the nodes not chosen before; None if there is none.

        Nodes that a step towards the goal has added count as chosen. A share `at_random` of the choices is random,
        because the best nodes may all be in the same dead end.
        """
        self._rank(weight)
        ranked, drawn = self._ranked, self._drawn
        by_chance = at_random > 0 and len(drawn) < len(ranked) and rng.random() < at_random
        while len(drawn) < len(ranked):
            node = ranked[int(rng.integers(len(ranked)))][1] if by_chance else heappop(ranked)[1]
            if node not in drawn:
                if by_chance:
                    # The node stays in the heap, because ordering the heap again would take long.
                    drawn.add(node)
                return node
            if not by_chance:
                drawn.remove(node)
        return None

    def _rank(self, weight: float) -> None:
        """Put the new nodes among those ranked by WS_DISTANCE + weight·CDF."""
        for node in self.untried:
            danger = weight * float(self.start.costs[node]) if weight else 0.0
            heappush(self._ranked, (self.distances[node] + danger, node))
        self.untried.clear()

    @property
    def has_goals(self) -> bool:
        """Whether there is a goal."""
        return self._goal is not None

    def approach(self, bridge: StateBridge) -> FloatArray:
        """Return the branch (N, n) to the node whose tip is nearest to the goal."""
        self.measure()
        return self.start.branch(int(np.argmin(self.distances)))

    def graph(self) -> PlannerGraph:
        """Return the graph of the tree; its goal is the node that arrived."""
        goals = [] if self.arrived is None else [self.arrived]
        return super().graph()._replace(goals=np.array(goals, dtype=np.intp))


class GoalStep:
    """The step of EXTEND_TOWARDS_GOAL from a node of a tree, no longer than `largest` [rad]; see `SafeJTRRT`."""

    def __init__(self, problem: PlanningProblem) -> None:
        self._problem = problem
        self.largest = _PSEUDOINVERSE_STEP
        self.null_space_gain = 1.0
        self.transpose = False
        self._target: TargetPose
        self._limits: StepLimits

    def aim(self, target: TargetPose) -> None:
        """Set a new target pose of the tip."""
        self._target, self._limits = target, motion_limits(target.robot)

    def at(self, q: FloatArray, distance: float, downhill: FloatArray | None) -> FloatArray:
        """Return Δq = k₂ [J†Δx + (I − J†J)Δq₀] at `q: (n,)`, or classically JᵀΔx, at most as long as the largest step.

        Δq₀ has the direction `downhill` and is proportional to the `distance` of the tip from the target. Otherwise the
        tip would not come to rest, because motions in the null space move the tip to second order.
        """
        rule = transpose_step if self.transpose else pseudoinverse_step
        posture = None if downhill is None else self.null_space_gain * distance / self._target.lever_arm * downhill
        return limited_step(rule, self._target, q, self._limits, self.largest, posture)

    def downhill(self, tree: Tree, node: int) -> FloatArray | None:
        """Return the descent direction (n,) of the danger at a node, with norm at most 1, or None if it is not used."""
        if self.transpose or not (self.null_space_gain and self._target.redundancy):
            return None
        if not (self._problem.cost.has_gradients and self._problem.slope):
            return None
        slope = tree.gradient(node) / self._problem.slope
        steepness = sqrt(slope @ slope)
        return -slope / max(1.0, steepness) if steepness < np.inf else None
