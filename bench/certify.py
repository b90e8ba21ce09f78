"""What the proofs are worth: verdicts against samples, and proven peaks of danger.

verdicts   Random edges of up to 1.5 rad on every robot and scene. An edge that is called free is looked at every
           0.001 rad, one that is called blocked must be in collision where it says, both by Pinocchio and coal alone
           (`bench/_plain.py`): `contradicted` must be 0. The target for undecided ones is 0.5 %.
hard       Edges that pass within 5 mm of a contact, looked at every 0.0002 rad.
danger     Proven peaks of danger of planned and random paths: violations by samples 0.001 rad apart (must be 0), slack
           (target: median 5 % at the default tolerance), field evaluations against those of a profile (target: 2).
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator
from math import ceil
from time import process_time
from typing import Any

import numpy as np

from bench._harness import Report
from bench._plain import TOLERANCE, PlainGeometry
from bench._scenes import bookshelf, pillar_of_points, scattered
from bench.motion import random_edges
from safe_ompl import CollisionChecker, DangerField, MotionProver, Robot, Scenario, Scene, Verdict
from safe_ompl.common import FloatArray
from safe_ompl.danger import CertifiedDanger
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.simplification.measures import PROFILE_POINTS, Curve
from safe_ompl.scene import list_scenarios

CLAIM = "what is called free is free, what is called blocked touches, and no danger is above its proven bound"
FINE, FINEST = 0.001, 0.0002  # [rad] between samples
NEAR = 0.005  # [m] how near hard edges pass to a contact
HARD_LENGTH = 0.05, 0.4  # [rad]
PLANNERS = ("SafeRRTConnect", "RRTConnect")

Problem = tuple[str, Robot, Scene]
Edge = tuple[FloatArray, FloatArray]


def problems() -> list[Problem]:
    """Return six robots, one with continuous joints, in scattered scenes, a bookshelf, a cloud and all scenarios."""
    names = {name: Robot.from_example(name) for name in ("panda", "ur5", "ur10", "xarm7", "kinova", "z1")}
    found = [(f"{name}, scattered {k}", robot, scattered(6, k)) for k, (name, robot) in enumerate(names.items())]
    found += [("panda, bookshelf", names["panda"], bookshelf()), ("ur5, cloud", names["ur5"], pillar_of_points())]
    for name, file in list_scenarios().items():
        scenario = Scenario.load(file)
        found.append((name, scenario.build_robot(), scenario.scene))
    return found


# ------------------------------------------------------------------------------------------------------ edges


def hard_edges(checker: CollisionChecker, rng: np.random.Generator) -> Iterator[Edge]:
    """Yield edges that pass a contact at less than `NEAR`: found by halving, then along it."""
    robot = checker.robot
    while True:
        free, touching = rng.uniform(robot.lower, robot.upper, (2, robot.n))
        if checker.in_collision(free) or not checker.in_collision(touching):
            continue
        wanted = rng.uniform(0.0, NEAR)
        while np.linalg.norm(touching - free) > 1e-6 and _distance(checker, free) > wanted:
            middle = (free + touching) / 2
            free, touching = (free, middle) if checker.in_collision(middle) else (middle, touching)
        slope = np.array([_distance(checker, free + h) - _distance(checker, free) for h in 1e-4 * np.eye(robot.n)])
        norm = float(np.linalg.norm(slope))
        along = rng.normal(size=robot.n)
        if norm > 1e-9:
            along -= (along @ slope) / norm**2 * slope
        along *= rng.uniform(*HARD_LENGTH) / max(float(np.linalg.norm(along)), 1e-9)
        start, end = free - rng.uniform(0.2, 0.8) * along, free + along
        if all((robot.within_limits(q)).all() for q in (start, end)):
            yield start, end


def _distance(checker: CollisionChecker, q: FloatArray) -> float:
    return float(checker.pair_distances(q).min(initial=np.inf))


def verdict_row(
    name: str, checker: CollisionChecker, edges: Iterator[Edge], number: int, step: float
) -> tuple[Counter[str], tuple[object, ...]]:
    """Check edges and look at them closely; return what was found, and a row of a table."""
    motion, plain, found = MotionProver(checker), PlainGeometry(checker.robot, checker.scene), Counter[str]()
    for _ in range(number):
        start, end = next(edges)
        checker.counts.reset()
        verdict = motion.check(start, end)
        found["bounds"] += checker.counts.bound_queries
        found["margin"] += checker.counts.margin_queries
        found["plain"] += checker.counts.collision_queries
        found[verdict.verdict.value] += 1
        if verdict.verdict is Verdict.FREE:
            way = checker.robot.difference(start, end)
            Q = start + np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(way) / step))[:, None] * way
            found["contradicted"] += plain.least(Q, TOLERANCE)[0] <= 0.0
        elif verdict.verdict is Verdict.BLOCKED and verdict.at is not None:
            at = start + verdict.at * checker.robot.difference(start, end)
            found["contradicted"] += not (plain.touches(at) or plain.distances(at).min() <= TOLERANCE)
    found["edges"] = number
    return found, _verdict_cells(name, found)


def _verdict_cells(name: str, found: Counter[str]) -> tuple[object, ...]:
    number = found["edges"]
    shares = (f"{found[verdict.value] / number:.2%}" for verdict in (Verdict.FREE, Verdict.BLOCKED, Verdict.UNDECIDED))
    return (
        name,
        number,
        found["contradicted"],
        *shares,
        *(found[kind] / number for kind in ("bounds", "margin", "plain")),
    )


def report_verdicts(
    report: Report,
    what: str,
    number: int,
    step: float,
    make: Callable[[CollisionChecker, np.random.Generator], Iterator[Edge]],
) -> int:
    """Report the verdicts on `number` edges, spread over all problems; return 1 if a sample contradicts one."""
    chosen, rows, total = problems(), [], Counter[str]()
    for k, (name, robot, scene) in enumerate(chosen):
        checker = CollisionChecker(robot, scene)
        edges = make(checker, np.random.default_rng(k))
        found, row = verdict_row(name, checker, edges, ceil(number / len(chosen)), step)
        total += found
        rows.append(row)
    rows.append(_verdict_cells("all", total))
    header = ("problem", "edges", "contradicted", "free", "blocked", "undecided")
    report.table((*header, "bound queries", "margin queries", "plain queries"), rows)
    report.counted(what, total["edges"], total["contradicted"], total[Verdict.UNDECIDED.value])
    return int(total["contradicted"] > 0)


def verdicts(options: argparse.Namespace, report: Report) -> int:
    """Check random edges."""
    return report_verdicts(
        report,
        "random edges of up to 1.5 rad, sampled every 0.001 rad",
        options.edges,
        FINE,
        lambda checker, rng: random_edges(checker.robot, rng, 0.1, 1.5),
    )


def hard(options: argparse.Namespace, report: Report) -> int:
    """Check edges that nearly touch."""
    what = "edges within 5 mm of a contact, sampled every 0.0002 rad"
    return report_verdicts(report, what, options.hard, FINEST, hard_edges)


# ------------------------------------------------------------------------------------------------------ danger


def random_path(robot: Robot, rng: np.random.Generator, edges: int) -> FloatArray:
    """Return a path through random configurations."""
    start = rng.uniform(robot.lower, robot.upper)
    steps = rng.normal(size=(edges, robot.n)) * rng.uniform(0.1, 1.0, (edges, 1))
    path = start + np.vstack([np.zeros((1, robot.n)), np.cumsum(steps, axis=0)])
    return np.where(robot.continuous, path, np.clip(path, robot.lower, robot.upper))


def danger(options: argparse.Namespace, report: Report) -> int:
    """Report how tight and dear proven peaks of danger are."""
    rows: list[tuple[Any, ...]] = []
    for name, file in list_scenarios().items():
        setup = setup_scenario(Scenario.load(file))
        if setup.field is None:
            continue
        rng, number = np.random.default_rng(5), options.paths
        planned = [setup.plan(PLANNERS[k % 2], seed=k, time=5.0).path for k in range(number)]
        random = [random_path(setup.robot, rng, int(rng.integers(1, 6))) for _ in range(number)]
        rows.append((f"{name}, planned", *danger_cells(setup.field, [p for p in planned if p is not None])))
        rows.append((f"{name}, random", *danger_cells(setup.field, random)))
    header = ("paths", "number", "violations", "slack median", "max", "unbounded")
    report.table((*header, "evaluations / profile", "max", "time / profile"), rows)
    false = sum(row[2] for row in rows)
    what = "proven peaks of danger, sampled every 0.001 rad"
    report.counted(what, sum(row[1] for row in rows), false, sum(row[5] for row in rows))
    return int(false > 0)


def danger_cells(field: DangerField, paths: list[FloatArray]) -> tuple[object, ...]:
    """Return number of paths, violations, slack of those that are bounded, evaluations and time against a profile."""
    proofs, slack, asked, times, violations, unbounded = CertifiedDanger(field), [], [], [], 0, 0
    for path in paths:
        curve = Curve(field.robot, path)
        usual = max(PROFILE_POINTS, 1 + ceil(curve.length / 0.05))
        profile = curve.at(np.linspace(0.0, curve.length, usual))
        begin = process_time()
        field.values(profile)
        middle, before = process_time(), field.counts.field_configurations
        bounds = proofs.of_path(path)
        times.append((process_time() - middle) / max(middle - begin, 1e-6))
        asked.append((field.counts.field_configurations - before) / usual)
        dense = field.values(curve.at(np.linspace(0.0, curve.length, 2 + int(curve.length / FINE)))).max()
        violations += bool(dense > bounds.upper * (1 + 1e-9))
        if np.isfinite(bounds.upper):
            slack.append(bounds.upper / max(float(dense), bounds.lower) - 1)
        else:
            unbounded += 1
    cells = (f"{np.median(slack):.1%}", f"{max(slack):.1%}")
    return (len(paths), violations, *cells, unbounded, float(np.median(asked)), max(asked), float(np.median(times)))


PARTS = {"verdicts": verdicts, "hard": hard, "danger": danger}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--edges", type=int, default=5000, help="random edges, over all problems")
    parser.add_argument("--hard", type=int, default=500, help="edges that nearly touch, over all problems")
    parser.add_argument("--paths", type=int, default=10, help="paths per scenario, for danger")
