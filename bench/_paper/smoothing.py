"""Smoothing of planned paths: none, OMPL's simplifier, or danger-aware simplification."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from time import perf_counter

from ompl import geometric as og

from _paper.studies import Pair
from safe_ompl.apps.benchmark.campaign import Campaign, failure
from safe_ompl.apps.benchmark.runs import Run
from safe_ompl.planning.result import PlanResult
from safe_ompl.planning.safe_setup import SafeSetup


class Smoothing(Enum):
    """A kind of smoothing."""

    PLANNED = "as planned"
    SHORTENED = "shortened"  # by OMPL's simplifier, as is usual
    SIMPLIFIED = "simplified"  # by ours, with danger in mind

    @property
    def suffix(self) -> str:
        """How the folder with such runs ends."""
        return "" if self is Smoothing.PLANNED else f"_{self.value}"

    def planners(self, pair: Pair) -> tuple[str, ...]:
        """Return the planners of a pair whose paths are looked at; what is usual is of interest for classical ones."""
        return (pair.classic,) if self is Smoothing.SHORTENED else pair.planners


@dataclass(frozen=True)
class ShorteningCampaign(Campaign):
    """A campaign whose paths are smoothed as is usual: OMPL's simplifier makes them shorter, between the same ends."""

    def result(self, run: Run, setup: SafeSetup) -> PlanResult:
        """Do one run. A path that is not proven free any more is reported as not solved."""
        result = super().result(run, setup)
        if result.path is None:
            return result
        # One of its own for every run: the seed of the run is that of its simplifier, too, and danger is no matter.
        simplifier, earlier = og.PathSimplifier(setup.getSpaceInformation()), setup.counts - result.counts
        begin = perf_counter()
        simplifier.simplifyMax(setup.getSolutionPath())
        elapsed, counts = perf_counter() - begin, setup.counts - earlier
        path = setup.solution()
        report = setup.report(path)
        if not report.certified:
            return failure(f"Error: not proven free: {report.refused}", *run, result.joint_names)
        return replace(result, path=path, report=report, simplification_time=elapsed, counts=counts)
