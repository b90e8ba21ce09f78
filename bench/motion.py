"""Certified motions against sampled ones: time of a free edge, and of a query with margins.

Free edges of 1 rad, each checked by `MotionProver` and by samples at most 0.01 rad apart (both with the same
boolean collision query, in turn, in one process). The target is a ratio of 0.06 on a UR5 with 6 obstacles
and on a Panda at a bookshelf. Clearance decides: in the first scene of the UR5 one obstacle stands beside the shoulder.

Margins are an argument of every query: what a query costs with the same read-only array as before, with an array of
the same content, and with other margins each time.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from math import ceil

import numpy as np

from bench._harness import Report, in_turn
from bench._scenes import bookshelf, scattered
from safe_ompl import CollisionChecker, MotionProver, Robot, Scene
from safe_ompl.common import FloatArray

CLAIM = "the proof of an edge costs a fraction of sampling it"
COARSE = 0.01  # [rad]


def random_edges(
    robot: Robot, rng: np.random.Generator, shortest: float, longest: float
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield straight motions within the limits, of random direction and length."""
    while True:
        start, direction = rng.uniform(robot.lower, robot.upper), rng.normal(size=robot.n)
        end = start + rng.uniform(shortest, longest) * direction / np.linalg.norm(direction)
        if robot.within_limits(end).all():
            yield start, end


def sampled_is_free(checker: CollisionChecker, start: FloatArray, end: FloatArray, step: float) -> bool:
    """Check an edge as is usual: at samples at most `step` apart."""
    delta = checker.robot.difference(start, end)
    count = ceil(float(np.linalg.norm(delta)) / step)
    return not any(checker.in_collision(start + k / count * delta) for k in range(count + 1))


def time_free_edges(name: str, scene_name: str, scene: Scene, number: int, rounds: int) -> tuple[object, ...]:
    """Return a row of the table of times."""
    robot = Robot.from_example(name)
    checker = CollisionChecker(robot, scene)
    motion = MotionProver(checker)
    candidates = random_edges(robot, np.random.default_rng(1), 1.0, 1.0)
    edges = []
    while len(edges) < number:
        edge = next(candidates)
        if motion.is_free(*edge):
            edges.append(edge)

    checker.counts.reset()
    assert all(motion.is_free(*edge) for edge in edges)
    counts = replace(checker.counts)
    queries = (counts.bound_queries, counts.margin_queries, counts.collision_queries)
    times = in_turn(
        {
            "certified": lambda: [motion.is_free(*edge) for edge in edges],
            "sampled": lambda: [sampled_is_free(checker, *edge, COARSE) for edge in edges],
        },
        number,
        rounds,
    )
    certified, sampled = times.microseconds("certified"), times.microseconds("sampled")
    each = (query / number for query in queries)
    return name, scene_name, *each, certified, sampled, times.ratio("certified", "sampled")


def time_margins(name: str, scene_name: str, scene: Scene, number: int, rounds: int) -> tuple[object, ...]:
    """Return a row of the table of what margins cost as an argument of every query."""
    robot = Robot.from_example(name)
    pairs = CollisionChecker(robot, scene).pairs
    configurations = list(np.random.default_rng(3).uniform(robot.lower, robot.upper, (number, robot.n)))
    frozen, changing, others = pairs.margins(0.01), pairs.margins(0.01).copy(), pairs.margins(0.01 + 1e-9)
    times = in_turn(
        {
            "same": lambda: [pairs.within_margins(q, frozen) for q in configurations],
            "equal": lambda: [pairs.within_margins(q, changing) for q in configurations],
            "other": lambda: [
                pairs.within_margins(q, others if k % 2 else frozen) for k, q in enumerate(configurations)
            ],
        },
        number,
        rounds,
    )
    return name, scene_name, len(pairs.names), *map(times.microseconds, ("same", "equal", "other"))


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--edges", type=int, default=300, help="free edges that are timed")
    parser.add_argument("--rounds", type=int, default=9, help="how often each is timed")


def main(options: argparse.Namespace, report: Report) -> None:
    """Report both tables."""
    shelf = ("panda", "bookshelf", bookshelf())
    clutter = [("ur5", f"6 obstacles, no. {seed}", scattered(6, seed)) for seed in range(5)]
    rows = [time_free_edges(*problem, options.edges, options.rounds) for problem in (*clutter, shelf)]
    queries = ("bound queries", "margin queries", "plain queries")
    report.table(("robot", "scene", *queries, "certified [µs]", "sampled [µs]", "ratio"), rows)
    rows = [time_margins(*problem, options.edges, options.rounds) for problem in (clutter[0], shelf)]
    kinds = ("same array [µs]", "equal margins [µs]", "others each time [µs]")
    report.table(("robot", "scene", "pairs", *kinds), rows)
