"""Time a path: blend its corners, compute speed limits, and find the fastest time law within them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import MotionProver
from safe_ompl.common import InputError, instance, number
from safe_ompl.motions.blends import blended
from safe_ompl.motions.cells import BodySpeeds
from safe_ompl.motions.danger import danger_velocity_limit
from safe_ompl.motions.limits import RateLimits
from safe_ompl.motions.motion import Motion
from safe_ompl.motions.separation import PeopleDistances
from safe_ompl.motions.stops import people_velocity_limits
from safe_ompl.motions.time_law import SmoothLimits, TimeLaw, best_window, fastest_law, joint_velocity_limit
from safe_ompl.motions.trajectory import Trajectory, VelocityLimit
from safe_ompl.motions.velocity_limits import (
    Standstill,
    StandstillError,
    TimingLimits,
    bending_velocity_limit,
    body_speed_limits,
)
from safe_ompl.robot import Robot

BLEND_TOLERANCE = 0.05  # [rad] of blends
CELL_LENGTH = 0.02  # [rad] largest cell
# Largest share of the time until people may arrive that is lost to the length of a cell. Beside a person, the coarse
# share takes a quarter of the computing time, and motions become 9 to 17 % slower.
_FINE_TIME_LOSS, _COARSE_TIME_LOSS = 0.02, 0.15
# Default minimum number of cells of a path.
CELLS = 400
# The search for the averaging window needs only a rough law: about this many cells, in which q′ changes by at most
# `_WINDOW_SEARCH_TURN`.
_WINDOW_SEARCH_CELLS, _WINDOW_SEARCH_TURN = 100, 0.3


def time_path(path: ArrayLike, robot: Robot, limits: RateLimits | None = None, **options: Any) -> Trajectory:
    """Return the fastest trajectory along a path that keeps its limits at every instant.

    Parameters
    ----------
    path : array_like, shape (N, n)
        Way points, such as `PlanResult.path`, joined by straight motions.
    robot : Robot
        The robot.
    limits : RateLimits, optional
        Joint velocities and accelerations. Default: `RateLimits.of(robot)`. If they limit the jerk, the trajectory is
        not quite the fastest one.
    **options
        Those of `PathTimer`: `motion`, which proves blends, their `tolerance`, and further limits of the speed:
        `people`, `tool_speed`, `link_speed`, `danger` and `max_danger`.

    Raises
    ------
    StandstillError
        If people, or the danger, allow no speed at some point. The error names the point, the person, the link and what
        would have to change.
    InputError
        If the path has fewer than two way points, is not finite, does not move or leaves the joint limits; if a person
        touches the robot at its start; or as `PathTimer`.
    """
    return PathTimer(robot, limits, **options).time(path)


class PathTimer:
    """Times many paths of one robot in one scene. Data that do not depend on the path are computed once.

    Parameters
    ----------
    robot : Robot
        The robot.
    limits : RateLimits, optional
        As in `time_path`.
    motion : MotionProver, optional
        Proves the blends at corners. Without it the robot stops at every corner.
    tolerance : float
        Largest distance of blends from the path [rad].
    **speed_limits
        Further limits of the speed. `people` who may come near: the robot is nowhere faster than is proven to stop
        before they touch it. This needs `motion`, whose scene contains the people. `tool_speed` and `link_speed`:
        largest speed of the tip, and of any point of any link [m/s]. `max_danger`: largest value of `danger`, a
        `KinetostaticField` of the robot in motion.

    Raises
    ------
    InputError
        If limits are missing or of other joints; if the tolerance is negative, or a speed not positive; if only one of
        `danger` and `max_danger` is given; if people are given without `motion`; if `motion` has a tube, and further
        speeds are limited; or if contact is allowed and the jerk is limited.

    Examples
    --------
    >>> robot = Robot.from_example("ur5")
    >>> timer = PathTimer(robot, RateLimits.of(robot, acceleration=8.0))
    >>> timer.time([[0.0] * 6, [0.5] * 6]).duration < timer.time([[0.0] * 6, [1.0] * 6]).duration
    True
    """

    def __init__(
        self,
        robot: Robot,
        limits: RateLimits | None = None,
        *,
        motion: MotionProver | None = None,
        tolerance: float = BLEND_TOLERANCE,
        **speed_limits: Any,
    ) -> None:
        self.robot = instance("robot", robot, Robot)
        self.limits = RateLimits.of(robot) if limits is None else instance("limits", limits, RateLimits)
        if self.limits.joint_names != robot.joint_names:
            raise InputError(
                f"the limits are for the joints {self.limits.joint_names}, the robot's are {robot.joint_names}"
            )
        self.timing_limits = within_tube(TimingLimits(**speed_limits), motion)
        self.motion, self.people = motion, self.timing_limits.people
        if self.people is not None and self.people.contact and self.limits.jerk is not None:
            raise InputError("contact cannot be proven with a jerk limit: leave one of them out", "people.contact")
        self.tolerance = number("tolerance", tolerance, at_least=0.0)
        self._bodies = BodySpeeds(robot)
        self.distances: PeopleDistances | None = None
        if self.people is not None:
            if motion is None:
                raise InputError("give a motion prover, whose scene contains the people", "motion")
            self.distances = PeopleDistances(robot, motion.checker.scene, self.people)

    def time(self, path: ArrayLike, *, cells: int = CELLS) -> Trajectory:
        """Return the fastest trajectory along a path; parameters and errors as `time_path`.

        Parameters
        ----------
        path : array_like, shape (N, n)
            Way points.
        cells : int
            Minimum number of cells of the curve. The result is proven for any number. With fewer than 400, cells are
            divided less where people limit the speed: 60 cells take a quarter of the time (a Panda beside a person: 25
            ms instead of 100), and the motion becomes some 9 to 17 % slower.
        """
        points = self.robot.way_points(path)
        if len(points) < 2:
            raise InputError(f"a trajectory needs a path of at least two way points, got {len(points)}")
        for k, q in enumerate(points):
            if (beyond := self.robot.beyond_limits(q)) is not None:
                raise InputError(f"way point {k}: {beyond}")
        return self.along(blended(points, self.robot, self.tolerance, self.motion, self.limits), cells=cells)

    def along(self, motion: Motion, *, cells: int = CELLS) -> Trajectory:
        """Return the fastest trajectory along a path whose corners are already blended (`blended`); see `time`."""
        limits, brakes, window, velocity_limits = self.limits, None, 0.0, list[VelocityLimit]()
        speeds = self.timing_limits.tool_speed, self.timing_limits.link_speed
        coarse, step = cells < CELLS, motion.length / cells
        grid = motion.cells(step if coarse else min(CELL_LENGTH, step))
        if self.distances is not None:
            loss = _COARSE_TIME_LOSS if coarse else _FINE_TIME_LOSS
            grid, brakes, window, velocity_limits = people_velocity_limits(
                motion, grid, self._bodies, limits, self.distances, loss
            )
        elif limits.jerk is not None:
            few = motion.cells(motion.length / _WINDOW_SEARCH_CELLS, _WINDOW_SEARCH_TURN)
            window = best_window(few, limits, joint_velocity_limit(few, limits))
        velocity_limits = [VelocityLimit("joint velocity", joint_velocity_limit(grid, limits)), *velocity_limits]
        if any(speeds):
            velocity_limits += body_speed_limits(self._bodies.bounds(motion, grid), *speeds)
        danger, max_danger = self.timing_limits.danger, self.timing_limits.max_danger
        if danger is not None and max_danger is not None:
            most = np.min([limit.speeds for limit in velocity_limits], axis=0)
            grid, of, allowed = danger_velocity_limit(motion, grid, danger, max_danger, most)
            for j in np.flatnonzero(allowed <= 0):
                q = motion.places(grid.centres[j : j + 1]).q[0]
                reason = (
                    f"the danger of the robot at rest is {danger.field.value(q):.4g} there, "
                    f"{max_danger:.4g} is allowed; allow more, or keep the path farther away"
                )
                raise StandstillError(Standstill(float(grid.centres[j]), q, reason))
            velocity_limits = [replace(limit, speeds=limit.speeds[of]) for limit in velocity_limits]
            brakes = None if brakes is None else brakes[of]
            velocity_limits.append(VelocityLimit("danger", np.where(allowed < most[of], allowed, np.inf)))
        most = np.min([limit.speeds for limit in velocity_limits], axis=0)
        if window:
            own = joint_velocity_limit(grid, limits)
            own = own if self.people is None else np.minimum(own, bending_velocity_limit(grid, limits))
            smooth = SmoothLimits.of(grid, limits, own, window, stops=self.people is not None)
            law: TimeLaw = smooth.law(limits, most)
        else:
            law = TimeLaw.through(grid.edges, fastest_law(grid, limits.acceleration, most))
        kept = self.people, *speeds, danger, max_danger
        return Trajectory(motion, law, limits, tuple(velocity_limits), brakes, *kept)


def within_tube(limits: TimingLimits, motion: MotionProver | None) -> TimingLimits:
    """Return the speed limits for a robot that may be anywhere in the tube of the prover.

    The tube is added to the clearance from people. Raises InputError for limits that cannot be proven within a tube.
    """
    if motion is None or not motion.separation.tube:
        return limits
    others = limits.tool_speed, limits.link_speed, limits.danger
    if any(limit is not None for limit in others) or (limits.people is not None and limits.people.contact):
        raise InputError(
            "bounds positions, not velocities: speeds of tool, links and contacts, and danger in motion, cannot be "
            "proven within it",
            "tube",
        )
    if limits.people is None:
        return limits
    nearer = motion.separation.tube_displacement(motion.checker)
    return replace(limits, people=replace(limits.people, clearance=limits.people.clearance + nearer))
