"""Tool motions: lines and seams among obstacles, against pink and roboplan, and proofs of corridors, against samples.

    python -m bench tools --lines 200 --seams 50 --longer

Problems are drawn from a seed on four arms: a line, or a seam of 5 to 20 way points, that begins where the tip of a
random free configuration is, such that poses at its beginning, middle and end have free configurations each; whether
any motion joins these nobody knows. Along every other one the tool may turn about its z axis. `least` is the mean of
the least danger of many free configurations at nine poses, joined or not: an estimate of what can be had.
Differential inverse kinematics is pink's (`pip install pin-pink daqp`); roboplan's planner (`pip install
roboplan-cartesian-planning`) keeps the whole orientation always and knows no obstacles. Both begin at the first free
configuration that is found. Their motions count if samples are free, within joint limits and in the corridor. Dangers
are means along the curve.

corridors: motions that wander about lines, arcs, corners and splines of the tool, from random configurations, upside
down or not, with turns of any angle and of half a turn on the way. Each is asked to stay in a corridor that is nearly
as wide as it wanders, so that about half of them leave it, and is looked at 5000 times by plain Pinocchio. `false` is a
proof of which a sample is outside, and an answer "outside" of a motion whose samples stay well within.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from time import process_time
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from bench._harness import Report
from safe_ompl import (
    Box,
    CollisionChecker,
    DangerField,
    Motion,
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
from safe_ompl.robot import EXAMPLES, Frames, Tip, robots_folder
from safe_ompl.tasks import Corridor, ToolMotion, ToolPath, ToolPlanner, prove_corridor

CLAIM = "the tool follows lines and seams within a proven corridor, in less danger than differential IK"
ROBOTS = ("panda", "ur5", "xarm7", "kinova")
SAMPLES = 10_000  # of a motion, by the judge
CORRIDOR = Corridor(0.001, 0.01)
_STEPS = 200  # poses along a path for the others


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--lines", type=int, default=200, metavar="N")
    parser.add_argument("--seams", type=int, default=50, metavar="N")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--longer", action="store_true", help="search ten times as long where nothing is found")
    parser.add_argument("--corridors", type=int, default=1000, metavar="N")


def curves(options: argparse.Namespace, report: Report) -> int:
    """Solve all problems, and judge the motions."""
    rows, broken = list[tuple[object, ...]](), 0
    for kind, number in (("line", options.lines), ("seam", options.seams)):
        results: dict[str, list[_Result]] = {"": [], "z": []}
        for problem in problems(kind, number, options.seed):
            found = _solved(problem, longer=options.longer)
            broken += found.broken
            results[problem.corridor.free_axis or ""].append(found)
        rows += [_row(f"{kind}, free {axis}" if axis else kind, each) for axis, each in results.items() if each]
    header = (
        "",
        "problems",
        "solved",
        "solvable",
        "pink",
        "roboplan",
        "[ms]",
        "90 % [ms]",
        "pink [ms]",
        "roboplan [ms]",
    )
    header += ("danger/pink", "least/pink", "danger/roboplan")
    report.table(header, rows)
    report.counted("tool motions, 10 000 samples each", options.lines + options.seams, broken)
    return int(broken > 0)


WANDER = -5.0, -1.5  # powers of ten of the noise of joints [rad]
TURNS = 0.0, 0.5, np.pi  # [rad] of the tool along a curve, beside angles drawn at random
LOOKS = 5000


def corridors(options: argparse.Namespace, report: Report) -> int:
    """Compare proofs that the tip keeps to a curve with dense samples."""
    found: dict[str, Counter[str]] = {}
    for k in range(options.corridors):
        rng, kind = np.random.default_rng([options.seed, k]), CURVES[k % len(CURVES)]
        robot = _robot(ROBOTS[k // len(CURVES) % len(ROBOTS)])
        axis = str(rng.choice(list("xyz"))) if k % 3 == 0 else None
        path, motion = _wandering(kind, robot, rng)
        far, turned = _deviations(motion, robot, path, Corridor(free_axis=axis))
        width, angle = (max(x, 1e-6) * rng.uniform(0.8, 1.4) for x in (far, turned))
        proof = prove_corridor(motion, robot, path, Corridor(width, min(angle, np.pi), axis))
        leaves = far > width or turned > angle
        counts = found.setdefault(kind, Counter())
        counts["curves"] += 1
        counts["proven"] += proof.proven
        counts["outside"] += proof.outside
        counts["undecided"] += not (proof.proven or proof.outside)
        counts["false"] += (proof.proven and leaves) or (proof.outside and max(far / width, turned / angle) < 0.999)
    kinds = ("curves", "false", "proven", "outside", "undecided")
    found["all"] = sum(found.values(), Counter())
    report.table(("curve", *kinds), [(name, *(counts[kind] for kind in kinds)) for name, counts in found.items()])
    total = found["all"]
    report.counted(f"corridors of the tool, {LOOKS} samples each", *(total[key] for key in (*kinds[:2], kinds[-1])))
    return int(total["false"] > 0)


CURVES = ("line", "arc", "corners", "spline")


def _wandering(kind: str, robot: Robot, rng: np.random.Generator) -> tuple[ToolPath, Motion]:
    """Return a curve of the tip from a random configuration, and a spline of the joints that wanders about it."""
    start = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi))
    pose = robot.tip_pose(start)
    turn = float(rng.choice([*TURNS, rng.uniform(0.0, np.pi)]))
    axis = rng.normal(size=3)
    axis *= turn / np.linalg.norm(axis)
    ways = np.cumsum(rng.normal(scale=0.1, size=(2, 3)), axis=0)
    middle, end = (
        pin.SE3(pose.rotation @ pin.exp3(share * axis), pose.translation + way)
        for share, way in zip((0.5, 1.0), ways, strict=True)
    )
    path = {
        "line": lambda: ToolPath.line(pose, end),
        "arc": lambda: ToolPath.arc(pose, middle.translation, end),
        "corners": lambda: ToolPath.polyline([pose, middle, end]),
        "spline": lambda: ToolPath.spline([pose, middle, end]),
    }[kind]()
    tip, at = Tip(robot, None), np.unique([*np.linspace(0.0, path.length, 25), *path.knots])
    at = at[np.diff(at, prepend=-np.inf) > 1e-6]  # knots that two computations round apart
    frames, Q = path.at(at), [start]
    for k in range(1, len(at)):
        # A pose that cannot be reached is left aside: the motion only has to be one, not a good one.
        solved, _ = tip.solved(Q[-1][None], Frames(*(part[k : k + 1] for part in frames)), 1e-9, 30)
        near = np.abs(robot.difference(Q[-1], solved[0])).max() < 1.0
        Q.append(solved[0] if near else Q[-1])
    noise = rng.normal(size=(len(at), robot.n)) * 10.0 ** rng.uniform(*WANDER)
    return path, Motion.of(CubicSpline(at, np.array(Q) + noise), names=robot.joint_names)


def _deviations(motion: Motion, robot: Robot, path: ToolPath, corridor: Corridor) -> tuple[float, float]:
    """Return the largest deviations of position [m] and angle [rad] at samples, by plain Pinocchio."""
    model, data, found = robot.model, robot.model.createData(), []
    s = np.linspace(0.0, path.length, LOOKS)
    frames = path.at(s)
    for q, place, turn in zip(motion.at(s), frames.positions, frames.rotations, strict=True):
        pin.framesForwardKinematics(model, data, robot.pinocchio_configuration(q))
        tip = data.oMf[robot.tip_frame]
        found.append((np.linalg.norm(tip.translation - place), _turned(turn, tip.rotation, corridor)))
    far, turned = np.max(found, axis=0)
    return float(far), float(turned)


@dataclass(frozen=True)
class Problem:
    """A curve, how near to it the tip must be, and what proves and weighs motions."""

    robot: str
    path: ToolPath
    corridor: Corridor
    prover: MotionProver
    field: DangerField


@dataclass(frozen=True)
class _Result:
    """What three planners found: times [s] and mean dangers of each, NaN where it found none."""

    solvable: bool
    broken: bool
    times: tuple[float, float, float]
    dangers: tuple[float, float, float]
    least: float


def _solved(problem: Problem, *, longer: bool) -> _Result:
    path, corridor, field, robot = problem.path, problem.corridor, problem.field, problem.prover.checker.robot
    begin = process_time()
    found = ToolPlanner(problem.prover, field).plan(path, corridor)
    times, dangers = [process_time() - begin], [found.danger_mean]
    solvable = bool(found)
    if not found and longer:
        solvable = bool(ToolPlanner(problem.prover, field, effort=10).plan(path, corridor))
    frames = path.at(np.linspace(0.0, path.length, _STEPS))
    start = _free_at(problem.prover.checker, pin.SE3(frames.rotations[0], frames.positions[0]))
    for rival in (differential, cartesian):
        begin, motion = process_time(), None
        if start is not None:
            motion = rival(problem, frames, start)
        times.append(process_time() - begin)
        dangers.append(float("nan") if motion is None else _danger(motion, robot, field))
    broken = bool(found) and not keeps(found, robot)
    least = _least(problem) if found and dangers[1] == dangers[1] else float("nan")
    return _Result(solvable, broken, (times[0], times[1], times[2]), (dangers[0], dangers[1], dangers[2]), least)


def _row(name: str, results: list[_Result]) -> tuple[object, ...]:
    times, dangers = (np.array([getattr(each, key) for each in results]) for key in ("times", "dangers"))
    there = np.isfinite(dangers)
    ratios = dangers[:, :1] / dangers[:, 1:]
    least = np.array([each.least for each in results]) / dangers[:, 1]
    solvable = sum(each.solvable for each in results)
    medians = [1e3 * float(np.median(times[there[:, k], k])) if there[:, k].any() else float("nan") for k in range(3)]
    slow = 1e3 * float(np.percentile(times[there[:, 0], 0], 90))
    means = [float(np.nanmean(each)) if np.isfinite(each).any() else float("nan") for each in (*ratios.T, least)]
    counts = (len(results), int(there[:, 0].sum()), solvable, int(there[:, 1].sum()), int(there[:, 2].sum()))
    return (name, *counts, medians[0], slow, *medians[1:], means[0], means[2], means[1])


def _danger(Q: FloatArray, robot: Robot, field: DangerField) -> float:
    """Return the mean danger along the tip's way."""
    places = np.array([robot.tip_pose(q).translation for q in Q])
    steps, dangers = np.linalg.norm(np.diff(places, axis=0), axis=1), field.values(Q)
    return float(steps @ (dangers[1:] + dangers[:-1]) / 2 / steps.sum())


def _least(problem: Problem, seeds: int = 200, descents: int = 15) -> float:
    """Return the mean over nine poses of the least danger of free configurations, after descents in the null space."""
    checker, tip = problem.prover.checker, Tip(problem.prover.checker.robot, problem.corridor.axis)
    rng, least = np.random.default_rng(0), []
    for s in np.linspace(0.0, problem.path.length, 9):
        frames = problem.path.at(np.repeat(s, seeds))
        Q = rng.uniform(tip.robot.lower, tip.robot.upper, (seeds, tip.robot.n))
        Q, arrived = tip.solved(Q, frames, 1e-6, 30)
        Q, frames = Q[arrived], Frames(*(part[: arrived.sum()] for part in frames))
        for _ in range(descents):
            dangers, gradients = problem.field.values_and_gradients(Q)
            _, jacobians = tip.task(tip.at(Q), frames)
            wanted = tip.null_motion(jacobians, -gradients)
            size = np.maximum(np.abs(wanted).max(axis=1, keepdims=True), 1e-3)
            moved, arrived = tip.solved(np.clip(Q + 0.1 * wanted / size, *tip.limits), frames, 1e-6, 4)
            better = arrived & (problem.field.values(moved) < dangers)
            better[better] = [not checker.in_collision(q) for q in moved[better]]
            Q = np.where(better[:, None], moved, Q)
        free = [not checker.in_collision(q) for q in Q]
        least.append(problem.field.values(Q[free]).min() if any(free) else np.nan)
    return float(np.nanmean(least))


def problems(kind: str, number: int, seed: int) -> Iterator[Problem]:
    """Yield curves from free configurations whose middles and ends can be reached, too."""
    for k in range(number):
        rng = np.random.default_rng([seed, k, kind == "seam"])
        name = ROBOTS[k % len(ROBOTS)]
        robot = _robot(name)
        corridor = replace(CORRIDOR, free_axis="z" if k // len(ROBOTS) % 2 else None)
        while True:
            scene = _scene(robot, rng)
            checker = CollisionChecker(robot, scene)
            q = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi))
            if checker.in_collision(q):
                continue
            path = _curve(kind, robot.tip_pose(q), rng)
            middle, end = (_pose(path, s) for s in (path.length / 2, path.length))
            if _free_at(checker, middle) is not None and _free_at(checker, end) is not None:
                break
        yield Problem(name, path, corridor, MotionProver(checker), DangerField.of_scene(robot, scene))


def _curve(kind: str, pose: pin.SE3, rng: np.random.Generator) -> ToolPath:
    way, length = rng.normal(size=3), rng.uniform(0.3, 0.6)
    way *= length / np.linalg.norm(way)
    if kind == "line":
        return ToolPath.line(pose, pin.SE3(pose.rotation, pose.translation + way))
    points = np.linspace(0.0, 1.0, int(rng.integers(5, 21)))
    side = np.cross(way, rng.normal(size=3))
    side *= rng.uniform(0.02, 0.06) / np.linalg.norm(side)
    wave = np.sin(2 * np.pi * points * rng.uniform(0.5, 1.5))
    places = pose.translation + points[:, None] * way + wave[:, None] * side
    return ToolPath.spline([pin.SE3(pose.rotation, place) for place in places])


def _pose(path: ToolPath, s: float) -> pin.SE3:
    frames = path.at(np.array([s]))
    return pin.SE3(frames.rotations[0], frames.positions[0])


def _free_at(checker: CollisionChecker, pose: pin.SE3) -> FloatArray | None:
    """Return a free configuration whose tip is at a pose, the first that is found."""
    return inverse_kinematics(checker.robot, pose, valid=lambda q: not checker.in_collision(q), seeds=50)


@cache
def _robot(name: str) -> Robot:
    return Robot.from_example(name)


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
    a, b = own @ corridor.axis, wanted @ corridor.axis
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _judged(Q: FloatArray, problem: Problem, frames: Frames) -> bool:
    """Return whether configurations (B, n) are free, within their limits, and in the corridor about frames (B,)."""
    checker, robot, corridor = problem.prover.checker, problem.prover.checker.robot, problem.corridor
    for q, place, turn in zip(Q, frames.positions, frames.rotations, strict=True):
        tip = robot.tip_pose(q)
        if np.linalg.norm(tip.translation - place) > corridor.position:
            return False
        if _turned(turn, tip.rotation, corridor) > corridor.angle:
            return False
        if checker.in_collision(q) or not robot.within_limits(q, 1e-6).all():
            return False
    return True


def differential(problem: Problem, frames: Frames, start: FloatArray) -> FloatArray | None:
    """Return the configurations of pink at frames, or None where they do not count."""
    if find_spec("pink") is None:
        return None
    import pink
    from pink.tasks import FrameTask

    robot = problem.prover.checker.robot
    own = pink.Configuration(robot.model, robot.model.createData(), robot.pinocchio_configuration(start))
    axes = [0.0 if axis == problem.corridor.free_axis else 1.0 for axis in "xyz"]
    task = FrameTask(robot.tip, position_cost=1.0, orientation_cost=axes)
    found, dt = [], 0.01
    for place, turn in zip(frames.positions, frames.rotations, strict=True):
        task.set_target(pin.SE3(turn, place))
        for _ in range(3):
            try:
                velocity = pink.solve_ik(own, [task], dt, solver="daqp", safety_break=False)
            except Exception:  # no solution of the QP
                return None
            own.integrate_inplace(velocity, dt)
        found.append(_planned(robot, own.q))
        if not _judged(found[-1][None], problem, Frames(*(part[len(found) - 1 : len(found)] for part in frames))):
            return None
    return np.array(found)


def cartesian(problem: Problem, frames: Frames, start: FloatArray) -> FloatArray | None:
    """Return the configurations of roboplan's Cartesian planner, or None where they do not count."""
    if find_spec("roboplan") is None or find_spec("roboplan.cartesian_planning") is None:
        return None
    from roboplan.cartesian_planning import CartesianPathPlanner, CartesianPlannerOptions, CartesianSpeedMode
    from roboplan.core import CartesianPath, JointConfiguration

    robot, corridor, scene = problem.prover.checker.robot, problem.corridor, _roboplan_scene(problem.robot)
    options = CartesianPlannerOptions(
        group_name="arm",
        max_position_error=corridor.position,
        max_orientation_error=corridor.angle,
        speed_mode=CartesianSpeedMode.TimeOptimal,
        lm_damping=1e-4,  # of those tried these solve most
        config_task_weight=1e-3,
    )
    poses = [np.eye(4, order="F") for _ in frames.positions]
    for pose, place, turn in zip(poses, frames.positions, frames.rotations, strict=True):
        pose[:3, :3], pose[:3, 3] = turn, place
    fingers = list(EXAMPLES[problem.robot].locked.values())[:1]  # the other one follows
    full = np.append(robot.pinocchio_configuration(start), fingers)
    try:
        found = CartesianPathPlanner(scene, options).plan(
            CartesianPath(["universe"], [robot.tip], [poses]), JointConfiguration(scene.getJointNames(), full)
        )
    except RuntimeError:
        return None
    Q = np.array([_planned(robot, np.asarray(q)) for q in found.positions])
    fine = problem.path.at(np.linspace(0.0, problem.path.length, 5001))
    places = np.array([robot.tip_pose(q).translation for q in Q])
    at = [int(np.linalg.norm(fine.positions - place, axis=1).argmin()) for place in places]
    return Q if _judged(Q, problem, Frames(*(part[at] for part in fine))) else None


@cache
def _roboplan_scene(name: str) -> Any:
    from roboplan.core import Scene, loadUrdfSceneDescription

    folder = robots_folder()
    scene = Scene(name, loadUrdfSceneDescription(str(folder / EXAMPLES[name].urdf), [str(folder.parent.parent)]))
    joints = "".join(f'<joint name="{joint}"/>' for joint in _robot(name).joint_names)
    scene.importSrdf(f'<robot name="{name}"><group name="arm">{joints}</group></robot>')
    return scene


def _planned(robot: Robot, full: FloatArray) -> FloatArray:
    """Return the configuration (n,) of Pinocchio's, with angles for cosines and sines."""
    if len(full) == robot.n:
        return full
    values = []
    for joint in list(robot.model.joints)[1:]:
        own = full[joint.idx_q : joint.idx_q + joint.nq]
        values.append(np.arctan2(own[1], own[0]) if joint.nq == 2 else own[0])
    return np.array(values)


PARTS = {"curves": curves, "corridors": corridors}
