"""Steps towards a goal in the workspace: the node to begin at, and the joint step along the arm's Jacobian."""

from __future__ import annotations

from heapq import heapify, heappop, heappush

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.planning.ompl import WorkspaceGoal
from safe_ompl.planning.planners.parts.problem import PlanningProblem
from safe_ompl.planning.planners.parts.tree import Tree, Trees
from safe_ompl.robot import Place, StepLimits, limited_step, pseudoinverse_step, transpose_step

STALLED = 0.995  # a step that leaves more than this share of the distance makes no progress


class Approach:
    """A tree that is to bring the tip to a goal in the workspace, and which of its nodes were not chosen yet.

    Parameters
    ----------
    trees : Trees
        The tree from the starts; that of the goals stays empty.
    goal : WorkspaceGoal or None
        The goal; without one nothing is measured.

    Attributes
    ----------
    tree : Tree
        The tree.
    distances : list of float
        WS_DISTANCE of the tip from the goal, for each node.
    untried : list of int
        Nodes that may be chosen and are not ranked yet.
    arrived : int or None
        The first node at the goal.
    """

    def __init__(self, trees: Trees, goal: WorkspaceGoal | None) -> None:
        self._goal = goal
        self.trees = trees
        self.tree = trees.start
        self.distances: list[float] = []
        self.untried: list[int] = []
        self.arrived: int | None = None
        self._ranked: list[tuple[float, int]] = []  # a heap

    def measure(self) -> None:
        """Note the distance of the tip from the goal at new nodes, and which node is the first at the goal."""
        if self._goal is None:
            return
        for node in range(len(self.distances), len(self.tree)):
            self.distances.append(self._goal.place.distance(self.tree.configurations[node]))
            if self.arrived is None and self.distances[node] < self._goal.tolerance:
                self.arrived = node

    def take_new(self) -> None:
        """Measure new nodes, and let them be chosen."""
        self.untried += range(len(self.distances), len(self.tree))
        self.measure()

    def best(self, weight: float, at_random: float, rng: np.random.Generator) -> int | None:
        """Return argmin of WS_DISTANCE + weight·CDF over the nodes not chosen before; None if there is none.

        Nodes that a step towards the goal has added count as chosen, as they were already extended. In a share
        `at_random` of the choices any node is taken: the best ones may all be in the same dead end.
        """
        self._rank(weight)
        if not self._ranked:
            return None
        if not at_random or rng.random() >= at_random:
            return heappop(self._ranked)[1]
        _, node = self._ranked.pop(int(rng.integers(len(self._ranked))))
        heapify(self._ranked)
        return node

    def _rank(self, weight: float) -> None:
        """Put the new nodes among those ranked by WS_DISTANCE + weight·CDF."""
        danger = self.tree.costs if weight and self.untried else np.zeros(len(self.tree))
        for node in self.untried:
            heappush(self._ranked, (self.distances[node] + weight * float(danger[node]), node))
        self.untried.clear()

    # ------------------------------------------------------------------------------------ starts and goals

    def add_start(self, q: FloatArray) -> None:
        """Add a start configuration (n,)."""
        self.trees.add_start(q)

    def add_goal(self, q: FloatArray) -> None:
        """Add a goal configuration (n,), which this tree has no use for."""
        self.trees.add_goal(q)

    @property
    def has_starts(self) -> bool:
        """Whether there is a start."""
        return self.trees.has_starts

    @property
    def has_goals(self) -> bool:
        """Whether there is a goal."""
        return self._goal is not None

    def graph(self) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
        """Return vertices (N, n), edges (E, 2) in the direction of driving, and which vertices are starts and goals."""
        vertices, edges, starts, _ = self.trees.graph()
        return (
            vertices,
            edges,
            starts,
            np.array([] if self.arrived is None else [self.arrived], dtype=np.intp),
        )


class GoalStep:
    """The step of EXTEND_TOWARDS_GOAL from a node of a tree.

    Parameters
    ----------
    problem : PlanningProblem
        Gives the danger.

    Attributes
    ----------
    largest : float
        Largest length of a step [rad].
    null_space_gain : float
        k₁, relative to the motion that the tip's way needs.
    transpose : bool
        Take Jᵀ in place of J†, and leave the null space alone.
    """

    def __init__(self, problem: PlanningProblem) -> None:
        self._problem = problem
        self.largest = 0.1
        self.null_space_gain = 1.0
        self.transpose = False
        self._place: Place
        self._limits: StepLimits

    def aim(self, place: Place) -> None:
        """Head for another place of the tip."""
        self._place, self._limits = place, StepLimits.of_motion(place.robot)

    def at(self, q: FloatArray, distance: float, downhill: FloatArray | None) -> FloatArray:
        """Return Δq = k₂ [J†Δx + (I − J†J)Δq₀] at `q: (n,)`, classical JᵀΔx, no longer than the largest step.

        Δq₀ goes along `downhill`, and to zero together with the `distance` that the tip has left, or the tip would not
        come to rest: motions in the null space move it to second order.
        """
        rule = transpose_step if self.transpose else pseudoinverse_step
        posture = None if downhill is None else self.null_space_gain * distance / self._place.lever * downhill
        return limited_step(rule, self._place, q, self._limits, self.largest, posture)

    def downhill(self, tree: Tree, node: int) -> FloatArray | None:
        """Return the direction (n,) in which the danger falls at a node, short if it hardly does.

        None where there is nothing to gain: no null space, no danger, or no gain k₁.
        """
        if self.transpose or not (self.null_space_gain and self._place.redundancy):
            return None
        if not (self._problem.cost.has_gradients and self._problem.slope):
            return None
        slope = tree.gradient(node) / self._problem.slope
        steepness = float(np.sqrt(slope @ slope))
        return -slope / max(1.0, steepness) if steepness < np.inf else None
