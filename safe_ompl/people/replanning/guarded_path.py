"""A path as the replanner follows it: cells with bounds of speed and braking, and the robot's bodies in each cell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.danger import JointMotions
from safe_ompl.geometry.kernels import CellFrames, Hulls, cell_gaps, gaps
from safe_ompl.people import ReachSets
from safe_ompl.people.replanning.command import Margin, StopMotion
from safe_ompl.robot import Robot, bounding_hull
from safe_ompl.trajectories import (
    LINK_SPEED,
    TOOL_SPEED,
    BlendedCurve,
    BodySpeeds,
    Cells,
    RateLimits,
    SpeedCap,
    Trajectory,
    arc_cap,
    braking,
    ceilings,
    drive,
    speed_caps,
    velocity_cap,
)

STEP = 0.02  # [rad] largest cell
_SLOWEST = 0.01  # [m/s] of people, in estimates
_BARRED = 0.02  # share of the full speed: ways that are slower than this are barred
_AHEAD = 1.0  # [s] that estimates look ahead at most
_COARSE = 0.1  # [rad] cells of estimates
_ENDS = 2  # cells at the ends of a path that are estimated again in small ones if they are barred
_ROUGH = 5e-3  # [m] of distances in estimates
_CLOSE = 1e-4  # [m] of margins that are exact
_SAME = 1e-9  # [rad]
# Caps of trajectories that the replanner derives itself at every tick.
_DERIVED = ("joint velocity", "separation", "separation or contact", "bends beside people")


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
        self.arrays = Hulls(
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

    def speeds(self, curve: BlendedCurve, cells: Cells) -> FloatArray:
        """Return the bounds of `BodySpeeds` (N, all bodies and the tip) [m/rad]."""
        return self._speeds.bounds(curve, cells)

    def travel(self, speeds: FloatArray, cells: Cells) -> FloatArray:
        """Return how far (N, G) the moving bodies get from where they are at the centres of cells, at most [m]."""
        found: FloatArray = np.ascontiguousarray(speeds[:, self._moving] * cells.sizes[:, None] / 2)
        return found


@dataclass(frozen=True)
class PathLimits:
    """Limits that every path of the replanner keeps, whatever its curve is.

    Attributes
    ----------
    joints : RateLimits
        Velocities and accelerations of the joints.
    tool_speed, link_speed : float, optional
        Of the tip, and of every point of every link [m/s].
    """

    joints: RateLimits
    tool_speed: float | None = None
    link_speed: float | None = None

    @classmethod
    def of(cls, trajectory: Trajectory) -> PathLimits:
        """Return those of a trajectory."""
        speeds = {cap.name: cap.limit for cap in trajectory.caps}
        return cls(trajectory.limits, speeds.get(TOOL_SPEED), speeds.get(LINK_SPEED))

    def same_as(self, other: PathLimits) -> bool:
        """Return whether the other limits are equal to these."""
        return (
            np.array_equal(self.joints.velocity, other.joints.velocity)
            and np.array_equal(self.joints.acceleration, other.joints.acceleration)
            and (self.tool_speed, self.link_speed) == (other.tool_speed, other.link_speed)
        )


def own_caps(trajectory: Trajectory) -> tuple[SpeedCap, ...]:
    """Return the caps of a trajectory that are proven on its own curve only, such as of danger."""
    return tuple(cap for cap in trajectory.caps if cap.name not in _DERIVED and cap.limit is None)


@dataclass(frozen=True)
class GuardedPath:
    """A curve in cells, with the bounds that hold in each.

    Attributes
    ----------
    bodies : RobotBodies
        The robot's.
    curve : BlendedCurve
        The path, proven against all that stands still.
    limits : PathLimits
        The limits that it keeps.
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
    limits: PathLimits
    edges: FloatArray
    squares: FloatArray
    brakes: FloatArray
    stops: IntArray
    frames: tuple[FloatArray, FloatArray]
    travel: FloatArray

    @classmethod
    def of(cls, bodies: RobotBodies, trajectory: Trajectory) -> GuardedPath:
        """Return the path of a trajectory, with its limits and all its caps except those by people.

        Its time law is not kept: the robot is as fast as limits, caps and people let it.
        """
        path = cls.along(bodies, trajectory.curve, PathLimits.of(trajectory))
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
        cls, bodies: RobotBodies, curve: BlendedCurve, limits: PathLimits, step: float = STEP
    ) -> GuardedPath:
        """Return the path along a curve, in cells no longer than a step [rad]."""
        cells, joints = curve.cells(step), limits.joints
        speeds = np.minimum(velocity_cap(cells, joints), arc_cap(cells, joints))
        of_bodies = bodies.speeds(curve, cells)
        for cap in speed_caps(of_bodies, limits.tool_speed, limits.link_speed):
            speeds = np.minimum(speeds, cap.speeds)
        frames = bodies.frames(curve.at(cells.centres).q)
        return cls(
            bodies,
            curve,
            limits,
            cells.edges,
            speeds * speeds,
            braking(cells, joints, speeds),
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

    @cached_property
    def fine(self) -> GuardedPath:
        """The same path in cells that are not larger than those of paths that are driven."""
        short = np.diff(self.edges).max() <= STEP * (1 + 1e-9)
        return self if short else GuardedPath.along(self.bodies, self.curve, self.limits)

    def motion_from(self, s: float, square: float, push: float, tick: float) -> StopMotion:
        """Return the motion of a tick [s] from (s, ṡ²), with a share of the acceleration of brakes, and its stop."""
        return StopMotion(*drive(self.edges, self.squares, self.brakes, self.ceiling, s, square, push, tick))

    def margin(
        self, motion: StopMotion, sets: ReachSets, since: float, clearance: float, *, exact: bool = False
    ) -> Margin:
        """Return the smallest margin along a motion; see `safe_ompl.geometry.kernels.gaps`.

        Parameters
        ----------
        motion : StopMotion
            A motion along this path.
        sets : ReachSets
            Where people and objects may be.
        since : float
            From the measurement of the sets to the beginning of the motion [s], ≥ 0.
        clearance : float
            Distance that must be left [m].
        exact : bool
            Whether to find the smallest margin, to 0.1 mm. If not, only its sign is right: a negative margin is the
            first one that is found.
        """
        times = since + motion.times
        enough, close = (np.inf, _CLOSE) if exact else (0.0, 0.0)
        margin, _, body, who = gaps(
            motion.cells,
            np.stack([times[:-1], times[1:]]),
            *self._arrays(sets, clearance, enough, close, not exact),
        )
        if body < 0:
            return Margin(np.inf)
        return Margin(float(margin), self.bodies.links[body], sets.names[who])

    def pace(self, sets: ReachSets, clearance: float, reaction: float) -> tuple[FloatArray, float]:
        """Return how long (N,) each cell takes beside people as they are now, and for how long that holds [s].

        In a cell that people need τ to reach, the robot is no faster than what stops within τ − reaction; a cell that
        allows less than a fiftieth of the full speed is barred (inf). The times hold until somebody can be so near that
        a cell takes longer: 0 where that is so already. This estimate compares paths; what is driven is proven by
        `margin`.
        """
        times, left = self._cell_times(sets, clearance, reaction)
        barred = np.isinf(times)
        if not barred.any() or barred[_ENDS:-_ENDS].any() or self.fine is self:
            return times, left
        # A robot that stands near something leaves it in cells that are shorter than the distance.
        fine = self.fine
        sums = np.zeros(len(times))
        inside = np.searchsorted(self.edges, 0.5 * (fine.edges[1:] + fine.edges[:-1])) - 1
        np.add.at(sums, inside, fine._cell_times(sets, clearance, reaction)[0])
        return np.where(barred, sums, times), left

    def _cell_times(self, sets: ReachSets, clearance: float, reaction: float) -> tuple[FloatArray, float]:
        """Return what `pace` says, with the bounds of these cells alone."""
        full = np.sqrt(self.squares)
        speeds, left = full, _AHEAD
        if len(sets):
            fastest = max(float(sets.growth[:, 1].max()), _SLOWEST)
            needed = reaction + full / self.brakes
            margins = cell_gaps(
                np.arange(len(self.brakes)),
                *self._arrays(sets, clearance, fastest * (float(needed.max()) + _AHEAD), _ROUGH),
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

    def _arrays(self, sets: ReachSets, *rest: float) -> Any:
        """Return frames, travel and hulls of the cells, the sets, and the rest, in the order of `gaps`."""
        return CellFrames(*self.frames, self.travel), self.bodies.arrays, sets.arrays, *rest
