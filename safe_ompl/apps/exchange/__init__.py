"""What other programs read and write: logs that Foxglove opens (MCAP), and recordings of ROS 2 (MCAP, rosbag2).

It needs the extra `safe-ompl[mcap]`. Nothing of ROS is needed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.apps.exchange import messages
    from safe_ompl.apps.exchange.mcap_log import McapLog, read_log
    from safe_ompl.apps.exchange.recordings import PeopleSource, read_joint_log, read_people

__all__ = [
    "McapLog",
    "PeopleSource",
    "messages",
    "read_joint_log",
    "read_log",
    "read_people",
]

__getattr__, __dir__ = lazily(__name__, __file__)
