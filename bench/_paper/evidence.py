"""Statistics of the runs of a study: means, ratios of safe to classical planners, deviations."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import nan

import numpy as np

from _paper.studies import Effort, Pair, Study
from safe_ompl.apps.benchmark.campaign import BAND, Summary, summarize
from safe_ompl.common import FloatArray
from safe_ompl.planning.result import PlanResult

COLUMNS: Mapping[str, Callable[[PlanResult], float]] = {
    "time": lambda result: result.planning_time,
    "nodes": lambda result: result.counts.nodes,
    "checks": lambda result: result.counts.queries + result.counts.distance_queries,
    "field": lambda result: result.counts.field_configurations,
}


@dataclass(frozen=True)
class Evidence:
    """The results of one study.

    Attributes
    ----------
    study : Study
        Which one.
    pairs : tuple of Pair
        Those of which both planners solved at least one run, in the paper's order.
    results : mapping of str to list of PlanResult
        Planner → its runs.
    summaries : mapping of str to Summary
        Planner → their summary.
    """

    study: Study
    pairs: tuple[Pair, ...]
    results: Mapping[str, Sequence[PlanResult]]
    summaries: Mapping[str, Summary]

    @classmethod
    def of(cls, study: Study, pairs: Sequence[Pair], results: Sequence[PlanResult]) -> Evidence:
        """Sort results by planner; those of planners that are in no pair are left out."""
        runs = {name: [r for r in results if r.planner == name] for pair in pairs for name in pair.planners}
        runs = {name: own for name, own in runs.items() if own}
        summaries = {name: summarize(own)[0] for name, own in runs.items()}
        both = tuple(
            pair for pair in pairs if all(n in summaries and summaries[n].solved for n in pair.planners)
        )
        return cls(study, both, runs, summaries)

    def effort(self, planner: str) -> Effort:
        """Return the means of a planner over its solved runs, as a row of the paper's tables."""
        solved = [result for result in self.results[planner] if result.solved]
        return Effort(*(float(np.mean([of(result) for result in solved])) for of in COLUMNS.values()))

    def effort_ratio(self, pair: Pair) -> Effort:
        """Return safe divided by classical for every column."""
        classic, safe = map(self.effort, pair.planners)
        return Effort(*map(quotient, safe, classic))

    def printed_ratio(self, pair: Pair) -> Effort:
        """Return the same of the paper's own numbers."""
        classic, safe = self.study.printed[pair.label]
        return Effort(*(s / c for s, c in zip(safe, classic, strict=True)))

    def danger(self, planner: str) -> float:
        """Return the mean danger along the paths of a planner, averaged over its solved runs."""
        return float(self.summaries[planner].metrics["danger_mean"].mean())

    def danger_ratio(self, pair: Pair) -> float:
        """Return the mean danger of the safe planner's paths, divided by that of the classical one's."""
        return self.danger(pair.safe) / self.danger(pair.classic)

    def danger_ratio_band(self, pair: Pair) -> tuple[float, float]:
        """Return the 15–85 % band of that ratio over all pairs of a safe and a classical run."""
        classic, safe = (self.summaries[name].metrics["danger_mean"] for name in pair.planners)
        low, high = np.percentile(np.divide.outer(safe, classic), BAND)
        return float(low), float(high)

    def band_width(self, planner: str) -> float:
        """Return the width of the 15–85 % band of a planner's danger profiles, averaged along the path."""
        low, high = np.percentile(self.summaries[planner].profiles, BAND, axis=0)
        return float(np.mean(high - low))

    def time_spread(self, planner: str) -> float:
        """Return the distance between the quartiles of a planner's times [s]."""
        low, high = np.percentile(self.times(planner), (25, 75))
        return float(high - low)

    def times(self, planner: str) -> FloatArray:
        """Return the times of a planner's solved runs [s]."""
        return self.summaries[planner].metrics["planning_time"]


def quotient(safe: float, classic: float) -> float:
    """Return safe divided by classical; NaN where there is nothing to divide by."""
    return safe / classic if classic else nan
