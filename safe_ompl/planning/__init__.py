"""SafeSetup, OMPL's SimpleSetup for a robot in a scene; and the results of planning."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.planning.front import Tradeoff as Tradeoff, tradeoff as tradeoff
    from safe_ompl.planning.planners import planner_data as planner_data
    from safe_ompl.planning.problem_setup import PLAN_JOBS as PLAN_JOBS, small_robot as small_robot
    from safe_ompl.planning.result import Improvement as Improvement, PlanResult as PlanResult
    from safe_ompl.planning.safe_setup import (
        SafeSetup as SafeSetup,
        plan as plan,
        repair as repair,
        setup_problem as setup_problem,
        setup_scenario as setup_scenario,
    )

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
