"""The safest way round: plans with ways="all" and with one way, against a long search in each of some random scenes.

A scene has a person and five boxes about a Panda, which moves its hand by more than 0.6 m. The long search is stored in
`ways.json`: the path of least integral of danger among those of 64 simplified plans and of eight plans with ways="all",
of other seeds than those here. With --renew it is done anew.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np

from bench._harness import Report, positions
from safe_ompl import Box, CollisionChecker, Obstacle, Person, PlanResult, Pose, Robot, SafeSetup, Scene
from safe_ompl.common import FloatArray

CLAIM = "how much oftener all ways than one come near the safest path that a long search knows, and what it costs"
REFERENCE = Path(__file__).with_suffix(".json")
ROBOT = "panda"
PLANS, SEARCHES, BETWEEN = 64, 8, 100  # of the long search; so far apart are seeds, as those of starts count up
CLOSE = 1.05  # times the least integral of danger that is known
APART = 0.6  # [m] of the hand at start and goal, at least


class Runs(NamedTuple):
    """Runs of one scene: CPU times [s], integrals and means of danger and least clearances, of one way and of all."""

    times: FloatArray
    integrals: FloatArray
    means: FloatArray
    clearances: FloatArray
    ways: list[int]


def problem(number: int) -> SafeSetup:
    """Return a random scene with start and goal."""
    robot, rng = Robot.from_example(ROBOT), np.random.default_rng([55, number])
    while True:
        angle, away = rng.uniform(-1.2, 1.2), rng.uniform(0.6, 0.9)
        stance = Pose.from_rpy((away * np.cos(angle), away * np.sin(angle), -0.4), (0.0, 0.0, angle + np.pi))
        obstacles = [Obstacle("person", Person(height=float(rng.uniform(1.6, 1.9))), stance)]
        for k in range(5):
            angle, away, height = rng.uniform(-np.pi, np.pi), rng.uniform(0.35, 0.8), rng.uniform(0.0, 0.9)
            place = away * np.cos(angle), away * np.sin(angle), height
            pose = Pose.from_rpy(place, tuple(rng.uniform(-np.pi, np.pi, 3)))
            obstacles.append(Obstacle(f"box {k}", Box(tuple(rng.uniform(0.06, 0.22, 3))), pose, weight=0.3))
        scene, free = Scene(tuple(obstacles)), list[FloatArray]()
        checker = CollisionChecker(robot, scene)
        for q in rng.uniform(robot.lower, robot.upper, (400, robot.n)):
            if not checker.in_collision(q) and robot.tip_pose(q).translation[2] > 0.1:
                free.append(q)
            if len(free) == 2:
                hands = [robot.tip_pose(q).translation for q in free]
                if np.linalg.norm(hands[1] - hands[0]) > APART:
                    setup = SafeSetup(robot, scene)
                    setup.setConfigurations(*free)
                    return setup
                free.clear()


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--scenes", type=positions, default="0:60", metavar="A:B")
    parser.add_argument("--seeds", type=int, default=4, metavar="N", help="runs in each scene (%(default)s)")
    parser.add_argument("--planner", default="SafeRRTConnect")
    parser.add_argument("--renew", action="store_true", help="store a long search in each scene, in place of all this")


def main(options: argparse.Namespace, report: Report) -> int:
    """Run the bench."""
    stored = json.loads(REFERENCE.read_text(encoding="utf-8")) if REFERENCE.is_file() else []
    if options.renew:
        numbers = range(options.scenes.start or 0, options.scenes.stop)
        found = {k: long_search(problem(k)) for k in numbers}
        REFERENCE.write_text(json.dumps([{"integral": i, "mean": m} for i, m in found.values()], indent=1) + "\n")
        return 0
    known, runs = stored[options.scenes], list[Runs]()
    for number in range(len(stored))[options.scenes]:
        runs.append(both(problem(number), options.planner, options.seeds))
    show(report, runs, known)
    return 0


def long_search(setup: SafeSetup) -> tuple[float, float]:
    """Return integral and mean of the danger of the path with the least integral that a long search finds."""
    seeds = (10_000 + k for k in range(PLANS)), (20_000 + BETWEEN * k for k in range(SEARCHES))
    results = [setup.plan(seed=seed, simplify=True) for seed in seeds[0]]
    results += [setup.plan(seed=seed, ways="all") for seed in seeds[1]]
    dangers = [danger_of(result) for result in results if result]
    return min(dangers)


def danger_of(result: PlanResult) -> tuple[float, float]:
    """Return integral and mean of the danger of a path."""
    assert result.report is not None
    assert result.report.danger is not None
    return result.report.danger.integral, result.report.danger.mean


def both(setup: SafeSetup, planner: str, seeds: int) -> Runs:
    """Plan with each seed one way and all ways, in turn."""
    setup.plan(planner, ways="all")  # what all runs share is made now
    rows, numbers = [], []
    for seed in range(0, BETWEEN * seeds, BETWEEN):
        pair = []
        for ways in (1, "all"):
            begin = process_time()
            result = setup.plan(planner, seed=seed, simplify=True, ways=ways)
            time = process_time() - begin
            if result.report is not None:
                pair.append((time, *danger_of(result), result.report.clearance.min))
        numbers.append(len(result.ways))
        rows.append(pair)
    columns = np.array(rows).transpose(2, 0, 1)
    return Runs(*columns, numbers)


def show(report: Report, runs: list[Runs], known: list[dict[str, float]]) -> None:
    """Report how near the runs come to the long search, and what they cost."""
    times = np.array([each.times for each in runs])
    integrals = np.array([each.integrals / best["integral"] for each, best in zip(runs, known, strict=True)])
    means = np.array([each.means / best["mean"] for each, best in zip(runs, known, strict=True)])
    clearances = 1e3 * np.array([each.clearances for each in runs])
    rows = []
    for k, name in enumerate(("one", "all")):
        near, late = integrals[..., k] <= CLOSE, (float(np.percentile(of[..., k], 90)) for of in (integrals, means))
        clear = (float(value) for value in np.percentile(clearances[..., k], [10, 50]))
        rows.append((name, f"{near.sum()}/{near.size}", float(near.mean()), *late, *clear))
    header = ("ways", "within 5 %", "share", "integral, 90 %", "mean, 90 %", "min clearance, 10 % [mm]", "median")
    report.table(header, rows, f"danger over that of the long search, {len(runs)} scenes")
    ratios = times[..., 1].sum(axis=1) / times[..., 0].sum(axis=1)
    report.figure("CPU time of all ways / of one, all runs together", float(times[..., 1].sum() / times[..., 0].sum()))
    report.figure("of a scene, median / largest", f"{np.median(ratios):.2f} / {ratios.max():.2f}")
    numbers = np.bincount([number for each in runs for number in each.ways])
    report.figure("runs that found 1, 2, … ways", " ".join(map(str, numbers[1:].tolist())))
