"""From a path to a trajectory: blends, caps of the speed, and the fastest law within them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import MotionProver
from safe_ompl.common import FloatArray, InputError, finite_array, instance, number
from safe_ompl.danger import KinetostaticField
from safe_ompl.robot import Robot
from safe_ompl.scene import People, Scene
from safe_ompl.trajectories.body_speeds import BodySpeeds
from safe_ompl.trajectories.caps import MotionCaps, Standstill, StandstillError, bending_cap, people_caps, speed_caps
from safe_ompl.trajectories.curve import BlendedCurve, blended
from safe_ompl.trajectories.danger import MovingDanger, danger_cap
from safe_ompl.trajectories.limits import RateLimits
from safe_ompl.trajectories.separation import PeopleDistances
from safe_ompl.trajectories.time_law import SmoothLimits, TimeLaw, best_window, fastest_law, velocity_cap
from safe_ompl.trajectories.trajectory import SpeedCap, Trajectory

BLEND_TOLERANCE = 0.05  # [rad] of blends
CELL_LENGTH = 0.02  # [rad] largest cell
_FINE, _COARSE = 0.02, 0.15  # share of the time that is left which the length of a cell may cost
CELLS = 400  # at least, on the whole path
_SEARCHED, _TURN = 100, 0.3  # cells, about, of the search for a window, and what q′ may change in one
_SAME = 1e-9  # relative, of ṡ²


def time_path(
    path: ArrayLike,
    robot: Robot,
    limits: RateLimits | None = None,
    *,
    motion: MotionProver | None = None,
    tolerance: float = BLEND_TOLERANCE,
    people: People | None = None,
    tool_speed: float | None = None,
    link_speed: float | None = None,
    danger: KinetostaticField | None = None,
    max_danger: float | None = None,
) -> Trajectory:
    """Return the fastest trajectory along a path that keeps its limits at every instant.

    Parameters
    ----------
    path : array_like, shape (N, n)
        Way points, such as those of `PlanResult.path`; straight motions between them.
    robot : Robot
        The robot.
    limits : RateLimits, optional
        Joint velocities and accelerations; default: `RateLimits.of(robot)`. If they limit the jerk the trajectory is
        not quite the fastest one.
    motion : MotionProver, optional
        What proves the blends that round the corners. Without it the robot stops in every corner.
    tolerance : float
        How far blends may be from the path [rad].
    people : People, optional
        Who may come near: the robot is nowhere faster than what is proven to stop before they touch it. Needs `motion`,
        whose scene says where people are.
    tool_speed, link_speed : float, optional
        Largest speed of the tip, and of any point of any link [m/s].
    danger : KinetostaticField, optional
        The danger of the robot in motion, such as `DangerField(...).moving`.
    max_danger : float, optional
        The largest danger that it may reach anywhere; given together with `danger`.

    Raises
    ------
    StandstillError
        If people, or the danger, allow no speed somewhere; says where, who, which link and what would have to change.
    InputError
        If only one of `danger` and `max_danger` is given, or the limit is not positive.
        If somebody touches the robot where it starts; if a speed is not positive; if the path has fewer than two way
        points, is not finite, does not move or leaves the joint limits; if limits are missing or of other joints; if
        the tolerance is negative.
    """
    caps = MotionCaps(people, tool_speed, link_speed, danger, max_danger)
    return PathTimer(robot, limits, motion=motion, tolerance=tolerance, caps=caps).time(path)


class PathTimer:
    """Times many paths of one robot in one scene; what does not depend on the path is computed once.

    It is the cheap form for replanning beside people who move:

    * `move` changes where people are, in place; nothing is built anew. All else of the scene stands still.
    * `retimed` times the rest of a trajectory again, from a time and the speed there: the curve is kept, and with it
      the proof of its blends; distances to people, caps and law are new.
    * `cells` says how fine. Any number is as proven; with fewer than 400 cells are divided less where people bound the
      speed: 60 take a quarter of the time (a Panda beside a person: 25 ms instead of 100), and the motion becomes some
      9 to 17 % slower.

    Parameters
    ----------
    robot, limits, motion, tolerance
        As in `time_path`.
    caps : MotionCaps, optional
        What else bounds the speed. Its fields may also be given by name: `PathTimer(robot, people=people)`.

    Raises
    ------
    InputError
        As `time_path`, except for errors of the path; or if `motion` has a tube, and speeds besides are limited; or
        if contact is allowed and the jerk limited.
    """

    def __init__(
        self,
        robot: Robot,
        limits: RateLimits | None = None,
        *,
        motion: MotionProver | None = None,
        tolerance: float = BLEND_TOLERANCE,
        caps: MotionCaps | None = None,
        **named: Any,
    ) -> None:
        self.robot = instance("robot", robot, Robot)
        self.limits = RateLimits.of(robot) if limits is None else instance("limits", limits, RateLimits)
        if self.limits.joint_names != robot.joint_names:
            raise InputError(
                f"the limits are for the joints {self.limits.joint_names}, the robot's are {robot.joint_names}"
            )
        self.caps = within_tube(replace(caps or MotionCaps(), **named), motion)
        self.motion, self.people = motion, self.caps.people
        if self.people is not None and self.people.contact and self.limits.jerk is not None:
            raise InputError("contact is not proven with a limit of the jerk: leave one out", "people.contact")
        if self.people is not None and motion is None:
            raise InputError("give a motion: its scene says where people are", "motion")
        self.tolerance = number("tolerance", tolerance, at_least=0.0)
        self._danger = None if self.caps.danger is None else MovingDanger(self.caps.danger)
        self._bodies = BodySpeeds(robot)
        self._distances: PeopleDistances | None = None
        if self.people is not None and motion is not None:
            self._distances = PeopleDistances(robot, motion.checker.scene, self.people)

    def __repr__(self) -> str:
        return f"PathTimer({self.robot!r}, people={self.people!r})"

    @property
    def distances(self) -> PeopleDistances | None:
        """Distances between robot and people; None without people."""
        return self._distances

    @property
    def has_other_caps(self) -> bool:
        """Whether the speed of tool or links, or the danger, is limited besides joints and separation."""
        return self._danger is not None or any(self.caps.speeds)

    def move(self, scene: Scene) -> None:
        """Take the places of people from another scene: the same people in other poses.

        Raises
        ------
        InputError
            If there are no people, or other ones.
        """
        if self._distances is None:
            raise InputError("there are no people who could move", "people")
        self._distances.move(scene)

    def time(self, path: ArrayLike, *, cells: int = CELLS) -> Trajectory:
        """Return the fastest trajectory along a path; parameters and errors as `time_path`.

        Parameters
        ----------
        path : array_like, shape (N, n)
            Way points.
        cells : int
            How many cells the curve has at least; see the class.
        """
        points = checked_path(path, self.robot)
        curve = blended(points, self.robot, self.tolerance, self.motion, self.limits)
        return self._timed(curve, 0.0, cells)

    def retimed(self, trajectory: Trajectory, time: float = 0.0, *, cells: int = CELLS) -> Trajectory:
        """Return the rest of a trajectory from a time [s] on, timed anew beside people where they are now.

        It begins with the place and the speed of the trajectory at that time.

        Raises
        ------
        StandstillError
            If it may not go on from that speed: what is left is to stop (`Trajectory.stop_from`, which was proven for
            where people were before); and as `time_path`.
        InputError
            If the time is not one of the trajectory's, or somebody touches the robot.
        """
        begin = number("time", time, at_least=0.0, at_most=trajectory.duration)
        _, s, rate, _ = trajectory.law.at(np.array([begin]))
        if self.limits.jerk is not None and (rate[0] > 0 or trajectory.limits.jerk is None):
            raise InputError(
                "with a limit of the jerk only a motion that has one is timed anew, and from rest: stop, then time the "
                "rest"
            )
        curve = trajectory.curve if s[0] == 0 else trajectory.curve.rest(float(s[0]))
        return self._timed(curve, float(rate[0]), cells)

    def _timed(self, curve: BlendedCurve, speed: float, number_of_cells: int) -> Trajectory:
        limits, brakes, window, caps = self.limits, None, 0.0, list[SpeedCap]()
        speeds, max_danger = self.caps.speeds, self.caps.max_danger
        coarse = number_of_cells < CELLS
        step = curve.length / number_of_cells
        cells = curve.cells(step if coarse else min(CELL_LENGTH, step))
        if self._distances is not None:
            loss = _COARSE if coarse else _FINE
            cells, brakes, window, caps = people_caps(curve, cells, self._bodies, limits, self._distances, loss=loss)
        elif limits.jerk is not None:
            few = curve.cells(curve.length / _SEARCHED, _TURN)
            window = best_window(few, limits, velocity_cap(few, limits))
        caps = [SpeedCap("joint velocity", velocity_cap(cells, limits)), *caps]
        if any(speeds):
            caps += speed_caps(self._bodies.bounds(curve, cells), *speeds)
        if self._danger is not None and max_danger is not None:
            most = np.min([cap.speeds for cap in caps], axis=0)
            cells, of, allowed = danger_cap(curve, cells, self._danger, max_danger, most)
            for j in np.flatnonzero(allowed <= 0):
                q = curve.at(cells.centres[j : j + 1]).q[0]
                reason = (
                    f"the danger of the robot at rest is {self._danger.field.field.value(q):.4g} there, "
                    f"{max_danger:.4g} is allowed; allow more, or keep the path farther away"
                )
                raise StandstillError(Standstill(float(cells.centres[j]), q, reason))
            caps = [replace(cap, speeds=cap.speeds[of]) for cap in caps]
            brakes = None if brakes is None else brakes[of]
            caps.append(SpeedCap("danger", np.where(allowed < most[of], allowed, np.inf)))
        kept = self.people, *speeds, self.caps.danger, max_danger
        most = np.min([cap.speeds for cap in caps], axis=0)
        if window:
            own = velocity_cap(cells, limits)
            own = own if self.people is None else np.minimum(own, bending_cap(cells, limits))
            smooth = SmoothLimits.of(cells, limits, own, window, stops=self.people is not None)
            return Trajectory(curve, smooth.law(limits, most), limits, tuple(caps), brakes, *kept)
        squares = fastest_law(cells, limits.acceleration, most, speed)
        if squares[0] < speed * speed * (1 - _SAME):
            q = curve.at(np.zeros(1)).q[0]
            reason = f"it is at {speed:.3f} rad/s, and from no more than {squares[0] ** 0.5:.3f} all holds; stop"
            raise StandstillError(Standstill(0.0, q, reason))
        law = TimeLaw.through(cells.edges, squares)
        return Trajectory(curve, law, limits, tuple(caps), brakes, *kept)


def checked_path(path: ArrayLike, robot: Robot) -> FloatArray:
    """Return a path (N ≥ 2, n) within the limits of the joints, or raise InputError."""
    points = finite_array(path, (None, robot.n), "path")
    if len(points) < 2:
        raise InputError(f"a trajectory needs a path of two way points at least, got {len(points)}")
    for k, q in enumerate(points):
        for i in np.flatnonzero(~robot.within_limits(q)):
            raise InputError(
                f"way point {k}: joint {robot.joint_names[i]!r} = {q[i]:g} is outside its limits "
                f"[{robot.lower[i]:g}, {robot.upper[i]:g}]"
            )
    return points


def within_tube(caps: MotionCaps, motion: MotionProver | None) -> MotionCaps:
    """Return what bounds the speed of a robot that may be anywhere in the tube of what is proven of its path."""
    if motion is None or not motion.separation.tube:
        return caps
    if any(caps.speeds) or caps.danger is not None or (caps.people is not None and caps.people.contact):
        raise InputError(
            "bounds positions, not velocities: speeds of tool, links and contacts, and danger in motion, cannot be "
            "proven within it",
            "tube",
        )
    if caps.people is None:
        return caps
    nearer = motion.separation.swing(motion.checker)
    return replace(caps, people=replace(caps.people, clearance=caps.people.clearance + nearer))
