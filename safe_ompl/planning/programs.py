"""Programs of many steps, planned as one motion: choices are resolved together, and all of it is proven.

Steps are data (`scene/program.py`). The search is best-first: of all beginnings of the program that are planned so far
the one goes on whose time is least, if a step that is done counts as two seconds less, and a choice after which steps
failed counts more. What only may be chosen, a grasp, a place or a branch of the inverse kinematics, waits with a bound
of its time until it is the best; then it is planned. So nothing is executed before all of it can be finished, and what
is planned once is kept.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from safe_ompl.common import CollisionError, FloatArray, InputError, PlanningError, UnknownNameError, clock, positive
from safe_ompl.common import documents as document
from safe_ompl.common import seed as checked_seed
from safe_ompl.geometry import Obstacle, Pose
from safe_ompl.motions import Motion, MotionCheck, tube_of
from safe_ompl.planning.program_result import ProgramResult, Stretch
from safe_ompl.planning.safe_setup import SafeSetup, setup_scenario
from safe_ompl.robot import Attachment, Robot
from safe_ompl.scene import (
    Attach,
    Detach,
    Goal,
    Gripper,
    Line,
    Move,
    Scenario,
    Scene,
    Seam,
    Wait,
    configuration_for,
    find_scenario,
)
from safe_ompl.tasks import Corridor, ToolPath, configurations_at
from safe_ompl.trajectories import BlendedCurve, PathTimer, RateLimits, Trajectory

TIME = 20.0  # [s]
_STEP_DONE = 2.0  # [s] that a planned step counts less
_REFUSED = 1.0  # [s] that what was chosen counts more for each step after it that failed
_BRANCHES = 6  # of the inverse kinematics that a move may end in
_LONGEST = 2.0  # [s] of one plan
_STILL = 1e-6  # [rad or m] a motion that is shorter is none
_SLOWER, _TRIES = 1.25, 12  # times as long, where stops beside people are too late
_RATE = 25.0  # [Hz] of the points of a move


def plan_program(scenario: Scenario | str | Path, *, time: float = TIME, seed: int = 0) -> ProgramResult:
    """Plan the program of a scenario: one motion in time through all of its steps, proven throughout.

    Parameters
    ----------
    scenario : Scenario, str or Path
        A scenario with a program, or the name or file of one. Its start is where the arm is; joints of grippers are
        where its robot locks them.
    time : float
        Time limit [s].
    seed : int
        The same seed gives the same motion, as long as the time is not over.

    Returns
    -------
    ProgramResult
        Where it is not solved, `why` says which step, and what is in the way.

    Raises
    ------
    InputError
        If the scenario has no program, or a step names what is not there; starts with the step and its key.
    """
    if not isinstance(scenario, Scenario):
        scenario = Scenario.load(find_scenario(scenario))
    limit = positive(time, "time limit", "number of seconds")
    with document.within(str(scenario.file or scenario.name), ": "):
        return _ProgramPlanner(scenario, checked_seed(seed)).run(limit)


def _named(robot: Robot, q: FloatArray) -> dict[str, float]:
    return dict(zip(robot.joint_names, q.tolist(), strict=True))


def program_robot(scenario: Scenario) -> Robot:
    """Return the robot with which the program of a scenario begins, joints of grippers among those that move."""
    planner = _ProgramPlanner(scenario, 0)
    return planner.holding(planner.begin)


class _ImpossibleError(Exception):
    """A step cannot be done in this way; says why."""


class _Driven(NamedTuple):
    """What is proven of a motion, and its curve."""

    check: MotionCheck
    curve: BlendedCurve | None


def _points(trajectory: Trajectory, robot: Robot) -> tuple[Motion, BlendedCurve]:
    """Return the motion through the points of a trajectory, and its curve."""
    times, points = trajectory.points(_RATE)
    rates = points["velocities"], points.get("accelerations")
    return Motion.hermite(times, points["positions"], *rates, robot.joint_names), trajectory.curve


class _State(NamedTuple):
    """Where everything is: all joints (n,), what is held, the obstacles, and which grasp and place were chosen."""

    q: FloatArray
    held: tuple[Attachment, ...]
    scene: Scene
    chosen: Mapping[tuple[str, str, str | None], int]


@dataclass(frozen=True)
class _Node:
    """A beginning of the program that is planned, up to a step, and perhaps how that step might be done."""

    step: int
    state: _State
    stretches: tuple[Stretch, ...] = ()
    choices: tuple[str, ...] = ()
    todo: Callable[[], tuple[_State, tuple[_Driven, ...]]] | None = None
    duration: float = field(default=0.0)


class _ProgramPlanner:
    """Plans the program of one scenario."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        if scenario.program is None:
            raise InputError("missing: the scenario has no program", "program")
        self._scenario, self._program, self._seed = scenario, scenario.program, seed
        self._steps = scenario.program.steps
        tool = scenario.limits.tool
        if tool is not None and tool.axis is None:
            raise InputError("missing: what points up at the start need not do so later", "limits.tool.axis")
        self._arm = scenario.build_robot()
        start = scenario.start_configuration(self._arm)
        self._robot = self._with_grippers()
        values = {**self._arm.held_joints, **_named(self._arm, start)}
        self._begin = self._robot.configuration({name: values[name] for name in self._robot.joint_names})
        motion = scenario.motion
        self._limits = RateLimits.of(self._robot, motion.velocity, motion.acceleration, motion.jerk)
        with document.within("limits"):
            tube = scenario.limits.tube
            self._tube = None if tube is None else np.array(tube_of(tube, self._robot))
        self._end = np.inf
        self._check_names()

    @property
    def begin(self) -> _State:
        """Where everything is at first."""
        return _State(self._begin, self._arm.spec.attached, self._scenario.scene, {})

    def _with_grippers(self) -> Robot:
        """Return the robot of the scenario with the joints of its grippers among those that move."""
        joints, spec = self._program.gripper_joints, self._arm.spec
        held = self._arm.held_joints
        for k, step in enumerate(self._steps):
            for name in step.joints if isinstance(step, Gripper) else ():
                if name not in held:
                    raise UnknownNameError("joint that is locked", name, held, f"program.steps[{k}].gripper.joints")
        if not spec.robots:
            return Robot(replace(spec.resolved(), free=joints, attached=()))
        robots = {
            prefix: replace(
                one.resolved(),
                free=tuple(name.removeprefix(f"{prefix}_") for name in joints if name.startswith(f"{prefix}_")),
            )
            for prefix, one in spec.robots.items()
        }
        return Robot(replace(spec, robots=robots, attached=()))

    def _check_names(self) -> None:
        """Raise InputError where a step names no link, object or arm."""
        held = {item.name for item in self._arm.spec.attached}
        shapes = {item.name: item.shape for item in (*self._scenario.scene, *self._arm.spec.attached)}
        things, arms = sorted(shapes), self._robot.spec.robots
        for k, step in enumerate(self._steps):
            depth = getattr(step, "depth", 0.0)
            with document.within(f"program.steps[{k}].{step.kind}"):
                for key in ("object", "grasp", "place"):
                    name = getattr(step, key, None)
                    if name is not None and name not in things:
                        raise UnknownNameError("object", name, things, key)
                for link, obstacle in getattr(step, "touching", ()):
                    links, obstacles = {*self._robot.shared.body_links, *held}, {*things} - held
                    for name, known in ((link, links), (obstacle, obstacles)):
                        if name not in known:
                            raise UnknownNameError("link or object", name, sorted(known), "touching")
                    with document.within(f"touching: {obstacle!r}, {1e3 * depth:g} mm deep", ": "):
                        shapes[obstacle].core(depth)
                arm = getattr(step, "arm", None)
                if arm is not None and arm not in arms:
                    raise UnknownNameError("robot", arm, arms, "arm")
            held = held | {step.object} if isinstance(step, Attach) else held
            held = held - {step.object} if isinstance(step, Detach) else held

    # --------------------------------------------------------------------------------------------------- search

    def run(self, time: float) -> ProgramResult:
        """Return the program planned within a time [s]."""
        begin = clock()
        self._end, order = begin + time, count()
        best = _Node(0, self.begin)
        waiting = [(0.0, next(order), 0.0, best)]
        refused: Counter[tuple[str, ...]] = Counter()  # how often choices, with whatever came after, failed
        why, failed = "", -1

        def wait(cost: float, node: _Node) -> None:
            heapq.heappush(waiting, (cost + _REFUSED * refused[node.choices], next(order), cost, node))

        while waiting and best.step < len(self._steps):
            if clock() > self._end:
                why = f"{why}; {time:g} s are over" if why else f"{time:g} s are over"
                break
            before, _, cost, node = heapq.heappop(waiting)
            if cost + _REFUSED * refused[node.choices] > before:  # some failed since
                wait(cost, node)
                continue
            try:
                if node.todo is not None:
                    node = self._done(node)
                    best = node if node.step > best.step else best
                    wait(node.duration - _STEP_DONE * node.step, node)
                    continue
                for bound, choice, todo in self._ways(node):
                    ahead = replace(node, todo=todo, choices=(*node.choices, *choice))
                    wait(node.duration + bound - _STEP_DONE * node.step, ahead)
            except (_ImpossibleError, CollisionError, PlanningError) as error:
                refused.update(node.choices[:k] for k in range(len(node.choices) + 1))
                if node.step >= failed:
                    failed, why = node.step, f"step {node.step + 1} ({self._steps[node.step]}): {error}"
        solved = best.step == len(self._steps)
        why = "" if solved else why or f"step {best.step + 1}: nothing is left to try"
        return ProgramResult(self._scenario, best.stretches, best.choices, why, clock() - begin)

    def _done(self, node: _Node) -> _Node:
        """Return the node after its step was planned."""
        assert node.todo is not None
        state, driven = node.todo()
        stretches, duration = list(node.stretches), node.duration
        for check, curve in driven:
            stretches.append(Stretch(node.step, duration, check, curve))
            duration += check.motion.duration
        return _Node(node.step + 1, state, tuple(stretches), node.choices, None, duration)

    def _ways(self, node: _Node) -> Iterator[tuple[float, list[str], Callable[[], Any]]]:
        """Yield how the next step of a node might be done: a bound of its time [s], what is chosen, and the doing."""
        step, state = self._steps[node.step], node.state
        if isinstance(step, Move) and (step.configuration is not None or step.region is not None):
            yield 0.0, [], partial(self._move, step, state, None)
        elif isinstance(step, (Move, Line)):
            reached = isinstance(step, Line)
            for chosen, target, said in self._targets(step, state):
                after = state._replace(chosen=chosen)
                if isinstance(step, Line):
                    yield 0.0, said, partial(self._line, step, after, [target])
                    continue
                arm, q = self._arm_at(step.arm, state)
                branches = configurations_at(arm, target, q, np.random.default_rng(self._seed))
                reached |= len(branches) > 0
                fastest = self._limits_of(arm).velocity
                for branch in branches[:_BRANCHES]:
                    bound = float((np.abs(arm.difference(q, branch)) / fastest).max())
                    yield bound, said, partial(self._move, step, after, branch)
            if not reached:
                raise _ImpossibleError("no configuration has its tip there")
        elif isinstance(step, Seam):
            yield 0.0, [], partial(self._line, step, state, [pose.se3 for pose in step.poses])
        else:
            yield 0.0, [], partial(getattr(self, f"_{step.kind}"), step, state)

    def _targets(self, step: Move | Line, state: _State) -> Iterator[tuple[Mapping[Any, int], pin.SE3, list[str]]]:
        """Yield what may be chosen, where the tip is to be then, and the choice in words."""
        ((kind, value),) = step.targets.items()
        up = pin.SE3(np.eye(3), np.array([0.0, 0.0, step.up]))
        back = pin.SE3(np.eye(3), np.array([0.0, 0.0, -step.back]))
        if kind in ("pose", "by"):
            pose = value.se3 if kind == "pose" else self._tip(step.arm, state)
            if kind == "by":
                pose.translation += np.array(value)
            yield state.chosen, up * pose * back, []
            return
        held = {item.name: item for item in state.held}
        item = held.get(value)
        if kind == "place" and item is None:
            raise _ImpossibleError(f"{value!r} is not held")
        if kind == "grasp" and item is not None and item.link == self._arm_at(step.arm, state)[0].tip:
            raise _ImpossibleError(f"{value!r} is held already")
        options = getattr(self._program, f"{kind}s")[value]
        key = kind, value, step.arm
        known = state.chosen.get(key)
        for k, option in enumerate(options):
            if known not in (None, k):
                continue
            if kind == "place":
                pose = option.se3 * self._held_pose(held[value], step.arm, state).inverse()
            elif item is not None:  # of the other arm, which hands it over
                pose = self._link(item.link, state) * item.pose.se3 * option.se3
            else:
                pose = state.scene[value].pose.se3 * option.se3
            said = [] if known is not None or len(options) == 1 else [f"{kind} {k + 1} of {value}"]
            yield {**state.chosen, key: k}, up * pose * back, said

    # ---------------------------------------------------------------------------------------------------- steps

    def _move(self, step: Move, state: _State, branch: FloatArray | None) -> Any:
        arm, q = self._arm_at(step.arm, state)
        scene = state.scene.touched(step.touching, step.depth)
        goal = Goal(region=step.region) if step.region is not None else None
        setup = self._setup(arm, scene, q, goal)
        if goal is None:
            wanted = branch
            if step.configuration is not None:
                wanted = configuration_for(arm, "configuration", step.configuration)
            assert wanted is not None
            if np.abs(arm.difference(q, wanted)).max() < _STILL:
                return state, ()
            setup.setConfigurations(q, wanted)
        left = min(_LONGEST, max(self._end - clock(), 1e-3))
        result = setup.plan(time=left, seed=self._seed, simplify=setup.field is not None)
        if result.path is None:
            raise _ImpossibleError(f"no path is found in {left:.2g} s")
        caps = {key: getattr(self._scenario.motion, key) for key in ("tool_speed", "link_speed")}
        timer = PathTimer(arm, self._limits_of(arm), motion=setup.motion_prover, **caps)
        return self._driven(state, scene, *_points(timer.time(result.path), arm))

    def _line(self, step: Line | Seam, state: _State, targets: list[pin.SE3]) -> Any:
        arm, q = self._arm_at(step.arm, state)
        poses = [arm.tip_pose(q), *targets]
        if len(poses) == 2 and np.abs(pin.log6(poses[0].inverse() * poses[1]).vector).max() < _STILL:
            return state, ()
        scene = state.scene.touched(step.touching, step.depth)
        setup = self._setup(arm, scene, q)
        corridor = Corridor(step.within, step.angle, step.free_axis)
        path = ToolPath.of(poses)
        found = setup.planTool(path, corridor, start=q, speed=step.speed, limits=self._limits_of(arm), seed=self._seed)
        if found.motion is None:
            raise _ImpossibleError(f"{100 * found.fraction:.0f} % of it can be followed; {found.why}")
        assert found.along is not None
        stops = np.searchsorted(found.along.times, path.corners - _STILL).tolist()
        return self._driven(
            state, scene, found.motion, BlendedCurve.of(found.along.times, found.along.coefficients, stops)
        )

    def _gripper(self, step: Gripper, state: _State) -> Any:
        robot = self.holding(state)
        q = robot.configuration({**_named(robot, state.q), **step.joints})
        if (beyond := robot.beyond_limits(q)) is not None:
            raise InputError(beyond, "gripper.joints")
        if np.abs(q - state.q).max() < _STILL:
            return state, ()
        scene = state.scene.touched(step.touching, step.depth)
        return self._driven(state, scene, *_points(PathTimer(robot, self._limits).time([state.q, q]), robot))

    def _wait(self, step: Wait, state: _State) -> Any:
        still = np.array([[state.q, np.zeros_like(state.q)]])
        scene = state.scene.touched(step.touching, step.depth)
        return self._driven(state, scene, Motion(np.array([0.0, step.time]), still, self._robot.joint_names))

    def _attach(self, step: Attach, state: _State) -> Any:
        if step.object not in state.scene.names:
            raise _ImpossibleError(f"{step.object!r} is held already")
        obstacle = state.scene[step.object]
        arm, _ = self._arm_at(step.arm, state)
        pose = self._tip(step.arm, state).inverse() * obstacle.pose.se3
        fingers = tuple(dict.fromkeys(self._finger_links))
        item = Attachment(obstacle.name, obstacle.shape, arm.tip, Pose.of(pose), fingers)
        return state._replace(held=(*state.held, item), scene=state.scene.without(obstacle.name)), ()

    def _detach(self, step: Detach, state: _State) -> Any:
        item = next((item for item in state.held if item.name == step.object), None)
        if item is None:
            raise _ImpossibleError(f"{step.object!r} is not held")
        before = self._scenario.scene
        known = before[item.name] if item.name in before.names else Obstacle(item.name, item.shape)
        pose = self._link(item.link, state) * item.pose.se3
        scene = state.scene.with_obstacles(known.moved(Pose.of(pose)))
        chosen = {key: k for key, k in state.chosen.items() if key[1] != item.name}
        held = tuple(other for other in state.held if other is not item)
        return state._replace(held=held, scene=scene, chosen=chosen), ()

    # --------------------------------------------------------------------------------------- robots and proofs

    def holding(self, state: _State) -> Robot:
        """Return the robot with all of its joints and what it holds."""
        robot = self._robot
        for item in state.held:
            robot = robot.with_attached(item.name, item.shape, item.link, item.pose, touch_links=item.touch_links)
        return robot

    def _arm_at(self, arm: str | None, state: _State) -> tuple[Robot, FloatArray]:
        """Return the robot with the joints of one arm alone, the others locked where they are, and where it is."""
        robot = self.holding(state)
        prefix = arm or (robot.spec.tip if robot.spec.robots else None)
        if robot.spec.robots and prefix is None:
            prefix = next(iter(robot.spec.robots))
        values = _named(robot, state.q)
        grippers = self._program.gripper_joints
        others = {
            name: value
            for name, value in values.items()
            if name in grippers or (prefix is not None and not name.startswith(f"{prefix}_"))
        }
        moving = robot.with_locked(others, prefix) if others else robot
        q = np.array([values[name] for name in moving.joint_names])
        return moving, moving.difference(np.zeros(moving.n), q)

    def _rows(self, arm: Robot) -> list[int]:
        """Return which of all joints those of an arm are."""
        return [self._robot.joint_names.index(name) for name in arm.joint_names]

    def _limits_of(self, arm: Robot) -> RateLimits:
        """Return the limits of the joints of an arm."""
        rows = self._rows(arm)
        jerk = self._limits.jerk
        most = self._limits.velocity[rows], self._limits.acceleration[rows], None if jerk is None else jerk[rows]
        return RateLimits(arm.joint_names, *most)

    def _tip(self, arm: str | None, state: _State) -> pin.SE3:
        moving, q = self._arm_at(arm, state)
        return moving.tip_pose(q)

    def _link(self, link: str, state: _State) -> pin.SE3:
        """Return where a link or frame is."""
        robot = self.holding(state)
        model, data = robot.shared.model, robot.shared.model.createData()
        pin.framesForwardKinematics(model, data, robot.pinocchio_configuration(state.q))
        return pin.SE3(data.oMf[model.getFrameId(link)])

    def _held_pose(self, item: Attachment, arm: str | None, state: _State) -> pin.SE3:
        """Return where an object that is held is, seen from the tip."""
        return self._tip(arm, state).inverse() * self._link(item.link, state) * item.pose.se3

    @cached_property
    def _finger_links(self) -> list[str]:
        """The links that joints of grippers move: they may touch what they hold."""
        shared = self._robot.shared
        followers = {name for name, mimic in shared.mimics.items() if mimic.primary in self._program.gripper_joints}
        joints = {shared.model.getJointId(name) for name in (*self._program.gripper_joints, *followers)}
        bodies = zip(shared.body_links, shared.collision_model.geometryObjects, strict=True)
        return [link for link, body in bodies if joints & set(shared.model.supports[body.parentJoint])]

    def _setup(self, robot: Robot, scene: Scene, q: FloatArray, goal: Goal | None = None) -> SafeSetup:
        """Return a setup for a robot in a scene at a configuration, under the limits of the scenario."""
        limits = self._scenario.limits
        if self._tube is not None:
            limits = replace(limits, tube=tuple(self._tube[self._rows(robot)].tolist()))
        start = tuple(q.tolist())
        given = replace(self._scenario, scene=scene, start=start, goal=goal, people=None, limits=limits)  # type: ignore[arg-type]
        return setup_scenario(given, robot)

    def _driven(
        self, state: _State, scene: Scene, moving: Motion, curve: BlendedCurve | None = None
    ) -> tuple[_State, tuple[_Driven, ...]]:
        """Return the state after a motion of some joints, the proof of it for all of them, and the curve of all."""
        robot, people = self.holding(state), self._scenario.people
        rows = [robot.joint_names.index(name) for name in moving.joint_names or ()]
        coefficients = np.zeros((moving.pieces, moving.degree + 1, robot.n))
        coefficients[:, 0] = state.q
        turns = np.round((state.q[rows] - moving.coefficients[0, 0]) / (2 * np.pi)) * robot.continuous[rows]
        coefficients[:, :, rows] = moving.coefficients
        coefficients[:, 0, rows] += 2 * np.pi * turns
        rounding = np.zeros((moving.pieces, robot.n))
        rounding[:, rows] = moving.allowance
        motion = Motion(moving.times - moving.times[0], coefficients, robot.joint_names, rounding=rounding)
        setup = self._setup(robot, scene, state.q)
        for _ in range(_TRIES):
            check = setup.check(motion, self._limits, people)
            if {violation.kind for violation in check.violations} != {"separation"}:
                break
            motion = replace(motion, times=motion.times * _SLOWER)
        if not check:
            raise _ImpossibleError(str(check.violations[0]))
        if curve is not None:
            shift = 2 * np.pi * turns
            curve = curve.among(state.q, rows, shift)
        return state._replace(q=motion.knots[-1]), (_Driven(check, curve),)
