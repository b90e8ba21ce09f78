"""Danger-aware simplification: a path becomes shorter and safer, and is proven at every step."""

from __future__ import annotations

from time import perf_counter

from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.danger.field import DangerField
from safe_ompl.paths.simplify.cost import WEIGHT, number
from safe_ompl.paths.simplify.freedom import GoalSet
from safe_ompl.paths.simplify.simplification import Better, Stop
from safe_ompl.paths.simplify.simplifier import CLEARANCE, EXPONENT, LENGTH_FACTOR, SPACING, Simplifier

TIME = 0.2  # [s]


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
    end = perf_counter() + seconds
    return lambda: perf_counter() >= end or (stop is not None and stop())
