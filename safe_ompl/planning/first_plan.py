"""What the first plan after an installation calls is compiled by two processes at a time.

Kernels are compiled for one kind of arguments, whatever the robot: that of two joints beside a person has them all.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from safe_ompl.collision import CollisionChecker, MotionProver
from safe_ompl.common import compile_together
from safe_ompl.danger import DangerField
from safe_ompl.danger.kernels import dangers
from safe_ompl.geometry import Obstacle, Person
from safe_ompl.geometry.kernels import extreme_vertices
from safe_ompl.paths import Curve
from safe_ompl.robot import JointLimits, Robot
from safe_ompl.robot.kernels import descend, steer
from safe_ompl.scene import Scenario, Scene, find_scenario

_MARGIN = 1.0  # [m] any
PLAN_JOBS = (f"{__name__}:ask_for_danger", f"{__name__}:ask_for_proofs")  # about half of the time each


@cache
def compile_kernels() -> None:
    """Compile the kernels of a plan, unless they are on disk: once in a process it is looked whether they are."""
    compile_together([dangers], PLAN_JOBS)


def small_robot() -> Robot:
    """Return a robot of two joints."""
    return Scenario.load(find_scenario("planar2")).build_robot()


def ask_for_danger() -> None:
    """Call what danger, steps and reports need."""
    robot = small_robot()
    step, q, wraps = np.ones((2, robot.n)), np.zeros(robot.n), np.zeros(robot.n, dtype=bool)
    steer(q, q + _MARGIN, wraps, _MARGIN, step)
    descend(step, q, _MARGIN, q, q, wraps)
    JointLimits(robot).hold(q)
    DangerField(robot, np.ones((1, 3))).values_and_gradients(np.zeros((1, robot.n)))
    Curve(robot, np.zeros((2, robot.n)))


def ask_for_proofs() -> None:
    """Call what the proof of an edge needs."""
    robot, scene = small_robot(), Scene((Obstacle("person", Person()),))
    scene.danger_points()
    extreme_vertices(np.zeros((1, 3)), 1)
    checker, q = CollisionChecker(robot, scene), np.zeros(robot.n)
    checker.in_collision(q)
    checker.pairs.bounds.of(q[None], np.arange(1), _MARGIN)
    MotionProver(checker).is_free(q, q + _MARGIN)
