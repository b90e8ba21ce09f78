"""Replanning beside people who move: what is driven is proven at every tick."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.people.replanning.bodies import RobotBodies
    from safe_ompl.people.replanning.detours import DetourRoadmap, Detours, PeopleNow
    from safe_ompl.people.replanning.guard import Command, Doing, Guard, ReplanningOptions, stop_as_dict
    from safe_ompl.people.replanning.guarded_path import (
        Around,
        GuardedPath,
        MotionMargin,
        PathLimits,
        StopMotion,
    )
    from safe_ompl.people.replanning.replanner import Replanner
    from safe_ompl.people.replanning.shield import Shield, ShieldCommand

__all__ = [
    "Around",
    "Command",
    "DetourRoadmap",
    "Detours",
    "Doing",
    "Guard",
    "GuardedPath",
    "MotionMargin",
    "PathLimits",
    "PeopleNow",
    "Replanner",
    "ReplanningOptions",
    "RobotBodies",
    "Shield",
    "ShieldCommand",
    "StopMotion",
    "stop_as_dict",
]

__getattr__, __dir__ = lazily(__name__, __file__)
