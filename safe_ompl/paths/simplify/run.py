"""One run of the simplifier on one path: retreats from its ends, shortcuts, then descent along the gradient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.errors import StaleSceneError
from safe_ompl.paths.curve import Curve
from safe_ompl.paths.simplify.active_set import ActiveSetCost
from safe_ompl.paths.simplify.constraints import FeasibleSet, FreeGoal, GoalSet
from safe_ompl.paths.simplify.cost import DangerDensity
from safe_ompl.paths.simplify.descent import LARGEST, Descent
from safe_ompl.paths.simplify.edge_proofs import EdgeProofs, least_clearance
from safe_ompl.paths.simplify.obstacle_cost import ObstacleCost
from safe_ompl.paths.simplify.peaks import peaks_beside_ends
from safe_ompl.paths.simplify.resampling import divided, path_length, refined, with_way_points
from safe_ompl.paths.simplify.retreat import retreat
from safe_ompl.paths.simplify.shortcut import shortcut
from safe_ompl.robot.robot import Robot

_SAME = 1e-4  # [m] clearances that differ by less are the same
_ALLOWANCE = 1.3  # clearance below this times that of the nearer end costs most
_APART = 0.01  # [rad] of path between way points, at least
_RESOLUTIONS = 2  # how often peaks are looked for
_FAR = 0.5  # [rad] when way points have moved so far, other danger points may matter
_LOOKS = 40  # how often these are looked for at most: as a rule two to five times
_ROUNDS = (3, 5, 8)  # steps between two proofs: more, as long as the proofs succeed
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
        self._path = path  # between the retreats: proven, too
        self._retreats = path[:1], path[-1:]
        self._pending = False  # nothing with these retreats is as cheap as the given path
        self._settings = settings
        self._revisions = settings.motion.checker.revision, settings.danger.field.revision
        self._robot = settings.danger.field.robot
        self._stop = stop
        self._on_better = on_better
        self._goal_is_free = goal is not None
        self._feasible = FeasibleSet(self._robot) if goal is None else FreeGoal(goal)
        self._longest = settings.length_factor * path_length(path)
        self._obstacles: ObstacleCost | None = None
        margin = 0.0
        if settings.obstacle_cost is not None:
            checker = settings.motion.checker
            margin = least_clearance(path, checker) - _SAME
            self._obstacles = settings.obstacle_cost.afresh()
            self._obstacles.allow(_ALLOWANCE * min(checker.clearance(q).distance for q in path[[0, -1]]))
        self._proofs = EdgeProofs.of(path, settings.motion, margin, proven=proven)
        self._cost = ActiveSetCost(settings.danger, self._obstacles, path)
        self._ceiling = self._cost.of(path)
        self._level = np.inf

    # -------------------------------------------------------------------------------------- what becomes of it

    def improve(self) -> None:
        """Make the path cheaper until the cost falls no more.

        Raises
        ------
        StaleSceneError
            If obstacles have moved since the run began.
        """
        if self._revisions != (self._settings.motion.checker.revision, self._settings.danger.field.revision):
            raise StaleSceneError("obstacles have moved since this run began: begin another one")
        given = self.best
        if self._take_retreats():
            self._descend()
            if self.best is not given:
                return
        self._path, self._retreats, self._pending = given, (given[:1], given[-1:]), False
        self._cost.look_at(given)
        self._shorten()
        self._descend()

    def _take_retreats(self) -> bool:
        """Leave ends that are near obstacles by a retreat, and take shortcuts between; return whether that goes."""
        start = self._retreat(self.best[0])
        goal = self.best[-1:] if self._goal_is_free else self._retreat(self.best[-1])
        apart = np.linalg.norm(self._robot.difference(start[0], goal[0]))
        if len(start) == len(goal) == 1 or apart <= path_length(start) + path_length(goal):
            return False  # nothing to leave, or nowhere to go from there
        path = divided(self.best, self._settings.spacing)
        if self._proofs.refused(start) or self._proofs.refused(goal[::-1]) or not self._proofs.admit(path):
            return False
        between = self._shortcut(np.concatenate([start[-1:], path[1:-1], goal[-1:]]))
        if between is None:
            return False
        goal = goal + (between[-1] - goal[-1])  # continuous joints may have been unwound
        self._retreats, self._pending = (start, goal[::-1]), True
        whole = self._whole(between)
        if path_length(whole) > self._longest:
            return False
        self._cost.look_at(whole)
        return self._go_on_from(between)

    def _retreat(self, end: FloatArray) -> FloatArray:
        if self._obstacles is None:
            return end[None]
        return retreat(end, self._obstacles, self._settings.danger.field, self._feasible, self._stop)

    def _shorten(self) -> None:
        """Take shortcuts."""
        shorter = self._shortcut(self._path)
        if shorter is None or path_length(shorter) > self._longest:
            return
        self._cost.look_at(shorter)  # where the given path has not been, other danger points may matter
        if not self._go_on_from(shorter):
            self._cost.look_at(self._path)

    def _shortcut(self, path: FloatArray) -> FloatArray | None:
        found = shortcut(path, self._cost.danger, self._proofs, self._stop)
        return None if found is None else unrolled(self._robot, found)

    def _descend(self) -> None:
        """Descend until the cost falls no more."""
        if self._stop() or not path_length(self._path):
            return  # where the start is the goal, nothing is shorter
        self._divide()
        known, resolutions = self.best, 0
        for _ in range(_LOOKS):
            far = self._descend_nearby()
            # Other danger points may matter now. They can only add to the cost.
            self._cost.look_at(self._whole(self._path))
            if not self._pending and self._cost.of(self._whole(self._path)) > self._ceiling:
                self.best = known
                return
            known = self.best
            if not far:
                if self._stop() or resolutions == _RESOLUTIONS or not self._resolve_peaks():
                    return
                resolutions += 1

    def _descend_nearby(self) -> bool:
        """Descend until the cost falls no more, or way points have moved far; return whether they have."""
        first = self._path
        self._level = self._cost.level(first)
        descent = Descent(self._cost.total, self._path, self._feasible)
        largest, round_ = LARGEST, 0
        while largest >= _SMALLEST and not self._stop():
            for _ in range(_ROUNDS[round_]):
                if self._stop() or not descent.step(largest):
                    break
            path, back = self._proofs.held_back(descent.path, self._path)
            gain = self._take(path)
            if self._stop():
                break
            if not gain:
                largest, round_ = _CAUTION * largest, 0
                self._cost.anchor(self._path)
                descent.restart(self._path)
            elif back.any():
                largest, round_ = 0.5 * largest, 0
                descent.restart(self._path, back)
            else:
                if gain < self._settings.precision * self._level and largest == LARGEST:
                    break
                largest, round_ = min(LARGEST, 2.0 * largest), min(round_ + 1, len(_ROUNDS) - 1)
                descent.resume(self._path)
            if float(np.abs(self._path - first).max()) > _FAR:
                return True
        return False

    def _take(self, path: FloatArray) -> float:
        """Go on from a proven path if it is cheaper and not too long; return by how much it is cheaper."""
        whole = self._whole(path)
        if (
            np.array_equal(path, self._path)
            or path_length(whole) > self._longest
            or not self._feasible.holds(path)
        ):
            return 0.0
        gain = self._level - self._cost.level(path)  # NaN where both are infinite, from a danger point
        if not (gain > 0 and self._go_on_from(path)):
            return 0.0
        self._level -= gain
        return gain

    def _go_on_from(self, path: FloatArray) -> bool:
        """Take a proven path for the one between the retreats, unless what is published would become too dear."""
        whole = self._whole(path)
        cost = self._cost.of(whole)
        cheap = cost <= self._ceiling
        if cheap or self._pending:
            self._path = path
        if cheap:
            self._pending, self.best = False, whole
            if self._on_better is not None:
                self._on_better(whole, cost)
        return cheap or self._pending

    def _whole(self, path: FloatArray) -> FloatArray:
        """Return `path` with the retreats on both sides."""
        start, goal = self._retreats
        return np.concatenate([start[:-1], path, goal[1:]])

    def _divide(self) -> None:
        """Put way points where the descent needs them; the path stays what it is."""
        path = divided(self._path, self._settings.spacing)
        if self._obstacles is not None:
            path = refined(path, self._obstacles.near)
        if self._proofs.admit(path):
            self._path = path

    def _resolve_peaks(self) -> bool:
        """Put way points where danger peaks beside the ends, between those that there are; return whether it does.

        There danger changes quickly, and a peak that no node of the cost sees is one that the descent does not lower.
        """
        field = self._settings.danger.field
        forced = float(field.values(self.best[[0, -1]]).max())
        places, peaks = peaks_beside_ends(Curve(self._robot, self._path), field, forced)
        path = with_way_points(self._path, places, _APART)
        if len(path) == len(self._path) or not self._proofs.admit(path):
            return False
        self._path = path
        self._cost.look_at(self._whole(path), peaks)
        return True


def unrolled(robot: Robot, path: FloatArray) -> FloatArray:
    """Return the path (N, n) with continuous joints that do not jump where they wrap; the others stay as they are."""
    steps = path[1:] - path[:-1]
    turns = np.rint((robot.difference(path[:-1], path[1:]) - steps) / (2.0 * np.pi))
    found: FloatArray = path.copy()
    found[1:] += 2.0 * np.pi * np.cumsum(turns, axis=0)
    return found
