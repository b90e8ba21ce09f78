"""What each idea adds to safety: python bench/ablation.py [--runs N] [--scenarios a,b] [--time S].

SafeRRTConnect with one of its ideas at a time, with all but one, and with all: the selection by ρ + α·CDF, the slide
down the gradient, the adaptive threshold on danger, and simplification afterwards. All of them run with the same seeds.
Medians over the runs; J is the cost ∫(1 + λ·CDF) ds that simplification lowers.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from _timing import print_table

from safe_ompl.models.scenario import Scenario, find_scenario, list_scenarios
from safe_ompl.setup import PlanResult, SafeSetup, setup_scenario

SELECTION: dict[str, Any] = {"nearest_fraction": 0.3}
NO_SELECTION: dict[str, Any] = {"nearest_fraction": 1.0}
SLIDE, NO_SLIDE = {"slide": 0.8}, {"slide": 0.0}
THRESHOLD, NO_THRESHOLD = {"threshold_rise": 0.05}, {"threshold_rise": 0.0}

VARIANTS: dict[str, tuple[dict[str, Any], bool]] = {
    "nothing (RRT-Connect)": ({"alpha": 0.0}, False),
    "selection": ({**SELECTION, **NO_SLIDE, **NO_THRESHOLD}, False),
    "slide": ({**NO_SELECTION, **SLIDE, **NO_THRESHOLD}, False),
    "threshold": ({**NO_SELECTION, **NO_SLIDE, **THRESHOLD}, False),
    "all but selection": ({**NO_SELECTION, **SLIDE, **THRESHOLD}, False),
    "all but slide": ({**SELECTION, **NO_SLIDE, **THRESHOLD}, False),
    "all but threshold": ({**SELECTION, **SLIDE, **NO_THRESHOLD}, False),
    "all three": ({}, False),
    "simplification alone": ({"alpha": 0.0}, True),
    "all and simplification": ({}, True),
}


def row(name: str, results: list[PlanResult]) -> tuple[object, ...]:
    """Return the row of a variant."""
    solved = [r for r in results if r]
    columns = [
        [1e3 * (r.planning_time + r.simplification_time) for r in solved],
        [float(r.counts.margin_queries + r.counts.collision_queries) for r in solved],
        [r.report.length for r in solved if r.report],
        *(
            [getattr(r.report.danger, key) for r in solved if r.report and r.report.danger]
            for key in ("mean", "max", "integral", "avoidable")
        ),
        [1e3 * r.report.clearance.min for r in solved if r.report],
    ]
    medians = (float(np.median(column or [np.nan])) for column in columns)
    return (name, f"{len(solved)}/{len(results)}", *(f"{value:.3g}" for value in medians))


def runs(setup: SafeSetup, name: str, number: int, limit: float) -> list[PlanResult]:
    """Return the results of a variant."""
    parameters, simplified = VARIANTS[name]
    return [
        setup.plan("SafeRRTConnect", time=limit, seed=seed, parameters=parameters, simplify=simplified)
        for seed in range(number)
    ]


def main() -> None:
    """Run the bench."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--time", type=float, default=10.0, help="limit of a run [s]")
    parser.add_argument("--scenarios", type=lambda text: text.split(","), default=list(list_scenarios()))
    options = parser.parse_args()
    header = ("", "solved", "ms", "checks", "length", "mean", "peak", "integral", "avoidable", "clearance mm")
    for scenario in options.scenarios:
        setup = setup_scenario(Scenario.load(find_scenario(scenario)))
        print(f"\n{scenario}")
        print_table(header, [row(v, runs(setup, v, options.runs, options.time)) for v in VARIANTS])


if __name__ == "__main__":
    main()
