"""Tool motions: lines and seams among obstacles, against differential inverse kinematics, judged by plain Pinocchio.

    python -m bench tools --lines 200 --seams 50

Problems are drawn from a seed on four arms: a random pose of the tip that a free configuration has, and a line or a
seam of 5 to 20 way points from there. Differential inverse kinematics is pink's (`pip install pin-pink daqp`), which
begins at the same configuration as our search is free to choose from: the first free one that is found.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Iterator
from importlib.util import find_spec
from time import process_time

import numpy as np
import pinocchio as pin

from bench._harness import Report
from safe_ompl import (
    Box,
    CollisionChecker,
    DangerField,
    MotionProver,
    Obstacle,
    Person,
    Pose,
    Robot,
    Scene,
    Sphere,
    inverse_kinematics,
)
from safe_ompl.common import FloatArray
from safe_ompl.tasks import Corridor, ToolMotion, ToolPath, ToolPlanner

CLAIM = "the tool follows lines and seams within a proven corridor, farther from danger than differential IK goes"
ROBOTS = ("panda", "ur5", "xarm7", "kinova")
SAMPLES = 10_000  # of a motion, by the judge
CORRIDOR = Corridor(0.001, 0.01)
_STEPS = 200  # of differential IK along a path


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--lines", type=int, default=200, metavar="N")
    parser.add_argument("--seams", type=int, default=50, metavar="N")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--free-axis", choices="xyz", help="the tool may turn about this axis of its own")
    parser.add_argument("--longer", action="store_true", help="search ten times as long where nothing is found")


def main(options: argparse.Namespace, report: Report) -> int:
    """Solve all problems, and judge the motions."""
    logging.disable(logging.WARNING)
    corridor = Corridor(CORRIDOR.position, CORRIDOR.angle, options.free_axis)
    rows, broken = [], 0
    for kind, number in (("line", options.lines), ("seam", options.seams)):
        solved, solvable, times, ratios, theirs, both = 0, 0, list[float](), list[float](), 0, 0
        for path, prover, field in problems(kind, number, options.seed):
            begin = process_time()
            found = ToolPlanner(prover, field).plan(path, corridor)
            times.append(process_time() - begin)
            longer = found
            if not found and options.longer:
                longer = ToolPlanner(prover, field, effort=10).plan(path, corridor)
            solved, solvable = solved + bool(found), solvable + bool(longer)
            broken += bool(found) and not keeps(found, prover.checker.robot)
            other = differential(path, prover, corridor)
            theirs += other is not None
            if found and other is not None:
                both += 1
                ratios.append(found.danger_mean / float(field.values(other).mean()))
        rows.append(
            (kind, number, solved, solvable, theirs, both, 1e3 * np.median(times), 1e3 * np.percentile(times, 90))
        )
        rows[-1] += (float(np.mean(ratios)) if ratios else float("nan"),)
    header = ("kind", "problems", "solved", "solvable", "pink", "both", "median [ms]", "90 % [ms]", "danger ours/pink")
    report.table(header, rows)
    report.figure("corridors broken", broken)
    return int(broken > 0)


def problems(kind: str, number: int, seed: int) -> Iterator[tuple[ToolPath, MotionProver, DangerField]]:
    """Yield paths, and what proves and weighs motions beside them."""
    for k in range(number):
        rng = np.random.default_rng([seed, k, kind == "seam"])
        robot = _robot(ROBOTS[k % len(ROBOTS)])
        while True:
            scene = _scene(robot, rng)
            checker = CollisionChecker(robot, scene)
            q = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi))
            if not checker.in_collision(q):
                break
        pose, length = robot.tip_pose(q), rng.uniform(0.3, 0.6)
        way = rng.normal(size=3)
        way *= length / np.linalg.norm(way)
        if kind == "line":
            path = ToolPath.line(pose, pin.SE3(pose.rotation, pose.translation + way))
        else:
            points = np.linspace(0.0, 1.0, int(rng.integers(5, 21)))
            side = np.cross(way, rng.normal(size=3))
            side *= rng.uniform(0.02, 0.06) / np.linalg.norm(side)
            wave = np.sin(2 * np.pi * points * rng.uniform(0.5, 1.5))
            places = pose.translation + points[:, None] * way + wave[:, None] * side
            path = ToolPath.spline([pin.SE3(pose.rotation, place) for place in places])
        yield path, MotionProver(checker), DangerField.of_scene(robot, scene)


_known: dict[str, Robot] = {}


def _robot(name: str) -> Robot:
    if name not in _known:
        _known[name] = Robot.from_example(name)
    return _known[name]


def _scene(robot: Robot, rng: np.random.Generator) -> Scene:
    """Return a person, a table and some boxes and balls about the arm, none of which holds its base."""
    angle, base = rng.uniform(-np.pi, np.pi), robot.keypoints(np.zeros(robot.n))[0]
    spot = base + 0.9 * np.array([np.cos(angle), np.sin(angle), 0.0]) - [0, 0, 0.9]
    turn = (0.0, 0.0, np.sin(angle / 2 + np.pi / 2), np.cos(angle / 2 + np.pi / 2))
    found = [Obstacle("operator", Person(1.75), Pose(tuple(spot), turn), weight=1.0)]
    for k in range(6):
        while True:
            place = base + rng.uniform(-0.8, 0.8, 3)
            if np.linalg.norm(place - base) > 0.45:
                break
        shape = Box(rng.uniform(0.08, 0.3, 3)) if k % 2 else Sphere(float(rng.uniform(0.05, 0.15)))
        found.append(Obstacle(f"thing_{k}", shape, Pose(tuple(place)), weight=0.0))
    return Scene(found)


def keeps(found: ToolMotion, robot: Robot) -> bool:
    """Return whether the tip keeps to the curve at samples of the motion in time, by plain Pinocchio."""
    motion, model, data = found.motion, robot.model, robot.model.createData()
    assert motion is not None
    frames = found.path.at(np.linspace(0.0, found.path.length, 20_001))
    at = 0
    for q in motion.at(np.linspace(0.0, motion.duration, SAMPLES)):
        pin.framesForwardKinematics(model, data, robot.pinocchio_configuration(q))
        tip = data.oMf[robot.tip_frame]
        window = slice(max(0, at - 50), at + 200)
        near = np.linalg.norm(frames.positions[window] - tip.translation, axis=1)
        at = window.start + int(near.argmin())
        angle = _turned(frames.rotations[at], tip.rotation, found.corridor)
        if near.min() > found.corridor.position + 2e-5 or angle > found.corridor.angle + 1e-4:
            return False
    return True


def _turned(wanted: FloatArray, own: FloatArray, corridor: Corridor) -> float:
    """Return the angle [rad] between two orientations, or between their free axes."""
    if corridor.axis is None:
        return float(np.linalg.norm(pin.log3(wanted @ own.T)))
    return float(np.arccos(np.clip((own @ corridor.axis) @ (wanted @ corridor.axis), -1, 1)))


def differential(path: ToolPath, prover: MotionProver, corridor: Corridor) -> FloatArray | None:
    """Return the configurations of pink along a path, or None where it leaves the corridor or touches."""
    if find_spec("pink") is None:
        return None
    import pink
    from pink.tasks import FrameTask

    robot, checker = prover.checker.robot, prover.checker
    frames = path.at(np.linspace(0.0, path.length, _STEPS))
    first = pin.SE3(frames.rotations[0], frames.positions[0])
    q = inverse_kinematics(robot, first, valid=lambda q: not checker.in_collision(q), seeds=50)
    if q is None:
        return None
    model = robot.model
    own = pink.Configuration(model, model.createData(), robot.pinocchio_configuration(q))
    axes = [0.0 if axis == corridor.free_axis else 1.0 for axis in "xyz"]
    task = FrameTask(robot.tip, position_cost=1.0, orientation_cost=axes)
    found, dt = [], 0.01
    for place, turn in zip(frames.positions, frames.rotations, strict=True):
        target = pin.SE3(turn, place)
        task.set_target(target)
        for _ in range(3):
            try:
                velocity = pink.solve_ik(own, [task], dt, solver="daqp", safety_break=False)
            except Exception:  # no solution of the QP
                return None
            own.integrate_inplace(velocity, dt)
        tip = own.get_transform_frame_to_world(robot.tip)
        if np.linalg.norm(tip.translation - place) > corridor.position:
            return None
        if _turned(turn, tip.rotation, corridor) > corridor.angle:
            return None
        q = _planned(robot, own.q)
        if checker.in_collision(q) or not robot.within_limits(q, 1e-6).all():
            return None
        found.append(q)
    return np.array(found)


def _planned(robot: Robot, full: FloatArray) -> FloatArray:
    """Return the configuration (n,) of Pinocchio's, with angles for cosines and sines."""
    if len(full) == robot.n:
        return full
    values = []
    for joint in list(robot.model.joints)[1:]:
        own = full[joint.idx_q : joint.idx_q + joint.nq]
        values.append(np.arctan2(own[1], own[0]) if joint.nq == 2 else own[0])
    return np.array(values)
