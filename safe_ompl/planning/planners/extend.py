"""EXTEND: one step of a tree towards a configuration, with a tangential descent from danger; and elastic bands.

A step that heeds danger is taken in one call of a kernel where its motions are proven by bounds of distances alone, and
costs are a danger field's at fixed points: steer, descent, danger, proof. What bounds do not decide, and what a class
of a user's own is asked, is composed of the same parts, with the same outcome.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from math import nan, sqrt
from typing import Any

import numpy as np

from safe_ompl.collision import CollisionChecker, DistanceBounds, RequiredDistances, edge_memory, prove_curve
from safe_ompl.common import BoolArray, FloatArray, IntArray, caller
from safe_ompl.danger import DangerField
from safe_ompl.danger.kernels import PointDanger, dangers
from safe_ompl.planning.ompl import StateBridge
from safe_ompl.planning.planners.problem import AdaptiveThreshold, DangerWeight, Margin, PlanningProblem
from safe_ompl.planning.planners.tree import Tree, Trees
from safe_ompl.robot import plain
from safe_ompl.robot.kernels import descend, lay_edge, steer

_RARE = 4  # if obstacles refuse so many times as many steps as danger does, proofs go first
_POINTS = 8  # at which the danger of a straight motion is evaluated
_NO_SLOPE: FloatArray = np.empty(0)


class Extension(Enum):
    """Outcome of EXTEND."""

    TRAPPED = "no new node"
    ADVANCED = "a new node on the way"
    REACHED = "a new node at the target"


# How a step in a kernel ends: the target was within the step, and is reached or missed; or the step ended before it.
TRAPPED, ADVANCED, REACHED, MISSED, UNDECIDED = range(5)
_ADDED = {ADVANCED: Extension.ADVANCED, REACHED: Extension.REACHED}


def steered(bridge: StateBridge, q: FloatArray, target: FloatArray, step: float) -> tuple[float, FloatArray]:
    """Return ρ(q, target), and where a step [rad] from `q` to `target: (n,)` leads and its direction, NaN for none."""
    moved: FloatArray = np.empty((2, len(q)))
    return float(steer(q, plain(target), bridge.circular, step, moved)), moved


@caller
def take_step(
    q: FloatArray,
    target: FloatArray,
    step: float,
    backwards: bool,
    lower: FloatArray,
    upper: FloatArray,
    wraps: BoolArray,
    danger: PointDanger,
    slope: FloatArray,
    share: float,
    ceiling: float,
    blocked: int,
    too_dangerous: int,
    joints: Any,
    bodies: Any,
    starts: IntArray,
    vertices: FloatArray,
    pair_bodies: IntArray,
    radii: FloatArray,
    reaches: FloatArray,
    certain: FloatArray,
    coupling: FloatArray,
    limits: FloatArray,
    required: FloatArray,
    floor: float,
    edge: FloatArray,
    left: FloatArray,
    suspects: IntArray,
    places: FloatArray,
    gradients: FloatArray,
) -> tuple[int, int, int, int, int, float]:
    """Take a step from q towards a target (n,), no longer than `step`.

    Return how it ended, and how many candidates were refused, as not free and as too dangerous; at how many places of
    motions bounds were looked at, how many dangers were computed, and the last one. Where the step leads is written to
    the first row of `places: (2, n)`. The arguments of a proof are those of `edge_tables`; `edge`, `left` and
    `suspects` those of `edge_memory`. An edge that is driven towards q is proven `backwards`.

    Steps that do not reach the target may descend a `slope: (n,)` of the danger sideways, by the `share` of a step at
    most; 0: none. They must be no more dangerous than the ceiling; NaN: there is none, and no danger is computed. The
    danger's gradient there is written to `gradients: (1 or 0, n)`; its joints are the planned ones. How many candidates
    were `blocked`, or `too_dangerous`, before says what is looked at first.
    """
    length = steer(q, target, wraps, step, places)
    outcome = ADVANCED if length > step else REACHED
    first, refused, dangerous, looked, evaluations, cost = 1, 0, 0, 0, 0, nan
    values = np.empty((1, len(q)))
    if length > step:
        # The reach of the descent shrinks as the target comes near, so that every step comes nearer to it.
        reach = share * min(step, length - step)
        if reach != 0.0 and descend(places, slope, reach, lower, upper, wraps):
            first = 0
    for candidate in range(first, 2):
        new = places[1 - candidate]
        # A proof costs as much as a danger. The danger comes first, because a motion that is refused for obstacles
        # lowers the margin; but where danger refuses few steps, computing it first would be wasted.
        proof_first = blocked + refused > _RARE * (too_dangerous + dangerous)
        free = False
        for turn in range(2):
            if proof_first == (turn == 0):
                start, end = (new, q) if backwards else (q, new)
                number, found = -1, 0
                if lay_edge(start, end, coupling, limits, edge):
                    number, _, found = prove_curve(
                        joints, bodies, starts, vertices, pair_bodies, radii, reaches, certain, edge, required,
                        floor, left, suspects,
                    )  # fmt: skip
                looked += found
                if number > 0:
                    return UNDECIDED, refused, dangerous, looked, evaluations, cost
                free = number == 0
                if not free:
                    refused += 1
                    break
            elif length > step and ceiling == ceiling:
                for i in range(len(q)):
                    values[0, i] = new[i]
                cost = dangers(danger.tables, values, danger.points, danger.aggregate, gradients)[0]
                evaluations += 1
                if not cost <= ceiling:
                    return TRAPPED, refused, 1, looked, evaluations, cost
        if free:
            for i in range(len(q)):
                places[0, i] = new[i]
            return outcome, refused, dangerous, looked, evaluations, cost
    outcome = TRAPPED if outcome == ADVANCED else MISSED
    return outcome, refused, dangerous, looked, evaluations, cost


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
        """Return the first row of `step: (2, n)` moved down the danger's gradient, at right angles to the second.

        That is a unit vector, and written over. The motion is at most `reach` long, shorter where the danger hardly
        changes; None where it does not change. `gradient` may be that at another place.
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
    """EXTEND of the safe RRTs (§4.3, §4.4): a step with a tangential descent, below a threshold on danger."""

    problem: PlanningProblem
    danger: DangerWeight
    descent: TangentialDescent
    threshold: AdaptiveThreshold
    margin: Margin

    def __post_init__(self) -> None:
        self._places: FloatArray = np.empty((2, self.problem.bridge.n))
        # With a margin, and without: the bounds that are asked, and what the kernel needs of them.
        self._known: dict[bool, tuple[RequiredDistances, DistanceBounds, tuple[Any, ...] | None]] = {}
        self._field: tuple[DangerField, PointDanger, bool] | None = None

    def extend(self, trees: Trees, tree: Tree, old: int, target: FloatArray, step: float) -> tuple[Extension, int]:
        """Add a node at most `step` [rad] from node `old` towards `target: (n,)`; return outcome and node.

        Where the step with descent is not free the straight one is tried. Targets within a step are neither moved nor
        held to the threshold: they are configurations that the path needs.
        """
        taken = self._at_once(trees, tree, old, target, step)
        return self._composed(trees, tree, old, target, step) if taken is None else taken

    def _at_once(
        self, trees: Trees, tree: Tree, old: int, target: FloatArray, step: float
    ) -> tuple[Extension, int] | None:
        """Do so in one call of a kernel; None, and nothing is done, where that cannot be."""
        margin = self.margin.in_force
        proofs = None if margin and self.margin.falls_next else self._proofs(margin)
        danger = None if proofs is None else self._point_danger()
        if proofs is None or danger is None:
            return None
        slope, share, ceiling = _NO_SLOPE, 0.0, nan
        if self.descent.acts:
            slope, share = tree.gradient(old) / self.danger.slope, self.descent.share
        if self.threshold.acts:
            ceiling = self.threshold.ceiling(tree, old, trees)
            if np.isnan(ceiling):
                return None
        checker, done, tables = proofs
        q, bridge = tree.configurations[old], self.problem.bridge
        gradients: FloatArray = np.empty((min(1, len(slope)), len(q)))
        look = danger, slope, share, ceiling, trees.blocked, trees.dangerous
        begin = q, plain(target), step, not tree.from_start, bridge.lower, bridge.upper, bridge.circular
        arguments: Any = *begin, *look, *tables, self._places, gradients
        outcome, refused, dangerous, looked, evaluations, cost = take_step(*arguments)
        checker.counts.bound_queries += looked
        if evaluations and (field := self.problem.cost.field) is not None:
            field.count(evaluations, len(field.points))
        if outcome == UNDECIDED or checker.changes.begun != done:
            return None
        trees.blocked += 0 if outcome == MISSED else refused
        for _ in range(refused if margin else 0):
            self.margin.refuse()
        if dangerous:
            trees.dangerous += 1
            self.threshold.refuse()
        if outcome not in _ADDED:
            return Extension.TRAPPED, old
        gradient = gradients[0] if len(gradients) and evaluations else None
        return _ADDED[outcome], trees.add(tree, self._places[0], old, cost, gradient)

    def _proofs(self, margin: float) -> tuple[CollisionChecker, int, tuple[Any, ...]] | None:
        """Return a checker, its changes that are done, and arguments of proofs; None where bounds do not suffice."""
        motion = self.problem.motion_prover
        if motion is None or motion.limits:
            return None
        done, required = motion.checker.changes.done, motion.required_with(margin)
        bounds, known = required.pairs.bounds, self._known.get(margin > 0)
        if known is None or known[0] is not required or known[1] is not bounds:
            limits = self.problem.limits_of(motion)
            tables = bounds.edge_tables(limits, required.allowed_for, motion.floor)
            if tables is not None:
                tables += edge_memory(len(limits.tables[0]), len(required.pairs.names))
            known = self._known[margin > 0] = required, bounds, tables
        return None if known[2] is None else (motion.checker, done, known[2])

    def _point_danger(self) -> PointDanger | None:
        """Return what the kernel needs for the danger; None where it cannot compute one that has weight."""
        field = self.problem.cost.field
        if field is None:
            return None
        frozen = field.frozen()
        if self._field is None or self._field[0] is not frozen:
            usable = len(frozen.points) > 0 and field.robot.coupling.trivial
            self._field = frozen, frozen.for_kernels(), usable
        return self._field[1] if self._field[2] or not self.danger.weight else None

    def _composed(self, trees: Trees, tree: Tree, old: int, target: FloatArray, step: float) -> tuple[Extension, int]:
        """Do so with whatever says what is free and dangerous, in the order of `take_step`."""
        q_old = tree.configurations[old]
        length, moved_to = steered(self.problem.bridge, q_old, target, step)
        if length <= step:
            free = self.margin.motion_is_free(*tree.as_driven(q_old, moved_to[0]))
            return (Extension.REACHED, trees.add(tree, moved_to[0], old)) if free else (Extension.TRAPPED, old)
        reach = self.descent.share * min(step, length - step)
        moved = self.descent.moved(moved_to, reach, lambda: tree.gradient(old))
        for q_new in (moved_to[0],) if moved is None else (moved, moved_to[0]):
            proof_first = trees.blocked > _RARE * trees.dangerous
            if proof_first and not self._is_unblocked(trees, tree, q_old, q_new):
                continue
            cost, gradient = np.nan, None  # not needed without a threshold
            if self.threshold.acts and self.descent.acts:
                cost, gradient = self.danger.cost.value_and_gradient(q_new)
            elif self.threshold.acts:
                cost = float(self.danger.cost.values(q_new[None])[0])
            if not self.threshold.tolerates(cost, tree, old, trees):
                trees.dangerous += 1
                break
            if proof_first or self._is_unblocked(trees, tree, q_old, q_new):
                return Extension.ADVANCED, trees.add(tree, q_new, old, cost, gradient)
        return Extension.TRAPPED, old

    def _is_unblocked(self, trees: Trees, tree: Tree, q_old: FloatArray, q_new: FloatArray) -> bool:
        """Return whether a step of a tree is free; count it where it is not."""
        free = self.margin.motion_is_free(*tree.as_driven(q_old, q_new))
        trees.blocked += not free
        return free


class ElasticBand:
    """Treats paths as elastic bands (Quinlan 1994); every new motion is checked."""

    def __init__(self, problem: PlanningProblem, danger: DangerWeight, descent: TangentialDescent) -> None:
        self._problem, self._danger, self._descent = problem, danger, descent

    def settled(self, path: FloatArray, step: float, ptc: Any, margin: float = 0.0) -> FloatArray:
        """Return a path (N, n) contracted where that is as safe, then bent away from danger as by `bent`."""
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
