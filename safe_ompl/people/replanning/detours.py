"""Detours: when the path ahead is barred or slow, a quicker one is searched on a roadmap among still obstacles."""

from __future__ import annotations

import heapq
import logging
from collections import OrderedDict
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from safe_ompl.collision import MotionProver
from safe_ompl.common import FloatArray
from safe_ompl.people import ReachSets
from safe_ompl.people.replanning.bodies import RobotBodies
from safe_ompl.people.replanning.guard import Command
from safe_ompl.people.replanning.guarded_path import GuardedPath, PathLimits
from safe_ompl.people.replanning.retreat import line
from safe_ompl.trajectories import BlendedCurve, ContactLimits, blended

_log = logging.getLogger(__name__)

_SPREAD = (0.3, 0.6, 1.2)  # [rad] how far from the curve samples are, in turn
_NEIGHBOURS = 8  # of a milestone
_STEP = 0.1  # [rad] cells of edges: estimates may be coarse
_KEPT = 400  # edges whose cells are kept
_STALE = 0.3  # [s] for which an estimate is kept at least, also of an edge that people slow down
_AWAY, _SLOWEST = 0.05, 0.01  # or until people who are no slower [m/s] can be so far from where they were [m]
_PROOF, _ESTIMATE, _SHORTCUT = 8, 1, 12  # units of work; a shortcut is a motion that replaces several edges
# A detour must take less than this share of the time, and be this much quicker [s].
_GAIN, _WORTH = 0.75, 0.3
_SLOW = 1.2  # a detour is searched if the rest takes so many times as long as with nobody near
# Detours are not wanted that take longer [s], and so many times as long as the rest alone.
_LONGEST, _TIMES = 30.0, 10.0
_SMALL = 1e-6  # [rad]
_TOLERANCE = 0.3  # [rad] of blends: the way points of a roadmap need not be met


@dataclass(frozen=True)
class EdgeTime:
    """An estimate of how long an edge takes beside people."""

    time: float  # How long [s]; inf: it is barred
    until: float  # Until when the estimate holds [s]: before that nobody can be near enough to make the edge slower


@dataclass(frozen=True)
class PeopleNow:
    """Where people and objects are now, and what estimates must leave to them."""

    sets: ReachSets  # Where they are
    clearance: float  # Distance that must be left [m]
    reaction: float  # From a measurement until the robot begins to brake at the latest [s]
    time: float  # Now [s]
    contact: ContactLimits | None = None  # At what speeds contact is borne, where it is allowed

    def pace(self, path: GuardedPath) -> tuple[FloatArray, float]:
        """Return how long (N,) each cell of a path takes, and for how long that holds [s]."""
        return path.pace(self.sets, self.clearance, self.reaction, self.contact)

    def estimate(self, path: GuardedPath) -> EdgeTime:
        """Return how long a path takes, and until when that holds."""
        times, left = self.pace(path)
        fastest = max(float((self.sets.grown(1.0) - self.sets.grown(0.0)).max(initial=0.0)), _SLOWEST)
        return EdgeTime(float(times.sum()), self.time + max(_STALE, _AWAY / fastest, left))


class Budget:
    """Units of work that are left for now."""

    def __init__(self, units: int) -> None:
        self.left = units

    def spend(self, units: int) -> bool:
        """Take some units, or return False if there are not so many left."""
        if self.left < units:
            return False
        self.left -= units
        return True


class DetourRoadmap:
    """Milestones around the paths of a robot, and what is known of the edges between them.

    An edge is proven free of still obstacles once, when it is first needed; the proof holds for ever. An estimate of
    how long it takes beside people holds until anyone can be near enough to slow it down, at the earliest: for
    T = (distance − what a full-speed stop needs)/v. `milestones` are drawn around each new trajectory.
    """

    def __init__(
        self,
        prover: MotionProver,
        bodies: RobotBodies,
        limits: PathLimits,
        milestones: int = 150,
        seed: int = 0,
    ) -> None:
        self._prover, self._bodies, self.limits = prover, bodies, limits
        self._robot = prover.checker.robot
        self._count = milestones
        self._rng = np.random.default_rng(seed)
        self.milestones: FloatArray = np.empty((0, self._robot.n))
        self._tips: FloatArray = np.empty((0, 3))  # where the milestones have the tip
        self._near: list[list[int]] = []
        self._free: dict[tuple[int, int], bool] = {}
        self._paths: OrderedDict[tuple[int, int], GuardedPath] = OrderedDict()
        self._estimates: dict[tuple[int, int], EdgeTime] = {}
        self._full: dict[tuple[int, int], float] = {}  # times with nobody near [s]
        self._passing: dict[str, int] = {}  # the milestones that are moved to starts and goals

    def __repr__(self) -> str:
        free = sum(self._free.values())
        return f"DetourRoadmap({len(self.milestones)} milestones, {free} of {len(self._free)} edges free)"

    def keep_to(self, limits: PathLimits) -> None:
        """Have paths keep other limits from now on: proofs are kept, times are estimated anew."""
        if not limits.same_as(self.limits):
            self._paths.clear()
            self._estimates.clear()
            self._full.clear()
        self.limits = limits

    # ------------------------------------------------------------------------------------------------- milestones

    def cover(self, curve: BlendedCurve) -> None:
        """Add milestones around a curve, unless its ends are milestones."""
        ends = curve.at(np.array([0.0, curve.length])).q
        if all(self._known(q) is not None for q in ends):
            return
        on_it = curve.at(np.linspace(0.0, curve.length, 2 + int(curve.length / max(_SPREAD)))).q
        samples = [q for q in on_it if self._known(q) is None]
        for k in range(self._count):
            way = curve.at(self._rng.uniform(0.0, curve.length, 1)).q[0]
            q = way + self._rng.uniform(-1.0, 1.0, self._robot.n) * _SPREAD[k % len(_SPREAD)]
            q = np.clip(q, self._robot.lower, self._robot.upper)
            if not self._prover.checker.touches(q):
                samples.append(q)
        self._add(samples)
        self._near = [[] for _ in self.milestones]
        for k, q in enumerate(self.milestones):
            for other in self._nearest(q, _NEIGHBOURS):
                self._join(k, other)

    def _add(self, samples: list[FloatArray]) -> None:
        """Add milestones, each (n,)."""
        self.milestones = np.concatenate([self.milestones, samples])
        self._tips = np.concatenate([self._tips, [self._tip(q) for q in samples]])

    def _tip(self, q: FloatArray) -> FloatArray:
        return np.asarray(self._robot.tip_pose(q).translation)

    def _join(self, a: int, b: int) -> None:
        for one, two in ((a, b), (b, a)):
            if two not in self._near[one]:
                self._near[one].append(two)

    def _known(self, q: FloatArray) -> int | None:
        same = np.flatnonzero(np.abs(self.milestones - q).max(axis=1, initial=0.0) < 1e-9)
        return int(same[0]) if len(same) else None

    def _nearest(self, q: FloatArray, count: int) -> list[int]:
        """Return the milestones to which straight motions of the joints are shortest, but for the nearest one."""
        order: list[int] = np.argsort(self._joint_times(q), kind="stable").tolist()
        return order[1 : count + 1]

    def _joint_times(self, q: FloatArray) -> FloatArray:
        """Return how long (N,) the joints take for the straight motions to all milestones at full speed [s]."""
        moves = np.abs(self._robot.difference(self.milestones, q))
        return np.asarray((moves / self.limits.joints.velocity).max(axis=1, initial=0.0))

    def _full_times(self, q: FloatArray) -> FloatArray:
        """Return how long (N,) motions to all milestones take with nobody near, at least [s]."""
        ways = np.linalg.norm(self._tips - self._tip(q), axis=1)
        cap = min(self.limits.tool_speed or np.inf, self.limits.link_speed or np.inf)
        return np.asarray(np.maximum(self._joint_times(q), ways / cap))

    # ------------------------------------------------------------------------------------------------------ edges

    def _is_free(self, a: int, b: int, budget: Budget) -> bool | None:
        """Return whether an edge is proven free of what stands still; None if the budget does not allow to find out."""
        key = (min(a, b), max(a, b))
        if key not in self._free:
            if not budget.spend(_PROOF):
                return None
            self._free[key] = self._prover.is_free(self.milestones[key[0]], self.milestones[key[1]])
        return self._free[key]

    def _estimate(self, a: int, b: int, people: PeopleNow, budget: Budget) -> float | None:
        """Return how long an edge takes beside people as they are now [s]; None if the budget is spent."""
        key = (min(a, b), max(a, b))
        known = self._estimates.get(key)
        if known is None or people.time > known.until:
            if not budget.spend(_ESTIMATE):
                return None
            self._estimates[key] = known = people.estimate(self._path(key))
        return known.time

    def _time(self, a: int, b: int, people: PeopleNow, budget: Budget) -> float | None:
        """Return how long an edge takes, inf where it is not free; None if the budget does not allow to find out."""
        free = self._is_free(a, b, budget)
        if free is None:
            return None
        return self._estimate(a, b, people, budget) if free else float("inf")

    def _path(self, key: tuple[int, int]) -> GuardedPath:
        found = self._paths.pop(key, None)
        if found is None:
            start, end = self.milestones[key[0]], self.milestones[key[1]]
            straight = line(start, start + self._robot.difference(start, end))
            found = GuardedPath.along(self._bodies, straight, self.limits, _STEP)
        self._paths[key] = found
        while len(self._paths) > _KEPT:
            self._paths.popitem(last=False)
        return found

    # ----------------------------------------------------------------------------------------------------- search

    def quickest(
        self, start: FloatArray, goal: FloatArray, people: PeopleNow, within: float, budget: Budget
    ) -> tuple[list[FloatArray], float] | None:
        """Return the quickest path (n,) to (n,) beside people as they are now, and how long it takes [s].

        A lazy A*: edges count with their time at full speed until they lie on the best path; then they are proven, and
        their time is estimated. Paths that take longer than `within` [s] are not wanted. What was learnt within the
        budget is kept for the next call.
        """
        first, last = self._end("start", start), self._end("goal", goal)
        ahead = self._full_times(goal)
        while True:
            path = self._best(first, last, people.time, ahead, within)
            if path is None:
                return None
            before = budget.left
            times = [self._time(a, b, people, budget) for a, b in pairwise(path)]
            if None in times:
                return None
            if budget.left == before:  # nothing was learnt, so the best path is final
                cost = sum(self._cost(a, b, people.time) for a, b in pairwise(path))
                return [self.milestones[k] for k in path], cost

    def _end(self, which: str, q: FloatArray) -> int:
        """Return the milestone at q; if there is none, the one for a start or a goal is moved there."""
        known = self._known(q)
        if known is not None:
            return known
        k = self._passing.get(which)
        if k is None:
            k = self._passing[which] = len(self.milestones)
            self._add([q])
            self._near.append([])
        else:
            self.milestones[k] = q
            self._tips[k] = self._tip(q)
            for other in self._near[k]:
                self._near[other].remove(k)
            self._near[k] = []
            for store in (self._free, self._estimates, self._full, self._paths):
                for key in [key for key in store if k in key]:
                    del store[key]
        for other in self._nearest(q, 2 * _NEIGHBOURS):
            self._join(k, other)
        return k

    def _cost(self, a: int, b: int, now: float) -> float:
        key = (min(a, b), max(a, b))
        if not self._free.get(key, True):
            return float("inf")
        full = self._full.get(key)
        if full is None:
            full = self._full[key] = float(self._full_times(self.milestones[a])[b])
        known = self._estimates.get(key)
        return full if known is None or now > known.until else max(full, known.time)

    def _best(self, first: int, last: int, now: float, ahead: FloatArray, within: float) -> list[int] | None:
        """Return the best path by what is known, or None if it takes longer than wanted."""
        best = {first: 0.0}
        before: dict[int, int] = {}
        queue = [(float(ahead[first]), first)]
        closed: set[int] = set()
        while queue:
            _, k = heapq.heappop(queue)
            if k == last:
                path = [k]
                while path[-1] in before:
                    path.append(before[path[-1]])
                return path[::-1]
            if k in closed:
                continue
            closed.add(k)
            for other in self._near[k]:
                cost = best[k] + self._cost(k, other, now)
                if cost < best.get(other, np.inf) and cost + ahead[other] <= within:
                    best[other], before[other] = cost, k
                    heapq.heappush(queue, (cost + float(ahead[other]), other))
        return None


class Detours:
    """Searches paths that are quicker beside people as they are now, on a roadmap of a `seed`, and keep limits."""

    def __init__(self, prover: MotionProver, bodies: RobotBodies, limits: PathLimits, seed: int = 0) -> None:
        self._prover, self._bodies, self._limits = prover, bodies, limits
        # A path that nobody can slow down before a time [s].
        self._undisturbed: tuple[GuardedPath | None, float] = (None, 0.0)
        self.roadmap = DetourRoadmap(prover, bodies, limits, seed=seed)

    def keep_to(self, limits: PathLimits) -> None:
        """Have detours keep other limits from now on."""
        self._limits = limits
        self.roadmap.keep_to(limits)

    def search(self, command: Command, people: PeopleNow, units: int) -> tuple[GuardedPath, float] | None:
        """Return a quicker path to the goal that leaves the command's path where its stop ends; None if none is found.

        It begins with the rest of the command's path up to there, so that the robot can change over at any time before
        that. The arc length of the command's path at which it begins is returned as well. At most so many units of work
        are done; the next call goes on where this one ended.
        """
        now = people.time
        path, budget = command.path, Budget(units)
        rest = float(command.motion.places[-1])
        if path.length - rest < _SMALL:
            return None
        if self._undisturbed[0] is path and now < self._undisturbed[1]:
            return None
        rough = path.coarse
        times, left = people.pace(rough)
        self._undisturbed = path, now + left
        ahead = rough.edges[1:] > rest
        stay = float(times[ahead].sum())
        alone = float((np.diff(rough.edges) / np.sqrt(rough.squares))[ahead].sum())
        if stay < _SLOW * alone + _WORTH:
            return None
        start, goal = path.curve.at(np.array([rest, path.length])).q
        within = min(_GAIN * stay, stay - _WORTH, max(_LONGEST, _TIMES * alone))
        found = self.roadmap.quickest(start, goal, people, within, budget)
        if found is None:
            return None
        points = self._shortened(found[0], people, budget)
        curve = blended(np.array(points), self._prover.checker.robot, _TOLERANCE, self._prover)
        way = GuardedPath.along(self._bodies, curve, self._limits)
        takes = self._time(way, people)
        if takes > within:
            return None
        _log.info("%.3f s: a detour of %.2f rad takes %.1f s instead of %.1f s", now, way.length, takes, stay)
        first = command.motion.at(now - command.time)[0]
        if rest - first <= _SMALL:  # it stands
            return way, rest
        begin = float(path.curve.starts[path.curve.piece_at(np.array([first]))[0]])
        return path.from_to(first, rest).then(way), begin

    def _time(self, path: GuardedPath, people: PeopleNow) -> float:
        return float(people.pace(path.coarse)[0].sum())

    def _shortened(self, points: list[FloatArray], people: PeopleNow, budget: Budget) -> list[FloatArray]:
        """Return the path without the points that a free and no slower straight motion can leave out."""
        kept = [points[0]]
        k = 0
        while k < len(points) - 1:
            for other in range(len(points) - 1, k, -1):
                if other == k + 1 or (
                    budget.spend(_SHORTCUT)
                    and self._prover.is_free(points[k], points[other])
                    and self._straight_time([points[k], points[other]], people)
                    <= self._straight_time(points[k : other + 1], people)
                ):
                    kept.append(points[other])
                    k = other
                    break
        return kept

    def _straight_time(self, points: list[FloatArray], people: PeopleNow) -> float:
        robot, total = self._prover.checker.robot, 0.0
        for a, b in pairwise(points):
            curve = blended(np.array([a, b]), robot, 0.0, None)
            total += self._time(GuardedPath.along(self._bodies, curve, self._limits), people)
        return total
