"""The simplifier: paths of one robot in one scene become shorter and safer, and are proven at every step."""

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
from safe_ompl.planning.simplification.descent import ActiveSetCost, BestPath, ProvenDescent, Terms
from safe_ompl.planning.simplification.edges import MOST, EdgeProofs, joined, retreat, shortcut
from safe_ompl.planning.simplification.measures import divided, path_length, refined
from safe_ompl.robot import motion_limits, plain

Stop = Callable[[], bool]
Better = Callable[[FloatArray, float], None]

# Way points are no farther apart than this when the descent begins.
_SPACING = 0.5  # [rad]
# No path becomes longer than this many times the given path.
_MOST_LENGTH_RATIO = 1.25
# The last round is one that lowers the cost by less than this share.
_CONVERGED = 0.06
# Clearances that differ by less than this are equal.
SAME_CLEARANCE = 1e-4  # [m]
# After the descent, shortcuts are searched between this many way points.
_SHORTCUT_POINTS = 14
# A shortcut after the descent must save this share of the cost.
_LEAST_SAVING = 0.08
# A shortcut is proven only if an estimate says that it saves this share.
_LEAST_ESTIMATED_SAVING = 0.04
# A clearance below this many times that of the nearer end costs most.
_ALLOWANCE = 1.3


def timed(seconds: float, stop: Stop | None = None) -> Stop:
    """Return a predicate that says stop after some seconds from now, or when `stop` does."""
    end = perf_counter() + seconds
    return lambda: perf_counter() >= end or (stop is not None and stop())


class Simplifier:
    """Lowers J = ∫ (1 + λ·CDF(q)²) ds of paths of one robot in one scene, and an obstacle cost with it.

    First shortcuts, which gain most for the least work: the cheapest chain of straight motions between the path's way
    points. Then retreats: ends that are near obstacles are left by the steepest way, unless `clearance` is 0. Then
    descent along the exact gradient of the cost, all way points between the retreats at once; after a few steps what
    has become of the path must be cheaper and proven, and way points beside an edge that is not proven go back.
    Shortcuts that then save much lead out of a poor minimum, to one more descent. It ends when a round of steps gains
    little; that does not depend on the clock.

    Every path on the way is proven. Its J is not above that of the given path, its least clearance not below its own by
    more than 0.1 mm, unless `clearance` is 0.

    Parameters
    ----------
    checker, field, motion : CollisionChecker, DangerField, MotionProver
        Robot and scene, the danger, and what proves edges; by default a `MotionProver` with the checker.
    weight : float
        λ·reference(CDF)², with the median danger over valid configurations as reference: where the danger is that,
        a radian of path costs `weight` radians besides its own length.
    clearance : float
        [m] Nearness to obstacles counts below this; 0: never, paths may come as near as they are proven free.

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
        """Measure what the danger is compared with in the scene as it is now, unless that is known."""
        revisions = self.checker.revision, self._field.revision
        if revisions == self._revisions:
            return
        self._revisions = revisions
        reference = reference_danger(self._field, self.checker)
        self._danger = DangerDensity(self._field, reference, self._weight)
        self._cost = PathCost(self.robot, [self._danger])

    @property
    def danger(self) -> DangerDensity:
        """The cost of danger of a radian of path."""
        self._follow()
        return self._danger

    @property
    def cost(self) -> PathCost:
        """J of paths."""
        self._follow()
        return self._cost

    def proving_by(self, motion: MotionProver) -> Simplifier:
        """Return the same simplifier whose edges another `MotionProver` proves."""
        other = copy(self)
        other.motion = motion
        return other

    def weighing(self, weight: float) -> Simplifier:
        """Return a simplifier with another weight of danger, whose paths need not stay far from obstacles.

        It keeps no more of a given path's clearance than counts as near: from there all weights reach their minima.
        """
        other = copy(self)
        other._weight, other._revisions = weight, None
        other.most_kept = 0.0 if self.obstacle_cost is None else self.obstacle_cost.distance
        return other

    def refined(self, times: int) -> Simplifier:
        """Return a simplifier that goes on where this one ends: so often half the spacing and a quarter of the gain."""
        finer = copy(self)
        finer.spacing = self.spacing / 2**times
        finer.precision = self.precision / 4**times
        return finer

    def coarse(self) -> Simplifier:
        """Return a simplifier that ends sooner, to compare paths: it keeps their clearance, but does not add to it."""
        other = self.refined(-1)
        other.gains_clearance = False
        return other

    def begin(
        self, path: ArrayLike, stop: Stop, on_better: Better | None = None, *, proven: bool = False
    ) -> SimplificationRun:
        """Return what makes a path better; arguments and errors as `simplify`.

        `on_better` is told every better path (N', n) as soon as it is proven, and its J for the danger points that
        matter near it. When others turn out to matter, such a path may be taken back.
        """
        checked = self.robot.way_points(path)
        if len(checked) < 2:
            raise InputError(f"path must have two configurations at least, got {len(checked)}")
        return SimplificationRun(self, checked.copy(), stop, on_better, proven)

    def simplify(self, path: ArrayLike, stop: Stop | float, *, proven: bool = False) -> FloatArray:
        """Return a path that is proven as the given one is, and cheaper: shorter, safer, farther from obstacles.

        Parameters
        ----------
        path : array_like, shape (N, n)
            Way points from start to goal [rad or m]; every edge must be proven free.
        stop : callable or float
            Asked between steps: when it returns True, that is the end. Or a time limit [s]. Whatever ends it, Ctrl-C
            too, the best proven path so far is returned; only the proof of the given path comes first.
        proven : bool
            Whether the path is known to be proven, which saves its proof.

        Returns
        -------
        ndarray, shape (N', n)
            The ends are those of the given path, but for full turns of continuous joints.

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
    """A run that lowers the cost of one unrolled path, step by proven step, the cheapest gains first.

    An InputError if the path is neither `proven` already nor proven free.
    """

    def __init__(
        self, simplifier: Simplifier, path: FloatArray, stop: Stop, on_better: Better | None, proven: bool
    ) -> None:
        # A copy keeps the present settings.
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
        """The best path (N', n) so far: always proven, and not above the given path's J as far as is known."""
        return self._best.path

    def improve(self) -> None:
        """Make the path cheaper until the cost falls no more."""
        if self._stop():
            return
        self._look_around()
        self._shorten()
        self._descend()
        # Shortcuts between way points that have descended may lead out of a poor minimum.
        if not self._stop() and self._shorten(_SHORTCUT_POINTS, (1.0 - _LEAST_SAVING) * self._cost.of(self.best)):
            self._descend()

    def _descend(self) -> None:
        """Leave ends that need it, and descend."""
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
        """Find out what the given path keeps from obstacles, and what it costs."""
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
        """Take shortcuts between up to `most` way points, if the path then costs no more; return whether."""
        estimate = 1.0 if worth == np.inf else 1.0 - _LEAST_ESTIMATED_SAVING
        shorter = self._shortcut(partial(shortcut, most=most, worth=estimate), self.best)
        if shorter is None or path_length(shorter) > self._terms.longest:
            return False
        # The new path passes other places, where other danger points may matter.
        self._cost.look_at(shorter)
        cost = self._cost.of(shorter)
        if cost > worth or not self._best.take(shorter, cost):
            return False
        self._best.confirm(cost)
        return True

    def _descend_between_retreats(self, path: FloatArray) -> bool:
        """Leave ends that are near obstacles by retreats, and descend between; return whether that is the best."""
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
        # Ends that are left well may cost more than shortcuts, though not more than the given path.
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
        """Return the same path with way points where the descent needs them."""
        path = divided(path, self._simplifier.spacing)
        obstacles = self._obstacles
        if obstacles is not None:
            path = refined(path, lambda Q: obstacles.near(Q).rows)
        self._proofs.inherit(path)
        return path

    def _descent(self, path: FloatArray, retreats: tuple[FloatArray, FloatArray]) -> ProvenDescent:
        """Return the descent of a path (N, n) between two that stay."""
        start, goal = retreats
        self._cost.look_at(np.concatenate([start[:-1], path, goal[1:]]))
        return ProvenDescent(path, retreats, self._cost, self._terms, self._best, self._stop)
