"""Trajectories against toppra's and Ruckig's: limits between the samples, durations, time to compute.

toppra and Ruckig need not be there. Limits are sampled every 0.1 ms and on both sides of every cell's edge. toppra is
given the same blended curve. With limited jerk,
a Panda with the limits that Franka publishes for it, the anchor is our own law without that limit, and Ruckig from rest
to rest along every edge on its own, straight ("phase" synchronisation): what it does with way points is not in its
package.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from time import process_time
from typing import Any
from unittest.mock import patch

import numpy as np

from bench._harness import Report
from bench._scenes import ACCELERATIONS
from safe_ompl import CollisionChecker, MotionProver, RateLimits, Robot, Scene, Trajectory, time_path
from safe_ompl.common import FloatArray

CLAIM = "trajectories keep their limits between all samples, and are as fast as toppra's"
ROBOTS = ("panda", "ur5", "xarm7", "kinova")
GRID = 1000


def random_paths(robot: Robot, number: int, seed: int) -> list[FloatArray]:
    """Return random paths of three to seven way points."""
    rng = np.random.default_rng(seed)
    low, high = np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5)
    # Way points of a continuous joint are less than half a turn apart.
    low, high = (np.where(robot.continuous, np.clip(ends, -1.5, 1.5), ends) for ends in (low, high))
    return [rng.uniform(low, high, (rng.integers(3, 8), robot.n)) for _ in range(number)]


def excess(trajectory: Trajectory, step: float = 1e-4) -> tuple[float, float]:
    """Return the largest velocity and acceleration over their limits."""
    edges = trajectory.law.times
    state = trajectory.at(
        np.concatenate([np.arange(0, trajectory.duration, step), edges * (1 - 1e-13), edges * (1 + 1e-13)])
    )
    limits = trajectory.limits
    return (float((np.abs(state.qd) / limits.velocity).max()), float((np.abs(state.qdd) / limits.acceleration).max()))


def toppra_duration(trajectory: Trajectory) -> tuple[float, float, float] | None:
    """Return duration, time to compute and excess of toppra's trajectory on the same curve; None without it."""
    try:
        import toppra
        from toppra import algorithm, constraint
    except ImportError:
        return None
    toppra.setup_logging("ERROR")
    curve, limits = trajectory.curve, trajectory.limits

    class Path(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
        dof = len(limits.joint_names)
        path_interval = np.array([0.0, curve.length])
        waypoints = None

        def __call__(self, s: Any, order: int = 0) -> Any:
            found = curve.places(np.atleast_1d(np.asarray(s, dtype=float)))[order]
            return found if np.ndim(s) else found[0]

    both = (np.column_stack([-bound, bound]) for bound in (limits.velocity, limits.acceleration))
    speeds, pushes = both
    begin = process_time()
    solver = algorithm.TOPPRA(
        [
            constraint.JointVelocityConstraint(speeds),
            constraint.JointAccelerationConstraint(
                pushes, discretization_scheme=constraint.DiscretizationType.Interpolation
            ),
        ],
        Path(),
        gridpoints=np.linspace(0, curve.length, GRID + 1),
        parametrizer="ParametrizeConstAccel",
    )
    found = solver.compute_trajectory(0, 0)
    elapsed = process_time() - begin
    if found is None:
        return None
    t = np.arange(0, found.duration, 1e-4)
    return found.duration, elapsed, float((np.abs(found(t, 2)) / limits.acceleration).max())


FRANKA_VELOCITY = (2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61)
FRANKA_JERK = (7500, 3750, 5000, 6250, 7500, 10000, 10000)
CURVES = 48


def ruckig_duration(path: FloatArray, limits: RateLimits) -> float | None:
    """Return how long Ruckig takes from rest to rest along each edge in turn; None without it."""
    try:
        from ruckig import InputParameter, Ruckig, Synchronization, Trajectory as Motion
    except ImportError:
        return None
    assert limits.jerk is not None
    given, duration = InputParameter(path.shape[1]), 0.0
    given.max_velocity, given.max_acceleration = limits.velocity.tolist(), limits.acceleration.tolist()
    given.max_jerk, given.synchronization = limits.jerk.tolist(), Synchronization.Phase
    for start, end in pairwise(path):
        given.current_position, given.target_position = start.tolist(), end.tolist()
        motion = Motion(path.shape[1])
        Ruckig(path.shape[1]).calculate(given, motion)
        duration += motion.duration
    return duration


def jerk_excess(trajectory: Trajectory, step: float = 1e-4) -> float:
    """Return the largest jerk over its limit: by its formula, and by differences of accelerations."""
    t, jerk = np.arange(0, trajectory.duration, step), trajectory.limits.jerk
    differences = np.diff(trajectory.at(t).qdd, axis=0) / step
    return max(float((np.abs(found) / jerk).max()) for found in (trajectory.jerks_at(t), differences))


def timed(path: FloatArray, robot: Robot, limits: RateLimits, **options: float) -> tuple[Trajectory, float]:
    """Return a trajectory and the time [s] that it took."""
    prover = MotionProver(CollisionChecker(robot, Scene()))
    begin = process_time()
    made = time_path(path, robot, limits, motion=prover, **options)
    return made, process_time() - begin


def limited_jerk(seed: int, curves: int) -> list[tuple[object, ...]]:
    """Return rows of a table: durations with limited jerk against those without, and the worst excess."""
    robot, rows = Robot.from_example("panda"), []
    smooth = RateLimits.of(robot, FRANKA_VELOCITY, ACCELERATIONS["panda"], FRANKA_JERK)
    sharp = RateLimits.of(robot, FRANKA_VELOCITY, ACCELERATIONS["panda"])
    for path in random_paths(robot, curves, seed):
        made, elapsed = timed(path, robot, smooth)
        edges = ruckig_duration(path, smooth)
        ratio = np.nan if edges is None else made.duration / edges
        least = timed(path, robot, sharp)[0].duration
        rows.append((made.duration / least, ratio, *excess(made), jerk_excess(made), 1e3 * elapsed))
    names = ("duration with limited jerk / without", "duration / Ruckig's edge by edge", "velocity / limit")
    names += ("acceleration / limit", "jerk / limit", "time to compute [ms]")
    found = np.array(rows).T
    return [
        (name, *map(float, (column.min(), np.median(column), column.max())))
        for name, column in zip(names, found, strict=True)
    ]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--paths", type=int, default=50, help="paths for each robot")
    parser.add_argument("--curves", type=int, default=CURVES, help="paths with limited jerk")
    parser.add_argument("--seed", type=int, default=0)


@patch("safe_ompl.motions.blends.is_free", lambda *_: True)  # the curves are about time only
def main(options: argparse.Namespace, report: Report) -> None:
    """Report the worst excess, and the ratios of durations and of times to compute."""
    rows: list[tuple[object, ...]] = []
    for name in ROBOTS:
        robot, rng = Robot.from_example(name), np.random.default_rng(options.seed)
        own, theirs = [], []
        for path in random_paths(robot, options.paths, options.seed):
            limits = RateLimits.of(robot, rng.uniform(0.5, 3, robot.n), rng.uniform(2, 20, robot.n))
            trajectory, elapsed = timed(path, robot, limits, tolerance=0.1)
            own.append((*excess(trajectory), elapsed))
            anchor = toppra_duration(trajectory)
            if anchor is not None:
                theirs.append((trajectory.duration / anchor[0], elapsed / anchor[1], anchor[2]))
        velocity, acceleration, _ = np.max(own, axis=0)
        cells = (f"{velocity - 1:.1e}", f"{acceleration - 1:.1e}", 1e3 * float(np.median(own, axis=0)[2]))
        ratio, cost, over = np.array(theirs).T if theirs else np.full((3, 1), np.nan)
        against = map(float, (np.median(ratio), ratio.max(), np.median(cost), over.max()))
        rows.append((name, len(own), *cells, len(theirs), *against))
    header = ("robot", "trajectories", "velocity/limit − 1 ≤", "acceleration/limit − 1 ≤", "time [ms]")
    header += ("found by toppra", "duration ours/its", "largest", "time ours/its", "its acceleration/limit ≤")
    report.table(header, rows)
    title = f"panda, Franka's limits, {options.curves} curves with limited jerk"
    report.table(("", "least", "median", "largest"), limited_jerk(options.seed, options.curves), title)
