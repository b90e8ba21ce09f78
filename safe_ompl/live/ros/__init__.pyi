from . import messages as messages
from .controller import Cell as Cell, ControlOptions as ControlOptions, LiveController as LiveController
from .execution import (
    ACTION as ACTION,
    Code as Code,
    Execution as Execution,
    GoalError as GoalError,
    Outcome as Outcome,
    TrajectoryGuard as TrajectoryGuard,
)
from .logs import Bag as Bag, McapLog as McapLog, read_joint_log as read_joint_log, read_log as read_log
from .messages import FramePlaces as FramePlaces, in_metres as in_metres
from .ros_node import (
    RosNode as RosNode,
    lookup_of as lookup_of,
    ros_context as ros_context,
    trajectory_action as trajectory_action,
)
