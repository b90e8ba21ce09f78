"""Time of the danger field on a skeleton of 7 links: python bench/field.py [--rounds N].

Rows are sizes (configurations × points). `naive` is the textbook formula, a logarithm of sums broadcast
over (…, M, 3) arrays; `field` is the package's; `lengths known` the same for a robot without prismatic
joints, as `DangerField` calls it, and `ratio` its time over that of `naive`. All run in turn in the
same process; figures are the best of all rounds in µs of CPU time. Kinematics are not included, but in the last
lines: danger and exact C-space gradient of a UR5 at the samples of a path, as a descent asks for them; and the
kinetostatic danger of 200 configurations of two scenarios in motion, over the static one.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping

import numpy as np

from safe_ompl import DangerField, Robot
from safe_ompl.common import FloatArray
from safe_ompl.danger.kinetostatic import KinetostaticField
from safe_ompl.danger.link_field import Segments, field
from safe_ompl.scene.scenario import Scenario, find_scenario

PATH = (60, 16)
MOVING = 200  # configurations
SIZES = ((1, 10), (1, 100), (1, 500), (50, 10), (50, 100), (60, 500))
LENGTHS = np.array([0.32, 0.08, 0.39, 0.09, 0.21, 0.15, 0.1])  # [m]


def naive(keypoints: FloatArray, pairs: FloatArray, points: FloatArray) -> FloatArray:
    """Return the field (B, M) by the textbook formula."""
    a, b = keypoints[:, pairs[:, 0], None], keypoints[:, pairs[:, 1], None]
    total = np.linalg.norm(points - a, axis=-1) + np.linalg.norm(points - b, axis=-1)
    length = np.linalg.norm(b - a, axis=-1)
    result: FloatArray = (np.log((total + length) / (total - length)) / length).sum(axis=1)
    return result


def skeletons(rng: np.random.Generator, configurations: int) -> FloatArray:
    """Return the key points (B, 8, 3) of random chains of 7 links."""
    links = rng.normal(size=(configurations, len(LENGTHS), 3))
    links *= (LENGTHS / np.linalg.norm(links, axis=-1))[..., None]
    return np.concatenate([np.zeros((configurations, 1, 3)), np.cumsum(links, axis=1)], axis=1)


def best_times(calls: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Return the best time of each call in µs, the calls taking turns."""
    best = dict.fromkeys(calls, np.inf)
    for _ in range(rounds):
        for name, call in calls.items():
            start = time.process_time()
            call()
            best[name] = min(best[name], 1e6 * (time.process_time() - start))
    return best


def measure(configurations: int, number: int, rounds: int) -> dict[str, float]:
    """Return the best times in µs for one size, after a check that the results agree."""
    rng = np.random.default_rng(0)
    keypoints = skeletons(rng, configurations)
    points = np.asfortranarray(rng.normal(size=(number, 3)) * 0.3 + [0.5, 0.5, 0.5])
    pairs = np.array([[k, k + 1] for k in range(len(LENGTHS))])
    segments, rigid = Segments(pairs), Segments(pairs, LENGTHS)
    np.testing.assert_allclose(field(keypoints, rigid, points), naive(keypoints, pairs, points), rtol=1e-9)
    calls = {
        "naive": lambda: naive(keypoints, pairs, points),
        "field": lambda: field(keypoints, segments, points),
        "lengths known": lambda: field(keypoints, rigid, points),
    }
    return best_times(calls, rounds)


def path_gradient(rounds: int) -> float:
    """Return the best time [µs] of danger and C-space gradients at `PATH` configurations × points of a UR5."""
    robot, rng = Robot.from_example("ur5"), np.random.default_rng(0)
    danger = DangerField(robot, rng.normal(size=(PATH[1], 3)) * 0.3 + [0.5, 0.0, 0.5])
    batches = iter(rng.uniform(robot.lower, robot.upper, (rounds, PATH[0], robot.n)))  # never the same twice
    return best_times({"": lambda: danger.values_and_gradients(next(batches))}, rounds)[""]


def in_motion(scenario: str, rounds: int) -> dict[str, float]:
    """Return the best times of the kinetostatic danger over those of the static one, values and with gradients."""
    problem = Scenario.load(find_scenario(scenario))
    robot, rng = problem.build_robot(), np.random.default_rng(0)
    danger = DangerField.of_scene(robot, problem.scene)
    Q = rng.uniform(np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5), (MOVING, robot.n))
    Qd = rng.normal(size=Q.shape)
    towards, every = KinetostaticField(danger, gamma=0.0), KinetostaticField(danger, gamma=1.0)
    calls = {
        "static": lambda: danger.values(Q),
        "γ = 0": lambda: towards.values(Q, Qd),
        "γ = 1": lambda: every.values(Q, Qd),
        "static with gradients": lambda: danger.values_and_gradients(Q),
        "γ = 0 with gradients": lambda: towards.values_and_gradients(Q, Qd),
        "γ = 1 with gradients": lambda: every.values_and_gradients(Q, Qd),
    }
    for call in calls.values():
        call()  # compiles
    best = best_times(calls, rounds)
    bases = {True: best.pop("static with gradients"), False: best.pop("static")}
    return {name: elapsed / bases[name.endswith("gradients")] for name, elapsed in best.items()}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=300)
    rounds = parser.parse_args().rounds
    print(f"{'size':>9} {'naive':>9} {'field':>9} {'lengths known':>14} {'ratio':>7}")
    for size in SIZES:
        best = measure(*size, rounds)
        ratio = best["lengths known"] / best["naive"]
        print(
            f"{size[0]:>4}×{size[1]:<4} {best['naive']:>9.1f} {best['field']:>9.1f} "
            f"{best['lengths known']:>14.1f} {ratio:>7.2f}"
        )
    print(f"{PATH[0]:>4}×{PATH[1]:<4} danger and C-space gradient, UR5: {path_gradient(rounds):.0f} µs")
    for scenario in ("panda_shelf", "ur5_handover"):
        ratios = ", ".join(f"{name} {ratio:.2f}" for name, ratio in in_motion(scenario, rounds // 5).items())
        print(f"kinetostatic over static, {scenario}: {ratios}")


if __name__ == "__main__":
    main()
