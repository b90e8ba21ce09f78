"""Planners that subclass ompl.base.Planner."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.planning.planners.base import Parameter as Parameter, SafePlanner as SafePlanner
    from safe_ompl.planning.planners.bubble import BubblePlanner as BubblePlanner
    from safe_ompl.planning.planners.jt_rrt import SafeJTRRT as SafeJTRRT
    from safe_ompl.planning.planners.nearest import NearestNode as NearestNode
    from safe_ompl.planning.planners.prm import SafePRM as SafePRM
    from safe_ompl.planning.planners.registry import (
        accepts as accepts,
        check_planner as check_planner,
        check_usable as check_usable,
        is_ours as is_ours,
        make_planner as make_planner,
        needs_place as needs_place,
        nodes_of as nodes_of,
        planner_data as planner_data,
        planner_names as planner_names,
        seed_ompl as seed_ompl,
        termination as termination,
    )
    from safe_ompl.planning.planners.rrt_connect import SafeRRTConnect as SafeRRTConnect

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
