"""Time of the danger field on a skeleton of 7 links, against the textbook formula, and in motion against at rest.

Rows are sizes (configurations × points). `naive` is a logarithm of sums broadcast over (…, M, 3) arrays; `field` is the
package's. Kinematics are not included, but in the last rows: danger and exact C-space gradient of a UR5 at the samples
of a path, as a descent asks for them; and the kinetostatic danger of 200 configurations of two scenarios in motion,
over the static one.
"""

from __future__ import annotations

import argparse

import numpy as np

from bench._harness import Report, in_turn
from safe_ompl import DangerField, KinetostaticField, Robot, Scenario
from safe_ompl.common import FloatArray
from safe_ompl.danger.link_field import field

CLAIM = "what danger costs: in batches, with gradients, and in motion against at rest"

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


def size_row(configurations: int, number: int, rounds: int) -> tuple[object, ...]:
    """Return the row of a size, after a check that the results agree."""
    rng = np.random.default_rng(0)
    keypoints = skeletons(rng, configurations)
    points = np.asfortranarray(rng.normal(size=(number, 3)) * 0.3 + [0.5, 0.5, 0.5])
    pairs = np.array([[k, k + 1] for k in range(len(LENGTHS))])
    np.testing.assert_allclose(field(keypoints, pairs, points), naive(keypoints, pairs, points), rtol=1e-9)
    calls = {"naive": lambda: naive(keypoints, pairs, points), "field": lambda: field(keypoints, pairs, points)}
    times = in_turn(calls, 1, rounds)
    size = f"{configurations} × {number}"
    return size, *map(times.microseconds, calls), times.ratio("field", "naive")


def path_gradient(rounds: int) -> float:
    """Return the time [µs] of danger and C-space gradients at `PATH` configurations × points of a UR5."""
    robot, rng = Robot.from_example("ur5"), np.random.default_rng(0)
    danger = DangerField(robot, rng.normal(size=(PATH[1], 3)) * 0.3 + [0.5, 0.0, 0.5])
    batches = iter(rng.uniform(robot.lower, robot.upper, (rounds + 1, PATH[0], robot.n)))  # no two alike
    return in_turn({"": lambda: danger.values_and_gradients(next(batches))}, 1, rounds).microseconds("")


def in_motion(scenario: str, rounds: int) -> tuple[object, ...]:
    """Return the times of the kinetostatic danger over those of the static one, values and with gradients."""
    problem = Scenario.load(scenario)
    robot, rng = problem.build_robot(), np.random.default_rng(0)
    danger = DangerField.of_scene(robot, problem.scene)
    Q = rng.uniform(np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5), (MOVING, robot.n))
    Qd = rng.normal(size=Q.shape)
    fields = (DangerField.of_scene(robot, problem.scene, gamma=gamma) for gamma in (0.0, 1.0))
    moving = [KinetostaticField(field) for field in fields]
    values = in_turn(
        {"rest": lambda: danger.values(Q)}
        | {str(k): lambda one=one: one.values(Q, Qd) for k, one in enumerate(moving)},
        MOVING,
        rounds,
    )
    gradients = in_turn(
        {"rest": lambda: danger.values_and_gradients(Q)}
        | {str(k): lambda one=one: one.values_and_gradients(Q, Qd) for k, one in enumerate(moving)},
        MOVING,
        rounds,
    )
    return scenario, *(times.ratio(k, "rest") for times in (values, gradients) for k in ("0", "1"))


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--rounds", type=int, default=300)


def main(options: argparse.Namespace, report: Report) -> None:
    """Report the tables."""
    rows = [size_row(*size, options.rounds) for size in SIZES]
    report.table(("size", "naive [µs]", "field", "ratio"), rows)
    report.figure(f"{PATH[0]} × {PATH[1]}: danger and C-space gradient, UR5 [µs]", path_gradient(options.rounds))
    rows = [in_motion(scenario, max(1, options.rounds // 5)) for scenario in ("panda_shelf", "ur5_handover")]
    header = ("kinetostatic over static", "γ = 0", "γ = 1", "γ = 0 with gradients", "γ = 1 with gradients")
    report.table(header, rows)
