"""The safest way round: several starts, joined into better paths, and told apart by the way that they take."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from ompl import base as ob

from safe_ompl.common import FloatArray, InputError
from safe_ompl.planning.simplification import Curve, Simplifier, Stop, hybrid, timed

if TYPE_CHECKING:
    from safe_ompl.planning.safe_setup import SafeSetup

# Numbers below were chosen on 120 random scenes with a person and five boxes, those of bench/ways among them.
#
# The weight of danger in J, as a share of the simplifier's own weight. Ways are compared by their integral of CDF, but
# J has its square: 1 + λ·CDF² ≥ 2·√λ·CDF, and both sides are equal where √λ·CDF = 1. With this share they are about
# equal at the mean danger of simplified paths, so the cheapest paths by J are nearly those of least integral.
_WEIGHT_SHARE = 0.4
# Paths keep no more of the least clearance of their planned path than this. That clearance differs by centimetres from
# start to start. With one way all of it is kept; here that kept most starts from the best path that others found.
_MOST_KEPT = 0.015  # [m]
_FEWEST, _MOST = 3, 5  # starts
# Starts end when so many of them come to within this share of the cheapest: then another way is rarely cheaper.
_AGREEING, _AGREEMENT = 2, 0.03
# At most this many joined paths are tried.
_JOINTS = 2
_WORTHWHILE = 0.02
# Two paths are compared at so many places, and at so many paths between them.
_PLACES, _BETWEEN = 16, 3
# Two paths belong to the same way if a path between them costs at most this share more than the more expensive one.
_BARRIER = 0.01


class WayPath(NamedTuple):
    """A proven path (N, n) that was simplified, J of it, and the path of the planner that it began with."""

    path: FloatArray
    cost: float
    planned: FloatArray


def all_ways(ways: Any) -> bool:
    """Return whether all ways are asked for; an InputError unless `ways` is 1 or "all"."""
    if isinstance(ways, bool) or not isinstance(ways, (int, str)) or ways not in (1, "all"):
        raise InputError(f'ways must be 1 or "all", got {ways!r}')
    return ways == "all"


def _cost(path: WayPath) -> float:
    return path.cost


class WaySearch:
    """The search for the safest way of a setup; what it has found so far stands whenever it ends.

    Starts are simplified coarsely, in half the time, and go on until two of them come to about the same least J: the
    more often the best result of a random search is found again, the less likely a further start finds a better one.
    Then these drafts are joined, see `hybrid`, and the joined path is simplified to the end; where that saves much,
    once more. At last the cheapest draft of every other way is simplified to the end, too. None of this depends on the
    clock, unless it is time to stop. The J of this search weighs danger less than the simplifier does, as the integral
    of danger asks for, and paths may come nearer to obstacles, down to 15 mm, than their planned paths.

    Parameters
    ----------
    setup : SafeSetup
        With start and goals.
    simplifier : Simplifier
        Makes paths of the setup cheaper.
    seconds : float
        [s] No path is simplified for longer.
    stop : callable
        Says when it is time to stop.
    """

    def __init__(self, setup: SafeSetup, simplifier: Simplifier, seconds: float, stop: Stop) -> None:
        self._setup, self._seconds, self._stop = setup, seconds, stop
        self._simplifier = simplifier.weighing(_WEIGHT_SHARE * simplifier.danger.weight)
        self._simplifier.most_kept = min(_MOST_KEPT, simplifier.most_kept)
        self._drafts: list[WayPath] = []
        self._finished: list[WayPath] = []

    def run(self, search: Callable[[int], FloatArray | None]) -> None:
        """Look for ways; `search` plans: from a number that is another one for every start to a path (N, n) or None."""
        coarse = self._simplifier.coarse()
        for start in range(_MOST):
            planned = search(start)
            if planned is not None:
                self._drafts.append(self._simplified(planned, planned, coarse))
            if self._stop() or (start + 1 >= _FEWEST and self._agree()):
                break
        for _ in range(_JOINTS if self._drafts else 0):
            if self._stop():
                break
            known = [*self._drafts, *self._finished]
            best = min(known, key=_cost)
            paths = [best.path, *(each.path for each in known if each is not best)]
            self._finish(hybrid(self._simplifier, paths, self._stop), best.planned)
            if self._finished[-1].cost > (1.0 - _WORTHWHILE) * best.cost:
                break
        for draft in sorted(self._drafts, key=_cost):
            if self._stop():
                break
            if not any(are_one_way(draft.path, each.path, self._simplifier) for each in self._finished):
                self._finish(draft.path, draft.planned)

    def _finish(self, path: FloatArray, planned: FloatArray) -> None:
        self._finished.append(self._simplified(path, planned, self._simplifier))

    def _simplified(self, path: FloatArray, planned: FloatArray, simplifier: Simplifier) -> WayPath:
        better = simplifier.simplify(path, timed(self._seconds, self._stop), proven=True)
        return WayPath(better, self._simplifier.cost.of(better), planned)

    def _agree(self) -> bool:
        """Return whether several starts have come to about the least J."""
        costs = np.array([each.cost for each in self._drafts])
        return bool((costs <= (1.0 + _AGREEMENT) * costs.min(initial=np.inf)).sum() >= _AGREEING)

    def ways(self) -> list[tuple[WayPath, float]]:
        """Return the cheapest path of each way by the setup's objective, and what it costs; the cheapest first.

        Paths that the user's own checker refuses, or whose cost is NaN, are left out. If no other are left, there are
        the paths of the planner.
        """
        objective = self._setup.getOptimizationObjective() or ob.PathLengthOptimizationObjective(
            self._setup.getSpaceInformation()
        )
        left = self._priced(self._finished or self._drafts, objective)
        left = left or self._priced([WayPath(each.planned, np.inf, each.planned) for each in self._drafts], objective)
        ways = list[tuple[WayPath, float]]()
        while left:
            best = left[0]
            for each in left[1:]:
                best = each if objective.isCostBetterThan(each[1], best[1]) else best
            ways.append((best[0], float(best[1].value())))
            others = [each for each in left if each is not best]
            left = [each for each in others if not are_one_way(best[0].path, each[0].path, self._simplifier)]
        return ways

    def _priced(self, paths: list[WayPath], objective: Any) -> list[tuple[WayPath, Any]]:
        """Return the paths that are allowed with their `ob.Cost` by the objective."""
        priced = []
        for each in paths:
            self._setup.set_solution(each.path)
            cost = self._setup.getSolutionPath().cost(objective)
            refused = self._setup.getConstraints().user is not None and not self._setup.is_free(each.path)
            if not refused and not np.isnan(cost.value()):
                priced.append((each, cost))
        return priced


def are_one_way(first: FloatArray, second: FloatArray, simplifier: Simplifier) -> bool:
    """Return whether one of two paths (N, n), (M, n) can be deformed into the other straight, freely and cheaply.

    Places at the same share of the lengths are joined: these motions must be proven free, and the paths between cost
    hardly more than the dearer of the two. Paths of one way pass people and obstacles on the same sides, in postures
    without a barrier of danger between them. This is the straight-line homotopy of Jaillet & Siméon (Path deformation
    roadmaps, IJRR 27, 2008), with a barrier by cost besides.
    """
    robot, danger = simplifier.robot, simplifier.danger
    curves = [Curve(robot, path) for path in (first, second)]
    start, end = (curve.at(np.linspace(0.0, curve.length, _PLACES)) for curve in curves)
    if not simplifier.motion.are_free(start, end).all():
        return False
    shares = np.linspace(0.0, 1.0, _BETWEEN + 2)[:, None, None]
    places = start + shares * robot.difference(start, end)
    density = 1.0 + danger.values(places.reshape(-1, robot.n)).reshape(places.shape[:2])
    steps = np.linalg.norm(places[:, 1:] - places[:, :-1], axis=2)
    costs = (0.5 * (density[:, 1:] + density[:, :-1]) * steps).sum(axis=1)
    return bool(costs.max() <= (1.0 + _BARRIER) * max(costs[0], costs[-1]))
