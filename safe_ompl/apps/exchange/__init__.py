"""What other programs read and write: logs that Foxglove opens, recordings and a node of ROS 2, worlds of planners.

Logs and recordings need the extra `safe-ompl[mcap]`, what starts a node ROS, too (`safe-ompl[ros]`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.apps.exchange import messages
    from safe_ompl.apps.exchange.controller import Cell, ControlOptions, LiveController
    from safe_ompl.apps.exchange.curobo import robot_from_curobo, scene_from_curobo
    from safe_ompl.apps.exchange.logs import McapLog, read_joint_log, read_log
    from safe_ompl.apps.exchange.messages import Frames, in_metres
    from safe_ompl.apps.exchange.mjcf import world_from_mjcf
    from safe_ompl.apps.exchange.moveit import scene_from_moveit, scene_from_octomap
    from safe_ompl.apps.exchange.ros_node import RosNode, ros_context

__all__ = [
    "Cell",
    "ControlOptions",
    "Frames",
    "LiveController",
    "McapLog",
    "RosNode",
    "in_metres",
    "messages",
    "read_joint_log",
    "read_log",
    "robot_from_curobo",
    "ros_context",
    "scene_from_curobo",
    "scene_from_moveit",
    "scene_from_octomap",
    "world_from_mjcf",
]

__getattr__, __dir__ = lazily(__name__, __file__)
