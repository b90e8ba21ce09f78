"""The planning problem on arrays, and the weight, decay and margin by which planners consider danger and clearance."""

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

# The margin is at most this share of the clearance of start and goal. With the whole clearance no motion could leave.
_KEPT_SHARE = 0.8
# A smaller margin is no margin.
_LEAST_MARGIN = 5e-4  # [m]
_EXAMINED = 5  # starts, and goals
# Bisections of the logarithm of the clearance of start and goal, if it must be found by yes-or-no queries: to 15 %.
_HALVINGS = 5
# The margin falls after this many refused motions. If nothing is dangerous, no gradient moves steps away from
# obstacles, so more motions are refused in open space, too.
_REFUSALS, _REFUSALS_WITHOUT_DANGER = 12, 48
# If start and goal have less clearance than this, penalties take time without changing the path.
WORTHWHILE = 0.02  # [m]


class PlanningProblem:
    """A space with validity checker, motion validator and cost, with an interface of arrays instead of OMPL states."""

    def __init__(self, si: Any) -> None:
        self.bridge = bridge_of(si)
        bridge = self.bridge
        self.coordinates = Coordinates(bridge.lower, bridge.upper, bridge.circular, bridge.rotations)
        self._si = si
        self._from, self._to = ScratchState(self.bridge), ScratchState(self.bridge)
        self._limits: tuple[MotionProver, JointLimits] | None = None
        self.take(None)

    def take(self, objective: Any) -> None:
        """Set the objective; None: no objective."""
        self.cost = StateCost(objective, self.bridge)
        self._slope: float | None = None

    @property
    def slope(self) -> float:
        """The median of ‖∇cost‖ over valid configurations, computed on first use."""
        if self._slope is None:
            self._slope = self.cost.slope(self._si)
        return self._slope

    @property
    def extent(self) -> float:
        """The length of the diagonal of the bounds [rad or m]; a revolute joint counts at most one full turn."""
        if self.robot is None:
            return self.bridge.extent
        sides = self.bridge.upper - self.bridge.lower
        # Further turns of a joint do not make the space larger for planning.
        return float(np.linalg.norm(np.where(self.robot.prismatic, sides, np.minimum(sides, 2 * np.pi))))

    def is_valid(self, q: FloatArray) -> bool:
        """Return whether `q: (n,)` is valid."""
        return bool(self._si.isValid(self._from.set(q)))

    def motion_is_free(self, start: FloatArray, end: FloatArray, margin: float = 0.0) -> bool:
        """Return whether the motion between two configurations (n,) is free.

        With a margin [m], the motion must also keep this distance from obstacles, if there is a `MotionProver`.
        """
        # Converting to OMPL states would add a sixth to the time of a check.
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
        """The prover of motions; None if the motion validator is no `CertifiedMotionValidator`."""
        validator = self._si.getMotionValidator()
        return validator.motion if type(validator) is CertifiedMotionValidator else None

    @property
    def settings(self) -> tuple[Any, ...]:
        """A key for comparison of everything that decides validity: checker, validator, and their settings."""
        validity, validator = self._si.getStateValidityChecker(), self._si.getMotionValidator()
        known = isinstance(validity, CollisionFreeValidity)
        return validity, validator, *((validity.check, validity.checker.revision) if known else ())

    def valid_samples(self, rng: np.random.Generator, count: int, stop: Callable[[], bool]) -> FloatArray:
        """Return uniform random configurations (count, n), which may be invalid.

        If the space information has an allocator of valid state samplers, its sampler is used and returns (S, n)
        configurations, at most `count`, because it may fail. It may also be slow, so it is called until `stop` is true.
        """
        sampler = self._si.allocValidStateSampler()
        # This is OMPL's sampler if no allocator was set.
        if type(sampler) is ob.UniformValidStateSampler:
            return self.random(rng, count)
        state = self._from.state
        rows = [self.bridge.read(state) for _ in range(count) if not stop() and sampler.sample(state)]
        return np.array(rows).reshape(-1, self.bridge.n)

    def random(self, rng: np.random.Generator, *count: int) -> FloatArray:
        """Return a uniform random configuration (n,), or `count` of them (count, n)."""
        return self.bridge.between_bounds(rng.random((*count, self.bridge.n)))

    @property
    def robot(self) -> Robot | None:
        """The robot of the validity checker; None if it is no `CollisionFreeValidity`."""
        validity = self._si.getStateValidityChecker()
        return validity.checker.robot if isinstance(validity, CollisionFreeValidity) else None

    def state(self, q: FloatArray) -> Any:
        """Return an `ob.State` at `q: (n,)`, which the next call of any method may overwrite."""
        return self._from.set(q)


class DangerWeight:
    """The weight α of danger against length, relative to the typical slope of the danger; 0 plans classically.

    `scale` in [0, 1] is a factor of `alpha`, see `DangerDecay`.
    """

    def __init__(self, problem: PlanningProblem) -> None:
        self._problem = problem
        self.alpha = self.scale = 1.0

    @property
    def cost(self) -> StateCost:
        """The cost of configurations, which is their danger."""
        return self._problem.cost

    @property
    def slope(self) -> float:
        """The typical slope of the danger [danger/rad]; 0 without danger."""
        return self._problem.slope

    @property
    def weight(self) -> float:
        """The present weight of danger [rad/danger]; 0 if danger is ignored."""
        return self.whole_weight * self.scale

    @property
    def whole_weight(self) -> float:
        """The weight of danger at a scale of 1."""
        # Without alpha the gradient is not needed.
        if not self.alpha:
            return 0.0
        return self.alpha / self.slope if self.slope else 0.0

    def prepare(self) -> None:
        """Compute the slope before planning begins, if it is needed."""
        if self.alpha:
            _ = self.slope


class DangerDecay:
    """Lowers the weight of danger while no path is found, so that danger and margin never prevent a solution.

    After t iterations the scale of the danger is 1/(1 + (t/`half_life`)⁴): 1/2 after `half_life` iterations, and 1/100
    after three times as many. A half-life of 0 means no decay. Iterations that ignore danger also ignore the margin.
    """

    def __init__(self, danger: DangerWeight, margin: Margin) -> None:
        self._danger, self._margin = danger, margin
        self.half_life = 0.0
        self.turns = 0

    def reset(self) -> None:
        """Restart the decay with the full weight."""
        self.turns = 0
        self._danger.scale = 1.0

    def turn(self, rng: np.random.Generator) -> None:
        """Begin an iteration in which danger has its full weight or, at random, none."""
        if self.acts:
            self._danger.scale = float(rng.random() < self._share)
            self.turns += 1

    def fade(self) -> None:
        """Begin an iteration in which danger has slightly less weight than in the previous one."""
        if self.acts:
            self._danger.scale = self._share
            self.turns += 1

    @property
    def acts(self) -> bool:
        """Whether there is a decay, and danger or a margin on which it acts."""
        matters = not self._danger.cost.is_zero or self._margin.wanted > 0
        return self.half_life > 0 and self._danger.alpha > 0 and matters

    @property
    def _share(self) -> float:
        return danger_share(self.turns, self.half_life)


class Margin:
    """The clearance that motions should keep: slightly less than that of start and goal, but at most `largest`.

    The danger field accounts for dangerous obstacles only, so a path around them could graze all others. Therefore
    every safe planner (α > 0) has a margin, even if nothing is dangerous, except in iterations that ignore danger. The
    queries that prove a motion free also prove the margin. `largest`, `level` (the present margin) and `allowed` (the
    margin that start and goal allow) are in [m]. `level` is None until start and goal are examined.
    """

    def __init__(self, problem: PlanningProblem, danger: DangerWeight, least: float = _LEAST_MARGIN) -> None:
        self._problem, self._danger, self.least = problem, danger, least
        self.largest = 0.0
        self.reset()

    def reset(self) -> None:
        """Reset the margin for another start and goal."""
        self.level: float | None = None
        self.allowed = 0.0
        self.refusals = 0

    def begin(self, trees: Trees) -> None:
        """Compute the margin that starts and goals of trees allow, unless it is known."""
        if self.is_unknown:
            self.begin_between([tree.roots for tree in (trees.start, trees.goal)])

    def begin_between(self, ends: Sequence[FloatArray]) -> None:
        """Compute the margin that at least one configuration of each of the `ends: (R, n)` allows, unless known."""
        if self.is_unknown:
            allowed = self._allowed_by([Q[:_EXAMINED] for Q in ends if len(Q)])
            self.level = self.allowed = allowed if allowed >= self.least else 0.0

    @property
    def is_unknown(self) -> bool:
        """Whether a margin is wanted, but start and goal were not examined yet."""
        return self.level is None and self.largest > 0 and self._danger.alpha > 0 and self._danger.scale > 0

    @property
    def in_force(self) -> float:
        """The margin [m] in this iteration; 0 for none."""
        return self.wanted if self._danger.scale else 0.0

    @property
    def wanted(self) -> float:
        """The margin [m] in iterations that do not ignore danger; 0 for none, as in classical planners."""
        return self.level if self.level and self._danger.alpha else 0.0

    @property
    def patience(self) -> int:
        """The number of refused motions after which the margin falls."""
        return _REFUSALS if self._danger.whole_weight else _REFUSALS_WITHOUT_DANGER

    def motion_is_free(self, start: FloatArray, end: FloatArray) -> bool:
        """Return whether the motion between two configurations (n,) is free and keeps the margin; count refusals."""
        margin = self.in_force
        if self._problem.motion_is_free(start, end, margin):
            return True
        if margin:
            self.refuse()
        return False

    def refuse(self) -> None:
        """Count a refusal, and lower the margin after every `patience` refusals."""
        self.refusals += 1
        if self.refusals % self.patience == 0:
            self.lower()

    def lower(self) -> None:
        """Lower the margin to 60 %, or to 0 if it would be below `least`."""
        if self.level:
            self.level = lowered_margin(self.level, self.least)

    def _allowed_by(self, ends: list[FloatArray]) -> float:
        """Return the largest margin [m] that at least one configuration of each of the `ends: (R, n)` allows."""
        motion = self._problem.motion_prover
        if motion is None:
            return 0.0
        bounds, kept = motion.checker.pairs.bounds, self.largest / _KEPT_SHARE
        if bounds.bounded:
            # Bounds of distances suffice; exact distances would take longer than solving an easy problem.
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
