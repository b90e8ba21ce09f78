"""The simplifier: paths of one robot in one scene become shorter and safer, and are proven at every step."""

from __future__ import annotations

from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import CertifiedMotion, CollisionChecker
from safe_ompl.common import FloatArray, InputError, clock, finite_array, number
from safe_ompl.danger import DangerField
from safe_ompl.paths.measures import Curve
from safe_ompl.paths.simplify.cost import STEP, WEIGHT, DangerDensity, PathCost, reference_danger
from safe_ompl.paths.simplify.descent import GoalSet
from safe_ompl.paths.simplify.obstacle_cost import ObstacleCost
from safe_ompl.paths.simplify.proven_descent import Better
from safe_ompl.paths.simplify.run import Settings, SimplificationRun, Stop, unrolled

CLEARANCE = 0.07  # [m]
EXPONENT = 2.0
LENGTH_FACTOR = 1.25
SPACING = 0.4  # [rad] between way points
TIME = 0.2  # [s]

_CONVERGED = 0.03  # a round that lowers the cost by less than this share is the last


@dataclass(frozen=True)
class SimplificationOptions:
    """Options of a `Simplifier`.

    Parameters
    ----------
    weight : float
        λ·reference(CDF)ᵖ, with the median danger over valid configurations as reference: where the danger is that,
        a radian of path costs `weight` radians besides its own length.
    exponent : float
        p ≥ 1. Larger ones punish peaks more.
    clearance, length_factor, spacing : float
        As in `simplify_danger`.

    Raises
    ------
    InputError
        If an option is out of range.
    """

    weight: float = WEIGHT
    exponent: float = EXPONENT
    clearance: float = CLEARANCE
    length_factor: float = LENGTH_FACTOR
    spacing: float = SPACING

    def __post_init__(self) -> None:
        for key, least in (("weight", 0.0), ("exponent", 1.0), ("clearance", 0.0), ("length_factor", 1.0)):
            object.__setattr__(self, key, number(key, getattr(self, key), at_least=least))
        object.__setattr__(self, "spacing", number("spacing", self.spacing, above=0.0))


class Simplifier:
    """Lowers J = ∫ (1 + λ·CDF(q)ᵖ) ds of paths of one robot in one scene, and an obstacle cost with it.

    First shortcuts, which gain most for the least work: the cheapest chain of straight motions between the path's way
    points. Then retreats: ends that are near obstacles are left by the steepest way, unless `clearance` is 0; a goal
    that is free is not. Then descent along the exact gradient of the cost, all way points between the retreats at once;
    after a few steps what has become of the path must be cheaper and proven, and way points beside an edge that is not
    proven go back to where they were. Shortcuts that then save much lead out of a poor minimum, to one more descent.
    It ends when a round of steps gains little; that does not depend on the clock.

    Parameters
    ----------
    checker, field, motion
        As in `simplify_danger`.
    **options
        Those of `SimplificationOptions`; errors as there.
    """

    def __init__(
        self,
        checker: CollisionChecker,
        field: DangerField,
        motion: CertifiedMotion | None = None,
        **options: Any,
    ) -> None:
        self.robot = checker.robot
        self.checker = checker
        self.motion = motion or CertifiedMotion(checker)
        self._options = chosen = SimplificationOptions(**options)
        self.length_factor, self.spacing, self.precision = chosen.length_factor, chosen.spacing, _CONVERGED
        self.obstacle_cost = ObstacleCost(checker, chosen.clearance) if chosen.clearance else None
        self._field = field
        self._measure_scene()

    def _measure_scene(self) -> None:
        """Measure what the danger is compared with in the scene as it is now."""
        self._revisions = self.checker.revision, self._field.revision
        reference = reference_danger(self._field, self.checker)
        self._danger = DangerDensity(self._field, reference, self._options.weight, self._options.exponent)
        self._cost = PathCost(self.robot, [self._danger])

    def _follow(self) -> None:
        """Measure it anew, if obstacles have moved since."""
        if self._revisions != (self.checker.revision, self._field.revision):
            self._measure_scene()

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

    def proving_by(self, motion: CertifiedMotion) -> Simplifier:
        """Return the same simplifier whose edges another certified motion proves."""
        other = copy(self)
        other.motion = motion
        return other

    def refined(self, times: int) -> Simplifier:
        """Return a simplifier that goes on where this one ends: so often half the spacing and a quarter of the gain."""
        finer = copy(self)
        finer.spacing = self.spacing / 2**times
        finer.precision = self.precision / 4**times
        return finer

    def danger_along(self, path: FloatArray) -> tuple[float, float, float]:
        """Return length [rad], mean and largest danger of a path (N, n)."""
        curve = Curve(self.robot, path)
        s = np.linspace(0.0, curve.length, 2 + int(curve.length / STEP))
        danger = self.danger.field.values(curve.at(s))
        mean = float(np.trapezoid(danger, s)) / curve.length if curve.length else float(danger[0])
        return curve.length, mean, float(danger.max())

    def begin(
        self,
        path: ArrayLike,
        stop: Stop,
        on_better: Better | None = None,
        goal: GoalSet | None = None,
        *,
        proven: bool = False,
    ) -> SimplificationRun:
        """Return what makes a path better; see `simplify_danger`. That `path` is proven already saves its proof."""
        checked = finite_array(path, (None, self.robot.n), "path")
        if len(checked) < 2:
            raise InputError(f"path must have two configurations at least, got {len(checked)}")
        settings = Settings(
            self.motion, self.danger, self.obstacle_cost, self.spacing, self.precision, self.length_factor
        )
        return SimplificationRun(
            settings, unrolled(self.robot, checked), stop, on_better, goal, proven=proven
        )

    def simplify(
        self,
        path: ArrayLike,
        stop: Stop,
        on_better: Better | None = None,
        goal: GoalSet | None = None,
        *,
        proven: bool = False,
    ) -> FloatArray:
        """Return a better path, as `begin`; when Ctrl-C ends it, the best path so far stands."""
        run = self.begin(path, stop, on_better, goal, proven=proven)
        with suppress(KeyboardInterrupt):
            run.improve()
        return run.best


def simplify_danger(
    path: ArrayLike,
    checker: CollisionChecker,
    field: DangerField,
    motion: CertifiedMotion | None = None,
    *,
    time: float = TIME,
    stop: Stop | None = None,
    on_better: Better | None = None,
    goal: GoalSet | None = None,
    weight: float = WEIGHT,
    exponent: float = EXPONENT,
    clearance: float = CLEARANCE,
    length_factor: float = LENGTH_FACTOR,
    spacing: float = SPACING,
) -> FloatArray:
    """Return a path that is proven as the given one is, and cheaper: shorter, safer, farther from obstacles.

    Whenever it ends, by itself, by time, by `stop` or by Ctrl-C, the best proven path so far is what it returns. Only
    the proof of the given path comes first, whatever the time.

    Parameters
    ----------
    path : array_like, shape (N, n)
        Way points from start to goal [rad or m]; every edge must be proven free by `motion`.
    checker : CollisionChecker
        Robot and scene.
    field : DangerField
        The danger.
    motion : CertifiedMotion, optional
        Proves edges; by default one on `checker`.
    time : float
        Time limit [s].
    stop : callable, optional
        Asked between steps; when it returns True, that is the end.
    on_better : callable, optional
        Told every better path (N', n) as soon as it is proven, and its J for the danger points that matter near it.
        When others turn out to matter, such a path may be taken back.
    goal : GoalSet, optional
        A set on which the last way point may move, such as a `WorkspaceGoal`; without it the ends are fixed.
    weight, exponent : float
        λ in units of 1/reference(CDF)ᵖ, and p; see `Simplifier`.
    clearance : float
        [m] Nearness to obstacles counts below this; 0: never, paths may come as near as they are proven free.
    length_factor : float
        The path never becomes longer than this times the given one; ≥ 1.
    spacing : float
        [rad] Way points are no farther apart when the descent begins; then they move.

    Returns
    -------
    ndarray, shape (N', n)
        The ends are those of the given path (with `goal`, the start), but for full turns of continuous joints; J is
        not above its J; the least clearance not below its own by more than 0.1 mm, unless `clearance` is 0.

    Raises
    ------
    InputError
        If the path has the wrong shape, is not finite, has an edge that is not proven free, or an option is out of
        range.
    """
    simplifier = Simplifier(
        checker,
        field,
        motion,
        weight=weight,
        exponent=exponent,
        clearance=clearance,
        length_factor=length_factor,
        spacing=spacing,
    )
    return simplifier.simplify(path, timed(number("time", time, above=0.0), stop), on_better, goal)


def timed(seconds: float, stop: Stop | None = None) -> Stop:
    """Return a predicate that says stop after some seconds from now, or when `stop` does."""
    end = clock() + seconds
    return lambda: clock() >= end or (stop is not None and stop())
