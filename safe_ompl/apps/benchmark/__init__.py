"""Runs of planners, campaigns of them, and benchmarks in OMPL's form."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.apps.benchmark.benchmark import Benchmark as Benchmark
    from safe_ompl.apps.benchmark.campaign import (
        Campaign as Campaign,
        Run as Run,
        Summary as Summary,
        check_named_planner as check_named_planner,
        default_planners as default_planners,
        failure as failure,
        lost as lost,
        run_planner as run_planner,
        summarize as summarize,
    )

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
