"""Danger as an OMPL optimisation objective, and the costs that planners read from any objective."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from itertools import islice
from typing import Any

import numpy as np
from ompl import base as ob, geometric as og

from safe_ompl.common import FloatArray, InputError, halton_point, uniform_shares
from safe_ompl.danger import DangerField
from safe_ompl.planning.ompl.validity import CollisionFreeValidity, bridge_of
from safe_ompl.robot import ScratchState, StateBridge

_log = logging.getLogger(__name__)

_OWN_THREAD = (
    "the planner asks its objective in a thread of its own, as OMPL's PRM and PRMstar do, and will wait for it for "
    "ever: end this process, as Ctrl-C does not, and take SafePRM"
)
_MOST_KEPT_COSTS = 20_000  # motions, some 5 MB

_SLOPE_SAMPLES = 50
_VALUE_SAMPLES = 100


def _kept_integrals(field: DangerField, bridge: StateBridge) -> Callable[[bytes, bytes, int], float]:
    """Return a cached function for ∫ CDF ds, to 1 %, of the motion between two configurations, given as bytes."""

    # This is no method, because an OMPL object that refers to itself, as by a bound method, is never freed.
    @lru_cache(_MOST_KEPT_COSTS)
    def integral(first: bytes, second: bytes, revision: int) -> float:
        start = np.frombuffer(first)
        delta = bridge.difference(start, np.frombuffer(second))
        return field.mean(start, start + delta) * math.sqrt(delta.dot(delta))

    return integral


class DangerObjective(ob.OptimizationObjective):  # type: ignore[misc]
    """The danger field of a robot as a cost: of a state CDF(q), of a motion ∫ CDF(q(s)) ds.

    The integral is computed by `DangerField.mean` to 1 %. The last 20 000 integrals are cached, because planners ask
    for many motions again, also in the other direction. `motionCostHeuristic` is `DangerField.minimum`, a proven lower
    bound, times the distance: optimising planners use it to skip motions that cannot improve a path.

    Examples
    --------
    >>> from ompl import geometric as og
    >>> from safe_ompl.robot import joint_space
    >>> robot = Robot.from_example("ur5")
    >>> plain = og.SimpleSetup(joint_space(robot))
    >>> field = DangerField(robot, [[0.8, 0.0, 0.5]])
    >>> plain.setOptimizationObjective(DangerObjective(plain.getSpaceInformation(), field))
    """

    def __init__(self, si: Any, field: DangerField) -> None:
        super().__init__(si)
        self.field = field
        self._bridge = bridge_of(si)
        self._integral = _kept_integrals(field, self._bridge)
        self._scales: dict[Any, float] = {}
        # The revision of the field for which the scales were computed.
        self._revision = field.revision
        self._thread = threading.get_ident()  # that asked last
        self._longest, self._starts = math.inf, set[bytes]()

    @property
    def scales(self) -> dict[Any, float]:
        """Statistics of the danger that `StateCost` computes once for all planners; cleared when obstacles move."""
        if self._revision != self.field.revision:
            self._scales, self._revision = {}, self.field.revision
        return self._scales

    @contextmanager
    def asked_by(self, planner: Any) -> Iterator[None]:
        """Within the block, give infinite cost to motions longer than the range of RRT*, which it would refuse anyway.

        This holds for OMPL's RRTstar and its informed variants. Motions from a start keep their costs, because the
        informed variants use them as bounds for pruning.
        """
        try:
            if isinstance(planner, og.RRTstar) and planner.getRange() > 0:
                starts = ob.PlannerInputStates()
                starts.use(planner.getProblemDefinition())
                while starts.haveMoreStartStates():
                    self._starts.add(self._bridge.view(starts.nextStart()).tobytes())
                # Motions exactly as long as the range are allowed; the factor covers rounding.
                self._longest = planner.getRange() * (1.0 + 1e-6)
            yield
        finally:
            self._longest, self._starts = math.inf, set()

    def stateCost(self, state: Any) -> Any:
        """Return the danger at a state."""
        return ob.Cost(self.field.value(self._bridge.read(state)))

    def motionCost(self, start: Any, end: Any) -> Any:
        """Return the integral of the danger over the straight motion, to 1 %; see `asked_by`."""
        first = self._bridge.view(start).tobytes()
        asked = self._longest < math.inf and first not in self._starts
        if asked and self._bridge.space.distance(start, end) > self._longest:
            return ob.Cost(math.inf)
        ends = first, self._bridge.view(end).tobytes()
        return ob.Cost(self._integral(min(ends), max(ends), self.field.revision))

    def motionCostHeuristic(self, start: Any, end: Any) -> Any:
        """Return a lower bound of the cost of any path between two states."""
        delta = self._bridge.difference(self._bridge.read(start), self._bridge.view(end))  # asked very often
        return ob.Cost(self._least() * math.sqrt(delta.dot(delta)))

    def _least(self) -> float:
        """Return a lower bound of the danger of all configurations; log an error if a thread of OMPL calls it."""
        thread = threading.get_ident()
        if thread != self._thread:
            self._thread = thread
            if thread not in {known.ident for known in threading.enumerate()}:
                _log.error("%s", _OWN_THREAD)
        return self.field.minimum

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the danger (B,) at a batch of configurations `Q: (B, n)`."""
        return self.field.values(Q)

    def values_and_gradients(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the danger (B,) and its C-space gradients (B, n) at `Q: (B, n)`."""
        return self.field.values_and_gradients(Q)


class FiniteCosts(ob.OptimizationObjective):  # type: ignore[misc]
    """A user's objective with infinite cost in place of NaN."""

    def __init__(self, objective: Any) -> None:
        super().__init__(objective.getSpaceInformation())
        self.objective = objective
        self.setCostThreshold(objective.getCostThreshold())


def _asking(name: str) -> Callable[..., Any]:
    """Return a method of `FiniteCosts` that calls the method of this name of the user's objective."""

    def ask(self: FiniteCosts, *arguments: Any) -> Any:
        answer = getattr(self.objective, name)(*arguments)
        return ob.Cost(math.inf) if isinstance(answer, ob.Cost) and math.isnan(answer.value()) else answer

    return ask


for _name in (
    *("stateCost", "motionCost", "initialCost", "terminalCost", "averageStateCost", "identityCost", "infiniteCost"),
    *("motionCostHeuristic", "motionCostBestEstimate", "combineCosts", "subtractCosts", "betterCost"),
    *("isCostBetterThan", "isCostEquivalentTo", "isFinite", "isSatisfied", "isSymmetric"),
):
    setattr(FiniteCosts, _name, _asking(_name))


class StateCost:
    """The cost of configurations by a problem's objective, for the planners of this package.

    Costs are computed in batches if the objective has `values(Q)`, as `DangerObjective` has, else state by state.
    Without an objective, or with path length, all costs are 0 and planning is classical.
    """

    def __init__(self, objective: Any, bridge: StateBridge) -> None:
        self._objective, self._bridge = objective, bridge
        self._scratch = ScratchState(bridge)
        self._own_scales: dict[Any, float] = {}
        self.is_zero = objective is None or isinstance(objective, ob.PathLengthOptimizationObjective)

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the cost (B,) of configurations `Q: (B, n)`."""
        if self.is_zero:
            return np.zeros(len(Q))
        if hasattr(self._objective, "values"):
            return np.asarray(self._objective.values(Q), dtype=np.float64)
        return np.array([self._state_cost(q) for q in Q], dtype=np.float64)

    def _state_cost(self, q: FloatArray) -> float:
        """Return the objective's cost of a state at `q: (n,)`; InputError if the objective returns no `ob.Cost`."""
        cost = self._objective.stateCost(self._scratch.set(q))
        if not isinstance(cost, ob.Cost):
            raise InputError(f"{type(self._objective).__name__}.stateCost must return an ob.Cost, got {cost!r}")
        return float(cost.value())

    @property
    def has_gradients(self) -> bool:
        """Whether the objective offers exact gradients (`values_and_gradients(Q)`)."""
        return not self.is_zero and hasattr(self._objective, "values_and_gradients")

    @property
    def field(self) -> DangerField | None:
        """The danger field if the costs are its values; None for other objectives."""
        own = type(self._objective) is DangerObjective
        return self._objective.field if own and type(self._objective.field) is DangerField else None

    def value_and_gradient(self, q: FloatArray) -> tuple[float, FloatArray]:
        """Return the cost and its exact gradient (n,) at `q: (n,)`; only where `has_gradients`."""
        values, gradients = self._objective.values_and_gradients(q[None])
        return float(values[0]), gradients[0]

    @property
    def _scales(self) -> dict[Any, float]:
        """What was measured of the cost: kept by a `DangerObjective` for all, else here."""
        return self._objective.scales if isinstance(self._objective, DangerObjective) else self._own_scales

    def slope(self, si: Any) -> float:
        """Return the median of ‖∇c‖ over valid configurations, what α is measured in; 0 where that is of no use.

        It is kept for the settings that decide what is valid; with a checker of the user's it is measured each time.
        """
        if self.is_zero:
            return 0.0
        validity = si.getStateValidityChecker()
        settings = validity.settings if isinstance(validity, CollisionFreeValidity) else None
        if settings is None:
            return self._measured_slope(si)
        key = *settings, self._bridge.held.tobytes()
        if key not in self._scales:
            self._scales[key] = self._measured_slope(si)
        return self._scales[key]

    @property
    def usual_value(self) -> float:
        """The median of the cost over the whole space, kept like the slope."""
        if self.is_zero:
            return 0.0
        key = self._bridge.held.tobytes()
        if key not in self._scales:
            shares = [halton_point(k, self._bridge.n) for k in range(1, 1 + _VALUE_SAMPLES)]
            self._scales[key] = float(np.median(self.values(self._bridge.between_bounds(np.array(shares)))))
        return self._scales[key]

    def _measured_slope(self, si: Any) -> float:
        candidates = self._bridge.between_bounds(uniform_shares(8 * _SLOPE_SAMPLES, self._bridge.n))
        validity = si.getStateValidityChecker()
        if isinstance(validity, CollisionFreeValidity):
            valid = validity.check.allowed(candidates)
        else:
            valid = (q for q in candidates if si.isValid(self._scratch.set(q)))
        Q = np.array(list(islice(valid, _SLOPE_SAMPLES)) or candidates)
        if self.has_gradients:
            gradients = self._objective.values_and_gradients(Q)[1]
        else:  # by central differences
            step = 1e-5 * np.eye(self._bridge.n)
            ends = [(self._bridge.wrapped(Q + h), self._bridge.wrapped(Q - h)) for h in step]
            gradients = np.stack([(self.values(there) - self.values(back)) / 2e-5 for there, back in ends], axis=1)
        norms = np.linalg.norm(gradients, axis=1)
        norms = np.sort(norms[np.isfinite(norms)])
        half = len(norms) // 2
        return 0.5 * float(norms[half] + norms[-1 - half]) if len(norms) else 0.0  # their median
