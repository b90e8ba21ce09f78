"""Paths of 200 runs, bit for bit: record them before a change, and compare them after it.

    python -m bench same --record before.json
    python -m bench same --against before.json

Our planners on the scenarios of the package with three seeds each, the printed forms on four of them. A planner is
stopped by how often it asks, not by a clock, and nothing else looks at one. The first seed's paths are simplified until
nothing is to gain, the second's are timed, too. What is compared are hashes of the bytes of way points, and of the
samples of trajectories: on the same machine with the same versions they stay the same.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from ompl import base as ob

from bench._harness import Report
from safe_ompl import RateLimits, SafeSetup, Scenario, StandstillError, time_path
from safe_ompl.common import FloatArray
from safe_ompl.planning import setup_scenario
from safe_ompl.scene import list_scenarios

CLAIM = "a change of the code leaves all paths as they were"
OURS = [f"{kind}{name}" for name in ("RRTConnect", "PRM", "JTRRT") for kind in ("Safe", "Classic")]
OURS += ["BubblePlanner", "ClassicBubble"]
PRINTED = [f"Paper{kind}{name}" for name in ("RRTConnect", "PRM", "JTRRT", "Bubble") for kind in ("Safe", "")]
PRINTED_ON = ("paper_1", "paper_2", "planar2", "planar3")
SEEDS = 3
ASKS = 1000  # how often a planner may ask whether to stop
INSTANTS = 200  # of a trajectory


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--record", type=Path, metavar="FILE", help="write the hashes there")
    action.add_argument("--against", type=Path, metavar="FILE", help="compare with what was recorded")
    parser.add_argument("--only", nargs="*", metavar="SCENARIO", help="on these scenarios (default: all)")


def main(options: argparse.Namespace, report: Report) -> int:
    """Record or compare."""
    found = dict(runs(options.only))
    report.figure("runs", len(found))
    report.figure("with a path", sum("planned" in hashes for hashes in found.values()))
    if options.record:
        options.record.write_text(json.dumps(found, indent=1) + "\n")
        return 0
    before = json.loads(options.against.read_text())
    rows = differences(before, found, options.only)
    report.figure("different", len(rows))
    if rows:
        report.table(("run", "what differs"), rows)
    return int(bool(rows))


def runs(only: list[str] | None = None) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the name of each run, and the hashes of its outcomes."""
    for name, file in list_scenarios().items():
        if only and name not in only:
            continue
        scenario = Scenario.load(file)
        setup = setup_scenario(scenario)
        chosen = [(planner, seed) for planner in OURS for seed in range(SEEDS)]
        chosen += [(planner, 0) for planner in PRINTED if name in PRINTED_ON]
        for planner, seed in chosen:
            hashes: dict[str, str] = {}
            setup.prepare(planner, seed, scenario.planners.get(planner))
            setup.solve(asks(ASKS))
            if setup.haveExactSolutionPath():
                path = setup.solution()
                hashes["planned"] = digest(path)
                if seed == 1:
                    hashes["timed"] = timed(setup, scenario)
                if seed == 0 and planner in OURS:
                    setup.simplifySolution()
                    hashes["simplified"] = digest(setup.solution())
            yield f"{name} {planner} {seed}", hashes


def asks(number: int) -> ob.PlannerTerminationCondition:
    """Return a condition that holds from the time on that it was asked so often."""
    asked = iter(range(number))
    return ob.PlannerTerminationCondition(lambda: next(asked, None) is None)


def timed(setup: SafeSetup, scenario: Scenario) -> str:
    """Return the hash of the trajectory of a solution, beside the people of the scenario where there are any."""
    limits = RateLimits.of(setup.robot, np.ones(setup.robot.n), np.full(setup.robot.n, 3.0))
    try:
        made = time_path(setup.solution(), setup.robot, limits, motion=setup.motion_prover, people=scenario.people)
    except StandstillError:
        return "stands still"
    state = made.at(np.linspace(0.0, made.duration, INSTANTS))
    return digest(np.hstack([state.q, state.qd, state.qdd]), np.array([made.duration]))


def digest(*arrays: FloatArray) -> str:
    """Return a hash of the shapes and the bytes of arrays."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(repr(array.shape).encode() + np.ascontiguousarray(array, dtype=float).tobytes())
    return found.hexdigest()[:16]


def differences(
    before: dict[str, dict[str, str]], after: dict[str, dict[str, str]], only: list[str] | None = None
) -> list[tuple[str, str]]:
    """Return the runs that are not the same, and which of their outcomes differ; missing runs differ, too."""
    rows = []
    for run in dict.fromkeys((*before, *after)):
        if only and run.split()[0] not in only:
            continue
        old, new = before.get(run), after.get(run)
        if old is None or new is None:
            rows.append((run, "was not there" if old is None else "is missing"))
        elif old != new:
            rows.append((run, ", ".join(key for key in {**old, **new} if old.get(key) != new.get(key))))
    return rows
