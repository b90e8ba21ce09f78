from .benchmark import Benchmark as Benchmark
from .campaign import (
    BASELINE as BASELINE,
    SAFEST_OF_ROUTES as SAFEST_OF_ROUTES,
    Campaign as Campaign,
    Run as Run,
    Summary as Summary,
    as_planned as as_planned,
    default_planners as default_planners,
    failure as failure,
    planner_of as planner_of,
    result_of_crash as result_of_crash,
    run_planner as run_planner,
    summarize as summarize,
)
