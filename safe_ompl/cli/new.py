"""`safe-ompl new`: a first scenario for a robot of one's own."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.cli.console import error_console
from safe_ompl.cli.files import check_writable
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.errors import InputError, SafeOmplError
from safe_ompl.robot.robot import Robot
from safe_ompl.robot.spec import RobotSpec
from safe_ompl.scene.obstacle import Obstacle
from safe_ompl.scene.pose import Pose
from safe_ompl.scene.scene import Scene
from safe_ompl.scene.shapes.person import Person
from safe_ompl.setup.safe_setup import SafeSetup

_SAMPLES, _SEED = 2000, 0
_ROOM = 0.03  # [m] that start and goal leave around the robot
_CHOICE = 12  # configurations on each side that may become start and goal
_PLANNER, _TRIALS, _PATIENCE = (
    "SafeRRTConnect",
    6,
    1.0,
)  # who tries how many pairs of them, for how long each [s]
_BESIDE = 0.35  # [m] from where the robot reaches to the middle of the person
_HEIGHT = 1.75  # [m]
_WAIST = 0.55  # share of her height that is below the middle of the robot's reach


def add_command(commands: Any) -> None:
    """Add `new` to the commands."""
    parser = commands.add_parser(
        "new",
        help="write a first scenario for your own robot",
        description="Write a scenario to begin with: your robot, a person just beyond its reach, a start and a goal on "
        "either side of her, both free of collision. Then edit it.",
    )
    parser.add_argument("urdf", metavar="URDF", help="the robot's URDF")
    parser.add_argument(
        "-o", "--output", metavar="FILE", required=True, help="where the scenario goes (.yaml)"
    )
    parser.add_argument("--srdf", metavar="FILE", help="its SRDF, which says which links may touch")
    parser.add_argument("--tip", metavar="FRAME", help="frame at the end of the arm")
    parser.set_defaults(prepare=prepare)


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Read the robot, and return the job."""
    if Path(options.output).suffix.lower() not in (".yaml", ".yml"):
        raise InputError(f"{options.output!r} must end in .yaml", "--output")
    if Path(options.output).exists():
        raise InputError(f"{options.output!r} is there already: give another file", "--output")
    check_writable(options.output, "--output")
    srdf = None if options.srdf is None else Path(options.srdf)
    spec = RobotSpec(None, Path(options.urdf), srdf, **({"tip": options.tip} if options.tip else {}))
    return New(spec, spec.build(), Path(options.output))


@dataclass(frozen=True)
class New:
    """The job of `safe-ompl new`."""

    spec: RobotSpec
    robot: Robot
    file: Path

    def __call__(self) -> int:
        """Find a start and a goal, and write the scenario."""
        person, reach = self._person()
        scene = Scene((person,))
        left, right = self._ends(CollisionChecker(self.robot, scene))
        start, goal, solved = self._connected(scene, left, right)
        self.file.write_text(self._text(person, start, goal), encoding="utf-8")
        error_console().print(
            f"a scenario in {self.file}: {self.robot.n} joints, tip {self.robot.tip!r}, reach {reach:.2f} m; "
            f"look at it: safe-ompl view {self.file}; plan: safe-ompl plan {self.file} --plot path.png",
            markup=False,
            soft_wrap=True,
        )
        if not solved:
            error_console().print(
                f"safe-ompl: {_PLANNER} found no path from this start to this goal, nor between other "
                "pairs: choose them by the sliders of `safe-ompl view`",
                markup=False,
                soft_wrap=True,
            )
        return 0

    def _person(self) -> tuple[Obstacle, float]:
        """Return a person who stands just beyond the reach of the robot, and how far it reaches [m]."""
        points = self.robot.keypoints_batch(self._sampled()).reshape(-1, 3)
        base = self.robot.keypoints(np.clip(np.zeros(self.robot.n), self.robot.lower, self.robot.upper))[0]
        reach = float(np.linalg.norm(points[:, :2] - base[:2], axis=1).max())
        middle = float(np.quantile(points[:, 2], 0.5))
        x, y = base[0] + reach + _BESIDE, base[1]
        place = tuple(round(float(value), 2) for value in (x, y, middle - _WAIST * _HEIGHT))
        return Obstacle("person", Person(height=_HEIGHT), Pose(place, (0.0, 0.0, 1.0, 0.0))), reach

    def _ends(self, checker: CollisionChecker) -> tuple[FloatArray, FloatArray]:
        """Return free configurations (K, n) in front of the person: tips far to her left, and far to her right."""
        samples = np.round(self._sampled(), 2)
        tips = self.robot.keypoints_batch(samples)[:, -1]
        sides = np.arctan2(tips[:, 1], tips[:, 0])
        order = np.argsort(np.abs(np.abs(sides) - np.pi / 3))  # 60° to either side

        def free(side: float) -> FloatArray:
            found = (
                samples[k]
                for k in order
                if side * sides[k] > 0
                and self.robot.within_limits(samples[k]).all()
                and not checker.in_collision(samples[k])
                and checker.clearance(samples[k]).distance > _ROOM
            )
            return np.array(list(islice(found, _CHOICE)))

        left, right = free(1.0), free(-1.0)
        if not len(left) or not len(right):
            raise SafeOmplError(
                f"no configuration of {_SAMPLES} is free on both sides: do links touch that may? see `safe-ompl srdf`"
            )
        return left, right

    def _connected(
        self, scene: Scene, left: FloatArray, right: FloatArray
    ) -> tuple[FloatArray, FloatArray, bool]:
        """Return start and goal with a path between them, near ones first; the nearest and False if none is found."""
        setup = SafeSetup(self.robot, scene)
        distances = np.linalg.norm(left[:, None] - right[None], axis=2)
        pairs = [np.unravel_index(k, distances.shape) for k in np.argsort(distances, axis=None)]
        for i, k in pairs[:_TRIALS]:
            setup.setConfigurations(left[i], right[k])
            if setup.plan(_PLANNER, time=_PATIENCE, seed=_SEED, report=False):
                return left[i], right[k], True
        i, k = pairs[0]
        return left[i], right[k], False

    def _sampled(self) -> FloatArray:
        low, high = np.maximum(self.robot.lower, -np.pi), np.minimum(self.robot.upper, np.pi)
        return np.random.default_rng(_SEED).uniform(low, high, (_SAMPLES, self.robot.n))

    def _text(self, person: Obstacle, start: FloatArray, goal: FloatArray) -> str:
        urdf = os.path.relpath(self.spec.urdf or "", self.file.parent)
        srdf = f", srdf: {os.path.relpath(self.spec.srdf, self.file.parent)}" if self.spec.srdf else ""
        x, y, z = person.pose.position
        return f"""\
# A scenario for safe-ompl; lengths in metres, angles in radians. What else there is: docs/scene.md and docs/goals.md
name: {self.file.stem}

robot: {{urdf: {urdf}{srdf}, tip: {self.robot.tip}}}
start: {_by_joint(self.robot, start)}
goal:
  configuration: {_by_joint(self.robot, goal)}

scene:
  obstacles:
    # Only people are dangerous by default; `weight: 1` makes any other thing so.
    - {{name: person, person: {{height: {_HEIGHT}}}, position: [{x}, {y}, {z}], yaw: 3.14159}}
    # - {{name: table, box: {{size: [1.0, 0.8, 0.04]}}, position: [0.5, 0.0, -0.2]}}

time: 5.0
"""


def _by_joint(robot: Robot, q: FloatArray) -> str:
    return (
        "{"
        + ", ".join(f"{name}: {value:.2f}" for name, value in zip(robot.joint_names, q, strict=True))
        + "}"
    )
