"""The kernels of all commands, which `doctor` lets two processes compile, so that nobody waits for them later.

Kernels are compiled for one kind of arguments, whatever the robot: a small one beside somebody has nearly all of them.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from safe_ompl.common import compile_together
from safe_ompl.danger import CertifiedDanger, DangerField
from safe_ompl.danger.kernels import dangers
from safe_ompl.geometry import Obstacle, Person, Pose
from safe_ompl.geometry.kernels import gaps
from safe_ompl.people import TrackedBody, Tracker, find_skeleton
from safe_ompl.people.replanning import Replanner
from safe_ompl.planning import PLAN_JOBS, SafeSetup, small_robot
from safe_ompl.planning.planners import NearestNode
from safe_ompl.scene import People, Scene
from safe_ompl.trajectories import RateLimits, time_path
from safe_ompl.view import render_path

_MANY = 1000  # points, which are put into balls
_TICKS = 2
ALL_JOBS = (  # those that need what a plan needs come after it
    *PLAN_JOBS,
    f"{__name__}:ask_for_many_points",
    f"{__name__}:ask_for_motions",
    f"{__name__}:ask_for_simplification",
    f"{__name__}:ask_for_people",
    f"{__name__}:ask_for_trees",
    f"{__name__}:ask_for_pictures",
)


def compile_all() -> None:
    """Compile what is not kept yet."""
    compile_together([dangers, gaps], ALL_JOBS)


def _field(number: int, aggregate: Literal["max", "mean"] = "max") -> DangerField:
    points = np.random.default_rng(0).uniform(2.0, 3.0, (number, 3))
    return DangerField(small_robot(), points, aggregate=aggregate)


def ask_for_many_points() -> None:
    """Call what the danger of many points needs, and a mean on an edge."""
    q = np.zeros(2)
    _field(_MANY, "mean").values_and_gradients([q])
    _field(1).mean(q, q)


def ask_for_motions() -> None:
    """Call what danger in motion needs, its gradients, and bounds on paths and in time."""
    q, field = np.zeros(2), _field(1)
    time_path([q, q + 1.0], field.robot, danger=field.moving, max_danger=1e3)
    field.moving.value(q, q + 1.0)
    _field(_MANY).moving.value(q, q + 1.0)
    field.moving.values_and_gradients([q], [q + 1.0])
    CertifiedDanger(field).of_path([q, q + 1.0])
    field.push(q)


def ask_for_simplification() -> None:
    """Call what planning, simplification and motions in time need."""
    robot = small_robot()
    setup = SafeSetup(robot, Scene((Obstacle("person", Person(), Pose((1.4, 0.0, -1.0))),)))
    setup.setConfigurations([-1.0, 0.0], [1.0, 0.0])
    result = setup.plan("SafeRRTConnect", seed=0, simplify=True)
    result.timed(RateLimits.of(robot, acceleration=10.0, jerk=100.0), people=People(speed=1.6))


def ask_for_people() -> None:
    """Call what a robot needs to drive beside people."""
    robot, skeleton = small_robot(), find_skeleton("recording12")
    replanner = Replanner(
        robot, Scene(), {"anna": Tracker(skeleton, TrackedBody())}, people=People(speed=1.6)
    )
    limits = RateLimits.of(robot, acceleration=10.0)
    replanner.start(time_path([[-1.0, 0.0], [1.0, 0.0]], robot, limits, motion=replanner.prover))
    keypoints = np.random.default_rng(0).uniform(-0.3, 0.3, (12, 3)) + np.array([1.5, 0.0, 0.2])
    for tick in range(_TICKS):
        replanner.update({"anna": keypoints}, {}, 0.05 * tick)
        replanner.command(0.05 * tick + 0.02)
        replanner.think()


def ask_for_trees() -> None:
    """Call what finds the nearest of many nodes."""
    rows = np.random.default_rng(0).uniform(size=(_MANY, 2))
    NearestNode(np.zeros(2, bool)).find(rows, rows[0], 0.1, rows[:, 0].copy())


def ask_for_pictures() -> None:
    """Call what a picture needs."""
    render_path(small_robot(), Scene(), np.zeros((2, 2)), size=(16, 16))
