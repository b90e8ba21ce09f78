"""A path as the replanner drives it: cells with bounds of speed and braking, and where the robot's bodies are there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.live.drive import Drive, Left
from safe_ompl.live.limits import DriveLimits, own_caps
from safe_ompl.live.robot_bodies import RobotBodies
from safe_ompl.maths.kernels.driving import ceilings, drive
from safe_ompl.maths.kernels.hull_gaps import cell_gaps, gaps
from safe_ompl.people.reach import ReachSets
from safe_ompl.trajectories.caps import speed_caps
from safe_ompl.trajectories.curve import BlendedCurve
from safe_ompl.trajectories.time_law import velocity_cap
from safe_ompl.trajectories.trajectory import Trajectory

STEP = 0.02  # [rad] largest cell
_BENDING = 0.5  # share of the accelerations that arcs may take; the rest is for speeding up and braking
_SLOWEST = 0.1  # [m/s] of people, in estimates
_BARRED = 0.02  # share of the full speed: ways that are slower than this are barred
_AHEAD = 1.0  # [s] that estimates look ahead at most
_COARSE = 0.1  # [rad] cells of estimates
_ROUGH = 5e-3  # [m] of distances in estimates
_CLOSE = 1e-4  # [m] of distances that are told
_SAME = 1e-9  # [rad]


@dataclass(frozen=True)
class GuardedPath:
    """Cells of a curve, and what must be known to drive it.

    Attributes
    ----------
    bodies : RobotBodies
        Of the robot.
    curve : BlendedCurve
        The path, proven against all that stands still.
    limits : DriveLimits
        What it keeps to.
    edges : ndarray, shape (N + 1,)
        Ends of the cells [rad].
    squares, brakes : ndarray, shape (N,)
        Bounds of ṡ² and |s̈|: |q′|b + |q″|X keeps to the accelerations.
    stops : ndarray of int
        Edges where the robot stops.
    frames : (ndarray of shape (N, m, 3, 3), ndarray of shape (N, m, 3))
        Of the joints at the centres of the cells.
    travel : ndarray, shape (N, G)
        How far the bodies get from there [m].
    """

    bodies: RobotBodies
    curve: BlendedCurve
    limits: DriveLimits
    edges: FloatArray
    squares: FloatArray
    brakes: FloatArray
    stops: IntArray
    frames: tuple[FloatArray, FloatArray]
    travel: FloatArray

    @classmethod
    def of(cls, bodies: RobotBodies, trajectory: Trajectory) -> GuardedPath:
        """Return the path of a trajectory, with its limits and its caps but those by people.

        Of its time law nothing is kept: the robot is as fast as limits, caps and people let it.
        """
        path = cls.along(bodies, trajectory.curve, DriveLimits.of(trajectory))
        squares = path.squares
        middles = 0.5 * (trajectory.law.edges[1:] + trajectory.law.edges[:-1])
        begin = np.clip(
            np.searchsorted(trajectory.law.edges, path.edges[:-1], side="right") - 1, 0, len(middles) - 1
        )
        end = np.clip(
            np.searchsorted(trajectory.law.edges, path.edges[1:], side="left"), begin + 1, len(middles)
        )
        for cap in own_caps(trajectory):
            least = [cap.speeds[a:b].min() for a, b in zip(begin, end, strict=True)]
            squares = np.minimum(squares, np.square(least))
        return replace(path, squares=squares)

    @classmethod
    def along(
        cls, bodies: RobotBodies, curve: BlendedCurve, limits: DriveLimits, step: float = STEP
    ) -> GuardedPath:
        """Return the path along a curve, in cells no longer than a step [rad]."""
        cells, joints = curve.cells(step), limits.joints
        with np.errstate(divide="ignore"):
            bending = np.sqrt((_BENDING * joints.acceleration / cells.bends).min(axis=1))
        speeds = np.minimum(velocity_cap(cells, joints), bending)
        of_bodies = bodies.speeds(curve, cells)
        for cap in speed_caps(of_bodies, limits.tool_speed, limits.link_speed):
            speeds = np.minimum(speeds, cap.speeds)
        rest = joints.acceleration - cells.bends * (speeds * speeds)[:, None]
        with np.errstate(divide="ignore"):
            brakes = np.where(cells.slopes > 0, rest / cells.slopes, np.inf).min(axis=1)
        frames = bodies.frames(curve.at(cells.centres).q)
        return cls(
            bodies,
            curve,
            limits,
            cells.edges,
            speeds * speeds,
            brakes,
            cells.stops,
            frames,
            bodies.travel(of_bodies, cells),
        )

    def __repr__(self) -> str:
        return f"GuardedPath({self.length:.3g} rad, {len(self.brakes)} cells)"

    @property
    def length(self) -> float:
        """Arc length [rad]."""
        return float(self.edges[-1])

    @cached_property
    def ceiling(self) -> FloatArray:
        """The largest ṡ² (N + 1,) at the ends of the cells from which all stops are reached."""
        found: FloatArray = ceilings(np.diff(self.edges), self.squares, self.brakes, self.stops)
        return found

    @cached_property
    def coarse(self) -> GuardedPath:
        """The same path in large cells, for estimates."""
        return GuardedPath.along(self.bodies, self.curve, self.limits, _COARSE)

    def drive(self, s: float, square: float, push: float, tick: float) -> Drive:
        """Return the motion of a tick [s] from (s, ṡ²) that accelerates by a share of what brakes allow."""
        return Drive(*drive(self.edges, self.squares, self.brakes, self.ceiling, s, square, push, tick))

    def left(self, motion: Drive, sets: ReachSets, since: float, clearance: float) -> Left:
        """Return what is left along a motion that begins a time after the sets were measured.

        Parameters
        ----------
        motion : Drive
            It.
        sets : ReachSets
            Where what moves may be.
        since : float
            From the measurement to the beginning of the motion [s], ≥ 0.
        clearance : float
            What must be left [m].
        """
        times = since + motion.times
        return self.least(motion.cells, times[:-1], times[1:], sets, clearance, 0.0, stop=True)

    def pace(self, sets: ReachSets, clearance: float, reaction: float) -> tuple[FloatArray, float]:
        """Return how long (N,) each cell takes beside people as they stand now, and for how long that holds [s].

        In a cell where people need τ to come the robot is no faster than what stops within τ − reaction; where that is
        next to nothing it takes for ever. It holds until somebody can be so near that a cell takes longer: 0 where that
        is so already. An estimate, to compare ways: what is driven is proven by `left`.
        """
        full = np.sqrt(self.squares)
        speeds, left = full, _AHEAD
        if len(sets):
            fastest = max(float(sets.growth[:, 1].max()), _SLOWEST)
            needed = reaction + full / self.brakes
            margins = cell_gaps(
                np.arange(len(self.brakes)),
                *self._beside(sets, clearance, fastest * (float(needed.max()) + _AHEAD), _ROUGH),
            )
            left = max(0.0, float((margins / fastest - needed).min()))
            speeds = np.minimum(full, self.brakes * (margins / fastest - reaction))
        barred = speeds < _BARRED * full
        return np.where(barred, np.inf, np.diff(self.edges) / np.where(barred, 1.0, speeds)), left

    def from_to(self, first: float, last: float) -> GuardedPath:
        """Return the path between two arc lengths; it begins at the start of the piece that holds the first one."""
        piece = int(self.curve.piece_at(np.array([first]))[0])
        begin = float(self.curve.starts[piece])
        a = int(np.searchsorted(self.edges, begin - _SAME))
        b = max(int(np.searchsorted(self.edges, last - _SAME)), a + 1)
        edges = np.append(self.edges[a:b], last) - begin
        end = int(self.curve.piece_at(np.array([0.5 * (self.edges[b - 1] + last)]))[0])
        pieces = list(self.curve.pieces[piece : end + 1])
        pieces[-1] = pieces[-1]._replace(length=last - float(self.curve.starts[end]))
        stops = [k - piece for k in self.curve.stops if piece < k <= end]
        rotations, origins = self.frames
        return replace(
            self,
            curve=BlendedCurve(pieces, stops),
            edges=edges,
            squares=self.squares[a:b],
            brakes=self.brakes[a:b],
            stops=self.stops[(self.stops > a) & (self.stops < b)] - a,
            frames=(rotations[a:b], origins[a:b]),
            travel=self.travel[a:b],
        )

    def then(self, other: GuardedPath) -> GuardedPath:
        """Return this path and, after a stop at its end, another one that begins there."""
        count, pieces = len(self.brakes), len(self.curve.pieces)
        stops = [*self.curve.stops, pieces, *(pieces + k for k in other.curve.stops)]
        return replace(
            self,
            curve=BlendedCurve([*self.curve.pieces, *other.curve.pieces], stops),
            edges=np.concatenate([self.edges, self.length + other.edges[1:]]),
            squares=np.concatenate([self.squares, other.squares]),
            brakes=np.concatenate([self.brakes, other.brakes]),
            stops=np.concatenate([self.stops, [count], count + other.stops]).astype(np.intp),
            frames=(
                np.concatenate([self.frames[0], other.frames[0]]),
                np.concatenate([self.frames[1], other.frames[1]]),
            ),
            travel=np.concatenate([self.travel, other.travel]),
        )

    def _beside(self, sets: ReachSets, *rest: float) -> Any:
        """Return frames, travel and hulls of the cells, the sets, and the rest, in the order of `kernels.hull_gaps`."""
        return *self.frames, self.travel, *self.bodies.arrays, *sets.arrays, *rest

    def least(
        self,
        cells: IntArray,
        begin: FloatArray,
        end: FloatArray,
        sets: ReachSets,
        clearance: float,
        enough: float,
        *,
        stop: bool = False,
    ) -> Left:
        """Return the least that is left in cells (W,) between two instants each; see `kernels.hull_gaps.gaps`."""
        margin, _, body, who = gaps(
            cells,
            begin,
            end,
            *self._beside(sets, clearance, enough, 0.0 if np.isfinite(enough) else _CLOSE, stop),
        )
        if body < 0:
            return Left(np.inf)
        return Left(float(margin), self.bodies.links[body], sets.names[who])
