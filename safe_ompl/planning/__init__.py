"""SafeSetup, OMPL's SimpleSetup for a robot in a scene; and the results of planning."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.planning.first_plan import PLAN_JOBS as PLAN_JOBS
    from safe_ompl.planning.first_plan import small_robot as small_robot
    from safe_ompl.planning.from_scenario import plan as plan
    from safe_ompl.planning.from_scenario import repair as repair
    from safe_ompl.planning.from_scenario import setup_problem as setup_problem
    from safe_ompl.planning.from_scenario import setup_scenario as setup_scenario
    from safe_ompl.planning.optimise import COSTS as COSTS
    from safe_ompl.planning.optimise import Improvement as Improvement
    from safe_ompl.planning.planners import planner_data as planner_data
    from safe_ompl.planning.problem import danger_field as danger_field
    from safe_ompl.planning.result import PlanResult as PlanResult
    from safe_ompl.planning.safe_setup import SafeSetup as SafeSetup

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
