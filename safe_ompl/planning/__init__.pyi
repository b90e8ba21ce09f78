from .front import Tradeoff as Tradeoff, tradeoff as tradeoff
from .planners import planner_data as planner_data
from .result import Improvement as Improvement, PlanResult as PlanResult
from .safe_setup import SafeSetup as SafeSetup, repair as repair
from .scenarios import (
    check_named_planner as check_named_planner,
    plan as plan,
    setup_problem as setup_problem,
    setup_scenario as setup_scenario,
)
