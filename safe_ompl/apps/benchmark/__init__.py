"""Benchmarks in OMPL's form, with their runs and logs; entries of the open table, and their judge."""

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
    from safe_ompl.apps.benchmark.entries import JUDGED, VERSION, Entry, ProblemSet, answered, checksum
    from safe_ompl.apps.benchmark.judge import Judge, PlainGeometry, Verdict

__all__ = [
    "JUDGED",
    "VERSION",
    "Benchmark",
    "Campaign",
    "Entry",
    "Judge",
    "PlainGeometry",
    "ProblemSet",
    "Summary",
    "Verdict",
    "answered",
    "check_named_planner",
    "checksum",
    "default_planners",
    "failure",
    "summarize",
]

__getattr__, __dir__ = lazily(__name__, __file__)
