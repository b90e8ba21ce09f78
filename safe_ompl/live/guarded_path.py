"""A path as the replanner drives it: cells with bounds of speed and braking, and where the robot's bodies are there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.danger.moving_skeleton import JointMotions
from safe_ompl.maths.kernels.driving import ceilings, drive
from safe_ompl.maths.kernels.hull_gaps import cell_gaps, gaps
from safe_ompl.people.reach import ReachSets
from safe_ompl.robot.bodies.reach import bounding_hull
from safe_ompl.robot.robot import Robot
from safe_ompl.trajectories.body_speeds import BodySpeeds
from safe_ompl.trajectories.curve import BlendedCurve, Cells
from safe_ompl.trajectories.limits import RateLimits
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
# Caps of trajectories that the replanner has itself, from moment to moment.
LIVE_CAPS = ("joint velocity", "separation", "separation or contact", "bends beside people")


class RobotBodies:
    """The moving bodies of a robot as hulls in the frames of their joints, with balls about them.

    Parameters
    ----------
    robot : Robot
        The robot.

    Attributes
    ----------
    links : tuple of str
        The link of each of the G moving bodies.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        parts = list(robot.shared.collision_model.geometryObjects)
        self._moving = [k for k, part in enumerate(parts) if part.parentJoint != 0]
        hulls = [bounding_hull(parts[k].geometry).moved(parts[k].placement) for k in self._moving]
        self.links = tuple(parts[k].name.rsplit("_", 1)[0] for k in self._moving)
        carriers: IntArray = np.array([parts[k].parentJoint - 1 for k in self._moving], dtype=np.intp)
        first: IntArray = np.cumsum([0] + [len(hull.points) for hull in hulls]).astype(np.intp)
        middles = np.array([hull.points.mean(axis=0) for hull in hulls]).reshape(-1, 3)
        extents = [np.linalg.norm(h.points - c, axis=1).max() for h, c in zip(hulls, middles, strict=True)]
        self.arrays = (
            carriers,
            np.ascontiguousarray(np.concatenate([np.zeros((0, 3)), *(hull.points for hull in hulls)])),
            first,
            np.array([hull.radius for hull in hulls]),
            middles,
            np.array(extents),
        )
        self._joints = JointMotions(robot)
        self._speeds = BodySpeeds(robot)

    def frames(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rotations (B, m, 3, 3) and origins (B, m, 3) of the joints at `Q: (B, n)`."""
        rotations, origins, _ = self._joints.frames(Q)
        return rotations, origins

    def travel(self, curve: BlendedCurve, cells: Cells) -> FloatArray:
        """Return how far (N, G) the bodies get from where they are at the centres of cells, at most [m]."""
        bounds = self._speeds.bounds(curve, cells)[:, self._moving]
        found: FloatArray = np.ascontiguousarray(bounds * cells.sizes[:, None] / 2)
        return found


class Left(NamedTuple):
    """The least that is left between a motion and what moves.

    Attributes
    ----------
    margin : float
        Lower bound of distance less growth, less what must be left [m]; +inf if there is nobody.
    link : str or None
    who : (str, str) or None
        Who, and which limb.
    """

    margin: float
    link: str | None = None
    who: tuple[str, str] | None = None


class Drive(NamedTuple):
    """A motion of one tick along a path, and the stop after it.

    Attributes
    ----------
    cells : ndarray of int, shape (W,)
        In which cell each piece of it is.
    places, squares, times : ndarray, shape (W + 1,)
        s, ṡ², and the time since it began [s] where pieces meet.
    """

    cells: IntArray
    places: FloatArray
    squares: FloatArray
    times: FloatArray

    @property
    def duration(self) -> float:
        """When it stands [s]."""
        return float(self.times[-1])

    def at(self, time: float) -> tuple[float, float, float]:
        """Return s, ṡ and s̈ at a time since it began [s]; at rest after its end."""
        if time >= self.duration:
            return float(self.places[-1]), 0.0, 0.0
        k = max(int(np.searchsorted(self.times, time, side="right")) - 1, 0)
        span, since = self.times[k + 1] - self.times[k], max(time, 0.0) - self.times[k]
        speed, after = np.sqrt(self.squares[k]), np.sqrt(self.squares[k + 1])
        push = (after - speed) / span if span > 0 else 0.0
        place = self.places[k] + since * (speed + 0.5 * since * push)
        return float(min(place, self.places[k + 1])), float(max(speed + since * push, 0.0)), float(push)


@dataclass(frozen=True)
class GuardedPath:
    """Cells of a curve, and what must be known to drive it.

    Attributes
    ----------
    bodies : RobotBodies
        Of the robot.
    curve : BlendedCurve
        The path, proven against all that stands still.
    limits : RateLimits
        Of the joints.
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
    limits: RateLimits
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
        path = cls.along(bodies, trajectory.curve, trajectory.limits)
        squares = path.squares
        middles = 0.5 * (trajectory.law.edges[1:] + trajectory.law.edges[:-1])
        begin = np.clip(
            np.searchsorted(trajectory.law.edges, path.edges[:-1], side="right") - 1, 0, len(middles) - 1
        )
        end = np.clip(
            np.searchsorted(trajectory.law.edges, path.edges[1:], side="left"), begin + 1, len(middles)
        )
        for cap in trajectory.caps:
            if cap.name not in LIVE_CAPS:
                least = [cap.speeds[a:b].min() for a, b in zip(begin, end, strict=True)]
                squares = np.minimum(squares, np.square(least))
        return replace(path, squares=squares)

    @classmethod
    def along(
        cls, bodies: RobotBodies, curve: BlendedCurve, limits: RateLimits, step: float = STEP
    ) -> GuardedPath:
        """Return the path along a curve, in cells no longer than a step [rad]."""
        cells = curve.cells(step)
        with np.errstate(divide="ignore"):
            bending = np.sqrt((_BENDING * limits.acceleration / cells.bends).min(axis=1))
        speeds = np.minimum(velocity_cap(cells, limits), bending)
        rest = limits.acceleration - cells.bends * (speeds * speeds)[:, None]
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
            bodies.travel(curve, cells),
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
