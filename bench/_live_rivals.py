"""Rivals of the replanner on the same path: stop-and-go, and a robot that does not look."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from safe_ompl.people.replanning import Command, Doing, Replanner
from safe_ompl.people.replanning.guarded_path import Around, GuardedPath, MotionMargin, StopMotion
from safe_ompl.trajectories.trajectory import Trajectory


class StopAndGo(Replanner):
    """Stops when anybody is nearer than one distance, and resumes at full speed when nobody is.

    The distance is the least that is safe wherever on the path the robot is: S = v (Δ + T) + r, with the time Δ from
    one measurement to the next command, the longest stop T of the path at its speed, and the farthest way r that any of
    its bodies covers in both. A slower robot needs less of it: `share` is its speed, as a share of what its joints can.
    """

    share = 1.0

    def start(self, trajectory: Trajectory) -> None:
        """Take a trajectory, at the share of its speed."""
        super().start(trajectory)
        assert self._path is not None
        self._path = replace(self._path, squares=self._path.squares * self.share**2)

    def _next(self, path: GuardedPath, s: float, speed: float, time: float) -> Command | None:
        if not self.surroundings.known:
            return None
        if speed == 0 and s >= path.length - 1e-6:
            return super()._next(path, s, speed, time)
        cell = np.array([min(int(np.searchsorted(path.edges, s, side="right")) - 1, len(path.brakes) - 1)])
        here = StopMotion(cell, np.array([s, s]), np.zeros(2), np.zeros(2))
        distance = self.clearance + self._distance(path, time)
        near = path.margin(here, Around(self.surroundings.sets, 0.0, distance), exact=True)
        trouble = self.surroundings.trouble(time, self.options.lost_after)
        push = 1.0 if near.margin >= 0 and trouble is None else -1.0
        if push < 0 and speed == 0:
            return None
        motion = path.motion_from(s, speed * speed, push, self.tick)
        doing = Doing.MOVING if push > 0 else Doing.BRAKING
        return Command(time, self.surroundings.time, path, motion, doing, near, trouble or "")

    def _distance(self, path: GuardedPath, time: float) -> float:
        full = np.sqrt(path.squares)
        stop = float((full / path.brakes).max())
        delay = time - self.surroundings.time + self.tick
        body = float((2 * path.frames.travel.max(axis=1) / np.diff(path.edges) * full).max())  # [m/s]
        fastest = float(self.surroundings.sets.growth[..., 1].max())
        return fastest * (delay + stop) + body * (delay + stop / 2)


class HalfSpeed(StopAndGo):
    """The same at half of the speed."""

    share = 0.5


class QuarterSpeed(StopAndGo):
    """The same at a quarter of the speed."""

    share = 0.25


class Careless(Replanner):
    """Drives as if it were alone."""

    def _next(self, path: GuardedPath, s: float, speed: float, time: float) -> Command | None:
        if speed == 0 and s >= path.length - 1e-6:
            return super()._next(path, s, speed, time)
        motion = path.motion_from(s, speed * speed, 1.0, self.tick)
        return Command(time, self.surroundings.time, path, motion, Doing.MOVING, MotionMargin(np.inf))
