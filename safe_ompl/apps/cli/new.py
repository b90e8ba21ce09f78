"""Commands `new` (write a first scenario for a URDF) and `srdf` (write an SRDF with the pairs to leave unchecked)."""

from __future__ import annotations

import argparse
import shlex
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.apps.cli import arguments, output
from safe_ompl.apps.cli.arguments import option
from safe_ompl.apps.cli.pick_and_place import CubeGripper, block, planned
from safe_ompl.collision import CollisionChecker
from safe_ompl.common import FloatArray, InputError, SafeOmplError, UnknownNameError, documents as document, files
from safe_ompl.geometry import Obstacle, Person, Pose
from safe_ompl.planning import SafeSetup
from safe_ompl.robot import (
    Mimic,
    Robot,
    RobotSpec,
    SrdfFile,
    UrdfFile,
    arm_joints,
    default_tip,
    disabled_links,
    finger_joints,
    has_range,
    joints_without_range,
    resting_value,
    srdf_text,
)
from safe_ompl.scene import Scene

_POSTURES, _SEED = 2000, 0
_SRDF_SAMPLES = 1000
# Start and goal have this clearance, if such configurations are found.
_ROOM = 0.03  # [m]
# At most this many configurations on each side are candidates for start and goal.
_CHOICE = 12
# This planner tries at most this many pairs of candidates, each for this time.
_PLANNER = "SafeRRTConnect"
_TRIALS = 24
_TRIAL_TIME = 5.0  # [s]
# The person first stands this far outside of the robot's reach.
_BESIDE = 0.35  # [m]
# The straight path from start to goal passes the person at this distance, or up to the least step of the person more.
_PASSES = 0.06  # [m]
_PERSON_STEP = 0.02  # [m]
# The number of configurations of the straight path whose clearance is computed.
_STRAIGHT = 41
# The way past the person matters where the planned path has no more than this share of the straight path's peak danger.
_SAFER = 0.8
_HEIGHT = 1.75  # [m]
# At least this share of the samples must be on either side of straight ahead.
_SHARE = 0.1
_PROGRAM_HEAD = (
    "# A program for safe-ompl; lengths in metres, angles in radians. What else there is: docs/programs.md\n"
)
# The middle of the robot's reach is at this share of the person's height.
_WAIST = 0.55


def add_commands(commands: Any) -> None:
    """Add `new` and `srdf` to the commands."""
    parser = arguments.add_parser(
        commands,
        "new",
        _prepare_new,
        "write a first scenario for your own robot",
        "Write a scenario to begin with: your robot, a start and a goal on either side of a person, both free of "
        "collision, and the person so near that the straight path from start to goal passes them closely. One arm "
        "moves: that of the SRDF's end effector with the most joints above it, or, if no end effector has as many, "
        "that of the link with the most joints above it. All other joints are held. Then edit the scenario.",
    )
    option(parser, "urdf URDF", "the robot's URDF")
    read = output.output_file(".yaml", ".yml")
    option(parser, "-o, --output FILE", "where the scenario goes (.yaml)", read, required=True)
    words = "write a program for an arm with a gripper: it takes a cube from a table and puts it elsewhere"
    option(parser, "--pick-and-place", words)
    option(parser, "--srdf FILE", "the robot's SRDF, which lists the links that may touch")
    words = "MoveIt's joint_limits.yaml (default: the one beside the SRDF, if there is one)"
    option(parser, "--joint-limits FILE", words)
    option(parser, "--tip FRAME", "frame at the end of the arm")
    option(parser, "--group NAME", "group of the SRDF whose joints move; the others are held")
    arguments.add_xacro_args(parser)
    arguments.add_collision_option(parser)
    parser = arguments.add_parser(
        commands,
        "srdf",
        _prepare_srdf,
        "write an SRDF for a URDF",
        "Write an SRDF that disables the collisions of adjacent links and of links that touch in more "
        "than 95 % of sampled configurations. Links that merely were never seen in contact stay enabled.",
    )
    option(parser, "urdf URDF", "the robot's URDF")
    read = output.output_file(".srdf", ".xml", output.STANDARD_OUTPUT)
    option(parser, "-o, --output FILE", "default: standard output", read, output.STANDARD_OUTPUT)
    arguments.add_xacro_args(parser)
    arguments.add_collision_option(parser)


def _prepare_srdf(options: argparse.Namespace) -> Callable[[], int]:
    """Read the URDF and return a function that writes the SRDF."""
    urdf = UrdfFile(options.urdf, options.package_dir, arguments.xacro_args(options))
    return partial(_write_srdf, urdf, options.output, options.collision or "required")


def _prepare_new(options: argparse.Namespace) -> Callable[[], int]:
    """Read the robot, choose its arm, and return a function that runs the command."""
    document.file("URDF", options.urdf, (".urdf", ".xml", ".xacro"))
    keys = ("urdf", "srdf", "tip", "group", "collision", "joint_limits")
    chosen: dict[str, Any] = {key: getattr(options, key) for key in keys if getattr(options, key)}
    if options.srdf and "joint_limits" not in chosen:
        # Packages of MoveIt hold both files in one folder.
        beside = Path(options.srdf).with_name("joint_limits.yaml")
        if beside.is_file():
            _say(f"safe-ompl: joint limits are also read from {beside}")
            chosen["joint_limits"] = beside
    chosen |= {"package_dirs": options.package_dir, "xacro_args": arguments.xacro_args(options)}
    with document.within("--", separator=""):
        given = RobotSpec.from_mapping(chosen, Path())
    new = New(*with_arm(given), Path(options.output))
    return partial(new.pick_and_place, CubeGripper(new.spec, new.robot.tip)) if options.pick_and_place else new


def with_arm(given: RobotSpec) -> tuple[RobotSpec, Robot]:
    """Return the specification and the robot with the joints of one arm free and all other joints locked.

    If the specification does not name group and tip, they are taken from the SRDF, or else from the joints of the URDF.
    """
    assert given.urdf is not None
    urdf = given.urdf_file()
    full = urdf.build_model()
    # A joint that mimics a missing joint is treated like any other joint.
    mimics = {name: mimic for name, mimic in urdf.mimics().items() if full.existJointName(mimic.primary)}
    srdf = given.srdf_file()
    if srdf is None and given.group:
        raise InputError("is defined in an SRDF: give --srdf, too", "--group")
    group, tip, moving = _arm(full, mimics, srdf, given)
    if not moving:
        raise InputError("the robot has no arm: no joint that can be planned for moves a link", str(given.urdf))
    still = [name for name in list(full.names)[1:] if name not in mimics and name not in moving]
    locked = {name: resting_value(full, name) for name in still}
    spec = replace(given, group=group, tip=tip, locked=locked)
    robot = Robot(spec)
    return replace(spec, tip=robot.tip), robot


def _arm(
    full: pin.Model, mimics: Mapping[str, Mimic], srdf: SrdfFile | None, given: RobotSpec
) -> tuple[str | None, str | None, set[str]]:
    """Return group and tip of the arm, each None if unknown, and the joints of the arm that can be planned for."""
    group, tip, fingers = given.group, given.tip, finger_joints(full)
    if tip is not None and not full.existFrame(tip):
        raise UnknownNameError("tip frame", tip, (frame.name for frame in list(full.frames)[1:]), "--tip")
    if tip is None and group is None:
        tip = default_tip(full, full)
        if srdf is not None:
            group, tip = srdf.arm(full, tip, fingers) or (None, tip)
    if group is None or srdf is None:
        assert tip is not None
        joints = set(arm_joints(full, tip, mimics))
    else:
        joints = set(srdf.group_joints(group, full))
    # A hand without an arm has only fingers.
    joints = joints - fingers or joints
    joints |= {mimics[name].primary for name in joints if name in mimics}
    joints -= set(joints_without_range(full, joints))
    return group, tip, {name for name in joints if has_range(full, full.getJointId(name))}


@dataclass(frozen=True)
class New:
    """The function that runs `safe-ompl new` after its options were validated."""

    spec: RobotSpec
    robot: Robot
    file: Path

    def __call__(self) -> int:
        """Find a start and a goal, write the scenario, and print the next commands."""
        samples = np.round(self._sampled(), 2)
        person, reach = self._person(samples)
        left, right = self._ends(CollisionChecker(self.robot, Scene((person,))), samples, person)
        person, start, goal, solved = self._connected(person, left, right)
        files.write(self.file, self._text(person, start, goal))
        group = f" of the group {self.spec.group!r}" if self.spec.group else ""
        number = len(self.spec.locked or {})
        _say(
            f"a scenario in {self.file}: {self.robot.n} joints{group}, tip {self.robot.tip!r}, "
            f"reach {reach:.2f} m; joints that are held: {number}"
        )
        if not solved:
            _say(
                f"safe-ompl: {_PLANNER} found no path from this start to this goal, nor between other "
                "pairs: choose them by the sliders of `safe-ompl view`"
            )
        self._say_what_next("the path", "--json STEM.json --certificate STEM.certificate.json", "STEM.json")
        return 0

    def _say_what_next(self, planned: str, options: str, shown: str) -> None:
        """Print the next commands: `plan` with `options`, and `view` of `shown`, where STEM stands for the scenario."""
        file, stem = (shlex.quote(str(name)) for name in (self.file, self.file.with_suffix("")))
        _say(f"look at it, plan, check the proof, and look at {planned}:")
        _say(f"    safe-ompl view {file}")
        _say(f"    safe-ompl plan {file} {options.replace('STEM', stem)}")
        _say(f"    safe-ompl verify {stem}.certificate.json {file}")
        _say(f"    safe-ompl view {shown.replace('STEM', stem)} --html {stem}.html")

    def pick_and_place(self, gripper: CubeGripper) -> int:
        """Find a program that can be planned, write the scenario, and print the next commands."""
        person, reach = self._person(np.round(self._sampled(), 2))
        spec = replace(self.spec, locked={**(self.spec.locked or {}), **gripper.open})
        there = {"position": list(person.pose.position), "yaw": round(_yaw(person), 5)}
        about = {"name": self.file.stem, "robot": spec.to_mapping(self.file.parent)}
        about["scene"] = {"obstacles": [{"name": person.name, "person": {"height": _HEIGHT}, **there}]}
        content, result = planned(spec, gripper, about, self._shoulder, reach, self.file.parent)
        files.write(self.file, f"{_PROGRAM_HEAD}{block(content)}\n")
        steps = len(content["program"]["steps"])
        _say(
            f"a scenario in {self.file}: {steps} steps in {result.duration:.1f} s, fingers: {', '.join(gripper.joints)}"
        )
        self._say_what_next("it once more", "--certificate STEM.certificate.json", "STEM.certificate.json")
        return 0

    def _person(self, samples: FloatArray) -> tuple[Obstacle, float]:
        """Return a person who stands just beyond the reach of the arm, and the reach [m]."""
        points = self.robot.keypoints_batch(samples).reshape(-1, 3)
        base = self._shoulder
        reach = float(np.linalg.norm(points[:, :2] - base[:2], axis=1).max())
        tips = self._azimuths(samples)
        way = 0.0 if min((tips > 0).mean(), (tips < 0).mean()) > _SHARE else float(np.median(tips))
        x, y = base[:2] + (reach + _BESIDE) * np.array([np.cos(way), np.sin(way)])
        middle = float(np.quantile(points[:, 2], 0.5))
        place = tuple(round(float(value), 2) for value in (x, y, middle - _WAIST * _HEIGHT))
        half = (way + np.pi) / 2
        turn = (0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
        return Obstacle("person", Person(height=_HEIGHT), Pose(place, turn)), reach

    @property
    def _shoulder(self) -> FloatArray:
        """The first key point of the arm [m]."""
        points = self.robot.keypoints(np.clip(np.zeros(self.robot.n), self.robot.lower, self.robot.upper))
        return np.asarray(points[self.robot.segments[:, 0].min(initial=len(points) - 1)])

    def _azimuths(self, samples: FloatArray, way: float = 0.0) -> FloatArray:
        """Return the azimuths (B,) [rad] of the tip, seen from the shoulder, relative to the azimuth `way`."""
        x, y = (self.robot.keypoints_batch(samples)[:, -1] - self._shoulder)[:, :2].T
        return np.asarray((np.arctan2(y, x) - way + np.pi) % (2 * np.pi) - np.pi)

    def _ends(self, checker: CollisionChecker, samples: FloatArray, person: Obstacle) -> tuple[FloatArray, FloatArray]:
        """Return free configurations (K, n) with the tip left and right of the person, if possible with clearance."""
        to_person = np.array(person.pose.position)[:2] - self._shoulder[:2]
        sides = self._azimuths(samples, float(np.arctan2(to_person[1], to_person[0])))
        order = np.argsort(np.abs(np.abs(sides) - np.pi / 3))  # 60° to either side

        def free(side: float, room: float) -> FloatArray:
            found = (
                samples[k]
                for k in order
                if side * sides[k] > 0
                and self.robot.within_limits(samples[k]).all()
                and not checker.in_collision(samples[k])
                and (not room or checker.clearance(samples[k]).distance > room)
            )
            return np.array(list(islice(found, _CHOICE)))

        for room in (_ROOM, 0.0):
            left, right = free(1.0, room), free(-1.0, room)
            if len(left) and len(right):
                return left, right
        why = "the tip does not move from one side to the other"
        if pairs := _touching(checker, samples):
            often = f"what touches most often: {', '.join(pairs)}"
            why = f"{often}. Do links touch that may? see `safe-ompl srdf`"
        raise SafeOmplError(
            f"{self.spec.urdf}: no start and goal on either side of a person, of {_POSTURES} configurations; {why}"
        )

    def _connected(
        self, person: Obstacle, left: FloatArray, right: FloatArray
    ) -> tuple[Obstacle, FloatArray, FloatArray, bool]:
        """Return the moved person, start, goal, and whether a path between start and goal was found.

        For each pair of configurations, near pairs first, the person is moved as near as the straight path allows. The
        first pair is chosen whose planned path is clearly safer than the straight path; otherwise the pair whose path
        is safest relative to the straight path. If no path is found, the person is not moved, and start and goal are
        the nearest pair.
        """
        distances = np.linalg.norm(left[:, None] - right[None], axis=2)
        pairs = [np.unravel_index(k, distances.shape) for k in np.argsort(distances, axis=None)]
        found, least = None, np.inf
        for i, k in pairs[:_TRIALS]:
            straight = np.linspace(left[i], right[k], _STRAIGHT)
            near = self._passed(person, straight)
            setup = SafeSetup(self.robot, Scene((near,)))
            assert setup.field is not None
            danger = setup.field.values(straight)
            # No path is safer than its ends.
            if found and max(danger[0], danger[-1]) > _SAFER * danger.max():
                continue
            setup.setConfigurations(left[i], right[k])
            result = setup.plan(_PLANNER, time=_TRIAL_TIME, seed=_SEED, simplify=True)
            if result.report is None or result.report.danger is None:
                continue
            share = result.report.danger.max / danger.max()
            if share < least:
                found, least = (near, left[i], right[k], True), share
            if share <= _SAFER:
                break
        i, k = pairs[0]
        return found or (person, left[i], right[k], False)

    def _passed(self, person: Obstacle, straight: FloatArray) -> Obstacle:
        """Move the person towards the shoulder, as far as a straight path (S, n) still passes without contact.

        A person who moves by d reduces the clearance by at most d. The step may therefore be as long as the clearance
        exceeds the required one.
        """
        x, y, z = person.pose.position
        away = np.array([x, y]) - self._shoulder[:2]
        left = length = float(np.linalg.norm(away))
        checker = CollisionChecker(self.robot, Scene((person,)), movable=[person.name])
        while True:
            checker.move(Scene((person,)))
            spare = min(checker.clearance(q).distance for q in straight) - _PASSES
            left -= spare
            if spare < _PERSON_STEP or left < _PERSON_STEP:
                return person
            nearer = np.round(self._shoulder[:2] + left / length * away, 2)
            person = replace(person, pose=Pose((*nearer.tolist(), z), person.pose.quaternion_xyzw))

    def _sampled(self) -> FloatArray:
        low, high = np.maximum(self.robot.lower, -np.pi), np.minimum(self.robot.upper, np.pi)
        return np.random.default_rng(_SEED).uniform(low, high, (_POSTURES, self.robot.n))

    def _text(self, person: Obstacle, start: FloatArray, goal: FloatArray) -> str:
        robot = self.spec.to_mapping(self.file.parent)
        lines = files.dump_document({"robot": robot}, flow=None, width=100)
        x, y, z = person.pose.position
        yaw = _yaw(person)
        return f"""\
# A scenario for safe-ompl; lengths in metres, angles in radians. What else there is: docs/scenarios.md
name: {files.dump_line(self.file.stem)}

# The joints in `locked` are held where it says.
{lines}
start: {_by_joint(self.robot, start)}
goal:
  configuration: {_by_joint(self.robot, goal)}

scene:
  obstacles:
    # Only people are dangerous by default; `weight: 1` makes any other thing so.
    - {{name: person, person: {{height: {_HEIGHT}}}, position: [{x}, {y}, {z}], yaw: {yaw:.5f}}}
    # - {{name: table, box: {{size: [1.0, 0.8, 0.04]}}, position: [0.5, 0.0, -0.2]}}

time: 10.0
"""


def _yaw(person: Obstacle) -> float:
    return 2 * float(np.arctan2(person.pose.quaternion_xyzw[2], person.pose.quaternion_xyzw[3]))


def _say(line: str) -> None:
    output.error_console().print(line)


def _touching(checker: CollisionChecker, samples: FloatArray) -> list[str]:
    """Return at most three pairs of bodies that collide most often, with the share of samples [%]."""
    looked = samples[:: len(samples) // 200]
    pairs = Counter(pair for q in looked if (pair := checker.colliding_pair(q)) is not None)
    return [f"{a} and {b} ({100 * n / len(looked):.0f} %)" for (a, b), n in pairs.most_common(3)]


def _by_joint(robot: Robot, q: FloatArray) -> str:
    values = dict(zip(robot.joint_names, np.round(q, 2).tolist(), strict=True))
    return files.dump_line(values)


def _write_srdf(urdf: UrdfFile, file: str, collision: str) -> int:
    pairs = disabled_links(urdf, _SRDF_SAMPLES, collision)
    output.write_text(file, srdf_text(urdf.build_model().name, pairs, _SRDF_SAMPLES))
    reasons = [pair.reason for pair in pairs]
    _say(
        f"safe-ompl: {_SRDF_SAMPLES} samples: {reasons.count('Always')} pairs of links always touch, "
        f"{reasons.count('Adjacent')} are adjacent"
    )
    return 0
