"""Detours: if people block or slow the path ahead, a faster path is searched on a roadmap among still obstacles."""

from __future__ import annotations

import heapq
import logging
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from safe_ompl.collision import MotionProver
from safe_ompl.common import BoolArray, FloatArray
from safe_ompl.live.replanning.bounded_path import Around, BoundedPath, RobotBodies, SpeedLimits, line
from safe_ompl.live.replanning.commands import Command
from safe_ompl.motions import Motion, blended

_log = logging.getLogger(__name__)

# This many milestones are drawn around each new trajectory.
_MILESTONES = 150
# The distances of samples from the curve, in turn.
_SPREAD = (0.3, 0.6, 1.2)  # [rad]
# The number of neighbours of a milestone.
_NEIGHBOURS = 8
# The length of the cells of edges. Estimates may be coarse.
_CELL_LENGTH = 0.1  # [rad]
# The cells of this many edges are kept.
_MOST_KEPT_EDGES = 400
# An estimate is kept at least this long, also for an edge that people slow down.
_ESTIMATE_LIFETIME = 0.3  # [s]
# An estimate is kept until people who are at least as fast as the second value [m/s] can have moved by the first [m].
_PERSON_MOTION, _PERSON_SPEED = 0.05, 0.01
# Units of work for a proof, an estimate and a shortcut, which replaces several edges by one motion.
_PROOF, _ESTIMATE, _SHORTCUT = 8, 1, 12
# A detour must take less than this share of the remaining time, and save at least this much time [s].
_GAIN, _WORTH = 0.75, 0.3
# A detour is searched if the rest of the path takes this many times as long as without people.
_SLOWDOWN = 1.2
# Detours are not taken if they take longer than both: this time, and this many times the time of the rest alone.
_MOST_DETOUR_TIME, _MOST_TIME_RATIO = 30.0, 10.0  # [s], 1
_SMALL = 1e-6  # [rad]
# The tolerance of blends is large, because the way points of a roadmap need not be met.
_BLEND_TOLERANCE = 0.3  # [rad]


@dataclass
class _Edge:
    """Results for the straight motion between two milestones."""

    # Whether the edge is free of still obstacles, which is proven once.
    free: bool | None = None
    # The least time of the edge without people [s].
    full: float | None = None
    # The estimated time of the edge among people [s], infinite if they block it.
    time: float = 0.0
    # The time until which the estimate is kept [s].
    until: float = -np.inf


class Detours:
    """Searches paths within `limits` that are faster among people at their present positions.

    Milestones are drawn around the trajectories that are given to `cover`. An edge between two milestones is proven
    free of still obstacles when it is first needed. Its estimated time among people is kept until somebody can be near
    enough to slow the robot down: for T = (distance − length of a stop from full speed)/v. `left` is the number of
    units of work left in this call. Joints that are not `movable` (n,) stay as on the trajectories.
    """

    def __init__(
        self,
        prover: MotionProver,
        bodies: RobotBodies,
        limits: SpeedLimits,
        tick: float,
        movable: BoolArray | bool = True,
    ) -> None:
        self._prover, self._bodies, self._tick, self.limits, self._movable = prover, bodies, tick, limits, movable
        self._robot = prover.checker.robot
        self._rng, self.left = np.random.default_rng(0), 0
        self.milestones: FloatArray = np.empty((0, self._robot.n))
        # The positions of the tip at the milestones.
        self._tips: FloatArray = np.empty((0, 3))
        self._near: list[list[int]] = []
        self._edges: defaultdict[tuple[int, int], _Edge] = defaultdict(_Edge)
        # The milestones that are moved to the start and the goal of each search.
        self._passing: dict[str, int] = {}
        # A path that nobody can slow down before a time [s].
        self._undisturbed: tuple[BoundedPath | None, float] = (None, 0.0)
        self._paths = lru_cache(_MOST_KEPT_EDGES)(self._straight)

    # ------------------------------------------------------------------------------------------------- milestones

    def cover(self, curve: Motion) -> None:
        """Add milestones around a curve, unless its ends are milestones."""
        ends = curve.places(np.array([0.0, curve.length])).q
        if all(self._known(q) is not None for q in ends):
            return
        on_it = curve.places(np.linspace(0.0, curve.length, 2 + int(curve.length / max(_SPREAD)))).q
        samples = [q for q in on_it if self._known(q) is None]
        for k in range(_MILESTONES):
            on_curve = curve.places(self._rng.uniform(0.0, curve.length, 1)).q[0]
            q = on_curve + self._rng.uniform(-1.0, 1.0, self._robot.n) * _SPREAD[k % len(_SPREAD)] * self._movable
            q = np.clip(q, self._robot.lower, self._robot.upper)
            if not self._prover.checker.touches(q):
                samples.append(q)
        self._add(samples)
        self._near = [[] for _ in self.milestones]
        for k, q in enumerate(self.milestones):
            self._join(k, q, _NEIGHBOURS)

    def _add(self, samples: list[FloatArray]) -> None:
        """Add milestones, each (n,)."""
        self.milestones = np.concatenate([self.milestones, samples])
        self._tips = np.concatenate([self._tips, [self._tip(q) for q in samples]])

    def _tip(self, q: FloatArray) -> FloatArray:
        return np.asarray(self._robot.tip_pose(q).translation)

    def _join(self, k: int, q: FloatArray, count: int) -> None:
        """Connect milestone k at `q: (n,)` with the `count` milestones that joints reach in the shortest time."""
        order: list[int] = np.argsort(self._joint_times(q), kind="stable").tolist()
        for other in order[1 : count + 1]:
            for one, two in ((k, other), (other, k)):
                if two not in self._near[one]:
                    self._near[one].append(two)

    def _known(self, q: FloatArray) -> int | None:
        same = np.flatnonzero(np.abs(self.milestones - q).max(axis=1, initial=0.0) < 1e-9)
        return int(same[0]) if len(same) else None

    def _joint_times(self, q: FloatArray) -> FloatArray:
        """Return the times (N,) [s] of straight motions to all milestones at the joints' velocity limits."""
        moves = np.abs(self._robot.difference(self.milestones, q))
        return np.asarray((moves / self.limits.joints.velocity).max(axis=1, initial=0.0))

    def _full_times(self, q: FloatArray) -> FloatArray:
        """Return lower bounds (N,) [s] of the times of motions to all milestones without people."""
        distances = np.linalg.norm(self._tips - self._tip(q), axis=1)
        limit = min(self.limits.tool_speed or np.inf, self.limits.link_speed or np.inf)
        return np.asarray(np.maximum(self._joint_times(q), distances / limit))

    # ------------------------------------------------------------------------------------------------------ edges

    def _spend(self, units: int) -> bool:
        """Spend units of work; return False if fewer are left."""
        if self.left < units:
            return False
        self.left -= units
        return True

    def _edge(self, a: int, b: int) -> _Edge:
        return self._edges[min(a, b), max(a, b)]

    def _time(self, a: int, b: int, around: Around, now: float) -> float | None:
        """Return the time of an edge [s], infinite if it is not free; None if too few units of work are left."""
        edge, start, end = self._edge(a, b), self.milestones[min(a, b)], self.milestones[max(a, b)]
        if edge.free is None:
            if not self._spend(_PROOF):
                return None
            edge.free = self._prover.is_free(start, end)
        if edge.free and now > edge.until:
            if not self._spend(_ESTIMATE):
                return None
            costs, left = self._between(start, end).pace(around, self._tick)
            fastest = max(float((around.sets.grown(1.0) - around.sets.grown(0.0)).max(initial=0.0)), _PERSON_SPEED)
            edge.time, edge.until = float(costs.sum()), now + max(_ESTIMATE_LIFETIME, _PERSON_MOTION / fastest, left)
        return edge.time if edge.free else np.inf

    def _between(self, start: FloatArray, end: FloatArray) -> BoundedPath:
        """Return the straight motion between two configurations (n,), in coarse cells."""
        return self._paths(start.tobytes(), end.tobytes())

    def _straight(self, start: bytes, end: bytes) -> BoundedPath:
        a, b = np.frombuffer(start), np.frombuffer(end)
        return BoundedPath.along(self._bodies, line(a, a + self._robot.difference(a, b)), self.limits, _CELL_LENGTH)

    # ----------------------------------------------------------------------------------------------------- search

    def quickest(
        self, start: FloatArray, goal: FloatArray, around: Around, now: float, within: float
    ) -> tuple[list[FloatArray], float] | None:
        """Return the fastest path between two configurations (n,) among people, and its time [s]; None if none.

        The search is a lazy A*. Edges count with their time at full speed until they lie on the best path; then they
        are proven and their time is estimated. Paths that take longer than `within` [s] are not searched. Results are
        kept for the next call.
        """
        first, last = self._end("start", start), self._end("goal", goal)
        ahead = self._full_times(goal)
        while True:
            path = self._best(first, last, now, ahead, within)
            if path is None:
                return None
            before = self.left
            times = [self._time(a, b, around, now) for a, b in pairwise(path)]
            if None in times:
                return None
            # No estimate has changed, so the best path is final.
            if self.left == before:
                cost = sum(self._cost(a, b, now) for a, b in pairwise(path))
                return [self.milestones[k] for k in path], cost

    def _end(self, which: str, q: FloatArray) -> int:
        """Return the milestone at q; if there is none, the milestone for starts or for goals is moved to q."""
        known = self._known(q)
        if known is not None:
            return known
        k = self._passing.get(which)
        if k is None:
            k = self._passing[which] = len(self.milestones)
            self._add([q])
            self._near.append([])
        else:
            self.milestones[k], self._tips[k] = q, self._tip(q)
            for other in self._near[k]:
                self._near[other].remove(k)
            self._near[k] = []
            for key in [key for key in self._edges if k in key]:
                del self._edges[key]
        self._join(k, q, 2 * _NEIGHBOURS)
        return k

    def _cost(self, a: int, b: int, now: float) -> float:
        edge = self._edge(a, b)
        if edge.free is False:
            return np.inf
        if edge.full is None:
            edge.full = float(self._full_times(self.milestones[min(a, b)])[max(a, b)])
        if now > edge.until:
            return edge.full
        return max(edge.full, edge.time)

    def _best(self, first: int, last: int, now: float, ahead: FloatArray, within: float) -> list[int] | None:
        """Return the best path by the present estimates, or None if it takes longer than `within` [s]."""
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

    def search(
        self, command: Command, around: Around, now: float, units: int, others: Sequence[FloatArray] = ()
    ) -> tuple[BoundedPath, float] | None:
        """Return a faster path that leaves the command's path where its stop ends; None if none is found.

        The goal is the end of the command's path, or one of the `others`, each (n,). The new path begins with the rest
        of the command's path up to the end of the stop, so that the robot can change to it at any earlier time. The arc
        length of the command's path at which the new path begins is returned, too. At most `units` units of work are
        done; the next call continues where this one ended.
        """
        path, self.left = command.path, units
        rest = float(command.motion.places[-1])
        if path.length - rest < _SMALL:
            return None
        if self._undisturbed[0] is path and now < self._undisturbed[1]:
            return None
        coarse = path.coarse
        expected, left = coarse.pace(around, self._tick)
        self._undisturbed = path, now + left
        ahead = coarse.edges[1:] > rest
        # The least time of each cell without people.
        alone = np.diff(coarse.edges) / np.sqrt(coarse.squared_limits)
        stay, least = float(expected[ahead].sum()), float(alone[ahead].sum())
        if stay < _SLOWDOWN * least + _WORTH:
            return None
        start, goal = path.curve.places(np.array([rest, path.length])).q
        within, found = min(_GAIN * stay, stay - _WORTH, max(_MOST_DETOUR_TIME, _MOST_TIME_RATIO * least)), None
        for end in (goal, *others):
            better = self.quickest(start, end, around, now, within)
            if better is not None:
                found, within = better, better[1]
        if found is None:
            return None
        points = self._shortened(found[0], around)
        curve = blended(np.array(points), self._robot, _BLEND_TOLERANCE, self._prover, self.limits.joints)
        detour = BoundedPath.along(self._bodies, curve, self.limits)
        costs = float(detour.coarse.pace(around, self._tick)[0].sum())
        if costs > min(_GAIN * stay, stay - _WORTH):
            return None
        _log.info("%.3f s: a detour of %.2f rad costs %.1f s instead of %.1f s", now, detour.length, costs, stay)
        first = command.motion.at(now - command.time)[0]
        # The robot stands.
        if rest - first <= _SMALL:
            return detour, rest
        begin = float(path.curve.times[path.curve.piece_at(np.array([first]))[0]])
        return path.from_to(first, rest).then(detour), begin

    def _shortened(self, points: list[FloatArray], around: Around) -> list[FloatArray]:
        """Return the path without points that a straight motion, which is free and no slower, can leave out."""

        def cost(*through: FloatArray) -> float:
            every = (self._between(a, b).pace(around, self._tick)[0] for a, b in pairwise(through))
            return sum(float(costs.sum()) for costs in every)

        kept, k = [points[0]], 0
        while k < len(points) - 1:
            for other in range(len(points) - 1, k, -1):
                if other == k + 1 or (
                    self._spend(_SHORTCUT)
                    and self._prover.is_free(points[k], points[other])
                    and cost(points[k], points[other]) <= cost(*points[k : other + 1])
                ):
                    kept.append(points[other])
                    k = other
                    break
        return kept
