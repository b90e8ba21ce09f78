"""Driving by ROS 2: a node, its messages, trajectories' actions, recordings, and logs for Foxglove.

Logs and recordings need the extra `safe-ompl[mcap]`, what starts a node ROS, too (`safe-ompl[ros]`).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
