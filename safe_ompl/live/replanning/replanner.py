"""The replanner: a robot follows trajectories among people, with detours around people and retreats from people.

A retreat is a motion that does not reduce the distance to people who are too near for any other motion. When a limb is
measured, it is inside a set. Let u be the unit vector along which a body of the robot is farthest from the set at the
beginning of the motion. Let the plane P be perpendicular to u and touch the body on the side of the set. The body
*recedes* from the limb if the set is on the other side of P and no point of the body crosses P. Then the limb needs at
least as long to reach the body as to reach P. The same bound holds for a body that stands.

Let a vertex of the body be at a distance a ≥ 0 from P at the beginning of the motion, and b ≥ 0 at its end. Let l be
the arc length of the motion and A a bound of the second derivative of the distance. At an arc length x the vertex is
below the chord from a to b by at most A x(l − x)/2. So the vertex does not cross P if √a + √b ≥ √(A l²/2). A convex
body recedes if all its vertices do. A body that only turns about the axis of the first joint stays in the solid that it
sweeps about this axis. Along u, a vertex at a distance r from the axis is never below the point of the axis by more
than r‖u⊥‖. Such a body recedes from every set that a plane perpendicular to u separates from this solid.

A body that does not recede must keep its margin as in any other motion. A body that must recede is no faster than
`RETREAT_SPEED`. People who follow the body may touch it, as they may touch a robot that stands.

A program is executed in segments with one replanner for each stretch; a segment begins where the robot rests after the
last one. The places of a route are visited in the order of the earliest expected arrival.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from safe_ompl.collision import MotionProver
from safe_ompl.common import BoolArray, FloatArray, InputError
from safe_ompl.live import ReachSets
from safe_ompl.live.replanning.bounded_path import BoundedPath, CellFrames, RobotBodies, SpeedLimits, StopLaw, line
from safe_ompl.live.replanning.commands import Action, Command, CommandProver
from safe_ompl.live.replanning.detours import Detours
from safe_ompl.motions import SEPARATION, Trajectory, first_unproven
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

# Path accelerations that are tried in retreats, as shares of the braking.
_ACCELERATIONS = (1.0, 0.2, 0.0, -1.0)
# A robot that is slower than this tries a retreat.
_CRAWL = 0.3  # [rad/s]
# A retreat begins only if it moves the robot this many times as far as continuing along the path.
_RETREAT_ADVANTAGE = 2.0
# Configurations nearer than this are equal.
_EQUAL_CONFIGURATIONS = 1e-6  # [rad]
# The robot retreats from limbs that can reach it within the first time. If no retreat is found, only limbs that can
# reach it within the second time count.
_SOON = (0.2, 0.12)  # [s]
# The lengths of the retreats that are tried.
_LENGTHS = (0.6, 0.3, 0.15)  # [rad]
# The step of finite differences.
_NUDGE = 1e-4  # [rad]
# The search also tries retreats in which up to this many first joints stand still, because links near the base
# cannot move away.
_MOST_STILL_JOINTS = 3
# Iterations of the search for a direction away from all limbs.
_DIRECTION_ITERATIONS = 40
# Limbs that are farther away than this are not considered.
_FAR_AWAY = 0.35  # [m]
# A retreat must increase the distances by at least this.
_LEAST_DISTANCE_GAIN = 0.02  # [m/rad]


class Replanner(CommandProver):
    """Makes a robot follow trajectories among people and objects that move.

    The motion until the next tick, and the stop on the path after it, are always proven: they touch no person or object
    that stays in its reach sets. If contact is allowed, they touch a limb only at speeds that the limb tolerates
    (`safe_ompl.motions.contact`). At every tick the robot takes the fastest motion that is proven against the newest
    measurement. If there is no such motion, or only slow ones, the robot retreats from people who are near: no body of
    the robot moves nearer to them, but people who follow the robot may touch it. Otherwise the robot follows the stop
    of the previous tick, whose proof covers all motions of people until the robot stands. The robot continues as soon
    as a motion is proven again.

    Parameters are those of `CommandProver`. Trajectories and detours satisfy the limits of the prover. If the
    trajectory has a jerk limit, all motions satisfy it, including stops and detours.

    Examples
    --------
    >>> from safe_ompl.live import find_skeleton
    >>> robot = Robot.from_example("panda").with_accelerations({f"panda_joint{k}": 10.0 for k in range(1, 8)})
    >>> around = Surroundings(Scene(), {"anna": Tracker(find_skeleton("coco17"))}, people=People(speed=1.6))
    >>> replanner = Replanner(robot, around)
    >>> path = [[-1.2, 0, 0, -2.0, 0, 2.2, 0.785], [1.2, 0, 0, -2.0, 0, 2.2, 0.785]]
    >>> replanner.start(time_path(path, robot, RateLimits.of(robot), motion=replanner.prover))
    >>> late = replanner.update({"anna": [[3.0, 0.0, 1.0]] * 17}, {}, 0.0)
    >>> replanner.command(0.02).action.value
    'moving'
    """

    # None before the first trajectory, and if detours are not searched.
    detours: Detours | None = None
    _path: BoundedPath | None = None
    # Other goals that may be reached instead.
    _others: tuple[FloatArray, ...] = ()
    # The detour, and the arc length of the present path at which it begins.
    _detour: tuple[BoundedPath, float] | None = None
    # The retreat, which begins where the robot stands.
    _retreat: BoundedPath | None = None
    _retreats: Retreats | None = None

    def start(self, trajectory: Trajectory, others: Sequence[FloatArray] = ()) -> None:
        """Follow a trajectory from where the robot stands; detours may lead to other goals `others`, each (n,).

        The curve of the trajectory is proven again against all still obstacles. Its limits hold, except the limits
        for people. Its time law is not used: the robot is as fast as limits and people allow. Raises
        InputError if the robot moves or stands elsewhere; if the trajectory has other joints or is not free; or if it
        has a limit that is proven on its own curve only, such as the danger limit.
        """
        if trajectory.joint_names != self.robot.joint_names:
            raise InputError(
                f"the trajectory has the joints {trajectory.joint_names}, the robot's are {self.robot.joint_names}"
            )
        path = BoundedPath.along(self.bodies, trajectory.curve, SpeedLimits.of(trajectory))
        last = self._last
        if last is not None:
            if last.action not in (Action.DONE, Action.STANDING):
                raise InputError("the robot still moves: start when it stands or is done")
            away = self.robot.difference(last.at(np.inf).q, path.curve.places(np.zeros(1)).q[0])
            if np.abs(away).max() > _EQUAL_CONFIGURATIONS:
                raise InputError(f"the trajectory begins {np.abs(away).max():.3g} rad from where the robot stands")
        blocked = first_unproven(trajectory.curve, self.prover)
        if blocked is not None:
            begin = trajectory.curve.knots[blocked].round(3).tolist()
            raise InputError(
                f"piece {blocked} of the trajectory, from {begin} on, is not proven free of still obstacles"
            )
        self._path, self._last, self._detour, self._retreat, self._others = path, None, None, None, tuple(others)
        retreats = self.options.retreats and not self.prover.separation.tube
        joints = self.robot.joint_names if self.options.joints is None else self.options.joints
        movable = np.isin(self.robot.joint_names, joints)
        self._retreats = Retreats(self.prover, self.bodies, path.limits, movable) if retreats else None
        if self.options.detours:
            if self.detours is None or not path.limits.same_as(self.detours.limits):
                self.detours = Detours(self.prover, self.bodies, path.limits, self.tick, movable)
            self.detours.cover(trajectory.curve)

    def soonest(self, trajectories: Sequence[Trajectory]) -> int:
        """Return the index of the trajectory with the earliest expected end; all begin where the robot stands.

        If nobody was seen yet, or no detours are searched, it is the trajectory of the shortest duration.
        """
        if self.detours is None or not self.surroundings.known:
            return int(np.argmin([trajectory.duration for trajectory in trajectories]))
        around = self._around(self.surroundings.time)
        paths = (BoundedPath.along(self.bodies, one.curve, SpeedLimits.of(one)) for one in trajectories)
        return int(np.argmin([path.coarse.pace(around, self.tick)[0].sum() for path in paths]))

    def resume(self, command: Command | None) -> None:
        """Continue from the end of a command of this replanner, where the robot stands; None: from the beginning."""
        self._last, self._detour, self._retreat = command, None, None
        if command is not None:
            self._path = command.path

    def command(self, time: float) -> Command:
        """Return the command from a time [s] on; an InputError if it is before the last command or measurement."""
        path = self._path
        if path is None:
            raise InputError("start a trajectory first")
        s, speed = self._place(time)
        found = None
        if self._detour is not None:
            detour, begin = self._detour
            past = self._past
            if past is not None:
                self._past = past._replace(places=past.places - begin)
            found = self._next(detour, max(s - begin, 0.0), speed, time)
            self._detour, self._past = None, past
        if found is None:
            found = self._next(path, s, speed, time)
        if self._retreats is not None:
            found = self._retreating(found, path, s, speed, time)
        self._retreat = None
        if found is None:
            found = self._kept(path, s, speed, time)
        self._path = found.path
        return self._given(found, time)

    def think(self, units: int = 60) -> bool:
        """Search a detour if people block or slow the path ahead; return whether the next command has a detour.

        Call it after `command`, in the time left until the next command, which takes the detour if it is proven.
        `units` limits the work: an estimate of an edge is 1 unit, a proof 8 units. Results are kept for the next call.
        """
        command = self._last
        if command is None or not self.surroundings.known or command.action is Action.DONE:
            return False
        now = max(command.time, self.surroundings.time)
        around = self._around(now)
        if self.detours is not None:
            self._detour = self.detours.search(command, around, now, units, self._others)
        if self._detour is None and self._retreats is not None and command.action is Action.STANDING:
            at = float(command.motion.places[-1])
            self._retreat = self._retreats.search(command.path, at, around.sets)
        for path in (self._path, self._retreat):
            if path is not None and self._retreats is not None:
                path.prepare()
        return self._detour is not None

    def _retreating(
        self, found: Command | None, path: BoundedPath, s: float, speed: float, time: float
    ) -> Command | None:
        """Return a retreat if it moves the robot much farther than `found`, or continues a retreat; else `found`."""
        if found is not None and (found.path is not path or found.action in (Action.MOVING, Action.DONE)):
            return found
        last = self._last
        advance = 0.0 if found is None else found.motion.at(self.tick)[0] - s
        if last is None or last.action is not Action.RETREATING:
            if max(speed * self.tick, advance) > _CRAWL * self.tick:
                return found
            advance *= _RETREAT_ADVANTAGE
        retreat = self._recede(path, s, speed, time)
        if retreat is not None:
            return retreat if retreat.motion.at(self.tick)[0] - s > advance else found
        if found is None and self._retreat is not None and speed == 0:
            return self._recede(self._retreat, 0.0, 0.0, time)
        return found

    def _recede(self, path: BoundedPath, s: float, speed: float, time: float) -> Command | None:
        """Return the fastest motion from (s, ṡ) that recedes from all people who are near; None if there is none."""
        if self.surroundings.trouble(time, self.options.lost_after) is not None:
            return None
        around = self._around(time)
        receding = Receding(path, s, around.sets)
        for share in _ACCELERATIONS:
            motion = path.motion_from(s, speed * speed, share, self.tick, self._past)
            if motion.places[-1] - s < _EQUAL_CONFIGURATIONS:
                continue
            margin = path.margin(motion, around, receding=receding.along(motion))
            if margin.margin >= 0:
                why = margin, self._margin.description, SEPARATION
                return Command(time, self.surroundings.time, path, motion, Action.RETREATING, *why)
        return None


class Receding:
    """Decides which of G bodies recede from which of M limbs along motions that begin at s of a path."""

    def __init__(self, path: BoundedPath, s: float, sets: ReachSets) -> None:
        self._path, self._s, self._sets = path, s, sets
        frames = path.bodies.frames(path.curve.places(np.array([s])).q)
        self._axes, self._apart = _ahead(path.bodies, frames, sets)
        self._always = np.zeros((len(path.bodies.links), len(sets.names)), dtype=bool)
        for g in np.flatnonzero(path.bodies.turning).tolist():
            near = np.flatnonzero((self._apart[g] > 0.0) & (self._apart[g] < np.inf))
            lost = path.bodies.swept(g, frames, self._axes[g, near])
            self._always[g, near[self._apart[g, near] > lost]] = True

    def along(self, motion: StopLaw) -> BoolArray:
        """Return which pairs (G, M) recede along a motion; with a corner, only pairs that recede for all motions."""
        path, last = self._path, float(motion.places[-1])
        found, corners = self._always.copy(), path.edges[path.cells.stops]
        if not len(motion.cells) or ((self._s < corners) & (corners < last)).any():
            return found
        frames = path.bodies.frames(path.curve.places(np.array([self._s, last])).q)
        curvatures = path.accelerations[motion.cells].max(axis=0) * (last - self._s) ** 2 / 2
        body, which = np.nonzero(path.bodies.hulls.chords_ahead(frames, self._axes, self._apart, curvatures))
        found[body, which] = True
        return found


def _ahead(bodies: RobotBodies, frames: CellFrames, sets: ReachSets) -> tuple[FloatArray, FloatArray]:
    """Return directions (G, S, 3) from sets to bodies, and lower bounds (G, S) of their distances along these [m].

    The sets are taken at the time of the measurement, and the first of the frames. Distances above `_FAR_AWAY` are
    infinite.
    """
    axes, apart = bodies.hulls.separating_axes(frames, sets.arrays, _FAR_AWAY)
    return axes, apart - bodies.hulls.pads[:, None] - sets.radii - sets.grown(0.0)


class Retreats:
    """Searches motions of the `movable` joints (n,) that recede from people and are free of still obstacles."""

    def __init__(
        self, prover: MotionProver, bodies: RobotBodies, limits: SpeedLimits, movable: BoolArray | bool = True
    ) -> None:
        self._prover, self._bodies, self._limits, self._movable = prover, bodies, limits, movable

    def search(self, path: BoundedPath, s: float, sets: ReachSets) -> BoundedPath | None:
        """Return a motion from s of a path away from people, back to s and on along the path; None if none is found."""
        q = path.curve.places(np.array([s])).q[0]
        end = self._away(q, sets)
        if end is None:
            return None
        out, back, rest = (
            BoundedPath.along(self._bodies, curve, self._limits)
            for curve in (line(q, end), line(end, q), path.curve.part(s, path.length))
        )
        return out.then(back).then(rest)

    def _away(self, q: FloatArray, sets: ReachSets) -> FloatArray | None:
        """Return the end of a free motion away from people who are near; None if nobody is near or none is found."""
        n, robot, bodies = len(q), self._prover.checker.robot, self._bodies
        frames = bodies.frames(np.vstack([q, q + _NUDGE * np.eye(n)]))
        axes, apart = _ahead(bodies, frames, sets)
        after = [sets.grown(soon) - sets.grown(0.0) for soon in _SOON]
        pairs = np.argwhere((apart > 0.0) & (apart < np.max(after, axis=0)))
        near = [(g, pairs[pairs[:, 0] == g, 1]) for g in np.unique(pairs[:, 0]).tolist()]
        least = [(bodies.vertices(g, frames) @ axes[g, limbs].T).min(axis=1) for g, limbs in near]
        rates = np.concatenate([np.zeros((0, n)), *((each[1:] - each[0]).T / _NUDGE for each in least)])
        for grown, still in product(after, range(min(n, _MOST_STILL_JOINTS + 1))):
            some = rates[apart[tuple(pairs.T)] < grown[pairs[:, 1]]] * (self._movable & (np.arange(n) >= still))
            some = some[some.any(axis=1)]
            direction = _away_from_all(some)
            if not len(some) or (some @ direction).min() < _LEAST_DISTANCE_GAIN:
                continue
            for length in _LENGTHS:
                end = q + length * direction
                if robot.within_limits(end).all() and self._prover.is_free(q, end):
                    return np.asarray(end)
        return None


def _away_from_all(rates: FloatArray) -> FloatArray:
    """Return a direction (n,) whose least product with the rates (P, n) is large, by the perceptron's iteration."""
    units = rates / np.maximum(np.linalg.norm(rates, axis=1), 1e-9)[:, None]
    sum_ = units.sum(axis=0)
    best, most = sum_, -np.inf
    for _ in range(_DIRECTION_ITERATIONS if len(rates) else 0):
        unit = sum_ / max(float(np.linalg.norm(sum_)), 1e-9)
        worst = int((rates @ unit).argmin())
        if rates[worst] @ unit > most:
            best, most = unit, float(rates[worst] @ unit)
        sum_ = sum_ + units[worst]
    return np.asarray(best)


@dataclass(frozen=True)
class Segment:
    """A trajectory that is executed without a change of robot or scene, and a pause [s] after it.

    A segment without a trajectory is only a pause, with the replanner of the previous segment. A segment that must stay
    on its curve has a replanner without detours and retreats.
    """

    replanner: Replanner
    trajectory: Trajectory | None
    # The robot with its attached objects.
    robot: Robot
    # The obstacles, and which links may touch them.
    scene: Scene
    # The number of the step of the program.
    step: int = 0
    pause: float = 0.0


class SegmentSequence:
    """Segments that are executed in order; raises InputError if the first has no trajectory, or one is not free."""

    def __init__(self, segments: Sequence[Segment]) -> None:
        if not segments or segments[0].trajectory is None:
            raise InputError("must begin with a trajectory", "segments")
        self.segments, self.done = tuple(segments), 0
        self._rests_since: float | None = None
        for segment in self.segments:
            if segment.trajectory is not None:
                segment.replanner.start(segment.trajectory)

    @property
    def current(self) -> Segment:
        """The segment that is being executed, or the last one if all are executed."""
        return self.segments[min(self.done, len(self.segments) - 1)]

    @property
    def finished(self) -> bool:
        """Whether all segments are executed."""
        return self.done == len(self.segments)

    def go_on(self, now: float) -> None:
        """Begin the next segment if the robot has stood at the end of this one for the pause; `now` is in [s]."""
        segment = self.current
        self._rests_since = now if self._rests_since is None else self._rests_since
        if self.finished or now < self._rests_since + segment.pause:
            return
        self.done += 1
        self._rests_since = None
        if self.current.replanner is not segment.replanner:
            self.current.replanner.surroundings.take_over(segment.replanner.surroundings)


class Route:
    """Places that a robot visits once in each round; the next place is the one with the earliest expected arrival.

    `trajectories` maps a pair of indices of the K ≥ 2 places to the trajectory between them. The route begins at
    place 0.
    """

    def __init__(self, trajectories: Mapping[tuple[int, int], Trajectory]) -> None:
        self.trajectories = trajectories
        begins = {i: one.curve.places(np.zeros(1)).q[0] for (i, _), one in trajectories.items()}
        self.places: FloatArray = np.array([begins[k] for k in sorted(begins)])
        # The places of this round that are not visited yet.
        self._left: set[int] = set()

    @classmethod
    def between(
        cls, places: Sequence[FloatArray], to_and_fro: Callable[[FloatArray, FloatArray], Sequence[Trajectory]]
    ) -> Route:
        """Return the route between places (n,); `to_and_fro` returns both trajectories between two places."""
        found: dict[tuple[int, int], Trajectory] = {}
        for i, k in combinations(range(len(places)), 2):
            found[i, k], found[k, i] = to_and_fro(places[i], places[k])
        return cls(found)

    def start(self, replanner: Replanner, q: FloatArray) -> None:
        """Start from the place at `q: (n,)` to one not visited in this round; detours may lead to the others."""
        here = int(np.abs(self.places - q).max(axis=1).argmin())
        self._left = self._left - {here} or {*range(len(self.places))} - {here}
        order = sorted(self._left)
        ahead = [self.trajectories[here, k] for k in order]
        first = replanner.soonest(ahead)
        replanner.start(ahead[first], [self.places[k] for k in order if k != order[first]])
