"""Certified motions against sampled ones: python bench/motion.py [--edges N] [--verify N] [--rounds N].

Time: free edges of 1 rad, each checked by `MotionProver` and by samples at most 0.01 rad apart (both with the same
boolean collision query, in turn, in one process). The target is a ratio of 0.06 on a UR5 with 6 obstacles
and on a Panda at a bookshelf. Clearance decides: in the first scene of the UR5 one obstacle stands beside the shoulder.

Margins are an argument of every query: what a query costs with the same read-only array as before, with an array of
the same content, and with other margins each time.

Truth: random edges of up to 1.5 rad, free and blocked. An edge that is called free is looked at every 0.001 rad;
one that is called blocked must be in collision where it says. `contradicted` must be 0; `undecided` are the edges that
pass nearer to something than the floor.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from math import ceil

import numpy as np
from _scenes import bookshelf, scattered
from _timing import in_turn, print_table

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.motion import MotionProver, Verdict
from safe_ompl.common import Counts, FloatArray
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene

COARSE, FINE = 0.01, 0.001  # [rad]


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
    counts = checker.counts.copy()
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


def verify_edges(name: str, scene_name: str, scene: Scene, number: int) -> tuple[object, ...]:
    """Return a row of the table of verdicts."""
    robot = Robot.from_example(name)
    checker = CollisionChecker(robot, scene)
    motion = MotionProver(checker)
    candidates = random_edges(robot, np.random.default_rng(2), 0.1, 1.5)
    found: Counter[Verdict] = Counter()
    contradicted, work = 0, Counts()
    for _ in range(number):
        start, end = next(candidates)
        before = checker.counts.copy()
        verdict = motion.check(start, end)
        for kind, value in (checker.counts - before).as_dict().items():
            setattr(work, kind, getattr(work, kind) + value)
        found[verdict.verdict] += 1
        if verdict.verdict is Verdict.FREE:
            contradicted += not sampled_is_free(checker, start, end, FINE)
        elif verdict.verdict is Verdict.BLOCKED and verdict.at is not None:
            contradicted += not checker.in_collision(start + verdict.at * robot.difference(start, end))
    shares = (
        f"{found[verdict] / number:.2%}" for verdict in (Verdict.FREE, Verdict.BLOCKED, Verdict.UNDECIDED)
    )
    each = (query / number for query in (work.bound_queries, work.margin_queries, work.collision_queries))
    return name, scene_name, number, contradicted, *shares, *each


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--edges", type=int, default=300, help="free edges that are timed")
    parser.add_argument(
        "--verify", type=int, default=10_000, help="random edges that are looked at closely; 0: none"
    )
    parser.add_argument("--rounds", type=int, default=9, help="how often each is timed")
    options = parser.parse_args()
    shelf = ("panda", "bookshelf", bookshelf())
    clutter = [("ur5", f"6 obstacles, no. {seed}", scattered(6, seed)) for seed in range(5)]

    rows = [time_free_edges(*problem, options.edges, options.rounds) for problem in (*clutter, shelf)]
    queries = ("bound queries", "margin queries", "plain queries")
    print_table(("robot", "scene", *queries, "certified [µs]", "sampled [µs]", "ratio"), rows)
    print()
    rows = [time_margins(*problem, options.edges, options.rounds) for problem in (clutter[0], shelf)]
    kinds = ("same array [µs]", "equal margins [µs]", "others each time [µs]")
    print_table(("robot", "scene", "pairs", *kinds), rows)
    if options.verify:
        print()
        rows = [verify_edges(*problem, options.verify) for problem in (clutter[0], shelf)]
        verdicts = ("contradicted", "free", "blocked", "undecided")
        print_table(("robot", "scene", "edges", *verdicts, *queries), rows)


if __name__ == "__main__":
    main()
