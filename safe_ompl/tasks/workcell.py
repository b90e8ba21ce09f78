"""The workcell of a program: the robot with attached objects, its single arms, and proofs of motions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from safe_ompl.collision import CollisionChecker
from safe_ompl.common import CollisionError, FloatArray, InputError, UnknownNameError, documents as document
from safe_ompl.geometry import Obstacle, Pose
from safe_ompl.motions import Motion, MotionCheck, RateLimits, tube_of
from safe_ompl.planning import SafeSetup, setup_scenario
from safe_ompl.robot import Attachment, Robot
from safe_ompl.scene import CONTACT_DEPTH, Attach, Detach, Goal, Gripper, Scenario, Scene, Step

# A motion that cannot stop in time for people is slowed down by this factor, at most this many times.
_SLOWDOWN, _MOST_SLOWDOWNS = 1.25, 12


class ImpossibleError(Exception):
    """Raised if a step of a program cannot be planned with the present choices; the message gives the reason."""


def named(robot: Robot, q: FloatArray) -> dict[str, float]:
    """Return a mapping from joint names to joint values (n,)."""
    return dict(zip(robot.joint_names, q.tolist(), strict=True))


class ProvenMotion(NamedTuple):
    """A motion of all joints with its proof, its curve without time, and the joints that the step may move."""

    check: MotionCheck
    curve: Motion | None
    joints: tuple[str, ...]


class CellState(NamedTuple):
    """State of the workcell: all joint values (n,), attached objects, obstacles, and chosen grasps and places."""

    q: FloatArray
    held: tuple[Attachment, ...]
    scene: Scene
    chosen: Mapping[tuple[str, str, str | None], int]


class Workcell:
    """Robot, limits and first state of the program of a scenario; raises InputError as `plan_program`.

    Attributes
    ----------
    robot : Robot
        The robot of the scenario without attached objects; its gripper joints are not locked.
    limits : RateLimits
        Rate limits of the joints.
    begin : CellState
        The state before the first step.
    """

    def __init__(self, scenario: Scenario) -> None:
        if scenario.program is None:
            raise InputError("missing: the scenario has no program", "program")
        self._scenario, self._program = scenario, scenario.program
        tool = scenario.limits.tool
        if tool is not None and tool.axis is None:
            raise InputError(
                "missing, but needed: the tool axis that points up at the start of a program may point elsewhere later",
                "limits.tool.axis",
            )
        self._arm = scenario.build_robot()
        start = scenario.start_configuration(self._arm)
        self.robot = self._with_grippers()
        values = {**self._arm.held_joints, **named(self._arm, start)}
        q = self.robot.configuration({name: values[name] for name in self.robot.joint_names})
        self.begin = CellState(q, self._arm.spec.attached, scenario.scene, {})
        motion = scenario.motion
        self.limits = RateLimits.of(self.robot, motion.velocity, motion.acceleration, motion.jerk)
        with document.within("limits"):
            tube = scenario.limits.tube
            self._tube = None if tube is None else np.array(tube_of(tube, self.robot))
        self._check_names()

    def _with_grippers(self) -> Robot:
        """Return the robot of the scenario with unlocked gripper joints."""
        joints, spec = self._program.gripper_joints, self._arm.spec
        held = self._arm.held_joints
        for k, step in enumerate(self._program.steps):
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
        """Raise InputError if a step names a link, an object or an arm that does not exist."""
        held = {item.name for item in self._arm.spec.attached}
        shapes = {item.name: item.shape for item in (*self._scenario.scene, *self._arm.spec.attached)}
        things, arms = sorted(shapes), self.robot.spec.robots
        for k, step in enumerate(self._program.steps):
            depth = getattr(step, "depth", 0.0)
            with document.within(f"program.steps[{k}].{step.kind}"):
                for key in ("object", "grasp", "place"):
                    name = getattr(step, key, None)
                    if name is not None and name not in things:
                        raise UnknownNameError("object", name, things, key)
                for link, obstacle in getattr(step, "touching", ()):
                    own = {*self.robot.shared.body_links} - held
                    # Attached objects may touch obstacles; links may touch obstacles and attached objects.
                    pairs = (link, own | held), (obstacle, {*things} - (held if link in held else set()))
                    for name, known in pairs:
                        if name not in known:
                            raise UnknownNameError("link or object", name, sorted(known), "touching")
                    with document.within(f"touching: {obstacle!r}, {1e3 * depth:g} mm deep", ": "):
                        shapes[obstacle].core(depth)
                arm = getattr(step, "arm", None)
                if arm is not None and arm not in arms:
                    raise UnknownNameError("robot", arm, arms, "arm")
            held = held | {step.object} if isinstance(step, Attach) else held
            held = held - {step.object} if isinstance(step, Detach) else held

    def holding(self, state: CellState) -> Robot:
        """Return the robot with all of its joints and with the attached objects of a state."""
        robot = self.robot
        for item in state.held:
            robot = robot.holding(item)
        return robot

    def during(self, step: Step, state: CellState) -> CellState:
        """Return the state in which the contacts of a step, with obstacles and attached objects, are allowed."""
        pairs, depth = getattr(step, "touching", ()), getattr(step, "depth", 0.0)
        held = []
        for item in state.held:
            links = tuple(link for link, name in pairs if name == item.name)
            if links:
                deepest = max(depth, item.touch_depth or 0.0)
                item = replace(item, touch_links=(*item.touch_links, *links), touch_depth=deepest)
            held.append(item)
        names = {item.name for item in held}
        scene = state.scene.touched([pair for pair in pairs if pair[1] not in names], depth)
        return state._replace(held=tuple(held), scene=scene)

    def taken(self, obstacle: Obstacle, arm: str | None, state: CellState) -> Attachment:
        """Return an obstacle as an object attached to the tip of an arm; the fingers of its hand may touch the object.

        The fingers may penetrate the object by the largest `depth` of the steps that allow this contact, or by the
        default depth. An object without a core at this depth, such as a mesh, may not be touched.
        """
        moving, _ = self.arm_at(arm, state)
        pose = self.tip(arm, state).inverse() * obstacle.pose.se3
        fingers = self.robot.hand_links(moving.tip)
        pairs = {(link, obstacle.name) for link in fingers}
        depths = [
            getattr(step, "depth", 0.0) for step in self._program.steps if pairs & {*getattr(step, "touching", ())}
        ]
        item = Attachment(obstacle.name, obstacle.shape, moving.tip, Pose.of(pose))
        depth = max(depths, default=CONTACT_DEPTH)
        try:
            obstacle.shape.core(depth)
        except InputError:
            return item
        return replace(item, touch_links=fingers, touch_depth=depth) if fingers else item

    def arm_at(self, arm: str | None, state: CellState) -> tuple[Robot, FloatArray]:
        """Return the robot with the joints of all but one arm locked, and the configuration of that arm."""
        robot = self.holding(state)
        prefix = (arm or robot.spec.tip or next(iter(robot.spec.robots))) if robot.spec.robots else None
        values = named(robot, state.q)
        grippers = self._program.gripper_joints
        others = {
            name: value
            for name, value in values.items()
            if name in grippers or (prefix is not None and not name.startswith(f"{prefix}_"))
        }
        moving = robot.with_locked(others, prefix) if others else robot
        q = np.array([values[name] for name in moving.joint_names])
        return moving, moving.difference(np.zeros(moving.n), q)

    def rows(self, names: Sequence[str]) -> list[int]:
        """Return the indices of the named joints among all joints."""
        return [self.robot.joint_names.index(name) for name in names]

    def limits_of(self, arm: Robot) -> RateLimits:
        """Return the limits of the joints of an arm."""
        rows = self.rows(arm.joint_names)
        jerk = self.limits.jerk
        most = self.limits.velocity[rows], self.limits.acceleration[rows], None if jerk is None else jerk[rows]
        return RateLimits(arm.joint_names, *most)

    def tip(self, arm: str | None, state: CellState) -> pin.SE3:
        """Return the pose of the tip of an arm in the world."""
        moving, q = self.arm_at(arm, state)
        return moving.tip_pose(q)

    def link(self, link: str, state: CellState) -> pin.SE3:
        """Return the pose of a link or frame in the world."""
        robot = self.holding(state)
        model, data = robot.shared.model, robot.shared.model.createData()
        pin.framesForwardKinematics(model, data, robot.pinocchio_configuration(state.q))
        return pin.SE3(data.oMf[model.getFrameId(link)])

    def setup(self, robot: Robot, scene: Scene, q: FloatArray, goal: Goal | None = None) -> SafeSetup:
        """Return a setup for a robot in a scene with a start configuration (n,) and the limits of the scenario."""
        limits = self._scenario.limits
        if self._tube is not None:
            limits = replace(limits, tube=tuple(self._tube[self.rows(robot.joint_names)].tolist()))
        start = tuple(q.tolist())
        given = replace(self._scenario, scene=scene, start=start, goal=goal, people=None, limits=limits)  # type: ignore[arg-type]
        try:
            return setup_scenario(given, robot)
        except CollisionError:
            pair = CollisionChecker(robot, scene).colliding_pair(q)
            if pair is None or pair[1] not in (*scene.names, *(item.name for item in robot.attached)):
                raise
            needs = f"if they may touch on this step, give it `touching: [[{pair[0]}, {pair[1]}]]`"
            raise ImpossibleError(f"{pair[0]!r} touches {pair[1]!r} where it begins: {needs}") from None

    def proven(
        self, step: Step, state: CellState, moving: Motion, curve: Motion | None = None
    ) -> tuple[CellState, tuple[ProvenMotion, ...]]:
        """Prove a step's motion of some joints; return the state after the step, and the motion of all joints.

        Raises ImpossibleError if the motion cannot be proven.
        """
        during, people = self.during(step, state), self._scenario.people
        robot = self.holding(during)
        rows = self.rows(moving.joint_names or ())
        motion = replace(moving.among(robot, state.q, rows), times=moving.times - moving.times[0])
        setup = self.setup(robot, during.scene, state.q)
        for _ in range(_MOST_SLOWDOWNS):
            check = setup.check(motion, self.limits, people)
            if {violation.kind for violation in check.violations} != {"separation"}:
                break
            motion = replace(motion, times=motion.times * _SLOWDOWN)
        if not check:
            raise ImpossibleError(str(check.violations[0]))
        if curve is not None:
            curve = curve.among(robot, state.q, rows)
        return state._replace(q=motion.knots[-1]), (ProvenMotion(check, curve, tuple(moving.joint_names or ())),)
