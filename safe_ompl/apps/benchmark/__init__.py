"""Runs of planners, campaigns of them, and benchmarks in OMPL's form."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.apps.benchmark.benchmark import Benchmark
    from safe_ompl.apps.benchmark.campaign import Campaign, Summary, check_named_planner, default_planners, summarize
    from safe_ompl.apps.benchmark.runs import Run, failure, run_planner

__all__ = [
    "Benchmark",
    "Campaign",
    "Run",
    "Summary",
    "check_named_planner",
    "default_planners",
    "failure",
    "run_planner",
    "summarize",
]

__getattr__, __dir__ = lazily(__name__, __file__)
