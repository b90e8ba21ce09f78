"""Execution of other planners' trajectories beside people: the action FollowJointTrajectory without ROS.

Before the execution the whole trajectory is proven among still obstacles. At every tick its stop beside people is
proven (`Shield.follow`). If a person is in the way, the robot stops on the path, and continues as soon as this is
proven. The robot also stops on the path for the faults of a `LiveController` (missing joint states, a clock that jumps,
new points of a cloud). Then the rest of the trajectory is proven again from the robot's position, until it can be
executed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, InputError, SafeOmplError
from safe_ompl.live.replanning import Shield
from safe_ompl.live.ros.controller import LiveController
from safe_ompl.live.ros.messages import rows_of, seconds
from safe_ompl.motions import Motion
from safe_ompl.robot import Robot

# The name of the action below the controller's name.
ACTION = "guard"
# The time between two attempts to continue when something new blocks the path.
_AGAIN = 0.5  # [s]
# The time that joints have to reach the end after the last command.
_SETTLES = 1.0  # [s]
_EQUAL_JOINT_VALUES = 1e-6  # [rad or m]
# The execution must begin within this time.
_BEGINS = 10.0  # [s]


class Code(IntEnum):
    """Values of `error_code` in the action's result."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class Outcome(NamedTuple):
    """The result of an execution, and its reason."""

    code: Code
    reason: str = ""
    cancelled: bool = False


class GoalError(InputError):
    """Raised for a goal that cannot be executed; has the error code of the action."""

    def __init__(self, code: Code, message: str, parameter: str | None = None) -> None:
        super().__init__(message, parameter)
        self.code = code


class Tolerance(NamedTuple):
    """Tolerances (n,) of joint positions and velocities; infinite: no tolerance."""

    position: FloatArray
    velocity: FloatArray

    def missed(self, robot: Robot, away: FloatArray, slower: FloatArray) -> str:
        """Return a text with the joint that exceeds its tolerance and the error, or an empty text."""
        for what, off, most in (("rad or m", away, self.position), ("rad/s or m/s", slower, self.velocity)):
            k = int((off - most).argmax())
            if off[k] > most[k]:
                return f"{robot.joint_names[k]!r} is off by {off[k]:.3g}, more than {most[k]:.3g} {what}"
        return ""


@dataclass
class Execution:
    """A trajectory to execute: K points at times (K,) [s], its tolerances, and the state of the execution."""

    times: list[float]
    # Positions, velocities and accelerations, as lists of (n,). The last two may be None.
    rows: tuple[Any, ...]
    path: Tolerance  # measured from commanded joints
    # The tolerance of the measured joints at the last point.
    end: Tolerance
    # The start time [s].
    begin: float = -np.inf
    # The execution may take longer than the trajectory by this [s].
    allowed: float = np.inf
    # The function that gets the outcome.
    report: Callable[[Outcome], Any] = print
    # When the goal was accepted, and when the robot began to move [s].
    taken: float = 0.0
    began: float = np.inf
    # The motion from where the robot stood.
    motion: Motion | None = None
    # The time on the motion up to which commands were sent [s].
    done: float = 0.0
    # The shield that computes the commands, and the time on the motion at which its path begins [s]; None: not proven
    # yet.
    drive: tuple[Shield, float] | None = None
    # Why the last attempt to execute it failed.
    rejection: str = ""

    @classmethod
    def of(cls, goal: Any, robot: Robot, tolerance: float) -> Execution:
        """Read a goal of the action. `tolerance` [rad or m] is used if the goal has none. Raises GoalError."""
        if goal.multi_dof_trajectory.joint_names or goal.component_path_tolerance or goal.component_goal_tolerance:
            raise GoalError(Code.INVALID_JOINTS, "has multi-DOF joints, which are not supported", "goal")
        given, points = goal.trajectory, goal.trajectory.points
        strange = [name for name in given.joint_names if name not in robot.joint_names]
        if strange:
            raise GoalError(Code.INVALID_JOINTS, f"{strange[0]!r} is not one of {robot.joint_names}", "joint_names")
        if not points or not all(len(point.positions) for point in points):
            raise GoalError(Code.INVALID_GOAL, "must have at least one point, and positions in every point", "points")
        times = [seconds(point.time_from_start) for point in points]
        if times[0] < 0 or (np.diff(times) <= 0).any():
            raise GoalError(Code.INVALID_GOAL, f"must increase from 0 on, got {times}", "time_from_start")
        try:
            rows = tuple(rows_of(given, robot))
        except InputError as error:
            missing = set(robot.joint_names) - set(given.joint_names)
            raise GoalError(Code.INVALID_JOINTS if missing else Code.INVALID_GOAL, str(error)) from None
        begin, late = seconds(given.header.stamp), seconds(goal.goal_time_tolerance)
        return cls(
            times,
            rows,
            _tolerance(goal.path_tolerance, "path_tolerance", robot, tolerance),
            _tolerance(goal.goal_tolerance, "goal_tolerance", robot, tolerance),
            begin if begin > 0 else -np.inf,
            late if late > 0 else np.inf,
        )

    @property
    def duration(self) -> float:
        """Duration without slowing [s]."""
        return self.times[-1]

    @property
    def arrived(self) -> bool:
        """Whether commands up to the end were sent."""
        return self.done >= self.duration - _EQUAL_JOINT_VALUES

    def drive_with(self, shield: Shield, start: FloatArray, tolerance: float) -> None:
        """Let a shield execute the rest from the robot's position. Raises SafeOmplError if the rest is not proven."""
        try:
            shield.start(start)
            motion = self._from(start, shield.robot) if self.motion is None else self.motion
            self.drive = shield, shield.follow(motion, max(self.done, 0.0), tolerance)
        except SafeOmplError as error:
            self.rejection = str(error)
            raise
        self.motion, self.rejection = motion, ""

    def _from(self, start: FloatArray, robot: Robot) -> Motion:
        """Return the motion through the points; if they begin after 0 s, the motion begins at the robot's position."""
        times, rows = self.times, self.rows
        if times[0] > 0:
            here = rows[0][0] - robot.difference(start, rows[0][0])
            firsts = here, np.zeros(robot.n), np.zeros(robot.n)
            times = [0.0, *times]
            rows = tuple(None if row is None else [first, *row] for row, first in zip(rows, firsts, strict=True))
        positions, velocities, accelerations = rows
        return Motion.hermite(times, positions, velocities, accelerations, robot.joint_names)


def _tolerance(given: Any, what: str, robot: Robot, usual: float) -> Tolerance:
    """Return the tolerances of a goal: 0 is the usual one, a negative one is none. On the path none may be larger."""
    found = Tolerance(np.full(robot.n, usual), np.full(robot.n, np.inf))
    for one in given:
        if one.name not in robot.joint_names:
            raise GoalError(Code.INVALID_JOINTS, f"{one.name!r} is not one of {robot.joint_names}", what)
        if one.acceleration > 0:
            raise GoalError(
                Code.INVALID_GOAL,
                f"has an acceleration of {one.name!r}, which cannot be checked: accelerations are not measured",
                what,
            )
        if what == "path_tolerance" and not 0 <= one.position <= usual:
            reason = f"of {one.name!r} must be at most {usual:g}, which stops the robot, got {one.position:g}"
            raise GoalError(Code.INVALID_GOAL, reason, what)
        k = robot.joint_names.index(one.name)
        for limit, most in zip(found, (one.position, one.velocity), strict=True):
            if most:
                limit[k] = most if most > 0 else np.inf
    return found


class TrajectoryGuard:
    """Executes trajectories with a `LiveController`, calls its `tick`, and reports the result of each trajectory.

    The cell of the controller plans with `Execution.drive_with`.
    """

    def __init__(self, controller: LiveController, clock: Callable[[], float]) -> None:
        self.controller, self._clock = controller, clock
        self.execution: Execution | None = None
        # The outcome that is reported once the robot stands.
        self._ending: Outcome | None = None
        self._tried = -np.inf

    def take(self, execution: Execution) -> None:
        """Execute a trajectory as soon as the robot stands. A running trajectory is aborted with a stop on its path."""
        execution.taken = now = self._clock()
        late = now - execution.begin - execution.duration
        if 0 < late < np.inf:
            execution.report(Outcome(Code.OLD_HEADER_TIMESTAMP, f"it was over {late:.2f} s ago"))
            return
        if self.execution is not None:
            self._report(self._ending or Outcome(Code.INVALID_GOAL, "a new trajectory took its place"))
        self.execution, self._tried = execution, -np.inf
        self.controller.pursue(None, "a new trajectory")

    def cancel(self) -> None:
        """Stop on the path. The trajectory is reported as cancelled when the robot stands."""
        self._end(Outcome(Code.SUCCESSFUL, "cancelled", cancelled=True))

    def _end(self, outcome: Outcome) -> None:
        if self.execution is not None and self._ending is None:
            self._ending = outcome
            self.controller.pursue(None, outcome.reason)

    def _report(self, outcome: Outcome) -> None:
        execution, self.execution, self._ending = self.execution, None, None
        assert execution is not None
        execution.report(outcome)

    # ----------------------------------------------------------------------------------------------------- ticks

    def tick(self) -> dict[str, Any]:
        """Compute a tick, as `LiveController.tick`, and update the state of the trajectory."""
        execution, controller = self.execution, self.controller
        idle = controller.goal is None and not controller.driving and self._ending is None
        if execution is not None and idle and not execution.arrived:
            now = self._clock()
            if now >= max(execution.begin, self._tried + _AGAIN):
                self._tried = now
                controller.pursue(execution, execution.rejection or "a new trajectory")
        tick = controller.tick()
        if execution is not None:
            self._look(execution, tick["time"], tick["reason"])
        return tick

    def _look(self, execution: Execution, now: float, reason: str) -> None:
        """Report the progress of a trajectory. End it if it has arrived, failed, or takes too long."""
        controller, command, drive = self.controller, self.controller.command, execution.drive
        driven = drive is not None and controller.commanded_by is drive[0]
        if driven and command is not None:
            assert drive is not None
            execution.began = min(execution.began, now)
            execution.done = drive[1] + float(command.motion.places[-1])
        stands = command is None or now >= command.standstill
        missed = execution.path.missed(controller.cell.robot, *controller.errors()) if driven else ""
        if self._ending is not None:
            if stands:
                self._report(self._ending)
        elif missed:
            self._end(Outcome(Code.PATH_TOLERANCE_VIOLATED, missed))
        elif drive is None and execution.rejection:
            self._report(Outcome(Code.INVALID_GOAL, execution.rejection))
        elif drive is None and now > max(execution.taken, execution.begin) + _BEGINS:
            self._end(Outcome(Code.INVALID_GOAL, f"it could not begin: {reason}"))
        elif execution.arrived:
            if stands:
                self._compare(execution, now)
        elif now > execution.began + execution.duration + execution.allowed:
            late = f"later than allowed at {max(execution.done, 0.0):.2f} of {execution.duration:.2f} s: {reason}"
            self._end(Outcome(Code.GOAL_TOLERANCE_VIOLATED, late))

    def _compare(self, execution: Execution, now: float) -> None:
        """Report whether the robot is at the end of the trajectory."""
        controller, command = self.controller, self.controller.command
        if controller.goal is not None:
            controller.pursue(None, "at the end")
        joints, robot, motion = controller.joints, controller.cell.robot, execution.motion
        if command is None or joints is None or joints.time < command.standstill or motion is None:
            return
        away = robot.difference(motion.knots[-1], joints.q)
        missed = execution.end.missed(robot, np.abs(away), np.abs(joints.qd))
        settled = np.nan_to_num(execution.allowed, posinf=0.0) + execution.began + execution.duration
        if not missed:
            self._report(Outcome(Code.SUCCESSFUL))
        elif now > max(command.standstill + _SETTLES, settled):
            self._report(Outcome(Code.GOAL_TOLERANCE_VIOLATED, missed))

    def progress(self) -> tuple[float, FloatArray, FloatArray] | None:
        """Return the present time on the trajectory [s], and the desired joint values and velocities (n,)."""
        execution, command = self.execution, self.controller.command
        if execution is None or execution.drive is None or command is None:
            return None
        if self.controller.commanded_by is not execution.drive[0]:
            return None
        now = self._clock()
        state = command.at(max(now, command.time))
        return execution.drive[1] + command.motion.at(max(now - command.time, 0.0))[0], state.q, state.qd
