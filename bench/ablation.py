"""What each idea adds to safety: python bench/ablation.py [--runs N] [--scenarios a,b] [--time S].

RRT-Connect exactly as printed (PaperRRTConnect) is what all else is compared with. SafeRRTConnect with one of its
ideas at a time, with all but one, and with all: short steps where a whole one is trapped, the selection by ρ + α·CDF,
the slide down the gradient, the adaptive threshold on danger, the clearance that motions keep while it costs no
solution, and simplification afterwards. All take turns, with the same seeds. Short steps go with each single idea.
Medians over the runs; J is the cost ∫(1 + λ·CDF²) ds that simplification lowers.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np
from _timing import print_table
from ompl import util as ou

from safe_ompl.planning.from_scenario import setup_scenario
from safe_ompl.planning.result import PlanResult
from safe_ompl.planning.safe_setup import SafeSetup
from safe_ompl.scene.scenario import Scenario, find_scenario, list_scenarios

PLANNER, BASELINE = "SafeRRTConnect", "PaperRRTConnect"
SELECTION: dict[str, Any] = {"nearest_fraction": 0.3}
NO_SELECTION: dict[str, Any] = {"nearest_fraction": 1.0}
SLIDE, NO_SLIDE = {"slide": 0.8}, {"slide": 0.0}
THRESHOLD, NO_THRESHOLD = {"threshold_rise": 0.05}, {"threshold_rise": 0.0}
NO_CLEARANCE = {"clearance": 0.0}

VARIANTS: dict[str, tuple[str, dict[str, Any], bool]] = {
    "nothing (RRT-Connect as printed)": (BASELINE, {}, False),
    "short steps": (PLANNER, {"alpha": 0.0, **NO_CLEARANCE}, False),
    "selection": (PLANNER, {**SELECTION, **NO_SLIDE, **NO_THRESHOLD, **NO_CLEARANCE}, False),
    "slide": (PLANNER, {**NO_SELECTION, **SLIDE, **NO_THRESHOLD, **NO_CLEARANCE}, False),
    "threshold": (PLANNER, {**NO_SELECTION, **NO_SLIDE, **THRESHOLD, **NO_CLEARANCE}, False),
    "clearance": (PLANNER, {**NO_SELECTION, **NO_SLIDE, **NO_THRESHOLD}, False),
    "all but selection": (PLANNER, {**NO_SELECTION, **SLIDE, **THRESHOLD}, False),
    "all but slide": (PLANNER, {**SELECTION, **NO_SLIDE, **THRESHOLD}, False),
    "all but threshold": (PLANNER, {**SELECTION, **SLIDE, **NO_THRESHOLD}, False),
    "all but clearance": (PLANNER, NO_CLEARANCE, False),
    "all but short steps": (PLANNER, {"short_steps": False}, False),
    "all": (PLANNER, {}, False),
    "simplification alone": (BASELINE, {}, True),
    "all and simplification": (PLANNER, {}, True),
}

COLUMNS: dict[str, Callable[[SafeSetup, PlanResult], float]] = {
    "ms": lambda setup, result: 1e3 * (result.planning_time + result.simplification_time),
    "checks": lambda setup, result: result.counts.queries,
    "length": lambda setup, result: result.report.length,
    "mean": lambda setup, result: result.report.danger.mean,
    "peak": lambda setup, result: result.report.danger.max,
    "integral": lambda setup, result: result.report.danger.integral,
    "avoidable": lambda setup, result: result.report.danger.avoidable,
    "clearance mm": lambda setup, result: 1e3 * result.report.clearance.min,
    "J": lambda setup, result: setup.simplifier.cost.of(result.path),
}


def row(setup: SafeSetup, name: str, results: list[PlanResult]) -> tuple[str, ...]:
    """Return the row of a variant."""
    solved = [result for result in results if result]
    medians = (np.median([of(setup, result) for result in solved] or [np.nan]) for of in COLUMNS.values())
    cells = (f"{value:.0f}" if value >= 100.0 else f"{value:.3g}" for value in medians)
    return (name, f"{len(solved)}/{len(results)}", *cells)


def runs(setup: SafeSetup, number: int, limit: float) -> dict[str, list[PlanResult]]:
    """Return the results of every variant; they take turns."""
    results: dict[str, list[PlanResult]] = {name: [] for name in VARIANTS}
    for seed in range(number):
        for name, (planner, parameters, simplify) in VARIANTS.items():
            results[name].append(
                setup.plan(planner, time=limit, seed=seed, parameters=parameters, simplify=simplify)
            )
    return results


def main() -> None:
    """Run the bench."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--time", type=float, default=10.0, help="limit of a run [s]")
    parser.add_argument("--scenarios", type=lambda text: text.split(","), default=list(list_scenarios()))
    options = parser.parse_args()
    ou.setLogLevel(ou.LogLevel.LOG_WARN)
    for scenario in options.scenarios:
        setup = setup_scenario(Scenario.load(find_scenario(scenario)))
        print(f"\n{scenario}")
        found = runs(setup, options.runs, options.time)
        print_table(("", "solved", *COLUMNS), [row(setup, name, own) for name, own in found.items()])


if __name__ == "__main__":
    main()
