from .benchmark import Benchmark as Benchmark
from .campaign import (
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
