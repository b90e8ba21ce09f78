"""Growth of two trees by turns and steps of a kernel, whose questions are answered here; and elastic bands."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from enum import IntEnum
from math import sqrt
from typing import Any

import numpy as np

from safe_ompl.collision import DistanceBounds, EdgeTables, MotionProver, Required, RequiredDistances
from safe_ompl.common import FloatArray
from safe_ompl.danger import DangerField
from safe_ompl.danger.kernels import PointDanger
from safe_ompl.planning.planners import turns
from safe_ompl.planning.planners.problem import DangerDecay, DangerWeight, Margin, PlanningProblem
from safe_ompl.planning.planners.tree import Tree, Trees
from safe_ompl.planning.planners.turns import SEARCH, Proofs, Space, Step, take_turns
from safe_ompl.robot import StateBridge, plain
from safe_ompl.robot.kernels import descend, steer

_STEPS = 40  # between two looks at the clock: some ms, beside which the call of the kernel takes little
_DRAWS = 1000  # random numbers that are drawn at once
_NO_DANGER = PointDanger.of_nothing()
_NO_PROOFS = Proofs(EdgeTables.of_nothing(), np.empty(0), np.empty(0, bool))
_POINTS = 8  # at which the danger of a straight motion is evaluated


class Extension(IntEnum):
    """Outcome of EXTEND: no new node, one on the way, or one at the target."""

    TRAPPED = turns.TRAPPED
    ADVANCED = turns.ADVANCED
    REACHED = turns.REACHED


def steered(bridge: StateBridge, q: FloatArray, target: FloatArray, step: float) -> tuple[float, FloatArray]:
    """Return ρ(q, target), and where a step [rad] from `q` to `target: (n,)` leads and its direction, NaN for none."""
    moved: FloatArray = np.empty((2, len(q)))
    return float(steer(q, plain(target), bridge.circular, step, moved)), moved


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

    def moved(self, step: FloatArray, reach: float) -> FloatArray | None:
        """Return, where it acts, the first row of `step: (2, n)` moved down the gradient, at right angles to the other.

        That is a unit vector, and written over. The motion is at most the share of the range `reach`, shorter where the
        danger hardly changes; None where it does not change.
        """
        bridge, slope = self._bridge, self._danger.cost.value_and_gradient(step[0])[1] / self._danger.slope
        if not descend(step, slope, self.share * reach, bridge.lower, bridge.upper, bridge.circular):
            return None
        return np.asarray(step[1])


@dataclass(eq=False)
class Growth:
    """Grows two trees by turns (§4.4), or single steps (§4.3), of a kernel (`turns.py`), and answers what that asks.

    `rise` is the share by which the threshold on danger rises after every eight refusals; 0: there is none.
    """

    problem: PlanningProblem
    danger: DangerWeight
    descent: TangentialDescent
    margin: Margin
    decay: DangerDecay | None = None
    rise: float = 0.0

    def __post_init__(self) -> None:
        bridge, n = self.problem.bridge, self.problem.bridge.n
        self._space = Space(bridge.lower, bridge.upper, bridge.circular)
        self._step = Step(np.zeros(n), np.zeros((2, n)), np.zeros(n), np.zeros((1, n)), np.zeros((1, n)))
        self._known: tuple[RequiredDistances, DistanceBounds, Proofs | None] | None = None
        self._field: tuple[DangerField, PointDanger | None] | None = None
        self._rng: np.random.Generator | None = None
        self._draws, self._search = np.empty(0), np.zeros(1, SEARCH)  # what was drawn and not used yet
        self.reset()

    def reset(self) -> None:
        """Begin anew, with other trees."""
        self._draws = self._draws[int(self._search[0]["drawn"]) :]
        self._search = np.zeros(1, SEARCH)
        self._search["in_a_row"] = 1

    def extend(self, trees: Trees, tree: Tree, old: int, target: FloatArray, reach: float) -> tuple[Extension, int]:
        """EXTEND: add a node at most `reach` [rad] from node `old` towards `target: (n,)`; return outcome and node."""
        s = self._search[0]
        s["phase"], s["role"], s["side"], s["old"] = turns.STEP, turns.ALONE, tree is trees.goal, old
        s["range"], s["answer"] = reach, -1
        self._step.target[:] = target
        while self.go_on(trees) != turns.DONE:
            pass
        outcome = Extension(int(s["outcome"]))
        return outcome, old if outcome is Extension.TRAPPED else int(s["node"])

    def begin(self, rng: np.random.Generator, reach: float, ignored: float, left: int) -> None:
        """Begin with the turn of the start's tree, with steps of at most `reach` [rad].

        In a share `ignored` of the choices of a node danger has no weight. Only so many turns are `left`; −1: any.
        """
        s = self._search[0]
        s["phase"], s["growing"], s["answer"] = turns.TURN, 0, -1
        s["range"], s["ignored"], s["left"] = reach, ignored, left
        if rng is not self._rng:
            self._rng, self._draws, s["drawn"] = rng, np.empty(0), 0

    def go_on(self, trees: Trees, enough: int = sys.maxsize) -> int:
        """Go on until something is asked for; return what, with its answer if it can be given here.

        With more than `enough` nodes GOALS are asked for.
        """
        s, motion, field = self._search[0], self.problem.motion_prover, self.problem.cost.field
        proofs = None if motion is None else self._proofs(motion)
        danger = None if field is None else self._point_danger(field.frozen())
        s["own_proofs"], s["own_danger"], s["enough"] = proofs is not None, danger is not None, enough
        self._load(trees)
        asked = take_turns(
            self._search,
            (trees.start.arrays, trees.goal.arrays),
            (trees.start.nearest.tree, trees.goal.nearest.tree),
            self._space,
            proofs or _NO_PROOFS,
            danger or _NO_DANGER,
            self._step,
            self._draws,
        )
        self._save(trees)
        if motion is not None:
            motion.checker.counts.bound_queries += int(s["places"])
        if field is not None and danger is not None:
            field.count(int(s["evaluations"]), len(danger.points.charges))
        self._answer(asked, trees)
        return int(asked)

    def met(self, trees: Trees) -> tuple[Tree, int, Tree, int]:
        """Return each tree with its node where they have met."""
        s, both = self._search[0], (trees.start, trees.goal)
        return both[s["growing"]], int(s["new"]), both[1 - s["growing"]], int(s["node"])

    def _load(self, trees: Trees) -> None:
        """Give the kernel what the parts know."""
        s, danger, margin, decay = self._search[0], self.danger, self.margin, self.decay
        s["alpha"], s["scale"] = danger.whole_weight, danger.scale
        s["slope"] = danger.slope if danger.whole_weight else 0.0
        s["share"] = self.descent.share if danger.cost.has_gradients else 0.0
        s["rise"], s["nodes"], s["steps"] = self.rise, trees.counts.nodes, _STEPS
        s["margin"], s["least_margin"], s["too_near"] = margin.wanted, margin.least, margin.refusals
        s["patience"] = margin.patience
        if decay is not None:
            s["half_life"], s["turns"] = decay.half_life if decay.acts else 0.0, decay.turns
        s["kept"], s["places"], s["evaluations"] = -1.0, 0, 0

    def _save(self, trees: Trees) -> None:
        """Tell the parts what has become of it."""
        s, margin = self._search[0], self.margin
        self.danger.scale, trees.counts.nodes = float(s["scale"]), int(s["nodes"])
        if margin.wanted:
            margin.level, margin.refusals = float(s["margin"]), int(s["too_near"])
        if self.decay is not None:
            self.decay.turns = int(s["turns"])

    def _answer(self, asked: int, trees: Trees) -> None:
        """Give the kernel what it asks for, but for goals and a look at the clock."""
        s, step, cost = self._search[0], self._step, self.problem.cost
        tree, old, new = (trees.start, trees.goal)[s["side"]], int(s["old"]), step.places[1 - s["candidate"]]
        if asked == turns.ROOM:
            tree.make_room()
        elif asked == turns.DRAWS:
            self._rng = self._rng or np.random.default_rng()
            more = self._rng.random(max(_DRAWS, 2 * len(new)))
            self._draws, s["drawn"] = np.concatenate([self._draws[s["drawn"] :], more]), 0
        elif asked == turns.COSTS:
            _ = trees.start.costs, trees.goal.costs
        elif asked == turns.GRADIENT:
            tree.gradient(old)
        elif asked == turns.MOTION:
            ends = tree.as_driven(tree.configurations[old], new)
            s["answer"] = self.problem.motion_is_free(*ends, self.margin.in_force)
        elif asked == turns.COST:
            if s["share"] > 0:
                s["cost"], step.gradients[0] = cost.value_and_gradient(new)
            else:
                s["cost"] = cost.values(new[None])[0]
            s["answer"] = 1

    def _proofs(self, motion: MotionProver) -> Proofs | None:
        """Return what proofs need; None where bounds do not suffice, or another thread moves obstacles."""
        required, changes = motion.required, motion.checker.changes
        done, bounds, known = changes.done, required.pairs.bounds, self._known
        if known is None or known[0] is not required or known[1] is not bounds:
            limits, least, meets = self.problem.limits_of(motion), required.least, required.pairs.meets_obstacle
            tables = None if motion.limits else bounds.edge_tables(limits, Required.of(least.copy()), motion.floor)
            proofs = None if tables is None else Proofs(tables, least.copy(), meets.copy())
            known = self._known = required, bounds, proofs
        return known[2] if changes.begun == done else None

    def _point_danger(self, field: DangerField) -> PointDanger | None:
        """Return what the kernel needs for the danger; None where it cannot compute that."""
        if self._field is None or self._field[0] is not field:
            usable = len(field.points) > 0 and field.robot.coupling.trivial
            self._field = field, field.for_kernels() if usable else None
        return self._field[1]


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
        middle = self._descent.moved(np.array([start + delta / 2, delta / length]), step)
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
