"""Trajectories against toppra's and Ruckig's: limits between the samples, durations, time to compute.

Run it from the root of the repository with `python -m bench.timing`; toppra and Ruckig need not be there. Limits are
sampled every 0.1 ms and on both sides of every cell's edge. toppra is given the same blended curve. With limited jerk,
a Panda with the limits that Franka publishes for it, the anchor is our own law without that limit, and Ruckig from rest
to rest along every edge on its own, straight ("phase" synchronisation): what it does with way points is not in its
package.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from time import perf_counter
from typing import Any

import numpy as np

from safe_ompl import RateLimits, Robot, Trajectory, time_path
from safe_ompl.trajectories import curve

ROBOTS = ("panda", "ur5", "xarm7", "kinova")
GRID = 1000


def random_paths(robot: Robot, number: int, seed: int) -> list[np.ndarray]:
    """Return random paths of three to seven way points."""
    rng = np.random.default_rng(seed)
    low, high = np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5)
    return [rng.uniform(low, high, (rng.integers(3, 8), robot.n)) for _ in range(number)]


def excess(trajectory: Trajectory, step: float = 1e-4) -> tuple[float, float]:
    """Return the largest velocity and acceleration over their limits."""
    edges = trajectory.law.times
    state = trajectory.at(
        np.concatenate([np.arange(0, trajectory.duration, step), edges * (1 - 1e-13), edges * (1 + 1e-13)])
    )
    limits = trajectory.limits
    return (
        float((np.abs(state.qd) / limits.velocity).max()),
        float((np.abs(state.qdd) / limits.acceleration).max()),
    )


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
            found = curve.at(np.atleast_1d(np.asarray(s, dtype=float)))[order]
            return found if np.ndim(s) else found[0]

    both = (np.column_stack([-bound, bound]) for bound in (limits.velocity, limits.acceleration))
    speeds, pushes = both
    begin = perf_counter()
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
    elapsed = perf_counter() - begin
    if found is None:
        return None
    t = np.arange(0, found.duration, 1e-4)
    return found.duration, elapsed, float((np.abs(found(t, 2)) / limits.acceleration).max())


FRANKA_VELOCITY = (2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61)
FRANKA_ACCELERATION = (15, 7.5, 10, 12.5, 15, 20, 20)
FRANKA_JERK = (7500, 3750, 5000, 6250, 7500, 10000, 10000)
CURVES = 48


def ruckig_duration(path: np.ndarray, limits: RateLimits) -> float | None:
    """Return how long Ruckig takes from rest to rest along each edge in turn; None without it."""
    try:
        from ruckig import InputParameter, Ruckig, Synchronization
        from ruckig import Trajectory as Motion
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


def limited_jerk(seed: int) -> None:
    """Print durations with limited jerk against those without, and the worst excess."""
    robot, rows = Robot.from_example("panda"), []
    for path in random_paths(robot, CURVES, seed):
        smooth = RateLimits.of(robot, FRANKA_VELOCITY, FRANKA_ACCELERATION, FRANKA_JERK)
        sharp = RateLimits.of(robot, FRANKA_VELOCITY, FRANKA_ACCELERATION)
        begin = perf_counter()
        made = time_path(path, robot, smooth, motion=object())  # type: ignore[arg-type]
        elapsed = perf_counter() - begin
        least = time_path(path, robot, sharp, motion=object()).duration  # type: ignore[arg-type]
        edges = ruckig_duration(path, smooth)
        ratio = np.nan if edges is None else made.duration / edges
        rows.append((made.duration / least, ratio, *excess(made), jerk_excess(made), elapsed))
    ratio, edges, velocity, acceleration, jerk, elapsed = np.array(rows).T
    print(
        f"panda, Franka's limits, {CURVES} curves: duration with limited jerk / without median {np.median(ratio):.4f}, "
        f"largest {ratio.max():.4f}; velocity/limit ≤ {velocity.max():.6f}, acceleration/limit ≤ "
        f"{acceleration.max():.6f}, jerk/limit ≤ {jerk.max():.6f}, {1e3 * np.median(elapsed):.1f} ms each"
    )
    if np.isfinite(edges).all():
        print(
            f"  Ruckig edge by edge: duration ours/its median {np.median(edges):.4f}, "
            f"{edges.min():.4f} to {edges.max():.4f}"
        )


def main() -> None:
    """Print the worst excess, and the ratios of durations and of times to compute."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--paths", type=int, default=50, help="paths for each robot")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    curve.Piece.is_free = lambda *_: True  # type: ignore[method-assign]  # the curves are about time only
    for name in ROBOTS:
        robot = Robot.from_example(name)
        rng = np.random.default_rng(options.seed)
        rows, theirs = [], []
        for path in random_paths(robot, options.paths, options.seed):
            limits = RateLimits.of(robot, rng.uniform(0.5, 3, robot.n), rng.uniform(2, 20, robot.n))
            begin = perf_counter()
            trajectory = time_path(path, robot, limits, motion=object(), tolerance=0.1)  # type: ignore[arg-type]
            elapsed = perf_counter() - begin
            rows.append((*excess(trajectory), elapsed))
            anchor = toppra_duration(trajectory)
            if anchor is not None:
                theirs.append((trajectory.duration / anchor[0], elapsed / anchor[1], anchor[2]))
        velocity, acceleration, _ = np.max(rows, axis=0)
        print(
            f"{name}: {len(rows)} trajectories, velocity/limit − 1 ≤ {velocity - 1:.1e}, acceleration/limit − 1 ≤ "
            f"{acceleration - 1:.1e}, {1e3 * np.median([row[2] for row in rows]):.1f} ms each"
        )
        if theirs:
            ratio, cost, over = np.array(theirs).T
            print(
                f"  toppra, {GRID} points, {len(theirs)} found: duration ours/theirs median {np.median(ratio):.4f}, "
                f"largest {ratio.max():.4f}; time to compute ours/theirs {np.median(cost):.3f}; its acceleration/limit "
                f"up to {over.max():.4f}"
            )
    limited_jerk(options.seed)


if __name__ == "__main__":
    main()
