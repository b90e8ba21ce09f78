"""A controller that moves a robot to goals among people: the work of the ROS node, without ROS.

Commands are proven as in `Replanner`: every command ends in a stop. The controller stops the robot by sending no
further command. It does so

* if joint states are missing, or the robot is not at the commanded configuration;
* if the controller's own command is computed too late to be followed;
* if people are seen who are not tracked, or the cloud has new points since the path was proven;
* if the clock jumps.

When none of these conditions holds, the controller plans again from where the robot stands. For people and objects that
are not seen, or leave their reach sets, the replanner stops by itself. With a shield, proposals take the place of
goals. A program continues where it stopped, from the configuration in which the robot should stand.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, InputError, SafeOmplError, Section, UnknownNameError, key, number
from safe_ompl.geometry import Obstacle, Pose
from safe_ompl.live import Tracker
from safe_ompl.live.replanning import (
    Action,
    Command,
    Replanner,
    ReplanningOptions,
    SegmentSequence,
    Shield,
    stop_as_dict,
)
from safe_ompl.live.ros.messages import by_name, goal_of
from safe_ompl.live.ros.sightings import CloudView, Joints, Sightings
from safe_ompl.motions import Motion, State
from safe_ompl.robot import Robot

_log = logging.getLogger(__name__)

# This many commands are kept for the comparison with measured joints.
_HISTORY = 100
# The robot is stopped if there are no joint states for this long.
_JOINTS_LATE = 0.3  # [s]
# Joints that are slower than this stand still.
_RESTING = 0.01  # [rad/s]
# The measured robot is compared with its commands at this many times within a lag.
_LAGS = 5
_ARRIVED = "at the goal"
# A goal that is nearer than this is reached.
_GOAL_REACHED = 1e-6  # [rad or m]


@dataclass(frozen=True)
class Cell:
    """A robot, the tracked people and objects around it, and the function that plans."""

    robot: Robot
    trackers: Mapping[str, Tracker]  # People
    # The obstacles that move, and bounds of their speeds [m/s].
    objects: Mapping[str, float]
    # Plans from a start (n,) to a goal among the obstacles and the cloud, and returns a started replanner. Raises
    # SafeOmplError if there is no path. Shields and programs have no goal and begin at the start.
    plan: Callable[[FloatArray, Any, Obstacle | None], Replanner | Shield | SegmentSequence]
    # Whether proposals are followed instead of goals.
    shielded: bool = False
    # Whether the scenario has a program.
    program: bool = False
    # The persons and objects that move, as in the header of ticks.
    moving: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ControlOptions(Section):
    """Options of `LiveController`; raises InputError if a value is out of its range."""

    replanning: ReplanningOptions = field(default_factory=ReplanningOptions)
    # The time from a tick until its command holds, at most one tick [s].
    latency: float = 0.05
    # The largest difference between the clocks of sensors and the robot's clock [s].
    clock_error: float = key(number, default=0.01, at_least=0.0)
    # The largest deviation of a joint from the command [rad or m]. If the prover has a tube, the tube counts instead.
    tolerance: float = key(number, default=0.05, above=0.0)
    # The radius of the ball about each point of a cloud [m].
    cloud_radius: float = key(number, default=0.02, above=0.0)

    def check(self) -> None:
        number("latency", self.latency, at_least=0.0, at_most=self.replanning.tick)


class LiveController:
    """Moves a robot to goals.

    Call the `receive_…` methods with measurements as they arrive, and `tick` at the rate of the options. A method that
    takes measurements raises InputError for invalid input and then changes nothing. `clock` returns the present time
    [s] of the clock of all stamps. Plans are made in `executor`, by default in a thread. `command` is the last command;
    while not `driving`, the robot follows it to its stop. The caller sets `blocked` to the reason why the robot must
    not move, or to "" if it may move.
    """

    def __init__(
        self, cell: Cell, clock: Callable[[], float], options: ControlOptions, executor: Executor | None = None
    ) -> None:
        self.cell, self.options, self._clock = cell, options, clock
        self._executor = ThreadPoolExecutor(1) if executor is None else executor
        self._now = -np.inf
        self._planning: Future[Replanner | Shield | SegmentSequence] | None = None
        # A configuration (n,), or another goal that `Cell.plan` accepts.
        self.goal: Any = None
        self._wanted = cell.shielded  # whatever the goal
        self._why, self.blocked = "nothing was proposed yet" if cell.shielded else "no goal yet", ""
        if cell.program:
            self._why = "the program was not started yet"
        self._forget()

    def _forget(self) -> None:
        """Clear all measurements and commands."""
        lost_after, error = self.options.replanning.lost_after, self.options.clock_error
        self._sightings = Sightings((*self.cell.trackers, *self.cell.objects), lost_after, error)
        # The joints as they were measured last.
        self.joints: Joints | None = None
        self._cloud: CloudView | None = None
        self._proven_cloud: CloudView | None = None
        self._strangers: tuple[float, str] = (-np.inf, "")
        self._pilot: Replanner | Shield | None = None
        # The segments of the present or the last program.
        self.segments: SegmentSequence | None = None
        self.driving = False
        # The start of the path that is planned.
        self._start: FloatArray = np.zeros(self.cell.robot.n)
        self.command: Command | None = None
        self.commanded_by: Replanner | Shield | None = None
        self._commands: deque[Command] = deque(maxlen=_HISTORY)

    # --------------------------------------------------------------------------------------------- what was measured

    def receive_joints(
        self, time: float, names: Sequence[str], position: Sequence[float], velocity: Sequence[float] = ()
    ) -> None:
        """Take joint positions and velocities; missing velocities are computed from the previous positions."""
        if time > self._clock() + self.options.clock_error:
            raise InputError(f"is {time - self._clock():.3f} s in the future: the clocks differ", "stamp")
        if self.joints is not None and time <= self.joints.time:
            return  # out of order
        q = by_name(names, position, self.cell.robot.joint_names)
        if len(velocity):
            qd = by_name(names, velocity, self.cell.robot.joint_names)
        elif self.joints is None:
            qd = np.full(len(q), np.inf)  # not known yet
        else:
            qd = self.cell.robot.difference(self.joints.q, q) / (time - self.joints.time)
        self.joints = Joints(time, q, qd)

    def receive_people(self, time: float, people: Mapping[str, FloatArray]) -> None:
        """Take key points (J, 3) of people in the order, axes and unit of their skeletons; NaN: not seen."""
        for name, points in people.items():
            if name in self.cell.trackers:
                self.cell.trackers[name].skeleton.keypoints(points)
        for name, points in people.items():
            if name in self.cell.trackers:
                self._sightings.add(name, time, self._clock(), points)
        strangers = [name for name in people if name not in self.cell.trackers]
        if strangers:
            self._strangers = max(self._strangers, (time, strangers[0]))
            raise UnknownNameError("person", strangers[0], self.cell.trackers)

    def receive_object(self, time: float, name: str, place: Pose) -> None:
        """Take the pose of a moving obstacle in the world frame."""
        if name not in self.cell.objects:
            raise UnknownNameError("object", name, self.cell.objects)
        self._sightings.add(name, time, self._clock(), place)

    def receive_cloud(self, time: float, points: FloatArray) -> None:
        """Take cloud points (M, 3) in the world [m]; points on the robot and on tracked people are left out."""
        if self.joints is None or abs(time - self.joints.time) > _JOINTS_LATE:
            raise InputError("comes without joint states of its time: the robot's own points are not known")
        around = None if self._pilot is None else self._pilot.surroundings
        self._cloud = CloudView.seen(points, self.options.cloud_radius, self.cell.robot, self.joints.q, around)

    def go_to(self, names: Sequence[str], position: Sequence[float]) -> None:
        """Set a goal configuration by joint names: the robot stops, then moves there. Without joints it only stops."""
        if self.cell.program:
            raise InputError("the scenario has a program, which is run", "goal")
        goal = goal_of(self.cell.robot, names, position) if len(names) else None
        self.pursue(goal, "no goal" if goal is None else "a new goal")

    def pursue(self, goal: Any, why: str) -> None:
        """Stop the robot for the reason `why`, then plan and move to a goal; None: stay."""
        self.goal, self._planning = goal, None
        self._halt(why)

    def run(self, wanted: bool) -> None:
        """Execute the program, from where it stopped if it is not finished; False: stop the robot."""
        if wanted and not self.cell.program:
            raise InputError("the scenario has no program", "run")
        if wanted and self.segments is not None and self.segments.finished:
            self.segments = None
        self._wanted = wanted
        if not wanted:
            self._planning = None
            self._halt("stopped")

    def propose(self, motion: Motion | FloatArray, start: float | None = None) -> bool:
        """Pass a proposal to the shield: a motion from a time [s] or from the next tick on, or joint velocities (n,).

        Return whether the proposal is valid; if not, the robot stops, and the next command gives the reason.
        """
        if not self.driving or not isinstance(self._pilot, Shield):
            raise InputError(f"is not followed: {self._why}")
        if isinstance(motion, Motion):
            return self._pilot.propose(motion, start=start)
        return self._pilot.propose_velocity(motion)

    # ------------------------------------------------------------------------------------------------------- ticks

    def tick(self) -> dict[str, Any]:
        """Compute the next command, and return the state of robot and surroundings as a tick (`safe_ompl.io.ticks`).

        If `driving` is true afterwards, the caller sends `command` to the robot.
        """
        before, self._now = self._now, self._clock()
        if self._now < before:
            self._forget()
            # The program cannot be continued, because the objects that are held are no longer known.
            self._planning, self._wanted = None, self.cell.shielded
            self._why = f"the clock went back by {before - self._now:.3f} s"
            return self._record()
        self._take_plan()
        if self.driving:
            why = self._fault()
            if why is not None:
                self._halt(why)
            else:
                self._drive()
        elif (self.goal is not None or self._wanted) and self._planning is None:
            self._start_planning()
        return self._record()

    def think(self, units: int = 60) -> None:
        """Search a detour in the time left until the next tick; see `Replanner.think`."""
        if self.driving and isinstance(self._pilot, Replanner):
            self._pilot.think(units)

    def _halt(self, why: str) -> None:
        """Send no more commands: the robot follows the last one to its stop."""
        self.driving, self._why = False, why

    def _fault(self) -> str | None:
        """Return the reason why the robot must be stopped, or None."""
        if self.blocked:
            return self.blocked
        late = np.inf if self.joints is None else self._now - self.joints.time
        if self.joints is None or late > _JOINTS_LATE:
            return "no joint states yet" if np.isinf(late) else f"no joint states for {late:.2f} s"
        if self._now - self._strangers[0] < self.options.replanning.lost_after:
            return f"{self._strangers[1]!r} is seen, but not tracked"
        if not self.driving:
            return None
        if self._cloud is not None and (new := self._cloud.news(self._proven_cloud)):
            return f"{new} points of the cloud are new"
        return self._astray(self.errors()[0], "it should be") or None

    def _allowed(self) -> FloatArray:
        """Return the largest deviations of joints (n,) from the command: the prover's tube, or the tolerance."""
        tube = () if self._pilot is None else self._pilot.prover.separation.tube
        return np.array(tube) if tube else np.full(self.cell.robot.n, self.options.tolerance)

    def _astray(self, away: FloatArray, where: str) -> str:
        """Return a message if a deviation (n,) of a joint is larger than allowed, else an empty string."""
        allowed, names = self._allowed(), self.cell.robot.joint_names
        joint = int((away - allowed).argmax())
        if away[joint] <= allowed[joint]:
            return ""
        return f"{names[joint]!r} is {away[joint]:.3f} from where {where}, and {allowed[joint]:.3g} is allowed"

    def _expected(self) -> list[State]:
        """Return the commanded states at several times within the lag before the last measurement of the joints."""
        now, lag = -np.inf if self.joints is None else self.joints.time, self.options.replanning.lag
        times = (now - lag * np.linspace(0.0, 1.0, _LAGS if lag else 1)).tolist()
        given = [(time, [one for one in self._commands if one.time <= time]) for time in times]
        return [before[-1].at(time) for time, before in given if before]

    def errors(self) -> tuple[FloatArray, FloatArray]:
        """Return deviations of the measured joint positions and velocities (n,) from the nearest commanded state."""
        found, joints = self._expected(), self.joints
        if joints is None or not found:
            return np.zeros(self.cell.robot.n), np.zeros(self.cell.robot.n)
        nearest = min(found, key=lambda state: float((self._apart(state.q, joints.q) / self._allowed()).max()))
        return self._apart(nearest.q, joints.q), np.abs(nearest.qd - joints.qd)

    def _apart(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Return the absolute differences (n,) of the joints of two configurations."""
        return np.asarray(np.abs(self.cell.robot.difference(one, other)))

    def _drive(self) -> None:
        """Pass the measurements to the replanner or shield, and compute the next command."""
        assert self._pilot is not None
        self._inform(self._pilot)
        command = self._pilot.command(self._now + self.options.latency)
        if command is not self.command:
            late, new = self._clock() - command.time, command.time >= self._now
            # The previous command still holds, and the next plan begins at its end.
            if new and late > 0:
                allowed = 1e3 * self.options.latency
                taken = f"{1e3 * late + allowed:.0f} ms after its tick"
                self._halt(f"the command was computed {taken}, and a latency of {allowed:.0f} ms is allowed")
                return
            self._commands.append(command)
        self.command, self.commanded_by, self._why = command, self._pilot, command.reason
        if command.action is not Action.DONE or self.cell.shielded:
            return
        if self.segments is not None:
            self.segments.go_on(self._now)
            self._pilot = self.segments.current.replanner
            if not self.segments.finished:
                return
        self.goal, self._wanted, self.driving, self._why = None, False, False, _ARRIVED

    def _inform(self, pilot: Replanner | Shield) -> None:
        due = self._sightings.due(self._now)
        if due is None:
            return
        time, seen = due
        people = {name: points for name, points in seen.items() if name in self.cell.trackers}
        try:
            pilot.update(people, {name: seen[name] for name in seen if name not in people}, time)
        # Only a hand of the person is known, so the person is not seen yet.
        except InputError as error:
            _log.warning("%s", error)

    # ---------------------------------------------------------------------------------------------------- planning

    def _start_planning(self) -> None:
        """Begin to plan if the robot stands and there is no fault."""
        why = self._fault()
        if why is not None:
            self._why = why
            return
        assert self.joints is not None
        stood = self.command is None or self.joints.time > self.command.standstill
        if not stood or np.abs(self.joints.qd).max() > _RESTING:
            return
        start = self.joints.q
        # The commanded state is used as the start, because it has no tracking error.
        if self.command is not None:
            rest = self.command.at(np.inf).q
            away = self._apart(rest, start)
            if self.segments is not None:
                self._resume(away)
                return
            start = start if self._astray(away, "") else rest
        goal = start if self.goal is None else self.goal
        if not self._wanted and isinstance(goal, np.ndarray) and self._apart(start, goal).max() < _GOAL_REACHED:
            self.goal, self._why = None, _ARRIVED
            return
        self._start, self._proven_cloud = start, self._cloud
        cloud = None if self._cloud is None else self._cloud.obstacle()
        self._planning = self._executor.submit(self.cell.plan, start, goal, cloud)
        self._why = "plans"

    def _resume(self, away: FloatArray) -> None:
        """Continue the program if the deviations `away` (n,) of the joints from its last command are allowed."""
        assert self.segments is not None
        if why := self._astray(away, "the program goes on"):
            self._why = why
            return
        replanner = self.segments.current.replanner
        replanner.resume(self.command if self.commanded_by is replanner else None)
        self.driving = True

    def _take_plan(self) -> None:
        """If a plan is finished, begin to execute it."""
        if self._planning is None or not self._planning.done():
            return
        planning, self._planning = self._planning, None
        try:
            found = planning.result()
        except SafeOmplError as error:
            what = "the program cannot be executed" if self.cell.program else "no way to the goal"
            self.goal, self._wanted, self._why = None, self.cell.shielded, f"{what}: {error}"
            return
        if self.joints is None or self._astray(self._apart(self._start, self.joints.q), ""):
            # The robot was moved in the meantime, so a new plan is needed.
            return
        self.segments = found if isinstance(found, SegmentSequence) else None
        self._pilot = found.current.replanner if isinstance(found, SegmentSequence) else found
        self._sightings.restart()
        self.driving, self.command = True, None
        self._commands.clear()

    # ------------------------------------------------------------------------------------------------------ record

    @property
    def state(self) -> str:
        """The state of the robot: a value of `Action`, or "planning"."""
        if self.driving and self.command is not None:
            rests = self.segments is not None and self.command.action is Action.DONE  # between two segments
            return (Action.STANDING if rests else self.command.action).value
        if self.command is not None and self._now < self.command.standstill:
            return Action.BRAKING.value
        if self._planning is not None:
            return "planning"
        return Action.DONE.value if self._why == _ARRIVED else Action.STANDING.value

    def stop(self) -> tuple[FloatArray, Sequence[Any]]:
        """Return times [s] and states of the command until the robot stands; empty before the first command."""
        if self.command is None:
            return np.zeros(0), ()
        begin = max(self._now + self.options.latency, self.command.time)
        return self.command.until_rest(begin, self.options.replanning.tick / 5)

    def _record(self) -> dict[str, Any]:
        times, states = self.stop()
        still = np.full(self.cell.robot.n, np.nan) if self.joints is None else self.joints.q
        command = self.command
        work = {}
        if self.segments is not None:
            segment = self.segments.current
            work = {"step": segment.step + 1, "holds": ", ".join(item.name for item in segment.robot.spec.attached)}
        return {
            "time": self._now,
            "joints_measured": None if self.joints is None else self.joints.time,
            "q": still.tolist(),
            "qd": (np.full(len(still), np.nan) if self.joints is None else self.joints.qd).tolist(),
            "stop": stop_as_dict(times, states),
            **({"people": {}, "objects": {}} if self._pilot is None else self._pilot.surroundings.seen()),
            "state": self.state,
            "margin": None if command is None else command.left.margin,
            **dict.fromkeys(("distance", "link", "who", "limb")),
            "reason": self.blocked or self._why,
            "measured": None if command is None else command.measured,
            **work,
        }

    def close(self) -> None:
        """Shut down the executor, after the present plan is finished."""
        self._executor.shutdown(wait=True, cancel_futures=True)
