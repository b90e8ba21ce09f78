from .base import Parameter as Parameter, SafePlanner as SafePlanner
from .bubble import BubblePlanner as BubblePlanner
from .given import FunctionPlanner as FunctionPlanner, PathFunction as PathFunction
from .jt_rrt import SafeJTRRT as SafeJTRRT
from .prm import SafePRM as SafePRM
from .registry import (
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
    settings_of as settings_of,
    termination as termination,
)
from .rrt_connect import SafeRRTConnect as SafeRRTConnect
