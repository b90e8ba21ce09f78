"""Driving by ROS 2: a node, its messages, trajectories' actions, recordings, and logs for Foxglove.

Logs and recordings need the extra `safe-ompl[mcap]`, what starts a node ROS, too (`safe-ompl[ros]`).
"""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.live.ros import messages as messages
    from safe_ompl.live.ros.controller import (
        Cell as Cell,
        ControlOptions as ControlOptions,
        LiveController as LiveController,
    )
    from safe_ompl.live.ros.execution import (
        ACTION as ACTION,
        Code as Code,
        Execution as Execution,
        GoalError as GoalError,
        Outcome as Outcome,
        TrajectoryGuard as TrajectoryGuard,
    )
    from safe_ompl.live.ros.logs import (
        Bag as Bag,
        McapLog as McapLog,
        read_joint_log as read_joint_log,
        read_log as read_log,
    )
    from safe_ompl.live.ros.messages import Frames as Frames, in_metres as in_metres
    from safe_ompl.live.ros.ros_node import (
        RosNode as RosNode,
        lookup_of as lookup_of,
        ros_context as ros_context,
        trajectory_action as trajectory_action,
    )

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
