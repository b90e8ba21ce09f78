"""Benchmarks in OMPL's form, with their runs and logs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.apps.benchmark.benchmark import Benchmark
    from safe_ompl.apps.benchmark.campaign import (
        Campaign,
        Summary,
        check_named_planner,
        default_planners,
        failure,
        summarize,
    )

__all__ = ["Benchmark", "Campaign", "Summary", "check_named_planner", "default_planners", "failure", "summarize"]

__getattr__, __dir__ = lazily(__name__, __file__)
