"""One run of the simplifier on one path: retreats from its ends, shortcuts, then descent along the gradient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from safe_ompl.arrays import BoolArray, FloatArray
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.paths.curve import Curve
from safe_ompl.paths.simplify.active_set import ActiveSetCost
from safe_ompl.paths.simplify.constraints import FeasibleSet, FreeGoal, GoalSet
from safe_ompl.paths.simplify.cost import DangerDensity
from safe_ompl.paths.simplify.descent import LARGEST, Descent
from safe_ompl.paths.simplify.edge_proofs import EdgeProofs
from safe_ompl.paths.simplify.obstacle_cost import ObstacleCost
from safe_ompl.paths.simplify.peaks import peaks_beside_ends
from safe_ompl.paths.simplify.resampling import divided, path_length, refined, with_way_points
from safe_ompl.paths.simplify.retreat import retreat
from safe_ompl.paths.simplify.shortcut import joined, shortcut
from safe_ompl.robot.robot import Robot

_SAME = 1e-4  # [m] clearances that differ by less are the same
_ALLOWANCE = 1.3  # clearance below this times that of the nearer end costs most
_APART = 0.01  # [rad] of path between way points, at least
_RESOLUTIONS = 2  # how often peaks are looked for
_FAR = 0.5  # [rad] when way points have moved so far, other danger points may matter
_LOOKS = 40  # how often these are looked for at most: as a rule two to five times
_ROUNDS = (3, 5, 8)  # steps between two proofs: more, as long as the proofs succeed
_IDLE = 3e-4  # share of the cost that a step must save, or it was the last one of its round
_CAUTION = 0.5  # a round that fails is tried again with this share of the step
_SMALLEST = 0.01  # [rad] steps are not worth taking


Stop = Callable[[], bool]
Better = Callable[[FloatArray, float], None]


@dataclass(frozen=True)
class Settings:
    """Settings of all runs of a `Simplifier`."""

    motion: CertifiedMotion
    danger: DangerDensity
    obstacle_cost: ObstacleCost | None
    spacing: float
    precision: float
    length_factor: float


class SimplificationRun:
    """A run that lowers the cost of one path, step by proven step.

    Parameters
    ----------
    settings : Settings
        What counts.
    path : ndarray, shape (N, n)
        Unrolled.
    stop : callable
        Asked between steps; when it returns True, that is the end.
    on_better : callable, optional
        Told every better path, and its J.
    goal : GoalSet, optional
        Where the last way point may move.
    proven : bool
        Whether the path is proven already.

    Attributes
    ----------
    best : ndarray, shape (N', n)
        Always proven, and not above the given path's J; while it improves, for the danger points that matter near it.

    Raises
    ------
    InputError
        If the path is not proven free.
    """

    def __init__(
        self,
        settings: Settings,
        path: FloatArray,
        stop: Stop,
        on_better: Better | None,
        goal: GoalSet | None,
        *,
        proven: bool,
    ) -> None:
        self.best = path
        self._path = path  # between the retreats
        self._retreats = path[:1], path[-1:]
        self._pending = False  # nothing with these retreats is as cheap as the best path
        self._settings = settings
        self._robot = settings.danger.field.robot
        self._stop = stop
        self._on_better = on_better
        self._goal_is_free = goal is not None
        self._feasible = FeasibleSet(self._robot) if goal is None else FreeGoal(goal)
        self._longest = settings.length_factor * path_length(path)
        self._proofs = EdgeProofs(settings.motion, stop)
        if proven:
            self._proofs.accept(path)
        else:
            self._proofs.check(path)

    # -------------------------------------------------------------------------------------- what becomes of it

    def improve(self) -> None:
        """Make the path cheaper until the cost falls no more, the cheapest gains first."""
        if self._stop() or not path_length(self.best):
            return  # where the start is the goal, nothing is shorter
        self._look_around()
        self._shorten()
        self._divide()
        shortened = self._path
        self._known, self._nearby = self.best, 0.0
        self._bound = self._level = self._costs(shortened)[1]
        if self._take_retreats():
            self._descend()
            if not self._pending:
                return
            self._path, self._retreats, self._pending = shortened, (shortened[:1], shortened[-1:]), False
            self._nearby = 0.0
            self._cost.look_at(shortened)
            self._bound = self._level = self._costs(shortened)[1]
        self._descend()

    def _look_around(self) -> None:
        """Find out what the given path keeps from obstacles, and what it costs."""
        self._obstacles = self._settings.obstacle_cost
        if self._obstacles is not None:
            ends, least = self._obstacles.clearances(self.best)
            self._obstacles = self._obstacles.afresh(_ALLOWANCE * ends)
            self._proofs.keep(max(0.0, least - _SAME) if np.isfinite(least) else 0.0)
        self._cost = ActiveSetCost(self._settings.danger, self._obstacles, self.best)
        self._ceiling = self._cost.of(self.best)

    def _shorten(self) -> None:
        """Take shortcuts between the way points of the given path."""
        shorter = self._shortcut(shortcut, self._path)
        if shorter is None or path_length(shorter) > self._longest:
            return
        self._cost.look_at(shorter)  # where the given path has not been, other danger points may matter
        cost = self._cost.of(shorter)
        if cost <= self._ceiling:
            self._path = shorter
            self._publish(shorter, cost)
        else:
            self._cost.look_at(self._path)

    def _take_retreats(self) -> bool:
        """Leave ends that are near obstacles by a retreat, and take shortcuts between; return whether that goes."""
        start = self._retreat(self.best[0])
        goal = self.best[-1:] if self._goal_is_free else self._retreat(self.best[-1])
        apart = np.linalg.norm(self._robot.difference(start[0], goal[0]))
        if len(start) == len(goal) == 1 or apart <= path_length(start) + path_length(goal):
            return False  # nothing to leave, or nowhere to go from there
        if self._proofs.refused(start) or self._proofs.refused(goal[::-1]):
            return False
        between = self._shortcut(joined, np.concatenate([start[-1:], self._path[1:-1], goal[-1:]]))
        if between is None:
            return False
        goal = goal + (between[-1] - goal[-1])  # continuous joints may have been unwound
        retreats = start, goal[::-1]
        if path_length(between) + sum(map(path_length, retreats)) > self._longest:
            return False
        self._path, self._retreats, self._pending = between, retreats, True
        self._divide()
        self._cost.look_at(self._whole(self._path))
        self._nearby = sum(self._cost.near(retreat) for retreat in retreats)
        self._settle(self._path, *self._costs(self._path))  # may be dearer at first
        return True

    def _retreat(self, end: FloatArray) -> FloatArray:
        if self._obstacles is None:
            return end[None]
        return retreat(end, self._obstacles, self._settings.danger.field, self._feasible, self._stop)

    def _shortcut(self, method: Callable[..., FloatArray | None], path: FloatArray) -> FloatArray | None:
        found = method(path, self._cost.danger, self._proofs, self._stop)
        return None if found is None else unrolled(self._robot, found)
    def _descend(self) -> None:
        """Descend until the cost falls no more."""
        descent = Descent(self._cost, self._path, self._feasible)
        seen, resolutions, largest, round_ = self._path, 0, LARGEST, 0
        while not self._stop():
            self._steps(descent, largest, _ROUNDS[round_])
            if self._stop():
                return
            moved = descent.path is not self._path
            gain, back = self._take(descent.path) if moved else (0.0, np.zeros(0, dtype=bool))
            if moved and not gain:
                largest, round_ = _CAUTION * largest, 0
                self._cost.anchor(self._path)
                descent.restart(self._path)
            elif back.any():
                largest, round_ = _CAUTION * largest, 0
                descent.restart(self._path, back)
            elif gain >= self._settings.precision * self._level:
                largest, round_ = min(LARGEST, 2.0 * largest), min(round_ + 1, len(_ROUNDS) - 1)
                if float(np.abs(self._path - seen).max()) > _FAR:
                    seen = self._path
                    if not self._look_again():
                        return
                descent.resume(self._path)
            else:
                largest = 0.0
            if largest < _SMALLEST:
                if not self._look_again() or resolutions == _RESOLUTIONS or not self._resolve_peaks():
                    return
                resolutions, largest, round_ = resolutions + 1, LARGEST, 0
                seen, descent = self._path, Descent(self._cost, self._path, self._feasible)

    def _steps(self, descent: Descent, largest: float, most: int) -> None:
        """Take steps, as many as are wanted at most, as long as they are worthwhile."""
        for _ in range(most):
            before = descent.value
            if self._stop() or not descent.step(largest):
                return
            if before - descent.value < _IDLE * before:
                return

    def _take(self, path: FloatArray) -> tuple[float, BoolArray]:
        """Go on from as much of a path (N, n) as is proven, if that is cheaper, and not too long.

        Returns
        -------
        gain : float
            By how much it is cheaper; 0 where nothing is taken.
        back : ndarray of bool, shape (N,)
            Way points that had to be held back.
        """
        back = np.zeros(len(path), dtype=bool)
        costs = self._costs_if_better(path)
        if costs is not None:
            wanted = path
            path, back = self._proofs.held_back(wanted, self._path)
            if path is not wanted:
                costs = self._costs_if_better(path)
        if costs is None:
            return 0.0, back
        gain = self._level - costs[1]
        self._settle(path, *costs)
        return gain, back

    def _costs_if_better(self, path: FloatArray) -> tuple[float, float] | None:
        """Return J of a path, and that with its obstacle cost, unless it is not cheaper, too long, or not feasible."""
        if (
            np.array_equal(path, self._path)
            or path_length(self._whole(path)) > self._longest
            or not self._feasible.holds(path)
        ):
            return None
        cost, total = self._costs(path)
        return (cost, total) if total < self._level and (self._pending or cost <= self._ceiling) else None

    def _costs(self, path: FloatArray) -> tuple[float, float]:
        """Return J with a path between the retreats, and that with its obstacle cost; it is anchored then."""
        cost = self._cost.of(self._whole(path))
        return cost, cost + self._cost.near(path) + self._nearby

    def _settle(self, path: FloatArray, cost: float, total: float) -> None:
        """Go on from a proven path, and publish it if it is as cheap as what was published before."""
        self._path, self._level = path, total
        if cost <= self._ceiling and total <= self._bound:
            self._bound, self._pending = total, False
            self._known = self.best
            self._publish(self._whole(path), cost)

    def _publish(self, path: FloatArray, cost: float) -> None:
        self.best = path
        if self._on_better is not None:
            self._on_better(path, cost)

    def _look_again(self) -> bool:
        """Take the danger points that matter now; return whether the path is still no dearer than the given one."""
        whole = self._whole(self._path)
        self._cost.look_at(whole)
        cost = self._cost.of(whole)
        if not self._pending and cost > self._ceiling:  # other points can only add to the cost
            self.best = self._known
            return False
        self._level = cost + self._cost.near(self._path) + self._nearby
        if not self._pending:
            self._bound = self._level
            self._known = self.best
        return True

    def _whole(self, path: FloatArray) -> FloatArray:
        """Return `path` with the retreats on both sides."""
        start, goal = self._retreats
        return np.concatenate([start[:-1], path, goal[1:]])

    def _divide(self) -> None:
        """Put way points where the descent needs them; the path stays what it is."""
        path = divided(self._path, self._settings.spacing)
        if self._obstacles is not None:
            path = refined(path, self._obstacles.near)
        self._proofs.inherit(path)
        self._path = path

    def _resolve_peaks(self) -> bool:
        """Put way points where danger peaks beside the ends, between those that there are; return whether it does.

        There danger changes quickly, and a peak that no node of the cost sees is one that the descent does not lower.
        """
        field = self._settings.danger.field
        forced = float(field.values(self.best[[0, -1]]).max())
        places, peaks = peaks_beside_ends(Curve(self._robot, self._path), field, forced)
        path = with_way_points(self._path, places, _APART)
        if len(path) == len(self._path):
            return False
        self._proofs.inherit(path)
        self._path = path
        self._cost.look_at(self._whole(path), peaks)
        self._level = self._costs(path)[1]
        return True


def unrolled(robot: Robot, path: FloatArray) -> FloatArray:
    """Return the path (N, n) with continuous joints that do not jump where they wrap; the others stay as they are."""
    steps = path[1:] - path[:-1]
    turns = np.rint((robot.difference(path[:-1], path[1:]) - steps) / (2.0 * np.pi))
    found: FloatArray = path.copy()
    found[1:] += 2.0 * np.pi * np.cumsum(turns, axis=0)
    return found
