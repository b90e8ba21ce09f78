"""Benchmarks in OMPL's form, with their runs and logs; entries of the open table, and their judge."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.apps.benchmark.benchmark import Benchmark as Benchmark
    from safe_ompl.apps.benchmark.campaign import Campaign as Campaign
    from safe_ompl.apps.benchmark.campaign import Summary as Summary
    from safe_ompl.apps.benchmark.campaign import check_named_planner as check_named_planner
    from safe_ompl.apps.benchmark.campaign import default_planners as default_planners
    from safe_ompl.apps.benchmark.campaign import failure as failure
    from safe_ompl.apps.benchmark.campaign import summarize as summarize
    from safe_ompl.apps.benchmark.entries import JUDGED as JUDGED
    from safe_ompl.apps.benchmark.entries import VERSION as VERSION
    from safe_ompl.apps.benchmark.entries import Entry as Entry
    from safe_ompl.apps.benchmark.entries import ProblemSet as ProblemSet
    from safe_ompl.apps.benchmark.entries import answered as answered
    from safe_ompl.apps.benchmark.entries import checksum as checksum
    from safe_ompl.apps.benchmark.judge import Judge as Judge
    from safe_ompl.apps.benchmark.judge import PlainGeometry as PlainGeometry
    from safe_ompl.apps.benchmark.judge import Verdict as Verdict

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
