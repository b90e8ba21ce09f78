"""The planning problem on arrays; danger and clearance in a planner's decisions: weight, decay, threshold, margin."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import sqrt
from typing import Any

import numpy as np
from ompl import base as ob

from safe_ompl.collision import MotionProver
from safe_ompl.common import FloatArray
from safe_ompl.planning.ompl import CertifiedMotionValidator, CollisionFreeValidity, StateCost, bridge_of
from safe_ompl.planning.planners.growth import danger_share, lowered_margin
from safe_ompl.planning.planners.tree import Trees
from safe_ompl.robot import Coordinates, JointLimits, Robot, ScratchState

# The share of the clearance of start and goal that is kept. With all of it no motion could leave them.
_KEPT_SHARE = 0.8
# A smaller margin is no margin.
_LEAST_MARGIN = 5e-4  # [m]
_EXAMINED = 5  # starts, and goals
# Of the logarithm of what start and goal keep, where only questions of yes and no tell: to within 15 %.
_HALVINGS = 5
# Motions that are refused before the margin falls. Where nothing is dangerous no gradient moves steps away from
# obstacles, so that more of them are refused in the open, too.
_REFUSALS, _REFUSALS_WITHOUT_DANGER = 12, 48
# If start and goal keep less than this, penalties cost time and lead nowhere else.
WORTHWHILE = 0.02  # [m]


class PlanningProblem:
    """A space with its validity checker, motion validator and cost, asked with arrays instead of OMPL's states."""

    def __init__(self, si: Any) -> None:
        self.bridge = bridge_of(si)
        bridge = self.bridge
        self.coordinates = Coordinates(bridge.lower, bridge.upper, bridge.circular, bridge.rotations)
        self._si = si
        self._from, self._to = ScratchState(self.bridge), ScratchState(self.bridge)
        self._limits: tuple[MotionProver, JointLimits] | None = None
        self.take(None)

    def take(self, objective: Any) -> None:
        """Take another objective, or None."""
        self.cost = StateCost(objective, self.bridge)
        self._slope: float | None = None

    @property
    def slope(self) -> float:
        """The median of ‖∇cost‖ over valid configurations; measured when it is first asked for."""
        if self._slope is None:
            self._slope = self.cost.slope(self._si)
        return self._slope

    @property
    def extent(self) -> float:
        """The length of the diagonal of the bounds [rad or m]; of a joint that turns no more than one turn counts."""
        if self.robot is None:
            return self.bridge.extent
        sides = self.bridge.upper - self.bridge.lower
        # More than one turn of a joint makes a space no larger to plan in.
        return float(np.linalg.norm(np.where(self.robot.prismatic, sides, np.minimum(sides, 2 * np.pi))))

    def is_valid(self, q: FloatArray) -> bool:
        """Return whether `q: (n,)` is valid."""
        return bool(self._si.isValid(self._from.set(q)))

    def motion_is_free(self, start: FloatArray, end: FloatArray, margin: float = 0.0) -> bool:
        """Return whether the motion between two configurations (n,) is free.

        With a margin [m], also whether it keeps that distance from obstacles, where a `MotionProver` can prove it.
        """
        # The detour by OMPL's states would cost a sixth of a check.
        motion = self.motion_prover
        if motion is not None:
            return motion.is_free(start, end, margin, self.limits_of(motion))
        return bool(self._si.checkMotion(self._from.set(start), self._to.set(end)))

    def limits_of(self, motion: MotionProver) -> JointLimits:
        """Return the joint limits of the robot that are also within the bounds of the space."""
        known = self._limits
        if known is None or known[0] is not motion:
            self._limits = known = motion, motion.checker.robot.joint_limits.within(*self.bridge.held)
        return known[1]

    @property
    def motion_prover(self) -> MotionProver | None:
        """What proves motions; None where the problem's motion validator is another one."""
        validator = self._si.getMotionValidator()
        return validator.motion if type(validator) is CertifiedMotionValidator else None

    @property
    def settings(self) -> tuple[Any, ...]:
        """What decides which states and motions are valid, to be compared: checker and validator, and what they use."""
        validity, validator = self._si.getStateValidityChecker(), self._si.getMotionValidator()
        known = isinstance(validity, CollisionFreeValidity)
        return validity, validator, *((validity.check, validity.checker.revision) if known else ())

    def valid_samples(self, rng: np.random.Generator, count: int, stop: Callable[[], bool]) -> FloatArray:
        """Return random configurations (count, n), uniform ones that may not be valid.

        Where the space information was given an allocator of valid state samplers, its samples are taken: (S, n), at
        most `count`, as such a sampler may fail. It may also take long, so that it is asked until `stop` says so.
        """
        sampler = self._si.allocValidStateSampler()
        # This is OMPL's sampler if no allocator was set.
        if type(sampler) is ob.UniformValidStateSampler:
            return self.random(rng, count)
        state = self._from.state
        rows = [self.bridge.read(state) for _ in range(count) if not stop() and sampler.sample(state)]
        return np.array(rows).reshape(-1, self.bridge.n)

    def random(self, rng: np.random.Generator, *count: int) -> FloatArray:
        """Return a uniform random configuration (n,), or several, (count, n)."""
        return self.bridge.between_bounds(rng.random((*count, self.bridge.n)))

    @property
    def robot(self) -> Robot | None:
        """The robot whose collisions the validity checker knows; None for a user's own checker."""
        validity = self._si.getStateValidityChecker()
        return validity.checker.robot if isinstance(validity, CollisionFreeValidity) else None

    def state(self, q: FloatArray) -> Any:
        """Return an `ob.State` at `q: (n,)`, which holds until the next question."""
        return self._from.set(q)


class DangerWeight:
    """The danger of configurations, and α: what it weighs against lengths, relative to its usual slope.

    0 plans classically. `scale` in [0, 1] is a factor of `alpha`, see `DangerDecay`.
    """

    def __init__(self, problem: PlanningProblem) -> None:
        self._problem = problem
        self.alpha = self.scale = 1.0

    @property
    def cost(self) -> StateCost:
        """The danger of configurations."""
        return self._problem.cost

    @property
    def slope(self) -> float:
        """The usual slope of the danger [danger/rad]; 0 where there is none."""
        return self._problem.slope

    @property
    def weight(self) -> float:
        """The weight of danger at present, in length per danger; 0 where danger is ignored."""
        return self.whole_weight * self.scale

    @property
    def whole_weight(self) -> float:
        """The weight of danger at a scale of 1."""
        # Without alpha the gradient is not needed.
        if not self.alpha:
            return 0.0
        return self.alpha / self.slope if self.slope else 0.0

    def prepare(self) -> None:
        """Measure the slope if it will be needed, so that planning need not."""
        if self.alpha:
            _ = self.slope


class DangerDecay:
    """Lowers the weight of danger the longer no path is found, so that danger and margin never cost a solution.

    After t turns the scale of the danger is 1/(1 + (t/`half_life`)⁴): 1/2 after `half_life` turns, and 1/100 after
    three times as many. With a half-life of 0 there is no decay. Turns that ignore danger keep no margin, either.
    """

    def __init__(self, danger: DangerWeight, margin: Margin) -> None:
        self._danger, self._margin = danger, margin
        self.half_life = 0.0
        self.turns = 0

    def reset(self) -> None:
        """Begin anew, with the whole weight."""
        self.turns = 0
        self._danger.scale = 1.0

    def turn(self, rng: np.random.Generator) -> None:
        """Begin a turn in which danger has its whole weight or, by chance, none."""
        if self.acts:
            self._danger.scale = float(rng.random() < self._share)
            self.turns += 1

    def fade(self) -> None:
        """Begin a turn in which danger has a little less weight than in the one before."""
        if self.acts:
            self._danger.scale = self._share
            self.turns += 1

    @property
    def acts(self) -> bool:
        """Whether there is a decay, and something that decays."""
        matters = not self._danger.cost.is_zero or self._margin.wanted > 0
        return self.half_life > 0 and self._danger.alpha > 0 and matters

    @property
    def _share(self) -> float:
        return danger_share(self.turns, self.half_life)


class Margin:
    """The clearance that motions should keep: nearly what start and goal keep, but no more than the largest.

    The danger field accounts for dangerous obstacles only, so a way around them could graze all others. So the margin
    belongs to every safe planner (α > 0), also where nothing is dangerous. Only turns that ignore danger keep none. It
    is proven by the same queries as that a motion is free. `largest`, `level`, the margin at present, and `allowed`,
    what start and goal allow, are in metres; before start and goal were examined there is no level.
    """

    def __init__(self, problem: PlanningProblem, danger: DangerWeight, least: float = _LEAST_MARGIN) -> None:
        self._problem, self._danger, self.least = problem, danger, least
        self.largest = 0.0
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self.level: float | None = None
        self.allowed = 0.0
        self.refusals = 0

    def begin(self, trees: Trees) -> None:
        """Take the margin that starts and goals of trees allow, unless that is known."""
        if self.is_unknown:
            self.begin_between([tree.roots for tree in (trees.start, trees.goal)])

    def begin_between(self, ends: Sequence[FloatArray]) -> None:
        """Take the margin that one of each of the `ends: (R, n)` allows, unless that is known."""
        if self.is_unknown:
            allowed = self._allowed_by([Q[:_EXAMINED] for Q in ends if len(Q)])
            self.level = self.allowed = allowed if allowed >= self.least else 0.0

    @property
    def is_unknown(self) -> bool:
        """Whether there is to be a margin, and start and goal were not examined yet."""
        return self.level is None and self.largest > 0 and self._danger.alpha > 0 and self._danger.scale > 0

    @property
    def in_force(self) -> float:
        """The margin [m] in this turn; 0 for none."""
        return self.wanted if self._danger.scale else 0.0

    @property
    def wanted(self) -> float:
        """The margin [m] in turns that do not ignore danger; 0 for none, as in classical planners."""
        return self.level if self.level and self._danger.alpha else 0.0

    @property
    def patience(self) -> int:
        """How many motions are refused before the margin falls."""
        return _REFUSALS if self._danger.whole_weight else _REFUSALS_WITHOUT_DANGER

    def motion_is_free(self, start: FloatArray, end: FloatArray) -> bool:
        """Return whether the motion between two configurations (n,) is free, and keeps the margin; count a refusal."""
        margin = self.in_force
        if self._problem.motion_is_free(start, end, margin):
            return True
        if margin:
            self.refuse()
        return False

    def refuse(self) -> None:
        """Count a refusal; when `patience` is used up the margin is lowered."""
        self.refusals += 1
        if self.refusals % self.patience == 0:
            self.lower()

    def lower(self) -> None:
        """Lower the margin to 60 %, or to none where little is left."""
        if self.level:
            self.level = lowered_margin(self.level, self.least)

    def _allowed_by(self, ends: list[FloatArray]) -> float:
        """Return the largest margin [m] that one of each of the `ends: (R, n)` allows; 0 for none."""
        motion = self._problem.motion_prover
        if motion is None:
            return 0.0
        bounds, kept = motion.checker.pairs.bounds, self.largest / _KEPT_SHARE
        if bounds.bounded:
            # Exact distances would cost more than a whole easy problem.
            return _KEPT_SHARE * min(float(bounds.clearances(Q, kept).max()) for Q in ends) if ends else self.largest

        def is_allowed(margin: float) -> bool:
            return all(any(motion.is_free(q, q, margin / _KEPT_SHARE) for q in Q) for Q in ends)

        if is_allowed(self.largest):
            return self.largest
        low, high = self.least, self.largest
        if not is_allowed(low):
            return 0.0
        for _ in range(_HALVINGS):
            middle = sqrt(low * high)
            low, high = (middle, high) if is_allowed(middle) else (low, middle)
        return low
