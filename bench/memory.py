"""Memory over thousands of solves: python bench/memory.py [--solves 5000].

Planners of this package and OMPL's, solved, out of time and broken off by exceptions, all mixed, with a new setup every
hundred solves. Prints the resident memory every 500 solves, and how much it has grown since the first 500; the
bar is 5 MB. Ends without a word about leaked instances if nothing leaks.
"""

from __future__ import annotations

import argparse
import gc
import logging
from typing import Any

import numpy as np
from ompl import util as ou

from safe_ompl import CollisionFreeValidity, SafeSetup
from safe_ompl.apps.benchmark.measures import resident_megabytes
from safe_ompl.planning.from_scenario import setup_scenario
from safe_ompl.planning.planners.registry import planner_names
from safe_ompl.scene.scenario import Scenario, find_scenario

BAR = 5.0  # [MB]
WARM_UP, STEP, SETUP_LIFE = 500, 500, 100
TIMES = (0.001, 0.02, 0.05)  # [s]; the first is not enough for anybody


class BrokenError(Exception):
    """What the checker raises."""


class Breaking(CollisionFreeValidity):
    """Raises at a call of its own choice."""

    def __init__(self, setup: SafeSetup, after: int) -> None:
        super().__init__(setup.getSpaceInformation(), setup.checker)
        self._left = after

    def isValid(self, state: Any) -> bool:
        """Return what the checker says, until it breaks."""
        self._left -= 1
        if self._left == 0:
            raise BrokenError
        return super().isValid(state)


def solve(setup: SafeSetup, rng: np.random.Generator, counts: dict[str, int]) -> None:
    """Plan once, one way or another."""
    planner = str(rng.choice(planner_names()))
    breaks = rng.random() < 0.15
    try:
        if breaks:
            setup.setStateValidityChecker(Breaking(setup, int(rng.integers(1, 30))))
        result = setup.plan(planner, time=float(rng.choice(TIMES)), seed=int(rng.integers(1000)))
        counts["solved" if result else "failed"] += 1
    except BrokenError:
        counts["broken"] += 1
    finally:
        if breaks:
            setup.setStateValidityChecker(CollisionFreeValidity(setup.getSpaceInformation(), setup.checker))


def main() -> None:
    """Run the bench."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--solves", type=int, default=5000)
    options = parser.parse_args()
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    logging.disable(logging.ERROR)
    rng, counts = np.random.default_rng(0), {"solved": 0, "failed": 0, "broken": 0}
    scenario = Scenario.load(find_scenario("planar3"))
    robot = scenario.build_robot()
    first = last = 0.0
    for k in range(options.solves):
        if k % SETUP_LIFE == 0:
            setup = setup_scenario(scenario, robot)
        solve(setup, rng, counts)
        if (k + 1) % STEP == 0:
            gc.collect()
            last = resident_megabytes()
            first = first or last
            print(f"{k + 1:6d} solves  {last:7.1f} MB", flush=True)
    print(", ".join(f"{number} {name}" for name, number in counts.items()))
    print(f"grown by {last - first:.1f} MB after the first {WARM_UP} solves (bar: {BAR:g} MB)")


if __name__ == "__main__":
    main()
