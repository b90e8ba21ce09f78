"""What the first plan after an installation compiles."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

import safe_ompl.planning.simplification as simplification
import safe_ompl.scene as scenes
from safe_ompl.collision import CollisionChecker, EdgeTables, MotionProver, prove_curve
from safe_ompl.common import compile_together
from safe_ompl.geometry import Box, Obstacle, Person, Sphere
from safe_ompl.geometry.kernels import extreme_vertices
from safe_ompl.robot import Robot
from safe_ompl.robot.kernels import lay_edge
from safe_ompl.scene import Scene

# By two processes, each about half of the time. Kernels are compiled for one kind of arguments, whatever the robot:
# that of two joints beside a person has them all.
PLAN_JOBS = (f"{__name__}:ask_for_danger", f"{__name__}:ask_for_edges", f"{__name__}:ask_for_proofs")
_ANY_LENGTH = 1.0


@cache
def compile_kernels() -> None:
    """Compile the kernels of a plan, unless they are on disk: once in a process it is looked whether they are."""
    compile_together([prove_curve], PLAN_JOBS)


def small_robot() -> Robot:
    """Return a robot of two joints."""
    return scenes.Scenario.load("planar2").build_robot()


def ask_for_danger() -> None:
    """Call what danger and reports need."""
    robot = small_robot()
    q = np.zeros(robot.n)
    robot.joint_limits.hold(q)
    simplification.Curve(robot, np.zeros((2, robot.n))).at(q[:1])


def ask_for_edges() -> None:
    """Call what the proof of an edge needs that no pair of bodies is near."""
    nothing = EdgeTables.of_nothing()
    required, edge = nothing.required, nothing.edge
    lay_edge(required.distances, required.distances, nothing.coupling, nothing.limits, edge)
    arguments: Any = *nothing.pairs, edge, *required, nothing.floor, *nothing[8:]
    prove_curve(nothing.joints, *nothing.shapes, *arguments)


def ask_for_proofs() -> None:
    """Call what else proofs and queries need."""
    shapes = {"person": Person(), "box": Box([1.0, 1.0, 1.0]), "ball": Sphere(1.0)}
    robot, scene = small_robot(), Scene([Obstacle(name, shape, weight=1.0) for name, shape in shapes.items()])
    scene.danger_points()
    extreme_vertices(np.zeros((1, 3)), 1)
    checker, q = CollisionChecker(robot, scene), np.zeros(robot.n)
    checker.in_collision(q)
    checker.pairs.bounds.of(q[None], np.arange(1), _ANY_LENGTH)
    MotionProver(checker).is_free(q, q + _ANY_LENGTH)
