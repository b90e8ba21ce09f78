"""What others read and write: logs for Foxglove, recordings and a node of ROS 2, and worlds of planners.

Logs and recordings need the extra `safe-ompl[mcap]`, what starts a node ROS, too (`safe-ompl[ros]`).
"""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.apps.exchange import messages as messages
    from safe_ompl.apps.exchange.controller import (
        Cell as Cell,
        ControlOptions as ControlOptions,
        LiveController as LiveController,
    )
    from safe_ompl.apps.exchange.execution import (
        ACTION as ACTION,
        Code as Code,
        Execution as Execution,
        GoalError as GoalError,
        Outcome as Outcome,
        TrajectoryGuard as TrajectoryGuard,
    )
    from safe_ompl.apps.exchange.logs import McapLog as McapLog, read_joint_log as read_joint_log, read_log as read_log
    from safe_ompl.apps.exchange.messages import Frames as Frames, in_metres as in_metres
    from safe_ompl.apps.exchange.mjcf import world_from_mjcf as world_from_mjcf
    from safe_ompl.apps.exchange.moveit import scene_from_moveit as scene_from_moveit
    from safe_ompl.apps.exchange.pieces import proven_pieces as proven_pieces
    from safe_ompl.apps.exchange.ros_node import (
        RosNode as RosNode,
        lookup_of as lookup_of,
        ros_context as ros_context,
        trajectory_action as trajectory_action,
    )

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
