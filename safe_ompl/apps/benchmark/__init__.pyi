from .benchmark import Benchmark as Benchmark
from .campaign import (
    ALL_WAYS as ALL_WAYS,
    BASELINE as BASELINE,
    Campaign as Campaign,
    Run as Run,
    Summary as Summary,
    as_planned as as_planned,
    default_planners as default_planners,
    failure as failure,
    lost as lost,
    planner_of as planner_of,
    run_planner as run_planner,
    summarize as summarize,
)
