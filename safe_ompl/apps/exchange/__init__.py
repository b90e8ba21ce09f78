"""What other programs read and write: logs that Foxglove opens, recordings of ROS 2, and a node of ROS 2.

It needs the extra `safe-ompl[mcap]`. Only what starts a node needs ROS, too (`safe-ompl[ros]`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.apps.exchange import messages as messages
    from safe_ompl.apps.exchange.controller import Answer as Answer
    from safe_ompl.apps.exchange.controller import Cell as Cell
    from safe_ompl.apps.exchange.controller import ControlOptions as ControlOptions
    from safe_ompl.apps.exchange.controller import LiveController as LiveController
    from safe_ompl.apps.exchange.mcap_log import McapLog as McapLog
    from safe_ompl.apps.exchange.mcap_log import read_log as read_log
    from safe_ompl.apps.exchange.received import Frames as Frames
    from safe_ompl.apps.exchange.received import in_metres as in_metres
    from safe_ompl.apps.exchange.recordings import PeopleSource as PeopleSource
    from safe_ompl.apps.exchange.recordings import read_joint_log as read_joint_log
    from safe_ompl.apps.exchange.recordings import read_people as read_people
    from safe_ompl.apps.exchange.ros_node import NodeSetup as NodeSetup
    from safe_ompl.apps.exchange.ros_node import RosNode as RosNode
    from safe_ompl.apps.exchange.ros_node import TrajectoryAction as TrajectoryAction
    from safe_ompl.apps.exchange.ros_node import received_text as received_text
    from safe_ompl.apps.exchange.ros_node import ros_context as ros_context

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
