"""SafeSetup, OMPL's SimpleSetup for a robot in a scene; and the results of planning."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.planning.front import Tradeoff, tradeoff
    from safe_ompl.planning.planners import planner_data
    from safe_ompl.planning.problem_setup import PLAN_JOBS, small_robot
    from safe_ompl.planning.program_result import ProgramResult, Stretch
    from safe_ompl.planning.programs import plan_program, program_robot
    from safe_ompl.planning.result import Improvement, PlanResult
    from safe_ompl.planning.safe_setup import SafeSetup, plan, repair, setup_problem, setup_scenario

__all__ = [
    "PLAN_JOBS",
    "Improvement",
    "PlanResult",
    "ProgramResult",
    "SafeSetup",
    "Stretch",
    "Tradeoff",
    "plan",
    "plan_program",
    "planner_data",
    "program_robot",
    "repair",
    "setup_problem",
    "setup_scenario",
    "small_robot",
    "tradeoff",
]

__getattr__, __dir__ = lazily(__name__, __file__)
