"""The danger-aware simplifier: it makes paths shorter and safer, and every intermediate path is proven."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from copy import copy
from functools import partial
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import CollisionChecker, MotionProver
from safe_ompl.common import FloatArray, InputError, number
from safe_ompl.danger import DangerField
from safe_ompl.planning.simplification.cost import WEIGHT, DangerDensity, ObstacleCost, PathCost, reference_danger
from safe_ompl.planning.simplification.costs import divided, refined
from safe_ompl.planning.simplification.descent import ActiveSetCost, BestPath, ProvenDescent, Terms
from safe_ompl.planning.simplification.edges import MOST, EdgeProofs, joined, retreat, shortcut
from safe_ompl.planning.simplification.measures import path_length
from safe_ompl.robot import motion_limits, plain

Stop = Callable[[], bool]
Better = Callable[[FloatArray, float], None]

# Way points are no farther apart than this when the descent begins.
_SPACING = 0.5  # [rad]
# No path becomes longer than this many times the given path.
_MOST_LENGTH_RATIO = 1.25
# The descent ends after a round that lowers the cost by less than this share.
_CONVERGED = 0.06
# Clearances that differ by less than this are equal.
SAME_CLEARANCE = 1e-4  # [m]
# After the descent, shortcuts are searched between this many way points.
_SHORTCUT_POINTS = 14
# A shortcut after the descent must save this share of the cost.
_LEAST_SAVING = 0.08
# A shortcut is proven only if an estimate says that it saves this share.
_LEAST_ESTIMATED_SAVING = 0.04
# A clearance below this many times the clearance of the nearer end has the steep cost of `ObstacleCost`.
_ALLOWANCE = 1.3


def timed(seconds: float, stop: Stop | None = None) -> Stop:
    """Return a predicate that is true after this many seconds from now, or if `stop` is true."""
    end = perf_counter() + seconds
    return lambda: perf_counter() >= end or (stop is not None and stop())


class Simplifier:
    """Lowers J = ∫ (1 + λ·CDF(q)²) ds and an obstacle cost of paths of one robot in one scene.

    1. Shortcuts: the cheapest chain of straight motions between the path's way points. They gain most per query.
    2. Retreats, unless `clearance` is 0: ends near obstacles are left along the steepest ascent of clearance.
    3. Descent along the exact gradient of the cost, for all way points between the retreats at once. After a few steps
       the path must be cheaper and proven; way points of an edge that is not proven go back.
    4. Shortcuts again; if they save much, they lead out of a poor minimum, and one more descent follows.

    The simplification ends if a round of steps gains little, so its result does not depend on the speed of the machine.
    Every intermediate path is proven. Its J is at most the J of the given path. Its least clearance is at most 0.1 mm
    less than that of the given path, unless `clearance` is 0.

    Parameters
    ----------
    checker, field, motion : CollisionChecker, DangerField, MotionProver
        Robot and scene, the danger field, and the prover of edges; by default a `MotionProver` with the checker.
    weight : float
        λ·reference(CDF)². The reference is the median danger over valid configurations: at this danger a radian of path
        costs `weight` radians in addition to its length.
    clearance : float
        Distance to obstacles [m] below which the obstacle cost counts; 0: no obstacle cost, and paths may come as near
        as they are proven free.

    Raises
    ------
    InputError
        If an option is out of range.

    Examples
    --------
    >>> setup = setup_scenario("planar2")
    >>> planned = setup.plan("ClassicRRTConnect", seed=0)
    >>> shorter = Simplifier(setup.checker, setup.field).simplify(planned.path, 1.0)
    >>> bool((shorter[0] == planned.path[0]).all())
    True
    """

    def __init__(
        self,
        checker: CollisionChecker,
        field: DangerField,
        motion: MotionProver | None = None,
        *,
        weight: float = WEIGHT,
        clearance: float = 0.07,
    ) -> None:
        self.robot = checker.robot
        self.checker = checker
        self.motion = motion or MotionProver(checker)
        self.spacing, self.precision = _SPACING, _CONVERGED
        self.obstacle_cost = ObstacleCost(checker, clearance) if clearance else None
        # The largest clearance of a given path that is kept [m]; see `weighing`.
        self.most_kept = np.inf  # [m]
        self.gains_clearance = True  # see `coarse`
        self._field, self._weight = field, weight
        self._revisions: tuple[int, int] | None = None
        self._follow()

    def _follow(self) -> None:
        """Compute the reference danger again if the scene or the field has changed."""
        revisions = self.checker.revision, self._field.revision
        if revisions == self._revisions:
            return
        self._revisions = revisions
        self._weigh(reference_danger(self._field, self.checker))

    def _weigh(self, reference: float) -> None:
        self._danger = DangerDensity(self._field, reference, self._weight)
        self._cost = PathCost(self.robot, [self._danger])

    @property
    def danger(self) -> DangerDensity:
        """The danger cost of a radian of path."""
        self._follow()
        return self._danger

    @property
    def cost(self) -> PathCost:
        """The cost J of paths."""
        self._follow()
        return self._cost

    def proving_by(self, motion: MotionProver) -> Simplifier:
        """Return a copy of the simplifier with another `MotionProver`."""
        other = copy(self)
        other.motion = motion
        return other

    def weighing(self, weight: float) -> Simplifier:
        """Return a copy with another weight of danger, whose paths need not keep a large clearance.

        Of a given path's clearance it keeps at most the distance below which the obstacle cost counts, so that paths
        for all weights can reach their minima.
        """
        reference, other = self.danger.reference, copy(self)
        other._weight = weight
        other._weigh(reference)
        other.most_kept = 0.0 if self.obstacle_cost is None else self.obstacle_cost.distance
        return other

    def refined(self, times: int) -> Simplifier:
        """Return a finer copy: `times` times half the spacing of way points and a quarter of the least gain."""
        finer = copy(self)
        finer.spacing = self.spacing / 2**times
        finer.precision = self.precision / 4**times
        return finer

    def coarse(self) -> Simplifier:
        """Return a coarser, faster copy to compare paths; it keeps their clearance, but does not increase it."""
        other = self.refined(-1)
        other.gains_clearance = False
        return other

    def begin(
        self, path: ArrayLike, stop: Stop, on_better: Better | None = None, *, proven: bool = False
    ) -> SimplificationRun:
        """Return a run that simplifies a path step by step; arguments and errors as `simplify`.

        `on_better` is called with every better path (N', n) as soon as it is proven, and with its J, computed from the
        danger points that matter near it. If other danger points matter after all, such a path may be dropped later.
        """
        checked = self.robot.way_points(path)
        if len(checked) < 2:
            raise InputError(f"path must have at least two configurations, got {len(checked)}")
        return SimplificationRun(self, checked.copy(), stop, on_better, proven)

    def simplify(self, path: ArrayLike, stop: Stop | float, *, proven: bool = False) -> FloatArray:
        """Return a proven path that costs less than the given one: shorter, safer, farther from obstacles.

        Parameters
        ----------
        path : array_like, shape (N, n)
            Way points from start to goal [rad or m]; every edge must be proven free.
        stop : callable or float
            A predicate that is called between steps and ends the simplification when it is true, or a time limit [s].
            The best proven path so far is then returned, also on Ctrl-C. The proof of the given path is always
            completed first.
        proven : bool
            Whether the path is already proven; its proof is then skipped.

        Returns
        -------
        ndarray, shape (N', n)
            The ends are those of the given path, except for full turns of continuous joints.

        Raises
        ------
        InputError
            If the path has the wrong shape, is not finite, or has an unproven edge, or the time is not positive.
        """
        if not callable(stop):
            stop = timed(number("time", stop, above=0.0))
        run = self.begin(path, stop, proven=proven)
        with suppress(KeyboardInterrupt):
            run.improve()
        return run.best


class SimplificationRun:
    """One run of a simplifier on one path, without jumps of continuous joints; all intermediate paths are proven.

    Raises InputError if the path is not `proven` and cannot be proven free.
    """

    def __init__(
        self, simplifier: Simplifier, path: FloatArray, stop: Stop, on_better: Better | None, proven: bool
    ) -> None:
        # The copy is not affected by later changes of the simplifier's settings.
        self._simplifier = copy(simplifier)
        self._danger = simplifier.danger
        self._robot = simplifier.robot
        self._stop = stop
        self._best = BestPath(path, on_better)
        self._limits = motion_limits(self._robot)
        self._proofs = EdgeProofs(simplifier.motion, stop)
        if proven:
            self._proofs.accept(path)
        else:
            self._proofs.check(path)
        longest = _MOST_LENGTH_RATIO * path_length(path)
        self._terms = Terms(self._proofs, self._limits, longest, simplifier.precision)

    @property
    def best(self) -> FloatArray:
        """The best path (N', n) so far. It is proven, and its J, for the danger points checked, has not risen."""
        return self._best.path

    def improve(self) -> None:
        """Simplify the path until the cost no longer falls."""
        if self._stop():
            return
        self._look_around()
        self._shorten()
        self._descend()
        # Shortcuts between way points that have descended may lead out of a poor minimum.
        if not self._stop() and self._shorten(_SHORTCUT_POINTS, (1.0 - _LEAST_SAVING) * self._cost.of(self.best)):
            self._descend()

    def _descend(self) -> None:
        """Descend between retreats from ends near obstacles, and without retreats unless that gave the best path."""
        if self._stop() or not path_length(self.best):
            # If the start is the goal, there is nothing to shorten.
            return
        shortened = self._divided(self.best)
        if self._descend_between_retreats(shortened) or self._stop():
            return
        descent = self._descent(shortened, (shortened[:1], shortened[-1:]))
        descent.leads = True
        descent.run()

    def _look_around(self) -> None:
        """Compute the clearance of the given path, which later paths must keep, and its cost."""
        self._obstacles = self._simplifier.obstacle_cost
        if self._obstacles is not None:
            ends, least = self._obstacles.clearances(self.best)
            self._obstacles = self._obstacles.afresh(_ALLOWANCE * ends)
            kept = min(least, self._simplifier.most_kept)
            self._proofs.keep(max(0.0, kept - SAME_CLEARANCE) if np.isfinite(kept) else 0.0)
        if not self._simplifier.gains_clearance:
            self._obstacles = None
        self._cost = ActiveSetCost(self._danger, self._obstacles, self.best)
        self._best.ceiling = self._cost.ceiling

    def _shorten(self, most: int = MOST, worth: float = np.inf) -> bool:
        """Take shortcuts between up to `most` way points if the path costs at most `worth`; return whether they are."""
        estimate = 1.0 if worth == np.inf else 1.0 - _LEAST_ESTIMATED_SAVING
        shorter = self._shortcut(partial(shortcut, most=most, worth=estimate), self.best)
        if shorter is None or path_length(shorter) > self._terms.longest:
            return False
        # The new path passes through other configurations, where other danger points may matter.
        self._cost.look_at(shorter)
        cost = self._cost.of(shorter)
        if cost > worth or not self._best.take(shorter, cost):
            return False
        self._best.confirm(cost)
        return True

    def _descend_between_retreats(self, path: FloatArray) -> bool:
        """Leave ends near obstacles by retreats, and descend between them; return whether this gave the best path."""
        start = self._retreat(path[0])
        goal = self._retreat(path[-1])
        apart = np.linalg.norm(self._robot.difference(start[0], goal[0]))
        if len(start) == len(goal) == 1 or apart <= path_length(start) + path_length(goal):
            return False  # nothing to replace
        if self._proofs.refused(start) or self._proofs.refused(plain(goal[::-1])):
            return False
        between = self._shortcut(joined, np.concatenate([start[-1:], path[1:-1], goal[-1:]]))
        if between is None or sum(map(path_length, (start, between, goal))) > self._terms.longest:
            return False
        if self._stop():
            return False
        # Continuous joints may have been unwound.
        goal = plain(goal[::-1] + (between[-1] - goal[-1]))
        descent = self._descent(self._divided(between), (start, goal))
        # A path with retreats may cost more than the shortcuts, but not more than the given path.
        whole = np.concatenate([start[:-1], between, goal[1:]])
        descent.leads = self._best.take(whole, descent.here.cost)
        descent.run()
        return descent.leads

    def _retreat(self, end: FloatArray) -> FloatArray:
        if self._obstacles is None:
            return end[None]
        return retreat(end, self._obstacles, self._danger.field, self._limits, self._stop)

    def _shortcut(self, method: Callable[..., FloatArray | None], path: FloatArray) -> FloatArray | None:
        found = method(path, self._cost, self._proofs, self._stop)
        return None if found is None else self._robot.unrolled(found)

    def _divided(self, path: FloatArray) -> FloatArray:
        """Return the same path with the way points that the descent needs."""
        path = divided(path, self._simplifier.spacing)
        obstacles = self._obstacles
        if obstacles is not None:
            path = refined(path, lambda Q: obstacles.near(Q).rows)
        self._proofs.inherit(path)
        return path

    def _descent(self, path: FloatArray, retreats: tuple[FloatArray, FloatArray]) -> ProvenDescent:
        """Return the descent of a path (N, n) between two retreats, which stay fixed."""
        start, goal = retreats
        self._cost.look_at(np.concatenate([start[:-1], path, goal[1:]]))
        return ProvenDescent(path, retreats, self._cost, self._terms, self._best, self._stop)
