"""A guard between a policy, or a teleoperator, and the motors of a robot: targets come one by one, at a fixed rate.

A target says where all motors should be when the next one comes. The guard makes joint values of it, and proposes to a
`Shield` the path through it, then through what is known of its chunk, and at last a ramp to rest. What is sent is where
the proven motion is when the next target comes: the target itself, where the robot is not slowed.

The robot stays on the path that the policy knows. Targets that it could not reach yet wait, with what belongs to them,
such as the gripper's, and it goes through them as soon as it may, a little faster than proposed. If a new target is
nearer to the robot than to the last one that waits, the policy has looked again: what waits is forgotten.

What is proven is where joints are, not what they are told: servos sag. How far is learnt from what was observed, taken
off targets, and added to what is sent.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.apps.exchange.controller import Cell, ControlOptions, LiveController
from safe_ompl.common import FloatArray, InputError, UnknownNameError, finite_array, number
from safe_ompl.geometry import Obstacle, Person
from safe_ompl.motions import Motion
from safe_ompl.people import Surroundings, TrackedBody, Tracker, find_skeleton
from safe_ompl.people.replanning import Doing, PathLimits, ReplanningOptions, Shield, ShieldCommand
from safe_ompl.people.simulation import ALL_KEYPOINTS
from safe_ompl.planning import setup_scenario
from safe_ompl.robot import Robot
from safe_ompl.scene import Goal, People, Scenario, Scene
from safe_ompl.trajectories import RateLimits

_log = logging.getLogger(__name__)

_AHEAD = 1.0  # [s] of a chunk that are proposed at most
_SAME = 1e-3  # [rad] targets that are nearer are one: chunks are rounded to 32 bits
_NOISE = 4e-3  # [rad] an encoder that moves less from one observation to the next stands
_RAMP = 0.5  # of the accelerations: what a motion that goes on beyond the last target is braked by
_FASTER = 1.25  # times as fast as proposed it goes through targets that wait
_SAGS = 0.5  # [s] within which sag is learnt
_AT_REST = (Doing.BRAKING.value, Doing.STANDING.value)


@dataclass(kw_only=True)
class PolicyOptions:
    """How motors and joints belong together, and how targets come."""

    joints: dict[str, str] = field(default_factory=dict)  # The joint that a motor moves, where their names differ
    # How far [° or m] a joint goes for one unit of its motor, negative: the other way; default: 1. And where it is when
    # the motor says 0.
    degrees: dict[str, float] = field(default_factory=dict)
    offsets: dict[str, float] = field(default_factory=dict)
    fps: float = 30.0  # Targets in a second
    latency: float = 0.01  # The guard answers within this time [s]
    # How far joints may be from where they should be [° or m]: otherwise the robot stops. limits.tube counts instead
    tolerance: float = 6.0
    lag: float = 0.0  # Servos are where they are told to be by so much later at the latest [s]
    backlog: float = 5.0  # Of how many seconds targets may wait; 0: the robot goes to the newest one
    skeleton: str = ""  # The key points of people, such as coco17; default: the package's own
    camera_delay: float = 0.0  # How old key points are when they are given [s]


class _Motors:
    """The motors of a robot, in the units of their driver, as its joints: q = scale · number + offset."""

    def __init__(self, robot: Robot, keys: Sequence[str], options: PolicyOptions) -> None:
        motors = [key.removesuffix(".pos") for key in keys if key.endswith(".pos")]
        for option in ("joints", "degrees", "offsets"):
            for name in getattr(options, option):
                if name not in motors:
                    raise UnknownNameError("motor", name, motors, option)
        moved = {options.joints.get(name, name): name for name in motors}
        for joint in robot.joint_names:
            if joint not in moved:
                known = ", ".join(motors)
                raise InputError(f"no motor moves {joint!r}: lock it in the robot, or name one of {known}", "joints")
        names = [moved[joint] for joint in robot.joint_names]
        self.keys = tuple(f"{name}.pos" for name in names)
        unit = np.where(robot.prismatic, 1.0, np.pi / 180)
        self._scales = unit * [number(f"degrees.{name}", options.degrees.get(name, 1.0)) for name in names]
        self._offsets = unit * [number(f"offsets.{name}", options.offsets.get(name, 0.0)) for name in names]
        if not self._scales.all():
            raise InputError("must not be 0", f"degrees.{names[int(np.argmin(np.abs(self._scales)))]}")

    def joints(self, values: ArrayLike) -> FloatArray:
        """Return the joint values (…, n) [rad or m] of numbers (…, n) in the order of `keys`."""
        return np.asarray(self._scales * np.asarray(values, dtype=float) + self._offsets)

    def of(self, values: Mapping[str, Any]) -> FloatArray:
        """Return the joint values (n,) of numbers by key; InputError if one is missing or not finite."""
        for key in self.keys:
            if key not in values or not np.isfinite(values[key]):
                raise InputError(f"must be a number, got {values.get(key)!r}", key)
        return self.joints([values[key] for key in self.keys])

    def numbers(self, q: FloatArray) -> dict[str, float]:
        """Return the numbers by key for joint values (n,)."""
        return dict(zip(self.keys, ((q - self._offsets) / self._scales).tolist(), strict=True))


class _AtOnce(Executor):
    """Does what it is given at once: the robot stands then."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        done: Future[Any] = Future()
        done.set_result(fn(*args, **kwargs))
        return done


class PolicyGuard:
    """Guards what a policy sends to the motors of a robot.

    Call `see` with each observation, and send what `guarded` returns in the place of the policy's action. `reason` says
    why the robot is slower than proposed, or stands.

    Parameters
    ----------
    scenario : Scenario
        The robot, whose joints are those of the motors, people and things around it; its limits hold.
    keys : sequence of str
        Of actions, in the order in which chunks have them. Those of motors end in ``.pos``. What is of no joint of the
        robot, such as a gripper that is locked there, is passed through as it is, and nothing is proven of it.
    options : PolicyOptions
        Units and rate.
    clock : callable
        Returns the time now [s].

    Raises InputError, UnknownNameError if these do not go together.
    """

    def __init__(
        self,
        scenario: Scenario,
        keys: Sequence[str],
        options: PolicyOptions,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        robot, self.options, self._keys, self._clock = scenario.build_robot(), options, tuple(keys), clock
        self.motors = _Motors(robot, keys, options)
        self.period = 1.0 / number("fps", options.fps, above=0.0)
        own = scenario.motion
        self._limits = RateLimits.of(robot, own.velocity, own.acceleration, own.jerk)
        limits = PathLimits(self._limits, own.tool_speed, own.link_speed)
        replanning = ReplanningOptions(tick=self.period, limits=limits, lag=options.lag)
        latency = min(number("latency", options.latency, at_least=0.0), self.period)
        control = ControlOptions(
            replanning, latency, tolerance=np.pi / 180 * number("tolerance", options.tolerance, above=0.0)
        )
        self.cell = _cell(scenario, robot, options.skeleton, replanning)
        self.cell.plan(scenario.start_configuration(robot), None, None)  # compiles or loads all that targets need
        self.controller = LiveController(self.cell, clock, control, _AtOnce())
        self._most = int(number("backlog", options.backlog, at_least=0.0) / self.period)
        self._waiting: deque[tuple[FloatArray, dict[str, Any]]] = deque()  # targets, and what is not of joints
        self._due = self._spacing = 0.0  # when the first is to be reached, and the time to the next [s]
        self._before: FloatArray | None = None  # the last one that was reached
        self._others: dict[str, Any] = {}
        self._chunk = np.zeros((0, robot.n))
        self._sag = np.zeros(robot.n)  # by which joints are told more than where they should be
        self.reason = ""

    def see(self, observation: Mapping[str, Any], time: float | None = None) -> None:
        """Take an observation of a time [s], by default of now.

        It has the positions of all motors, and key points (J, 3) of people in the world [m] as ``people.NAME``.
        """
        now, q = self._clock() if time is None else time, self.motors.of(observation)
        controller, robot = self.controller, self.cell.robot
        before, most = controller.joints, controller.options.tolerance
        velocity = np.zeros_like(q)
        if before is not None and now > before.time:
            step = robot.difference(before.q, q)
            velocity = np.where(np.abs(step) < _NOISE, 0.0, step / (now - before.time))
        controller.see_joints(now, robot.joint_names, q.tolist(), velocity.tolist())
        if controller.state not in _AT_REST:  # what it is told does not change while somebody may be near
            self._sag = np.clip(self._sag + self.period / _SAGS * controller.behind(), -most, most)
        seen = {name: observation.get(f"people.{name}") for name in self.cell.trackers}
        found = {name: np.asarray(points, dtype=float) for name, points in seen.items() if points is not None}
        self.controller.see_people(now - self.options.camera_delay, found)

    def foresee(self, chunk: ArrayLike) -> None:
        """Take a chunk of actions (K, m), whose columns are those of the keys: what the next targets will be."""
        rows = finite_array(chunk, (None, len(self._keys)), "chunk")
        self._chunk = self.motors.joints(rows[:, [self._keys.index(key) for key in self.motors.keys]])

    def guarded(self, action: Mapping[str, Any]) -> dict[str, Any]:
        """Return what to send in the place of an action; InputError if that has not all motors, or before `see`."""
        joints = self.controller.joints
        if joints is None:
            raise InputError("nothing was observed yet", "observation")
        q = self.motors.of(action) - self._sag
        others = {key: value for key, value in action.items() if key not in self.motors.keys}
        now, controller = self._clock(), self.controller
        usable = controller.driving and self._propose(q, others, now)
        self.reason = controller.tick()["reason"]
        command = controller.command
        if not (usable and controller.driving):
            self._forget()
        elif isinstance(command, ShieldCommand):
            reached = command.time + self.period - command.delay
            while self._waiting and self._due < reached + 0.5 * self._spacing:
                self._before, self._others = self._waiting.popleft()
                self._due += self._spacing
            self._due += command.delay
        there = joints.q if command is None else command.at(max(now + self.period, command.time)).q
        return {**others, **self._others, **self.motors.numbers(there + self._sag)}

    def _forget(self) -> None:
        self._waiting.clear()
        self._before = None

    def _propose(self, q: FloatArray, others: dict[str, Any], now: float) -> bool:
        """Propose the path through what waits, a new target and what is known beyond; return whether it can be used."""
        waiting, command, apart = self._waiting, self.controller.command, self.cell.robot.difference
        here = q if command is None else command.at(max(now, command.time)).q
        again = waiting and np.abs(apart(here, q)).max() < np.abs(apart(waiting[-1][0], q)).max()
        if again or len(waiting) > self._most:
            self._forget()
        if not waiting:
            self._due = now + self.period
        waiting.append((q, others))
        limits = self.period * self._limits.velocity  # of a jump: it is approached at half of the speed
        far = float((np.abs(apart(here, waiting[0][0])) / limits).max())
        if far * self.period > self._due - now:
            self._due = now + 2 * far * self.period
        self._spacing = self.period / (_FASTER if len(waiting) > 1 else 1.0)
        known = [one for one, _ in waiting] + list(self._rest_of_chunk(q))
        before = known[-2] if len(known) > 1 else known[-1] if self._before is None else self._before
        path = np.vstack([known, known[-1] + self._ramp(apart(before, known[-1]))])
        steps = np.full(len(path) - 1, self.period)
        steps[: len(waiting) - 1] = self._spacing
        return self.controller.propose(Motion.hermite(np.cumsum([0.0, *steps]), path), start=self._due)

    def _rest_of_chunk(self, q: FloatArray) -> FloatArray:
        """Return the targets (K, n) that follow one in the chunk that was foreseen; none if it is not of that."""
        chunk = self._chunk  # another thread may give a new one
        (found,) = np.nonzero((np.abs(chunk - self._sag - q) < _SAME).all(axis=1))
        if not len(found):
            return chunk[:0]
        first = int(found[0]) + 1
        return np.asarray(chunk[first : first + int(_AHEAD / self.period)] - self._sag)

    def _ramp(self, step: FloatArray) -> FloatArray:
        """Return how a robot goes on (K, n) that made a step (n,) within a period: as far again, then it brakes."""
        limits = self._limits
        step = np.clip(step, -self.period * limits.velocity, self.period * limits.velocity)
        count = int(np.ceil((np.abs(step) / (_RAMP * limits.acceleration * self.period**2)).max()))
        k = np.arange(1.0, count + 1)[:, None]
        ramp = np.vstack([step, step + step * (k - k * k / (2 * max(count, 1)))])
        return np.vstack([ramp, ramp[-1]])


def _cell(scenario: Scenario, robot: Robot, skeleton: str, options: ReplanningOptions) -> Cell:
    """Return a robot behind a shield: people of the scene are tracked, objects of limits.moving move."""
    keypoints = find_skeleton(skeleton) if skeleton else ALL_KEYPOINTS
    bodies = {one.name: TrackedBody(one.shape.height) for one in scenario.scene if isinstance(one.shape, Person)}
    trackers = {name: Tracker(keypoints, body) for name, body in bodies.items()}
    moving = {} if scenario.limits.moving is None else dict(scenario.limits.moving.speeds)
    still = scenario.scene.without(*(name for name in scenario.scene.names if name in trackers or name in moving))
    limited = limits_of_still(scenario, still, beside_people=bool(trackers))
    people = scenario.people or People()
    people = replace(people, who=None, clearance=max(people.clearance, scenario.limits.min_clearance))
    setup_scenario(limited, robot)  # what cannot be used is said now

    def begin(start: FloatArray, goal: FloatArray, cloud: Obstacle | None) -> Shield:
        here = tuple(start.tolist())
        setup = setup_scenario(replace(limited, start=here, goal=Goal(configurations=(here,))), robot)
        around = Surroundings(scenario.scene, trackers, moving, people)
        shield = Shield(robot, around, options=options, prover=setup.motion_prover)
        shield.start(start)
        return shield

    return Cell(robot, trackers, moving, begin, shielded=True)


def limits_of_still(scenario: Scenario, still: Scene, *, beside_people: bool) -> Scenario:
    """Return the scenario with its still obstacles only, and limits that concern them."""
    limits = scenario.limits
    dangerous = [obstacle.name for obstacle in still if obstacle.weight > 0]
    kept_from = dangerous
    if limits.obstacles is not None:
        kept_from = [name for name in limits.obstacles if name in still.names]
        gone = set(limits.obstacles) - set(scenario.scene.names)
        if gone:
            raise UnknownNameError("obstacle", min(gone), scenario.scene.names, "limits.obstacles")
    limits = replace(
        limits,
        max_danger=limits.max_danger if dangerous else 0.0,
        min_clearance=limits.min_clearance if kept_from else 0.0,
        obstacles=tuple(kept_from) if kept_from else None,
        exempt=tuple(pair for pair in limits.exempt if pair[1] in kept_from),
        moving=None,
    )
    if scenario.limits.max_danger and beside_people:
        _log.warning(
            "limits.max_danger counts obstacles that stand still only; the robot keeps a distance from people who move"
        )
    if scenario.people is not None and scenario.people.contact:
        _log.warning("contact is allowed: %s", scenario.people.contact_sentence)
    if scenario.motion.max_danger is not None:
        _log.warning("motion.max_danger is not kept in `live`; the robot keeps distances from all that moves instead")
    return replace(scenario, scene=still, people=None, limits=limits)
