"""Registers the robot ``safe_ompl``: LeRobot imports packages of such names."""

from safe_ompl.apps.exchange.lerobot import SafeOmplChunks, SafeOmplRobot, SafeOmplRobotConfig

__all__ = ["SafeOmplChunks", "SafeOmplRobot", "SafeOmplRobotConfig"]
