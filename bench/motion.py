"""Certified motions against sampled ones: time of a free edge, alone and with others.

Free edges of 1 rad, each checked by `MotionProver` and by samples at most 0.01 rad apart (both with the same
boolean collision query, in turn, in one process). The target is a ratio of 0.06 on a UR5 with 6 obstacles
and on a Panda at a bookshelf. Clearance decides: in the first scene of the UR5 one obstacle stands beside the shoulder.

Many free edges are proven one by one, together in one loop, and by two threads that share it. Rates are of the wall
clock, which other work on the machine lowers; CPU times are of all threads.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from math import ceil
from time import perf_counter, process_time

import numpy as np

from bench._harness import Report, in_turn
from bench._scenes import bookshelf, scattered
from safe_ompl import CollisionChecker, MotionProver, Robot, Scene
from safe_ompl.common import FloatArray

CLAIM = "the proof of an edge costs a fraction of sampling it"
COARSE = 0.01  # [rad]
LENGTHS, TURNS = (0.2, 0.5, 1.0), 7


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


def together(name: str, scene_name: str, scene: Scene, length: float, number: int) -> tuple[object, ...]:
    """Return a row of the table of many free edges: of some turns of each way to ask, the shortest times."""
    robot = Robot.from_example(name)
    motion = MotionProver(CollisionChecker(robot, scene))
    candidates, edges = random_edges(robot, np.random.default_rng(2), length, length), list[FloatArray]()
    while len(edges) < number:
        some = np.array([next(candidates) for _ in range(number)])
        edges += list(some[motion.are_free(some[:, 0], some[:, 1])])
    starts, ends = np.array(edges[:number]).transpose(1, 0, 2)
    ways: dict[str, Callable[[], object]] = {
        "loop": lambda: [motion.is_free(*edge) for edge in edges[:number]],
        "1": lambda: motion.are_free(starts, ends),
        "2": lambda: motion.are_free(starts, ends, workers=2),
    }
    wall: dict[str, list[float]] = {way: [] for way in ways}
    cpu: dict[str, list[float]] = {way: [] for way in ways}
    for _ in range(TURNS):
        for way, ask in ways.items():
            begin, worked = perf_counter(), process_time()
            ask()
            wall[way].append(perf_counter() - begin)
            cpu[way].append(process_time() - worked)
    rates = [number / min(times) for times in wall.values()]
    return name, scene_name, length, *rates, rates[2] / rates[1], *(1e6 * min(times) / number for times in cpu.values())


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--edges", type=int, default=300, help="free edges that are timed; of many at once 20 times")
    parser.add_argument("--rounds", type=int, default=9, help="how often each is timed")


SHELF = ("panda", "bookshelf", bookshelf())
CLUTTER = [("ur5", f"6 obstacles, no. {seed}", scattered(6, seed)) for seed in range(5)]


def edges(options: argparse.Namespace, report: Report) -> None:
    """Report times of edges, by proof and by samples."""
    rows = [time_free_edges(*problem, options.edges, options.rounds) for problem in (*CLUTTER, SHELF)]
    queries = ("bound queries", "margin queries", "plain queries")
    report.table(("robot", "scene", *queries, "certified [µs]", "sampled [µs]", "ratio"), rows)


def many(options: argparse.Namespace, report: Report) -> None:
    """Report how many free edges a second are proven one by one, together, and by two workers."""
    lengths = ((problem, length) for problem in (CLUTTER[0], SHELF) for length in LENGTHS)
    rows = [together(*problem, length, 20 * options.edges) for problem, length in lengths]
    rates = ("one by one [1/s]", "together [1/s]", "2 workers [1/s]", "2 workers/1")
    times = ("one by one [CPU µs]", "together [CPU µs]", "2 workers [CPU µs]")
    report.table(("robot", "scene", "length [rad]", *rates, *times), rows)


PARTS = {"edges": edges, "many": many}
