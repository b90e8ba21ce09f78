"""Planners that subclass ompl.base.Planner."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.planning.planners.base import Parameter, SafePlanner
    from safe_ompl.planning.planners.bubble import BubblePlanner
    from safe_ompl.planning.planners.jt_rrt import SafeJTRRT
    from safe_ompl.planning.planners.nearest import NearestNode
    from safe_ompl.planning.planners.prm import SafePRM
    from safe_ompl.planning.planners.registry import (
        accepts,
        check_planner,
        check_usable,
        is_ours,
        make_planner,
        needs_place,
        nodes_of,
        planner_data,
        planner_names,
        seed_ompl,
        termination,
    )
    from safe_ompl.planning.planners.rrt_connect import SafeRRTConnect

__all__ = [
    "BubblePlanner",
    "NearestNode",
    "Parameter",
    "SafeJTRRT",
    "SafePRM",
    "SafePlanner",
    "SafeRRTConnect",
    "accepts",
    "check_planner",
    "check_usable",
    "is_ours",
    "make_planner",
    "needs_place",
    "nodes_of",
    "planner_data",
    "planner_names",
    "seed_ompl",
    "termination",
]

__getattr__, __dir__ = lazily(__name__, __file__)
