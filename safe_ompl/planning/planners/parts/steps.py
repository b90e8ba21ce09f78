"""A step of a tree that heeds danger, in one call of a kernel: steer, descent, danger, proof.

It is for problems whose motions are proven by bounds of distances alone, and whose costs are a danger field's at fixed
points. What bounds do not decide is not decided here, and neither is what a class of a user's own is asked:
`parts.extend` composes those steps, with the same outcome. It composes steps without danger, too, which take as long.
"""

from __future__ import annotations

from math import nan
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.collision import CollisionChecker, DistanceBounds, RequiredDistances, edge_memory, prove_curve
from safe_ompl.common import BoolArray, FloatArray, IntArray, caller
from safe_ompl.danger import DangerField
from safe_ompl.danger.kernels import PointDanger, dangers
from safe_ompl.planning.planners.parts.problem import PlanningProblem
from safe_ompl.planning.planners.parts.tree import Tree
from safe_ompl.robot import plain
from safe_ompl.robot.kernels import descend, lay_edge, steer

RARE = 4  # if obstacles refuse so many times as many steps as danger does, proofs go first
# The target was within a step, and is reached or missed; or the step ended before it.
TRAPPED, ADVANCED, REACHED, MISSED, UNDECIDED = range(5)


class Taken(NamedTuple):
    """What became of a step: how it ended, and how many candidates were refused, as not free and as too dangerous.

    Also at how many places of motions bounds were looked at, how many dangers were computed, the last one, and its
    gradient (n,), if steps descend.
    """

    outcome: int
    refused: int
    dangerous: int
    places: int
    evaluations: int
    cost: float
    gradient: FloatArray | None


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
    moved: BoolArray,
    certain: FloatArray,
    coupling: FloatArray,
    limits: FloatArray,
    required: FloatArray,
    growth: FloatArray,
    floor: float,
    edge: FloatArray,
    left: FloatArray,
    suspects: IntArray,
    places: FloatArray,
    gradients: FloatArray,
) -> tuple[int, int, int, int, int, float]:
    """Take a step from q towards a target (n,), no longer than `step`; return what `Taken` says.

    Where it leads is written to the first row of `places: (2, n)`. The arguments of a proof are those of `edge_tables`;
    `edge`, `left` and `suspects` those of `edge_memory`. An edge that is driven towards q is proven `backwards`.

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
        proof_first = blocked + refused > RARE * (too_dangerous + dangerous)
        free = False
        for turn in range(2):
            if proof_first == (turn == 0):
                start, end = (new, q) if backwards else (q, new)
                number, found = -1, 0
                if lay_edge(start, end, coupling, limits, edge):
                    number, _, found = prove_curve(
                        joints, bodies, starts, vertices, pair_bodies, radii, moved, certain, edge, required, growth,
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


class Look(NamedTuple):
    """How a step is to look at danger: arguments of `take_step`, from `danger` to `too_dangerous`."""

    danger: PointDanger
    slope: FloatArray
    share: float
    ceiling: float
    blocked: int
    too_dangerous: int


class Proofs(NamedTuple):
    """How steps are proven: a checker, its changes that are done, and the arguments of `take_step` from `joints` on."""

    checker: CollisionChecker
    done: int
    arguments: tuple[Any, ...]


class StepKernel:
    """Calls the kernel of steps where it can do all that is asked of a step; `places: (2, n)` is where that led."""

    def __init__(self, problem: PlanningProblem) -> None:
        bridge = problem.bridge
        self.places: FloatArray = np.empty((2, bridge.n))
        self._problem = problem
        self._space = bridge.lower, bridge.upper, bridge.circular
        # With a margin, and without: the bounds that are asked, and what the kernel needs of them.
        self._known: dict[bool, tuple[RequiredDistances, DistanceBounds, tuple[Any, ...] | None]] = {}
        self._danger: tuple[DangerField, PointDanger | None] | None = None

    def proofs(self, margin: float) -> Proofs | None:
        """Return how steps are proven to keep a margin [m]; None where bounds say nothing, or more is to be asked."""
        motion = self._problem.motion_prover
        if motion is None or motion.limits or self._problem.limit is not None:
            return None
        done, required = motion.checker.changes.done, motion.required_with(margin)
        bounds, known = required.pairs.bounds, self._known.get(margin > 0)
        if known is None or known[0] is not required or known[1] is not bounds:
            limits = self._problem.limits_of(motion)
            tables = bounds.edge_tables(limits, required.bounded, motion.floor)
            if tables is not None:
                tables += edge_memory(len(limits.tables[0]), len(required.pairs.names))
            known = self._known[margin > 0] = required, bounds, tables
        return None if known[2] is None else Proofs(motion.checker, done, known[2])

    def take(self, tree: Tree, old: int, target: FloatArray, step: float, proofs: Proofs, look: Look) -> Taken | None:
        """Take a step [rad] from a node towards a target (n,); None where it is not decided."""
        checker = proofs.checker
        q, backwards = tree.configurations[old], not tree.from_start
        gradients: FloatArray = np.empty((min(1, len(look.slope)), len(q)))
        begin = q, plain(target), step, backwards
        arguments: Any = *begin, *self._space, *look, *proofs.arguments, self.places, gradients
        found = take_step(*arguments)
        taken = Taken(*found, gradients[0] if len(gradients) and found[4] else None)
        checker.counts.bound_queries += taken.places
        if taken.evaluations:
            self._count(taken.evaluations)
        return None if taken.outcome == UNDECIDED or checker.changes.begun != proofs.done else taken

    def danger(self) -> PointDanger | None:
        """Return what the kernel needs for the danger; None where the cost is another one, or joints are coupled."""
        field = self._problem.cost.field
        if field is None:
            return None
        frozen = field.frozen()
        if self._danger is None or self._danger[0] is not frozen:
            coupled = not field.robot.coupling.trivial
            self._danger = frozen, None if coupled else frozen.for_kernels()
        return self._danger[1]

    def _count(self, evaluations: int) -> None:
        """Count dangers that the kernel computed."""
        field = self._problem.cost.field
        if field is not None:
            field.counts.field_configurations += evaluations
            field.counts.field_points += evaluations * len(field.points)
