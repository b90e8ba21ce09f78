"""Constraints on every configuration and motion, and the check of single configurations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar
from weakref import ProxyType, proxy

import numpy as np

from safe_ompl.collision import (
    FLOOR,
    TOUCHING_ONLY,
    CollisionChecker,
    MotionLimit,
    MotionProver,
    MotionVerdict,
    Separation,
    ToolLimit,
)
from safe_ompl.common import FloatArray
from safe_ompl.danger import DangerLimit

Pairs = Sequence[tuple[str, str]]
Limit = TypeVar("Limit", bound=ToolLimit)
_TOGETHER = 64  # configurations


class UserCheck(ABC):
    """The user's own state validity checker, a `MotionLimit` for `MotionProver.limits` that is evaluated at samples.

    Reports call it `name`. Samples are at most `resolution` [rad or m] apart. Sampling proves nothing.
    """

    name: str
    resolution: float

    @abstractmethod
    def check(self, start: FloatArray, end: FloatArray) -> MotionVerdict:
        """Check the straight motion between `start` and `end: (n,)`."""

    @abstractmethod
    def allows(self, q: FloatArray, state: Any = None) -> bool:
        """Return whether the user's checker accepts a configuration (n,), which may also be given as an OMPL state."""


@dataclass(frozen=True)
class Constraints:
    """Requirements on every configuration and every motion, besides joint limits and collision.

    Constraints are changed with `setConstraints`, as ``setConstraints(replace(getConstraints(), danger=None))``.
    `separation` holds the distances from obstacles, at rest or moving; `danger` the largest danger; `tool` limits of
    the orientation and position of the tool. `user` is the user's own state validity checker, for which nothing can be
    proven. `from_dangerous` is a minimum clearance [m] from all dangerous obstacles of any scene, with its exempt
    pairs.

    Examples
    --------
    >>> ball = Obstacle("ball", Sphere(0.1), Pose([0.5, 0.1, 0.5]))
    >>> checker = CollisionChecker(Robot.from_example("ur5"), Scene([ball]))
    >>> constraints = Constraints().with_min_clearance(checker, 0.05, ["ball"])
    >>> constraints.separation.min_clearance is not None
    True
    """

    separation: Separation = TOUCHING_ONLY
    danger: DangerLimit | None = None
    tool: tuple[ToolLimit, ...] = ()
    user: UserCheck | None = None
    from_dangerous: tuple[float, Pairs] | None = None

    @property
    def limits(self) -> tuple[MotionLimit, ...]:
        """All limits except the separation, in the order in which `MotionProver` checks them."""
        limits = (self.user, *self.tool, self.danger)
        return tuple(limit for limit in limits if limit is not None)

    def tool_limit(self, kind: type[Limit]) -> Limit | None:
        """Return the tool limit of the given class, or None."""
        return next((limit for limit in self.tool if isinstance(limit, kind)), None)

    def with_min_clearance(
        self, checker: CollisionChecker, distance: float, obstacles: Sequence[str] | None = None, exempt: Pairs = ()
    ) -> Constraints:
        """Return a copy with another distance from chosen obstacles; arguments and errors as `MinClearance.of`."""
        separation = self.separation.with_min_clearance(checker, distance, obstacles, exempt)
        from_dangerous = (distance, tuple(exempt)) if obstacles is None else None
        return replace(self, separation=separation, from_dangerous=from_dangerous)

    def with_separation(self, **changed: Any) -> Constraints:
        """Return a copy with other `speeds`, `time` or `tube` of the separation."""
        return replace(self, separation=replace(self.separation, **changed))

    def in_scene_of(self, checker: CollisionChecker) -> Constraints:
        """Return a copy for another scene, in which other obstacles may be dangerous."""
        if self.from_dangerous is None:
            return self
        distance, exempt = self.from_dangerous
        dangerous = [obstacle.name for obstacle in checker.scene if obstacle.weight > 0]
        still = [pair for pair in exempt if pair[1] in dangerous]
        separation = self.separation.with_min_clearance(checker, distance if dangerous else 0.0, dangerous, still)
        return replace(self, separation=separation)

    def borrowed(self) -> Constraints:
        """Return a copy that does not keep the user's checker alive, for objects that OMPL never frees."""
        borrows = self.user is None or isinstance(self.user, ProxyType)
        return self if borrows else replace(self, user=proxy(self.user))


def claims_of(motion: MotionProver) -> tuple[str, ...]:
    """Return the claims that the prover proves. Checks of the user are sampled, so they are not included."""
    touched = any(obstacle.touched_by for obstacle in motion.checker.scene)
    claims = ["no collision except allowed contact" if touched else "no collision"]
    separation = motion.separation
    if separation.margin or separation.min_clearance is not None:
        claims.append("min clearance")
    if any(isinstance(limit, DangerLimit) for limit in motion.limits):
        claims.append("max danger")
    if separation.speeds:
        claims.append("moving obstacles")
    others = (limit for limit in motion.limits if not isinstance(limit, (DangerLimit, UserCheck)))
    claims += [getattr(limit, "name", type(limit).__name__) for limit in others]
    return tuple(claims)


class ConfigurationCheck:
    """Checks whether constraints allow configurations. Raises UnknownNameError if the constraints name no obstacle."""

    def __init__(self, checker: CollisionChecker, constraints: Constraints) -> None:
        self.checker, self.constraints = checker, constraints
        self._required = constraints.separation.required(checker)
        self._tool, self._danger = constraints.tool, constraints.danger
        self._user = constraints.user

    def within_limits(self, q: FloatArray) -> bool:
        """Return whether `q: (n,)` is finite and within the joint limits of the robot."""
        return self.checker.robot.joint_limits.hold(q)

    def allows(self, q: FloatArray, state: Any = None) -> bool:
        """Return whether `q: (n,)` is finite, within the joint limits, and allowed.

        `state` is the same configuration in OMPL.
        """
        if not self.checker.robot.joint_limits.hold(q) or self.checker.touches(q) or self._required.violated(q):
            return False
        return self._allows_free(q, state)

    def allowed(self, Q: FloatArray) -> Iterator[FloatArray]:
        """Yield the allowed rows of `Q: (B, n)` in order. Distance bounds decide most rows in batches."""
        required, limits = self._required, self.checker.robot.joint_limits
        for some in (Q[k : k + _TOGETHER] for k in range(0, len(Q), _TOGETHER)):
            edges, within = limits.table.edges(some, some)  # motions that stand still
            known = np.where(within, 0, -1)
            with self.checker.changes.read_lock():
                known[within] = required.pairs.bounds.prove_many(edges[within], required.allowed_for, FLOOR)
            for q, free in zip(some, known.tolist(), strict=True):
                if self._allows_free(q) if free > 0 else free == 0 and self.allows(q):
                    yield q

    def _allows_free(self, q: FloatArray, state: Any = None) -> bool:
        """Return whether limits allow `q: (n,)`, which is within the joint limits and keeps all distances."""
        if self._tool and not all(limit.allows(q) for limit in self._tool):
            return False
        if self._danger is not None and not self._danger.allows(q):
            return False
        return self._user is None or self._user.allows(q, state)

    def refusal(self, q: FloatArray) -> str | None:
        """Return why `q: (n,)` is not allowed, as a text to follow a configuration's name, or None if it is allowed."""
        separation, limit = self.constraints.separation, self._danger
        beyond = self.checker.robot.beyond_limits(q)
        if beyond is not None:
            return f": {beyond}"
        pair = self.checker.colliding_pair(q)
        if pair is not None:
            return f" is in collision: {pair[0]!r} touches {pair[1]!r}"
        at_rest = self._required
        if separation.speeds:
            at_rest = replace(separation, speeds={}, time=0.0).required(self.checker)
        near = at_rest.violating_pair(q)
        if near is not None:
            least = f"{1e3 * at_rest.least.max():g} mm"
            return f" is too near: {near[0]!r} keeps less than {least} from {near[1]!r}"
        if limit is not None and not limit.allows(q):
            return f": danger {limit.danger(q):.4g} is above the limit {limit.limit:g}"
        near = self._required.violating_pair(q) if separation.speeds else None
        if near is not None:
            moved = 1e3 * separation.time * separation.speeds.get(near[1], 0.0)
            return f" is too near: {near[1]!r} may move {moved:g} mm, and come to {near[0]!r}"
        if self._user is not None and not self._user.allows(q):
            return f" is refused by your state validity checker {self._user.name}"
        return next((f": {tool.refusal(q)}" for tool in self._tool if not tool.allows(q)), None)
