"""What makes paths shorter and safer: shortcuts, then descent along the gradient of their cost."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from copy import copy

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.errors import InputError
from safe_ompl.models.collision import CollisionChecker
from safe_ompl.models.danger import DangerField
from safe_ompl.models.motion import CertifiedMotion
from safe_ompl.models.robot import Robot
from safe_ompl.paths.cost import STEP, WEIGHT, DangerDensity, PathCost, number, reference_danger
from safe_ompl.paths.descent import LARGEST, Descent
from safe_ompl.paths.division import divided, refined, with_way_points
from safe_ompl.paths.freedom import Freedom, FreeGoal, GoalSet
from safe_ompl.paths.nearness import NearnessDensity
from safe_ompl.paths.proof import PathProof, least_clearance
from safe_ompl.paths.report import Curve
from safe_ompl.paths.shortcut import shortcut

CLEARANCE = 0.05  # [m]
EXPONENT = 2.0
LENGTH_FACTOR = 1.25
SPACING = 0.4  # [rad] between way points

_ALLOWANCE = 1.3  # clearance below this times that of the nearer end costs most
_SAME = 1e-4  # [m] clearances that differ by less are the same
_SCAN = 0.15  # [rad] between the configurations at which all danger points are looked at
_BESIDE, _CLOSELY = 0.4, 0.02  # [rad] so far from the ends peaks are looked for, at samples so close together
_EXCESS = 0.02  # over the danger of the ends: share that makes a peak
_APART = 0.01  # [rad] of path between way points, at least
_RESOLUTIONS = 2  # how often peaks are looked for
_SHARE = 0.85  # of the greatest danger: points that reach it somewhere are looked at in the descent
_FAR = 0.5  # [rad] when way points have moved so far, other points may matter
_ROUNDS = (3, 5, 8)  # steps between two proofs: more, as long as the proofs succeed
_CAUTION = 0.5  # a round that fails is tried again with this share of the step
_SMALLEST = 0.01  # [rad] steps are not worth taking
_CONVERGED = 2e-3  # a round that lowers the cost by less than this share is the last

Stop = Callable[[], bool]
Better = Callable[[FloatArray, float], None]


class Simplifier:
    """Lowers J = ∫ (1 + λ·CDF(q)ᵖ) ds of paths of one robot in one scene, and a cost of nearness with it.

    First shortcuts: the cheapest chain of straight motions between the path's way points. Then descent along the
    exact gradient of the cost, all way points at once; after a few steps what has become of the path must be proven,
    way points beside an edge that is not go back to where they were, and only what is proven and cheaper counts.

    Parameters
    ----------
    checker, field, motion, clearance, length_factor, spacing
        As in `simplify_danger`.
    weight : float
        λ·reference(CDF)ᵖ, with the median danger over valid configurations as reference: where the danger is that,
        a radian of path costs `weight` radians besides its own length.
    exponent : float
        p ≥ 1. Larger ones punish peaks more.

    Raises
    ------
    InputError
        If an option is out of range.
    """

    def __init__(
        self,
        checker: CollisionChecker,
        field: DangerField,
        motion: CertifiedMotion | None = None,
        *,
        weight: float = WEIGHT,
        exponent: float = EXPONENT,
        clearance: float = CLEARANCE,
        length_factor: float = LENGTH_FACTOR,
        spacing: float = SPACING,
    ) -> None:
        checker.cover(CLEARANCE)  # so that the first path need not wait for it
        self.robot = checker.robot
        self.checker = checker
        self.motion = motion or CertifiedMotion(checker)
        self.length_factor = number("length_factor", length_factor, least=1.0)
        self.spacing = number("spacing", spacing, above=0.0)
        self.precision = _CONVERGED
        self.nearness = (
            NearnessDensity(checker, clearance) if number("clearance", clearance, least=0.0) else None
        )
        self.danger = DangerDensity(field, reference_danger(field, checker), weight, exponent)
        self.cost = PathCost(self.robot, [self.danger])

    def refined(self, times: int) -> Simplifier:
        """Return a simplifier that goes on where this one ends: the spacing halved so many times, smaller gains."""
        finer = copy(self)
        finer.spacing = self.spacing / 2**times
        finer.precision = self.precision / 2**times
        return finer

    def danger_along(self, path: FloatArray) -> tuple[float, float, float]:
        """Return length [rad], mean and largest danger of a path (N, n)."""
        curve = Curve(self.robot, path)
        s = np.linspace(0.0, curve.length, 2 + int(curve.length / STEP))
        danger = self.danger.field.values(curve.at(s))
        mean = float(np.trapezoid(danger, s)) / curve.length if curve.length else float(danger[0])
        return curve.length, mean, float(danger.max())

    def simplify(
        self,
        path: ArrayLike,
        stop: Stop,
        on_better: Better | None = None,
        goal: GoalSet | None = None,
        *,
        proven: bool = False,
    ) -> FloatArray:
        """Return a better path; see `simplify_danger`. That `path` is proven already saves its proof."""
        checked = finite_array(path, (None, self.robot.n), "path")
        if len(checked) < 2:
            raise InputError(f"path must have two configurations at least, got {len(checked)}")
        run = _Run(self, _unrolled(self.robot, checked), stop, on_better, goal, proven)
        with suppress(KeyboardInterrupt):  # the best path so far stands
            run.shorten()
            run.descend()
        return run.best


class _Run:
    """One path on its way down; `best` is always proven."""

    def __init__(
        self,
        simplifier: Simplifier,
        path: FloatArray,
        stop: Stop,
        on_better: Better | None,
        goal: GoalSet | None,
        proven: bool,
    ) -> None:
        self.best = path
        self._robot = simplifier.robot
        self._spacing = simplifier.spacing
        self._precision = simplifier.precision
        self._stop = stop
        self._on_better = on_better
        self._place = Freedom(simplifier.robot) if goal is None else FreeGoal(goal)
        self._longest = simplifier.length_factor * _length(path)
        self._proof = _proof_of(path, simplifier, proven)
        self._nearness = simplifier.nearness
        if self._nearness is not None:
            ends = [simplifier.checker.clearance(q).distance for q in path[[0, -1]]]
            self._nearness.allow(_ALLOWANCE * min(ends))
        self._all_danger = simplifier.danger
        self._look_at_danger()
        self._ceiling = self._danger_cost.of(path)
        self._level = np.inf

    # -------------------------------------------------------------------------------------- what becomes of it

    def shorten(self) -> None:
        """Take shortcuts."""
        shorter = shortcut(self.best, self._danger_cost, self._proof, self._stop)
        cost = self._danger_cost.of(shorter)
        if _length(shorter) <= self._longest and cost < self._ceiling:
            self._publish(shorter, cost)

    def descend(self) -> None:
        """Descend until the cost falls no more."""
        if not _length(self.best):
            return  # the start is the goal, and nothing is shorter
        self._divide()
        known, resolutions = self.best, 0
        while True:
            far = self._descend_nearby()
            # Other danger points may matter now. They can only add to the cost.
            self._look_at_danger()
            if self._danger_cost.of(self.best) > self._ceiling:
                self.best = known
                return
            known = self.best
            if not far:
                if self._stop() or resolutions == _RESOLUTIONS or not self._resolve_peaks():
                    return
                resolutions += 1

    def _descend_nearby(self) -> bool:
        """Descend until the cost falls no more, or way points have moved far; return whether they have."""
        first, self._level = self.best, self._danger_cost.of(self.best) + self._nearness_of(self.best)
        descent = Descent(self._cost, self.best, self._place)
        largest, round_ = LARGEST, 0
        while largest >= _SMALLEST and not self._stop():
            for _ in range(_ROUNDS[round_]):
                if self._stop() or not descent.step(largest):
                    break
            path, back = self._proof.held_back(descent.path, self.best)
            gain = self._take(path)
            if not gain:
                largest, round_ = _CAUTION * largest, 0
                self._anchor(self.best)
                descent.restart(self.best)
            elif back.any():
                largest, round_ = 0.5 * largest, 0
                descent.restart(self.best, back)
            else:
                if gain < self._precision * self._level and largest == LARGEST:
                    break
                largest, round_ = min(LARGEST, 2.0 * largest), min(round_ + 1, len(_ROUNDS) - 1)
                descent.resume(self.best)
            if float(np.abs(self.best - first).max()) > _FAR:
                return True
        return False

    def _take(self, path: FloatArray) -> float:
        """Make a proven path the best one if it is cheaper and not too long; return by how much it is cheaper."""
        if np.array_equal(path, self.best) or _length(path) > self._longest:
            return 0.0
        cost = self._danger_cost.of(path)
        level = cost + self._nearness_of(path)
        gain = self._level - level
        if gain <= 0 or cost > self._ceiling:
            return 0.0
        self._level = level
        self._publish(path, cost)
        return gain

    def _publish(self, path: FloatArray, cost: float) -> None:
        self.best = path
        if self._on_better is not None:
            self._on_better(path, cost)

    def _divide(self) -> None:
        """Put way points where the descent needs them; the path stays what it is."""
        path = divided(self.best, self._spacing)
        if self._nearness is not None:
            path = refined(path, self._nearness.near)
        if self._proof.admit(path):
            self.best = path

    def _resolve_peaks(self) -> bool:
        """Put way points where danger peaks beside the ends, between those that there are; return whether it does.

        There danger changes quickly, and a peak that no node of the cost sees is one that the descent does not lower.
        """
        curve = Curve(self._robot, self.best)
        beside = np.arange(0.0, min(_BESIDE, 0.5 * curve.length), _CLOSELY)
        s = np.concatenate([beside, curve.length - beside[::-1]])
        samples = curve.at(s)
        danger = self._all_danger.field.values(samples)
        forced = max(danger[0], danger[-1])
        inner = danger[1:-1]
        peak = (inner > (1.0 + _EXCESS) * forced) & (inner >= danger[:-2]) & (inner >= danger[2:])
        path = with_way_points(self.best, s[1:-1][peak], _APART)
        if len(path) == len(self.best) or not self._proof.admit(path):
            return False
        self.best = path
        self._look_at_danger(samples[1:-1][peak])
        return True

    # ------------------------------------------------------------------------------------------- what it costs

    def _look_at_danger(self, besides: FloatArray | None = None) -> None:
        """Take the danger points that matter near the best path, and at some configurations besides."""
        samples = divided(self.best, _SCAN)
        if besides is not None:
            samples = np.concatenate([samples, besides])
        field = self._all_danger.field.active(samples, _SHARE)
        danger = self._all_danger.restricted(field)
        self._danger_cost = PathCost(self._robot, [danger])
        self._cost = PathCost(self._robot, [danger, *([] if self._nearness is None else [self._nearness])])

    def _nearness_of(self, path: FloatArray) -> float:
        """Return what nearness along a path costs; the witnesses of nearness are those of this path then."""
        if self._nearness is None:
            return 0.0
        self._anchor(path)
        return PathCost(self._robot, [self._nearness]).value_and_gradient(path)[0] - _length(path)

    def _anchor(self, path: FloatArray) -> None:
        if self._nearness is not None:
            self._nearness.anchor(self._cost.nodes(path))


def _proof_of(path: FloatArray, simplifier: Simplifier, proven: bool) -> PathProof:
    """Return what later paths must hold: proven free, and no nearer to obstacles than the given one, but for 0.1 mm."""
    margin = least_clearance(path, simplifier.checker) - _SAME
    proof = PathProof(simplifier.motion, max(0.0, margin) if np.isfinite(margin) else 0.0)
    if not proof.admit(path, proven):
        raise InputError(f"path: the edge from way point {proof.refused(path)[0]} on is not proven free")
    return proof


def _unrolled(robot: Robot, path: FloatArray) -> FloatArray:
    """Return the path with continuous joints that do not jump where they wrap."""
    steps = robot.difference(path[:-1], path[1:])
    unrolled: FloatArray = np.concatenate([path[:1], path[0] + np.cumsum(steps, axis=0)])
    return unrolled if robot.continuous.any() else path


def _length(path: FloatArray) -> float:
    return float(np.linalg.norm(path[1:] - path[:-1], axis=1).sum())
