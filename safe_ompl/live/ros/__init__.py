"""ROS 2: a node that controls the robot, messages, trajectory actions, recordings, and logs for Foxglove.

Logs and recordings need the extra `safe-ompl[mcap]`. Nodes need ROS 2 and the extra `safe-ompl[ros]`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
