"""Planners that subclass ompl.base.Planner."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.planning.planners.base import SafePlanner as SafePlanner
    from safe_ompl.planning.planners.bubble import BubblePlanner as BubblePlanner
    from safe_ompl.planning.planners.jt_rrt import SafeJTRRT as SafeJTRRT
    from safe_ompl.planning.planners.parameters import Parameter as Parameter
    from safe_ompl.planning.planners.parts.tree import NearestNode as NearestNode
    from safe_ompl.planning.planners.parts.tree import PlannerGraph as PlannerGraph
    from safe_ompl.planning.planners.prm import SafePRM as SafePRM
    from safe_ompl.planning.planners.registry import accepts as accepts
    from safe_ompl.planning.planners.registry import check_planner as check_planner
    from safe_ompl.planning.planners.registry import check_usable as check_usable
    from safe_ompl.planning.planners.registry import is_ours as is_ours
    from safe_ompl.planning.planners.registry import make_planner as make_planner
    from safe_ompl.planning.planners.registry import needs_place as needs_place
    from safe_ompl.planning.planners.registry import nodes_of as nodes_of
    from safe_ompl.planning.planners.registry import planner_data as planner_data
    from safe_ompl.planning.planners.registry import planner_names as planner_names
    from safe_ompl.planning.planners.registry import seed_ompl as seed_ompl
    from safe_ompl.planning.planners.registry import termination as termination
    from safe_ompl.planning.planners.rrt_connect import SafeRRTConnect as SafeRRTConnect

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
