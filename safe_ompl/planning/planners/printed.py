"""The planners as printed in the papers, as baselines for the other planners; with α = 0 the classical planners.

Some lines of the paper cannot be meant as printed. They are interpreted as follows:

* below (3): a = α₁² + β₁² + γ₁²; read: a = α₂² + β₂² + γ₂² = ℓ².
* (3): α₂, β₂, γ₂ undefined; read: minus the components of b − a; otherwise it is the field of the mirrored link.
* EXTEND_TOWARDS_GOAL: JᵀΔx + (I − JᵀJ)Δq₀; read: J†Δx + (I − J†J)Δq₀, as the text says.
* SAFE_RRT-CONNECT: argument x_g; read: q_g.
* (10): C = Closed(dir); read: Closed(1): after the swap the active tree is always the first.
* bubble planner, PRM: roots in Closed and in Open; read: in one of the two; otherwise they are closed twice.
* EXTEND_TOWARDS_GOAL: ``while 1``; read: ends without progress; steps are bounded and stay within the joint
  limits.
* SAFE_JT-RRT: "if q_old has been chosen before"; read: a node from which a step was tried counts as chosen.
* SAFE_JT-RRT: Σ over "all relevant obstacles"; read: over all danger points, with weights, and the distal ends of
  the links.
* CONNECT: q_new where EXTEND was trapped; read: no such node exists, so there is no CONNECT in this iteration.
* g: its norm is that of h, the 1-norm; otherwise h overestimates.
* PRM: milestones offered twice; read: the better offer counts.
* d_c: the closest obstacle; read: the robot's own pairs as well; otherwise a bubble is not free.
* (9): bubble vertices; read: contact is possible there, so 0.99 of the way is used, within the joint limits.
"""

from __future__ import annotations

from itertools import count, islice
from math import sqrt
from typing import Any

import numpy as np

from safe_ompl.collision import Bubble
from safe_ompl.common import FloatArray, IntArray
from safe_ompl.danger import DangerField
from safe_ompl.planning.ompl import WorkspaceGoal
from safe_ompl.planning.planners.base import Parameter, Query, SafePlanner
from safe_ompl.planning.planners.bubble import (
    JointMetric,
    VolumeTree,
    bubble_validity,
    free_part,
    intersect,
    volume_trees,
)
from safe_ompl.planning.planners.growth import Extension, Tree
from safe_ompl.planning.planners.jt_rrt import STALLED, Approach
from safe_ompl.planning.planners.problem import PlanningProblem
from safe_ompl.planning.planners.roadmap import Roadmap, SearchGraph
from safe_ompl.planning.planners.tree import Trees
from safe_ompl.robot import plain


def straight_extension(
    problem: PlanningProblem, trees: Trees, tree: Tree, old: int, target: FloatArray, step: float
) -> tuple[Extension, int]:
    """Add a node on the straight motion from node `old` to `target: (n,)`, at most `step` [rad] away.

    Return the outcome and the index of the node.
    """
    q_old = tree.configurations[old]
    length, (q_new, _) = problem.coordinates.steer(q_old, plain(target), step)
    outcome = Extension.REACHED if length <= step else Extension.ADVANCED
    if not problem.motion_is_free(*tree.as_driven(q_old, q_new)):
        return Extension.TRAPPED, old
    return outcome, trees.add(tree, q_new, old)


class PaperSafeRRTConnect(SafePlanner):
    """SAFE_RRT-CONNECT as it is printed in [1], §4.4, with EXTEND and CONNECT of [2]; with α = 0 `PaperRRTConnect`.

    The argument x_g is read as q_g. CONNECT is skipped if EXTEND was trapped, because then q_new does not exist.

    Parameters
    ----------
    range : float >= 0, default 0.0 [rad]
        Largest length of one extension; 0 takes 7.5 % of the space's extent.
    alpha : float >= 0, default 1.0
        Weight of danger α, as length per danger.
    iterations : int >= 0, default 0
        K: number of iterations; 0: until the time is over.

    References
    ----------
    1. B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013.
    2. J. Kuffner, S. LaValle: RRT-Connect. ICRA 2000.
    """

    alpha = Parameter(1.0)
    setAlpha, getAlpha = alpha.methods()
    iterations = Parameter(0)
    setIterations, getIterations = iterations.methods()

    def _search(self, ptc: Any) -> FloatArray | None:
        """SAFE_RRT-CONNECT."""
        tree, other = self._trees.start, self._trees.goal
        for _ in islice(count(), self.iterations or None):
            if ptc():
                break
            self._take_goals(ptc)
            q_rand = self._problem.random(self._rng)
            outcome, new = self._extend(tree, tree.best(q_rand, self.alpha), q_rand)
            if outcome is not Extension.TRAPPED:
                q_new = tree.configurations[new]
                outcome, met = self._connect(other, other.best(q_new, self.alpha), q_new, ptc)
                if outcome is Extension.REACHED:
                    return self._trees.path(tree, new, other, met)  # RETURN_PATH
            tree, other = other, tree  # SWAP
        return None

    def _extend(self, tree: Tree, old: int, target: FloatArray) -> tuple[Extension, int]:
        """EXTEND."""
        return straight_extension(self._problem, self._trees, tree, old, target, self.getRange())

    def _connect(self, tree: Tree, node: int, target: FloatArray, ptc: Any) -> tuple[Extension, int]:
        """CONNECT."""
        outcome = Extension.ADVANCED
        while outcome is Extension.ADVANCED and not ptc():
            outcome, node = self._extend(tree, node, target)
        return outcome, node


class PaperSafePRM(SafePlanner):
    """SAFE_PRM_PLANNER as it is printed in [1], §4.2; with α = 0 `PaperPRM`.

    N samples are drawn once. If they do not suffice, the planner fails. Open points of the print are decided as
    follows. The roots begin in Open and are closed once. g is measured in the 1-norm, as h, so that h does not
    overestimate. If a milestone is added to Open twice, the better entry counts. Two graphs that met are connected even
    if an Open list is empty.

    Parameters
    ----------
    alpha : float >= 0, default 5.0
        Weight of danger α, as length per danger.
    neighbors : int >= 1, default 25
        K: number of nearest milestones that are neighbours.
    samples : int >= 1, default 50
        N: number of milestones.

    References
    ----------
    1. B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013.
    """

    alpha = Parameter(5.0)
    setAlpha, getAlpha = alpha.methods()
    neighbors = Parameter(25, at_least=1)
    setNeighbors, getNeighbors = neighbors.methods()
    samples = Parameter(50, at_least=1)
    setSamples, getSamples = samples.methods()

    def _forget_ends(self) -> None:
        self._roadmap.forget_ends()

    def _search(self, ptc: Any) -> FloatArray | None:
        """SAFE_PRM_PLANNER."""
        roadmap = self._roadmap
        missing = self.samples + len(roadmap.starts) + len(roadmap.goals) - len(roadmap)
        if missing > 0:
            roadmap.add(self._problem.valid_samples(self._rng, missing, ptc))  # RANDOM_SET
        self._take_goals(ptc)
        graph = SearchGraph(len(roadmap), roadmap.starts, from_start=True)
        other = SearchGraph(len(roadmap), roadmap.goals, from_start=False)
        current_goal = roadmap.goals[0]
        while len(graph.g) and not ptc():
            best = int(self._f(graph, current_goal).argmin())
            new = graph.add_closed(best)
            graph.remove_open([best])
            self.counts.nodes += not roadmap.connected[new]
            roadmap.connected[new] = True
            if other.closed[new]:  # CONNECTED
                return roadmap.configurations[graph.joined(other, new)]  # PATH
            neighbors = self._neighbors(graph, new, ptc)
            graph.add_open(neighbors, new, self._lengths_from(new)[neighbors])
            if not len(graph.g):
                break  # EMPTY(Open(1))
            graph, other = other, graph
            current_goal = new
        return None

    def _f(self, graph: SearchGraph, current_goal: int) -> FloatArray:
        """Return f = g + h + α·CDF for the entries of Open(1)."""
        f = graph.g + self._lengths_from(current_goal)[graph.milestones]
        return f + self.alpha * self._roadmap.costs(graph.milestones) if self.alpha else f

    def _neighbors(self, graph: SearchGraph, new: int, ptc: Any) -> IntArray:
        """NEIGHBORS: the milestones among the K nearest to `new` in Samples ∖ Closed(1) with a free edge to `new`."""
        nearest = self._roadmap.nearest(new, graph.closed)[: self.neighbors].tolist()
        free = [other for other in nearest if not ptc() and self._roadmap.check(*graph.as_driven(new, other))]
        return np.array(free, dtype=np.intp)

    def _lengths_from(self, milestone: int) -> FloatArray:
        """Return the distances (N,) in the 1-norm between all milestones and one of them."""
        return np.asarray(np.abs(self._roadmap.ways_to(milestone)).sum(axis=1))

    def _forget(self) -> None:
        self._structure = self._roadmap = Roadmap(self._problem)


class PaperSafeJTRRT(SafePlanner):
    """SAFE_JT-RRT as it is printed in [1], §4.3; with Jᵀ and α = 0 the classical `PaperJTRRT` [2].

    A step towards the goal is Δq = k₂ [J†Δx + (I − J†J)Δq₀] with Δq₀ = k₁ Σ_j Σ_i J_ijᵀ CDF(r_j), summed over all
    danger points r_j and, as in the paper's experiments, the distal ends of all links. Open or misleading points of the
    print are decided as follows. Jᵀ in the step is J†. The loop `while 1` ends without progress. Steps are bounded and
    stay within the joint limits. A node from which a step was tried counts as chosen before. If all nodes were chosen,
    a random extension is made. The vectors CDF are weighted by their danger points.

    Parameters
    ----------
    range : float >= 0, default 0.0 [rad]
        Largest length of one random extension; 0 takes 7.5 % of the space's extent.
    alpha : float >= 0, default 1.0
        Weight of danger α, as length per danger, for lengths in rad and in metres.
    goal_bias : float >= 0, <= 1, default 0.05
        p_g: share of the extensions towards the goal.
    step : float > 0, default 0.1 [rad]
        Largest length of a step towards the goal.
    gain : float > 0, default 0.1
        k₂: gain of a step towards the goal.
    null_space_gain : float >= 0, default 1.0
        k₁: gain of the posture motion. It must be smaller for more danger points; 0.001 suits the paper's scenes.
    danger_threshold : float >= 0, default 0.0
        CDF_Threshold: a step towards the goal is refused if its danger is not below this; 0 for none.
    transpose : bool, default False
        Whether the step is k₂JᵀΔx, as in the classical JT-RRT.

    References
    ----------
    1. B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013.
    2. M. Vande Weghe, D. Ferguson, S. Srinivasa: Randomized path planning for redundant manipulators
       without inverse kinematics. Humanoids 2007.
    """

    plans_to = WorkspaceGoal

    alpha = Parameter(1.0)
    setAlpha, getAlpha = alpha.methods()
    goal_bias = Parameter(0.05, at_most=1)
    setGoalBias, getGoalBias = goal_bias.methods()
    step = Parameter(0.1, above=0)
    setStep, getStep = step.methods()
    gain = Parameter(0.1, above=0)
    setGain, getGain = gain.methods()
    null_space_gain = Parameter(1.0)
    setNullSpaceGain, getNullSpaceGain = null_space_gain.methods()
    danger_threshold = Parameter(0.0)
    setDangerThreshold, getDangerThreshold = danger_threshold.methods()
    transpose = Parameter(False)
    setTranspose, getTranspose = transpose.methods()

    _trees: Approach
    _goal: Any = None

    def _search(self, ptc: Any) -> FloatArray | None:
        """SAFE_JT-RRT."""
        while self._trees.arrived is None and not ptc():  # WS_DISTANCE(Q, x_g) ≥ D_Threshold
            if self._rng.random() < self.goal_bias:
                self._extend_towards_goal(ptc)
            else:
                self._extend_randomly()
        return None if self._trees.arrived is None else self._trees.start.branch(self._trees.arrived)

    def _extend_towards_goal(self, ptc: Any) -> None:
        """EXTEND_TOWARDS_GOAL."""
        approach, tree = self._trees, self._trees.start
        old = approach.best(self.alpha, 0.0, self._rng)
        if old is None:
            self._extend_randomly()
            return
        while True:
            q_old = tree.configurations[old]
            q_new = self._bridge.inside(q_old + self._displacement(q_old))
            if self._goal.target.distance(q_new) > STALLED * approach.distances[old]:
                return
            if not self._problem.motion_is_free(q_old, q_new):
                return
            level = self.danger_threshold  # ‖CDF(q)‖ < CDF_Threshold
            if level and not self._problem.cost.values(q_new[None])[0] < level:
                return
            old = approach.add(tree, q_new, old)
            approach.measure()
            if approach.arrived is not None or ptc():
                return

    def _extend_randomly(self) -> None:
        """EXTEND_RANDOMLY."""
        q_rand = self._problem.random(self._rng)
        approach, tree = self._trees, self._trees.start
        old = tree.best(q_rand, self.alpha)
        outcome, new = straight_extension(self._problem, approach, tree, old, q_rand, self.getRange())
        if outcome is not Extension.TRAPPED:
            approach.measure()
            approach.untried.append(new)

    def _displacement(self, q: FloatArray) -> FloatArray:
        """Return Δq (n,) at `q: (n,)`, shortened to the largest step."""
        target, field = self._goal.target, self._field
        jacobian, error = target.jacobian(q), target.error(q)
        if self.transpose:
            step: FloatArray = self.gain * (jacobian.T @ error)
        else:
            inverse = np.linalg.pinv(jacobian)
            step = inverse @ error
            if self.null_space_gain and field is not None:
                posture = self.null_space_gain * field.push(q)
                # On a danger point the field is infinite.
                if np.isfinite(posture).all():
                    step += posture - inverse @ (jacobian @ posture)
            step = self.gain * step
        length = sqrt(step @ step)
        return step * (self.step / length) if length > self.step else step

    @property
    def _field(self) -> DangerField | None:
        field = getattr(self.getProblemDefinition().getOptimizationObjective(), "field", None)
        return field if isinstance(field, DangerField) else None

    def _still_serves(self, before: Query, now: Query) -> bool:
        """Return whether the tree is valid for the new query; it grows from the start, so the goal may change."""
        return super()._still_serves(before._replace(goal=now.goal), now)

    def _take_goals(self, ptc: Any, samples: int = 1) -> None:
        """Read the target from the problem. For a new target the tree is kept, and all nodes may be chosen again."""
        self._goal = self.getProblemDefinition().getGoal()
        self._trees.take(self._goal)

    def _forget(self) -> None:
        self._structure = self._trees = Approach(self._bridge, self._problem.cost, self.counts, self._goal)


class PaperSafeBubble(SafePlanner):
    """BUBBLE_PLANNER as it is printed in [1], §4.1; with α = 0 `PaperBubble`.

    Bubbles are those of eq. (9), f is that of eq. (10), with the 1-norm of joint angles for g and h. Open points of the
    print are decided as follows. C is Closed(1). The roots begin in Open and are closed once. d_c includes
    self-collision pairs, because otherwise a bubble is not free. Vertices lie at 0.99 of the distance to the boundary,
    and within the joint limits. If several bubbles intersect the new bubble, the path uses the bubble with the largest
    overlap. The planner is deterministic.

    Parameters
    ----------
    alpha : float >= 0, default 1.0
        Weight of danger α, as length per danger.
    beta : float >= 0, default 0.0
        Weight β of the diversity.
    iterations : int >= 0, default 0
        k_max: number of iterations; 0: until the time is over.

    References
    ----------
    1. B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013.
    """

    alpha = Parameter(1.0)
    setAlpha, getAlpha = alpha.methods()
    beta = Parameter(0.0)
    setBeta, getBeta = beta.methods()
    iterations = Parameter(0)
    setIterations, getIterations = iterations.methods()

    def _search(self, ptc: Any) -> FloatArray | None:
        """BUBBLE_PLANNER."""
        tree, other = self._volumes.start, self._volumes.goal
        for _ in islice(count(), self.iterations or None):
            if ptc() or not (len(tree.open) or len(other.open)):
                break
            self._take_goals(ptc)
            path = self._expand(tree, other, other.latest) if len(tree.open) and not ptc() else None
            if path is not None:
                return path
            tree, other = other, tree  # SWAP
        return None

    def _expand(self, tree: VolumeTree, other: VolumeTree, current_goal: FloatArray) -> FloatArray | None:
        """Move argmin of f from Open(1) to Closed(1), and add the end points of its bubble to Open(1)."""
        x = tree.take(int(self._f(tree, current_goal).argmin()))
        bubble = Bubble.around(x.q, self._validity.checker, printed=True)
        if bubble is None:
            return None
        new = tree.close(x, bubble.weights)
        self.counts.nodes += 1
        path = intersect(self._problem, tree, new, other)
        if path is None:
            points = self._bubble_endpoints(bubble)
            dangers = self._problem.cost.values(points) if self.alpha else np.zeros(len(points))
            tree.add(points, new, dangers)
        return path

    def _f(self, tree: VolumeTree, current_goal: FloatArray) -> FloatArray:
        """Return f = g + h + α·CDF − β·diversity, eq. (10), for the points in Open(1)."""
        rows = tree.open
        f: FloatArray = self._metric.lengths(rows["q"], current_goal) + rows["path_length"]
        if self.alpha:
            f += self.alpha * rows["cost"]
        if self.beta:
            f -= self.beta * rows["diversity"]
        return f

    def _bubble_endpoints(self, bubble: Bubble) -> FloatArray:
        """BUBBLE_ENDPOINTS: the vertices (K, n)."""
        bridge = self._bridge
        points = bridge.inside(bubble.vertices(bridge.lower, bridge.upper, bridge.circular))
        return points[self._metric.separations(bubble.q, points) > 1e-9]

    def _approach(self) -> FloatArray:
        return free_part(self._problem, super()._approach())

    def _forget(self) -> None:
        self._validity = bubble_validity(self.getSpaceInformation(), self.getName())
        self._metric = JointMetric(self._bridge, np.ones(self._bridge.n), taxicab=True)
        self._structure = self._volumes = volume_trees(self._bridge, self._metric, diverse=self.beta > 0)
