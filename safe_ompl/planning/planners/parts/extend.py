"""EXTEND: one step of a tree towards a configuration, straight or with a tangential descent from danger."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from math import sqrt
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray
from safe_ompl.planning.ompl import StateBridge
from safe_ompl.planning.planners.parts.clearance import AdaptiveMargin
from safe_ompl.planning.planners.parts.problem import AdaptiveThreshold, DangerWeight, FixedThreshold, PlanningProblem
from safe_ompl.planning.planners.parts.steps import ADVANCED, MISSED, RARE, REACHED, Look, StepKernel
from safe_ompl.planning.planners.parts.tree import Tree, Trees
from safe_ompl.robot import plain
from safe_ompl.robot.kernels import descend, steer

_SHORTEST = 0.05  # of a whole step


class Extension(Enum):
    """Outcome of EXTEND."""

    TRAPPED = "no new node"
    ADVANCED = "a new node on the way"
    REACHED = "a new node at the target"


_ADDED = {ADVANCED: Extension.ADVANCED, REACHED: Extension.REACHED}
_NO_SLOPE: FloatArray = np.empty(0)


def steered(bridge: StateBridge, q: FloatArray, target: FloatArray, step: float) -> tuple[float, FloatArray]:
    """Return ρ(q, target), and where a step [rad] from `q` towards `target: (n,)` leads and its direction, (2, n).

    A step leads no farther than to the target. There is no direction, NaN, where the target is `q` itself.
    """
    moved: FloatArray = np.empty((2, len(q)))
    return float(steer(q, plain(target), bridge.circular, step, moved)), moved


def straight_extension(
    problem: PlanningProblem, trees: Trees, tree: Tree, old: int, target: FloatArray, step: float
) -> tuple[Extension, int]:
    """Add a node at most `step` [rad] from node `old` straight towards `target: (n,)`; return outcome and node."""
    q_old = tree.configurations[old]
    length, (q_new, _) = steered(problem.bridge, q_old, target, step)
    outcome = Extension.REACHED if length <= step else Extension.ADVANCED
    if not problem.motion_is_free(*tree.as_driven(q_old, q_new)):
        return Extension.TRAPPED, old
    return outcome, trees.add(tree, q_new, old)


class TangentialDescent:
    """Moves a way point down the gradient of the danger, at right angles to the motion that leads to it.

    This is the null-space motion of the paper's JT-RRT (§4.3) for a straight motion in joint space: directions in which
    the motion does not lead turn the links away from danger. It acts where α > 0 and the objective offers gradients.
    The sideways motion is at most a `share` of the planner's range.
    """

    def __init__(self, bridge: StateBridge, danger: DangerWeight) -> None:
        self._bridge, self._danger = bridge, danger
        self.share = 0.0

    @property
    def acts(self) -> bool:
        """Whether way points are moved at all."""
        return self.share > 0 and self._danger.weight > 0 and self._danger.cost.has_gradients

    def moved(
        self, step: FloatArray, reach: float, gradient: Callable[[], FloatArray] | None = None
    ) -> FloatArray | None:
        """Return the first row of `step: (2, n)` moved down the danger's gradient there, at right angles to the second.

        That is a unit vector, and written over. The motion is at most `reach` long, and shorter where the danger hardly
        changes; None where it does not change at all. `gradient` gives another gradient than that of the danger there.
        """
        if not (self.acts and reach):
            return None
        slope = gradient() if gradient else self._danger.cost.value_and_gradient(step[0])[1]
        bridge, slope = self._bridge, slope / self._danger.slope
        if not descend(step, slope, reach, bridge.lower, bridge.upper, bridge.circular):
            return None
        moved: FloatArray = step[1]
        return moved


@dataclass(eq=False)
class SafeStep:
    """EXTEND of the safe RRTs (§4.3, §4.4): a step with a tangential descent, below a threshold on danger.

    With a `fixed` threshold steps must be below that, too.
    """

    problem: PlanningProblem
    danger: DangerWeight
    descent: TangentialDescent
    threshold: AdaptiveThreshold
    margin: AdaptiveMargin
    fixed: FixedThreshold | None = None

    def __post_init__(self) -> None:
        self._kernel = StepKernel(self.problem)
        self._is_free = (self.fixed or self.margin).motion_is_free

    def extend(self, trees: Trees, tree: Tree, old: int, target: FloatArray, step: float) -> tuple[Extension, int]:
        """Add a node at most `step` [rad] from node `old` towards `target: (n,)`; return outcome and node.

        Where the step with descent is not free the straight one is tried. Targets within a step are neither moved nor
        held to the threshold: they are configurations that the path needs.
        """
        taken = self._at_once(trees, tree, old, target, step) if self.danger.weight else None
        return self._composed(trees, tree, old, target, step) if taken is None else taken

    def _at_once(
        self, trees: Trees, tree: Tree, old: int, target: FloatArray, step: float
    ) -> tuple[Extension, int] | None:
        """Do so in one call of a kernel; None, and nothing is done, where that cannot be."""
        margin = self.margin.in_force
        if (margin and self.margin.falls_next) or (self.fixed is not None and self.fixed.acts):
            return None
        proofs = self._kernel.proofs(margin)
        look = None if proofs is None else self._look(trees, tree, old)
        if proofs is None or look is None:
            return None
        taken = self._kernel.take(tree, old, target, step, proofs, look)
        if taken is None:
            return None
        trees.blocked += 0 if taken.outcome == MISSED else taken.refused
        for _ in range(taken.refused if margin else 0):
            self.margin.refuse()
        if taken.dangerous:
            trees.dangerous += 1
            self.threshold.refuse()
        if taken.outcome not in _ADDED:
            return Extension.TRAPPED, old
        new = trees.add(tree, self._kernel.places[0], old, taken.cost, taken.gradient)
        return _ADDED[taken.outcome], new

    def _look(self, trees: Trees, tree: Tree, old: int) -> Look | None:
        """Return how a step looks at danger; None where the kernel cannot."""
        danger = self._kernel.danger()
        if danger is None:
            return None
        slope, share, ceiling = _NO_SLOPE, 0.0, np.nan
        if self.descent.acts:
            slope, share = tree.gradient(old) / self.danger.slope, self.descent.share
        if self.threshold.acts:
            ceiling = self.threshold.ceiling(tree, old, trees)
            if np.isnan(ceiling):
                return None
        return Look(danger, slope, share, ceiling, trees.blocked, trees.dangerous)

    def _composed(self, trees: Trees, tree: Tree, old: int, target: FloatArray, step: float) -> tuple[Extension, int]:
        """Do so with whatever says what is free and dangerous, in the order of `take_step`."""
        q_old = tree.configurations[old]
        length, moved_to = steered(self.problem.bridge, q_old, target, step)
        if length <= step or not self.danger.weight:
            free = self._is_free(*tree.as_driven(q_old, moved_to[0]))
            outcome = Extension.REACHED if length <= step else Extension.ADVANCED
            if free:
                return outcome, trees.add(tree, moved_to[0], old)
            trees.blocked += outcome is Extension.ADVANCED
            return Extension.TRAPPED, old
        reach = self.descent.share * min(step, length - step)
        moved = self.descent.moved(moved_to, reach, lambda: tree.gradient(old))
        for q_new in (moved_to[0],) if moved is None else (moved, moved_to[0]):
            proof_first = trees.blocked > RARE * trees.dangerous
            if proof_first and not self._is_unblocked(trees, tree, q_old, q_new):
                continue
            cost, gradient = self._examined(q_new)
            if not self.threshold.tolerates(cost, tree, old, trees):
                trees.dangerous += 1
                break
            if proof_first or self._is_unblocked(trees, tree, q_old, q_new):
                return Extension.ADVANCED, trees.add(tree, q_new, old, cost, gradient)
        return Extension.TRAPPED, old

    def _is_unblocked(self, trees: Trees, tree: Tree, q_old: FloatArray, q_new: FloatArray) -> bool:
        """Return whether a step of a tree is free; count it where it is not."""
        free = self._is_free(*tree.as_driven(q_old, q_new))
        trees.blocked += not free
        return free

    def _examined(self, q: FloatArray) -> tuple[float, FloatArray | None]:
        """Return the danger of a candidate, and the gradient that a step from it will need; NaN if not needed."""
        if not self.threshold.acts:
            return np.nan, None
        if self.descent.acts:
            return self.danger.cost.value_and_gradient(q)
        return float(self.danger.cost.values(q[None])[0]), None


class ShortSteps:
    """Decides whether a shorter step is tried after a whole one was trapped, and how long it is.

    Short steps lead out of narrow places; elsewhere they would double the checks and make for paths that graze
    obstacles. So while danger has weight only nodes whose last step was trapped, too, get one.
    """

    def __init__(self, bridge: StateBridge, danger: DangerWeight) -> None:
        self._bridge, self._danger = bridge, danger
        self.allowed = True

    def is_due(self, tree: Tree, node: int) -> bool:
        """Note that a step from a node was trapped; return whether a shorter one is to be tried now."""
        if not self.allowed:
            return False
        narrow = node in tree.trapped
        tree.trapped.add(node)
        return narrow or not self._danger.weight

    def nearer(self, q: FloatArray, target: FloatArray, step: float, rng: np.random.Generator) -> FloatArray:
        """Return a configuration (n,) on the way to a target, log-uniformly nearer than a whole step [rad]."""
        delta = self._bridge.difference(q, target)
        length = sqrt(delta @ delta)
        step = _SHORTEST ** rng.random() * min(length, step)
        return self._bridge.inside(q + (step / length) * delta) if length else q


_POINTS = 8  # at which the danger of a straight motion is evaluated


class ElasticBand:
    """Treats paths as elastic bands (Quinlan 1994); every new motion is checked."""

    def __init__(self, problem: PlanningProblem, danger: DangerWeight, descent: TangentialDescent) -> None:
        self._problem, self._danger, self._descent = problem, danger, descent

    def settled(self, path: FloatArray, step: float, ptc: Any, margin: float = 0.0) -> FloatArray:
        """Return a path (N, n) contracted where that is as safe, then bent away from danger.

        New motions keep a margin [m] from obstacles; those longer than twice the planner's range `step` [rad] are bent.
        """
        band = [path[0]]
        at = 0
        while at < len(path) - 1:
            at = self._farthest(path, at, ptc, margin)
            band += [*self.bent(band[-1], path[at], step, ptc, margin), path[at]]
        return np.array(band)

    def bent(self, start: FloatArray, end: FloatArray, step: float, ptc: Any, margin: float = 0.0) -> list[FloatArray]:
        """Return way points between two configurations (n,): the middle, moved sideways, and those of the halves.

        Motions no longer than twice the range `step` stay straight, and so do those whose halves would not be free, or
        not keep a margin [m].
        """
        delta = self._problem.bridge.difference(start, end)
        length = sqrt(delta @ delta)
        if not self._descent.acts or length <= 2 * step or ptc():
            return []
        middle = self._descent.moved(np.array([start + delta / 2, delta / length]), self._descent.share * step)
        is_free = self._problem.motion_is_free
        if middle is None or not (is_free(start, middle, margin) and is_free(middle, end, margin)):
            return []
        halves = ((start, middle), (middle, end))
        before, after = (self.bent(*half, step, ptc, margin) for half in halves)
        return [*before, middle, *after]

    def _farthest(self, path: FloatArray, at: int, ptc: Any, margin: float) -> int:
        """Return the way point to which a straight motion from way point `at`, as safe and free, leads the farthest."""
        end = len(path) - 1
        while end > at + 1 and not ptc():
            is_as_safe = self._is_as_safe(path[at : end + 1])
            if is_as_safe and self._problem.motion_is_free(path[at], path[end], margin):
                return end
            end = (at + end) // 2
        return at + 1

    def _is_as_safe(self, path: FloatArray) -> bool:
        """Return whether the straight motion between the ends of a path (N, n) is no more dangerous on an average."""
        if not self._danger.weight:
            return True
        bridge = self._problem.bridge
        t = np.linspace(0.0, 1.0, _POINTS)[:, None]
        straight = path[0] + t * bridge.difference(path[0], path[-1])
        costs = self._danger.cost.values(np.vstack([bridge.wrapped(straight), path]))
        return bool(costs[:_POINTS].mean() <= costs[_POINTS:].mean())
