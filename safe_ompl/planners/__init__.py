"""Planners: ours, their forms as printed in the papers, baselines to compare with, and OMPL's, by name."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from safe_ompl.planners.base import SafePlanner
    from safe_ompl.planners.bubble import BubblePlanner
    from safe_ompl.planners.graphs.planner_graph import PlannerGraph
    from safe_ompl.planners.jt_rrt import SafeJTRRT
    from safe_ompl.planners.parameters import Parameter
    from safe_ompl.planners.prm import SafePRM
    from safe_ompl.planners.registry import accepts, is_ours, make_planner, needs_place, planner_names
    from safe_ompl.planners.rrt_connect import SafeRRTConnect

_FOUND_IN = {  # imported when it is first asked for
    "BubblePlanner": "bubble",
    "Parameter": "parameters",
    "PlannerGraph": "graphs.planner_graph",
    "SafeJTRRT": "jt_rrt",
    "SafePRM": "prm",
    "SafePlanner": "base",
    "SafeRRTConnect": "rrt_connect",
    "accepts": "registry",
    "is_ours": "registry",
    "make_planner": "registry",
    "needs_place": "registry",
    "planner_names": "registry",
}

__all__ = [
    "BubblePlanner",
    "Parameter",
    "PlannerGraph",
    "SafeJTRRT",
    "SafePRM",
    "SafePlanner",
    "SafeRRTConnect",
    "accepts",
    "is_ours",
    "make_planner",
    "needs_place",
    "planner_names",
]


def __getattr__(name: str) -> object:
    """Import one of the room's public names, and keep it."""
    if name not in _FOUND_IN:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(import_module(f"{__name__}.{_FOUND_IN[name]}"), name)
    globals()[name] = found
    return found
