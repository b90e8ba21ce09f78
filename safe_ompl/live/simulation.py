"""A robot, the replanner and people in simulated time, with a judge beside them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from time import perf_counter
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.exchange.problems import packed_robot
from safe_ompl.inputs import number
from safe_ompl.live.command import Command, Doing
from safe_ompl.live.judge import Judge, Nearest
from safe_ompl.live.movers import ObjectMover, PersonMover
from safe_ompl.live.replanner import Replanner
from safe_ompl.live.summary import Faults, Summary
from safe_ompl.live.ticks import header
from safe_ompl.live.world import World
from safe_ompl.paths.certificate.portable import carried_scene
from safe_ompl.people.reach import ReachSets
from safe_ompl.trajectories.trajectory import Trajectory

_FINE = 0.005  # [s] between looks of the judge
_STILL = 1e-9  # [rad/s] slower than this is at rest
_ROUNDING = 1e-6  # [m]


class Simulation:
    """A robot that goes along trajectories, beside people and things that move.

    Parameters
    ----------
    replanner : Replanner
        What drives it; nothing was started yet.
    trajectories : sequence of Trajectory
        What it does, one after the other and again from the first: each begins where the one before ends.
    people : mapping of str to PersonMover
        Those that the replanner tracks.
    objects : mapping of str to ObjectMover
        As well.
    faults : Faults, optional
        What goes wrong.
    latency : float
        From a measurement to when the command that rests on it holds [s]: what the replanner may take to answer.
    judged : bool
        Whether a judge looks for contacts: that takes most of the time.

    Attributes
    ----------
    summary : Summary
        What came of it, complete once it has run to its end.
    world : World
        Who and what moves.
    judge : Judge or None
        Knows the contacts.
    reactions : list of float
        From each measurement to its command, on the clock of this machine [s].
    """

    def __init__(
        self,
        replanner: Replanner,
        trajectories: list[Trajectory],
        people: Mapping[str, PersonMover],
        objects: Mapping[str, ObjectMover] | None = None,
        *,
        faults: Faults | None = None,
        latency: float = 0.02,
        judged: bool = True,
    ) -> None:
        self.replanner, self.trajectories = replanner, trajectories
        self.world = World(people, objects or {}, replanner.surroundings)
        self.faults = Faults() if faults is None else faults
        self.latency = number("latency", latency, at_least=0.0, at_most=replanner.tick)
        self.judge = Judge(replanner.robot) if judged else None
        self.summary = Summary()
        self._rng = np.random.default_rng(self.faults.seed)
        self._promised: dict[float, ReachSets] = {}
        self.reactions: list[float] = []

    def _obeyed(self, ends: list[FloatArray], time: float, measured: float) -> bool:
        """Return whether all are where the measurement promised that they would be."""
        sets = self._promised.get(measured)
        return sets is None or bool((sets.excess(ends, time - measured) <= _ROUNDING).all())

    # ---------------------------------------------------------------------------------------------------- running

    def run(self, seconds: float) -> Summary:
        """Run for a time, and return what came of it."""
        for _ in self.ticks(seconds):
            pass
        return self.summary

    def ticks(self, seconds: float) -> Iterator[dict[str, Any]]:
        """Run for a time, and yield header and ticks as `safe_ompl.live.ticks` describes them."""
        yield self._header()
        replanner, summary = self.replanner, self.summary
        tick, job = replanner.tick, 0
        replanner.start(self.trajectories[0])
        command: Command | None = None
        obeyed_time = moving_time = 0.0
        ways, started, before = 0, 0, Doing.DONE
        for k in range(round(number("seconds", seconds, above=0.0) / tick)):
            now = k * tick
            late = self._rng.random() < self.faults.late
            new: Command | None = command
            reaction = None
            if not late:
                reaction = self._measure(now)
                begin = perf_counter()
                if command is not None and command.doing is Doing.DONE:
                    summary.tasks += 1
                    job = (job + 1) % len(self.trajectories)
                    replanner.start(self.trajectories[job])
                    started += 1
                    begin = perf_counter()
                new = replanner.command(now + self.latency)
                reaction += perf_counter() - begin
                replanner.think()
                self.reactions.append(reaction)
            else:
                summary.deadlines_missed += 1
            if new is None:
                continue
            old, command = command, new
            if command.path is not getattr(old, "path", None):
                ways += 1
                summary.detours = ways - 1 - started
            if command.doing in (Doing.STANDING, Doing.BRAKING) and before in (Doing.MOVING, Doing.SLOWED):
                summary.stops += 1
            before = command.doing
            obeyed, moving, nearest = self._judge(now, old, command)
            obeyed_time += obeyed * tick
            moving_time += moving * tick
            line = self._line(now, command, nearest, obeyed == 1.0, ways, reaction)
            yield (
                line
                if command.path is getattr(old, "path", None)
                else {**line, "ahead": _way_points(command)}
            )
        self._conclude(seconds, obeyed_time, moving_time)

    def _measure(self, now: float) -> float:
        """Let the replanner see the world; return how long it took [s]."""
        seen: dict[str, Any] = {}
        things: dict[str, Any] = {}
        if not self._rng.random() < self.faults.drops:
            for name, mover in self.world.people.items():
                points = mover.at(now)
                seen[name] = points + self._noise(points.shape) / mover.tracker.skeleton.scale
            for name, thing in self.world.objects.items():
                things[name] = thing.at(now)
        begin = perf_counter()
        violations = self.replanner.update(seen, things, now)
        took = perf_counter() - begin
        self.summary.violations += bool(violations)
        if self.replanner.surroundings.known:
            self._promised[now] = self.replanner.surroundings.sets
        while len(self._promised) > 200:
            del self._promised[next(iter(self._promised))]
        return took

    def _noise(self, shape: tuple[int, ...]) -> FloatArray:
        if not self.faults.noise:
            return np.zeros(shape)
        directions = self._rng.normal(size=shape)
        directions /= np.maximum(np.linalg.norm(directions, axis=-1, keepdims=True), 1e-12)
        radii = self.faults.noise * self._rng.random((*shape[:-1], 1)) ** (1 / 3)
        found: FloatArray = directions * radii
        return found

    def _judge(self, now: float, old: Command | None, new: Command) -> tuple[float, float, Nearest]:
        """Look at a tick from `now` on.

        Returns shares of it in which all obeyed and in which the robot moved, and who was nearest at its beginning.
        """
        robot = self.replanner.robot
        times = now + np.arange(0.0, self.replanner.tick - 1e-9, _FINE)
        obeyed = moves = 0
        here, first_q, first = Nearest(np.inf), np.zeros(0), [np.zeros((0, 3))]
        for i, time in enumerate(times.tolist()):
            command = new if old is None or time >= now + self.latency - 1e-12 else old
            state = command.at(max(time, command.time))
            moving = bool(np.abs(state.qd).max() > _STILL)
            keypoints = self.world.keypoints(time)
            ends = self.world.ends(keypoints, time)
            good = self._obeyed(ends, time, command.measured)
            obeyed, moves = obeyed + good, moves + moving
            if self.judge is None:
                continue
            if i:
                way = float(np.abs(state.q - first_q) @ robot.displacement_radii.max(axis=0))
                way += max(
                    (float(np.linalg.norm(a - b, axis=1).max()) for a, b in zip(ends, first, strict=True)),
                    default=0.0,
                )
                if way < here.distance:
                    self.judge.apart()
                    continue
            nearest = self.judge.look(
                time, state.q, self.world.solids(keypoints, time), moving=moving, obeyed=good
            )
            if not i:
                here, first_q, first = nearest, state.q, ends
            if moving and good:
                self.summary.least_distance = min(self.summary.least_distance, nearest.distance)
        return obeyed / len(times), moves / len(times), here

    def _conclude(self, seconds: float, obeyed: float, moving: float) -> None:
        summary = self.summary
        summary.seconds = float(seconds)
        summary.model_obeyed = min(1.0, obeyed / seconds)
        summary.moving = min(1.0, moving / seconds)
        if self.reactions:
            median, late = np.percentile(self.reactions, (50, 99)).tolist()
            summary.reaction = median, late
        if self.judge is not None:
            contacts = self.judge.contacts
            summary.contacts_while_moving = sum(c.moving and c.obeyed for c in contacts)
            summary.contacts_after_violations = sum(c.moving and not c.obeyed for c in contacts)
            summary.contacts_at_rest = sum(not c.moving for c in contacts)

    # ----------------------------------------------------------------------------------------------------- ticks

    def _header(self) -> dict[str, Any]:
        replanner = self.replanner
        return header(
            tick=replanner.tick,
            joint_names=list(replanner.robot.joint_names),
            robot=packed_robot(replanner.robot),
            scene=carried_scene(replanner.surroundings.scene),
            **self.world.header(),
        )

    def _line(
        self, now: float, command: Command, nearest: Nearest, obeyed: bool, ways: int, reaction: float | None
    ) -> dict[str, Any]:
        state = command.at(max(now, command.time))
        return {
            "time": now,
            "q": state.q.tolist(),
            "qd": state.qd.tolist(),
            **self.world.tick(now),
            "state": command.doing.value,
            "margin": command.left.margin,
            "distance": nearest.distance,
            "link": nearest.link,
            "who": nearest.who,
            "limb": nearest.limb,
            "reason": command.reason,
            "obeyed": obeyed,
            "path": ways,
            "task": self.summary.tasks,
            "reaction": reaction,
            "measured": command.measured,
        }


def _way_points(command: Command) -> list[list[float]]:
    curve = command.path.curve
    points: list[list[float]] = curve.at(np.append(curve.starts, curve.length)).q.tolist()
    return points
