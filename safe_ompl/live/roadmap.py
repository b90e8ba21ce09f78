"""The roadmap of the replanner: made once for what stands still, searched lazily, and never made anew."""

from __future__ import annotations

import heapq
from collections import OrderedDict
from itertools import pairwise

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.live.around import Around, Look
from safe_ompl.live.guarded_path import GuardedPath
from safe_ompl.live.limits import DriveLimits
from safe_ompl.live.robot_bodies import RobotBodies
from safe_ompl.trajectories.curve import BlendedCurve, Piece

_AROUND = (0.3, 0.6, 1.2)  # [rad] how far from the way samples are, in turn
_NEIGHBOURS = 8
_STEP = 0.1  # [rad] cells of edges: estimates may be coarse
_KEPT = 400  # edges whose cells are kept
_PROOF, _LOOK = 8, 1  # units of work


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


class Roadmap:
    """Milestones about the ways of a robot, and what is known of the edges between them.

    That an edge is free of what stands still is proven once, when it is first asked for, and for ever. How long it
    takes beside people holds for a while: with the least time T = (distance − what a full-speed stop needs)/v in which
    anyone can come so near that the edge is slowed down, it needs no look before T has passed.

    Parameters
    ----------
    motion : CertifiedMotion
        What proves edges; its scene stands still.
    bodies : RobotBodies
        Of the robot.
    limits : DriveLimits
        What ways keep to, until `keep_to`.
    milestones : int
        How many there are about each new way.
    seed : int
        Of the generator that draws them.
    """

    def __init__(
        self,
        motion: CertifiedMotion,
        bodies: RobotBodies,
        limits: DriveLimits,
        milestones: int = 150,
        seed: int = 0,
    ) -> None:
        self._motion, self._bodies, self.limits = motion, bodies, limits
        self._robot = motion.checker.robot
        self._count = milestones
        self._rng = np.random.default_rng(seed)
        self.milestones: FloatArray = np.empty((0, self._robot.n))
        self._near: list[list[int]] = []
        self._free: dict[tuple[int, int], bool] = {}
        self._paths: OrderedDict[tuple[int, int], GuardedPath] = OrderedDict()
        self._looks: dict[tuple[int, int], Look] = {}
        self._full: dict[tuple[int, int], float] = {}  # times alone [s]
        self._passing: dict[str, int] = {}  # milestones that stand for a start or a goal that is none itself

    def __repr__(self) -> str:
        free = sum(self._free.values())
        return f"Roadmap({len(self.milestones)} milestones, {free} of {len(self._free)} edges free)"

    def keep_to(self, limits: DriveLimits) -> None:
        """Have ways keep to other limits from now on: what is free stays so, how long it takes is asked anew."""
        if not limits.same_as(self.limits):
            self._paths.clear()
            self._looks.clear()
            self._full.clear()
        self.limits = limits

    # ------------------------------------------------------------------------------------------------- milestones

    def cover(self, curve: BlendedCurve) -> None:
        """Add milestones about a way, unless its ends are known."""
        ends = curve.at(np.array([0.0, curve.length])).q
        if all(self._known(q) is not None for q in ends):
            return
        on_it = curve.at(np.linspace(0.0, curve.length, 2 + int(curve.length / max(_AROUND)))).q
        samples = [q for q in on_it if self._known(q) is None]
        for k in range(self._count):
            way = curve.at(self._rng.uniform(0.0, curve.length, 1)).q[0]
            q = way + self._rng.uniform(-1.0, 1.0, self._robot.n) * _AROUND[k % len(_AROUND)]
            q = np.clip(q, self._robot.lower, self._robot.upper)
            if not self._motion.checker.touches(q):
                samples.append(q)
        self.milestones = np.concatenate([self.milestones, samples])
        self._near = [[] for _ in self.milestones]
        for k, q in enumerate(self.milestones):
            for other in np.argsort(self._full_times(q), kind="stable")[1 : _NEIGHBOURS + 1].tolist():
                self._join(k, other)

    def _join(self, a: int, b: int) -> None:
        for one, two in ((a, b), (b, a)):
            if two not in self._near[one]:
                self._near[one].append(two)

    def _known(self, q: FloatArray) -> int | None:
        same = np.flatnonzero(np.abs(self.milestones - q).max(axis=1, initial=0.0) < 1e-9)
        return int(same[0]) if len(same) else None

    def _full_times(self, q: FloatArray) -> FloatArray:
        """Return how long (N,) the straight motions to all milestones take at full speed [s]."""
        moves = np.abs(self._robot.difference(self.milestones, q))
        times: FloatArray = (moves / self.limits.joints.velocity).max(axis=1, initial=0.0)
        return times

    # ------------------------------------------------------------------------------------------------------ edges

    def _is_free(self, a: int, b: int, budget: Budget) -> bool | None:
        """Return whether an edge is proven free of what stands still; None if there is no time to find out."""
        key = (min(a, b), max(a, b))
        if key not in self._free:
            if not budget.spend(_PROOF):
                return None
            self._free[key] = self._motion.is_free(self.milestones[key[0]], self.milestones[key[1]])
        return self._free[key]

    def _look(self, a: int, b: int, now: float, people: Around, budget: Budget) -> float | None:
        """Return how long an edge takes beside people as they stand now [s]; None if there is no time to look."""
        key = (min(a, b), max(a, b))
        known = self._looks.get(key)
        if known is None or now > known.until:
            if not budget.spend(_LOOK):
                return None
            self._looks[key] = known = people.look(self._path(key), now)
        return known.time

    def _time(self, a: int, b: int, now: float, people: Around, budget: Budget) -> float | None:
        """Return how long an edge takes, inf where it is not free; None if there is no time to find out."""
        free = self._is_free(a, b, budget)
        if free is None:
            return None
        return self._look(a, b, now, people, budget) if free else float("inf")

    def _path(self, key: tuple[int, int]) -> GuardedPath:
        found = self._paths.pop(key, None)
        if found is None:
            start, end = self.milestones[key[0]], self.milestones[key[1]]
            found = GuardedPath.along(
                self._bodies, _line(self._robot.difference(start, end), start), self.limits, _STEP
            )
        self._paths[key] = found
        while len(self._paths) > _KEPT:
            self._paths.popitem(last=False)
        return found

    # ----------------------------------------------------------------------------------------------------- search

    def way(
        self, start: FloatArray, goal: FloatArray, now: float, people: Around, within: float, budget: Budget
    ) -> tuple[list[FloatArray], float] | None:
        """Return the quickest way from start to goal beside people as they stand, and how long it takes.

        A lazy A*: edges count with their time at full speed until they lie on the best way; then they are looked at.

        Parameters
        ----------
        start, goal : ndarray, shape (n,)
            Configurations.
        now : float
            [s]
        people : Around
            Where they are.
        within : float
            Ways that take longer than this are not wanted [s].
        budget : Budget
            What may be done for it; what was learnt is kept where that does not do.
        """
        first, last = self._end("start", start), self._end("goal", goal)
        ahead = self._full_times(goal)
        while True:
            path = self._best(first, last, now, ahead, within)
            if path is None:
                return None
            before = budget.left
            times = [self._time(a, b, now, people, budget) for a, b in pairwise(path)]
            if None in times:
                return None
            if budget.left == before:  # nothing was learnt: the best way by what is known is known
                return [self.milestones[k] for k in path], self._cost_of(path, now)

    def _end(self, which: str, q: FloatArray) -> int:
        """Return the milestone at q; where there is none, the one that stands for such ends is moved there."""
        known = self._known(q)
        if known is not None:
            return known
        k = self._passing.get(which)
        if k is None:
            k = self._passing[which] = len(self.milestones)
            self.milestones = np.concatenate([self.milestones, q[None]])
            self._near.append([])
        else:
            self.milestones[k] = q
            for other in self._near[k]:
                self._near[other].remove(k)
            self._near[k] = []
            for store in (self._free, self._looks, self._full, self._paths):
                for key in [key for key in store if k in key]:
                    del store[key]
        for other in np.argsort(self._full_times(q), kind="stable")[1 : 2 * _NEIGHBOURS + 1].tolist():
            self._join(k, other)
        return k

    def _cost(self, a: int, b: int, now: float) -> float:
        key = (min(a, b), max(a, b))
        if not self._free.get(key, True):
            return float("inf")
        full = self._full.get(key)
        if full is None:
            move = self._robot.difference(self.milestones[a], self.milestones[b])
            full = self._full[key] = float((np.abs(move) / self.limits.joints.velocity).max())
        known = self._looks.get(key)
        return full if known is None or now > known.until else max(full, known.time)

    def _cost_of(self, path: list[int], now: float) -> float:
        return sum(self._cost(a, b, now) for a, b in pairwise(path))

    def _best(self, first: int, last: int, now: float, ahead: FloatArray, within: float) -> list[int] | None:
        """Return the best way by what is known, or None if it takes longer than wanted."""
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


def _line(step: FloatArray, start: FloatArray) -> BlendedCurve:
    length = float(np.linalg.norm(step))
    return BlendedCurve([Piece(start, step / length, np.zeros(len(step)), length, 0.0)], [])
