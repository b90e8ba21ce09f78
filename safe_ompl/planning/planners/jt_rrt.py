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
    """One tree from the start that grows towards a place of the tip, a goal in the workspace (SAFE_JT-RRT).

    Some extensions go towards a random configuration, as in SafeRRTConnect. The others start from a safe node
    near the goal and follow the pseudoinverse of the arm's Jacobian, which brings the tip straight there;
    the freedom that this leaves to the arm, its null space, turns the links away from danger. The goal must be a
    `WorkspaceGoal`; no inverse kinematics is needed.

    Parameters
    ----------
    range : float >= 0, default 0.0 [rad]
        Largest length of one random extension, before it moves sideways; 0 takes 7.5 % of the space's extent.
    alpha : float >= 0, default 1.0
        Weight of danger α, as for `SafeRRTConnect`. It also weighs the danger in the choice of the node from which to
        go to the goal; there the distance is the tip's, and a radian counts as many metres as it typically moves the
        tip (`TargetPose.lever_arm`). 0 plans classically.
    nearest_fraction : float >= 0, <= 1, default 0.1
        ε: share of the choices of a node by distance alone, of random extensions. Any ε > 0 keeps the planner
        probabilistically complete: a node in a dangerous passage would otherwise never be chosen again.
    slide : float >= 0, <= 1, default 0.8
        Largest sideways motion of a new node down the gradient of the danger, as a fraction of the range; 0 gives the
        paper's straight extension. It acts where α > 0 and the objective offers gradients (`DangerObjective` does).
    threshold_rise : float >= 0, default 0.05
        No node is added that is more dangerous than its parent and than a threshold. This is at first the danger of the
        more dangerous end, which no path can avoid; after every eight refusals it rises by this share. It keeps the
        peak of the danger low. 0 for no threshold.
    step : float >= 0, default 0.0 [rad]
        Largest length ‖Δq‖ of one step towards the goal; 0 means 0.4, or 0.2 with `transpose`. It takes the place of
        the paper's gain k₂: far from the goal all steps are this long, near it they are the pseudoinverse's own.
    goal_bias : float >= 0, <= 1, default 0.05
        p_g: share of the extensions that go towards the goal. More is faster, less is safer.
    null_space_gain : float >= 0, default 1.0
        k₁: length of the posture motion Δq₀ relative to the motion that the tip's way needs. It goes down the gradient
        of the danger, Δq₀ ∝ −∇CDF: the paper's Σ Jᵀ CDF, with the share of every link in the field. It needs an
        objective with gradients (`DangerObjective`). 0 leaves the posture alone.
    transpose : bool, default False
        Whether Jᵀ takes the place of J†, without posture motion. With α = 0 this is the classical JT-RRT [2].
    danger_decay : float >= 0, default 100.0
        Number of turns after which half of the turns ignore danger and margin; after three times as many nearly all do.
        So danger that keeps the planner out of a narrow place costs no more than about that many turns. 0 for no decay.
    clearance : float >= 0, default 0.05 [m]
        Largest margin that motions keep from all obstacles, as for `SafeRRTConnect`. It is no more than 80 % of what
        the start keeps, and ends below 10 mm. 0 for none.

    Notes
    -----
    The planner as it is printed in [1] is `PaperSafeJTRRT`, and the classical one `PaperJTRRT`, k₂JᵀΔx. What differs
    here, and why:

    * k₁ and k₂ are relative: the same gains for all robots, without oscillation;
    * Δq₀ goes down the gradient of the greatest danger, with the share of every link in the field: the danger of the
      configuration falls, which a sum over all points does not ensure;
    * that gradient is kept for a few steps: fewer evaluations of the field;
    * joints at their limits stop, and the others take over: the tip still gets there;
    * some extensions begin elsewhere than at the best node, and some choices ignore danger (`nearest_fraction`): out of
      dead ends;
    * random steps descend sideways and keep to a threshold (`slide`, `threshold_rise`): lower danger;
    * CDF_Threshold is that of random steps; what `max_danger` forbids is proven not to happen;
    * the path is contracted like an elastic band where neither the peak of the danger nor its integral rises, and its
      edges are moved sideways (`slide`): it is shorter, and the danger is lower;
    * motions keep a margin, as long as they can (`clearance`): obstacles that are not dangerous are not grazed, either;
    * danger and margin lose weight where no path is found (`danger_decay`): they cost no solution;
    * α is relative to the usual slope of the danger: one default serves all robots.

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.3.
    .. [2] M. Vande Weghe, D. Ferguson, S. Srinivasa: Randomized path planning for redundant manipulators
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
        """EXTEND_TOWARDS_GOAL: from the best node not chosen before, step by step as long as there is progress."""
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
        """Set another goal; the tree is kept, and all of its nodes may be chosen again."""
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
        """Set the goal, measure new nodes, and add them to the nodes to choose; a new goal resets all nodes."""
        if goal is not self._goal:
            self.aim(goal)
        self.untried += range(len(self.distances), len(self.start))
        self.measure()

    def best(self, weight: float, at_random: float, rng: np.random.Generator) -> int | None:
        """Return argmin of WS_DISTANCE + weight·CDF over the nodes not chosen before; None if there is none.

        Nodes that a step towards the goal has added count as chosen. In a share `at_random` of the choices any node is
        taken: the best ones may all be in the same dead end.
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
        """Set another target of the tip."""
        self._target, self._limits = target, motion_limits(target.robot)

    def at(self, q: FloatArray, distance: float, downhill: FloatArray | None) -> FloatArray:
        """Return Δq = k₂ [J†Δx + (I − J†J)Δq₀] at `q: (n,)`, classical JᵀΔx, no longer than the largest step.

        Δq₀ goes along `downhill`, and to zero together with the `distance` that the tip has left, or the tip would not
        come to rest: motions in the null space move it to second order.
        """
        rule = transpose_step if self.transpose else pseudoinverse_step
        posture = None if downhill is None else self.null_space_gain * distance / self._target.lever_arm * downhill
        return limited_step(rule, self._target, q, self._limits, self.largest, posture)

    def downhill(self, tree: Tree, node: int) -> FloatArray | None:
        """Return the direction (n,) in which the danger falls at a node, short if it hardly does; None for none."""
        if self.transpose or not (self.null_space_gain and self._target.redundancy):
            return None
        if not (self._problem.cost.has_gradients and self._problem.slope):
            return None
        slope = tree.gradient(node) / self._problem.slope
        steepness = sqrt(slope @ slope)
        return -slope / max(1.0, steepness) if steepness < np.inf else None
