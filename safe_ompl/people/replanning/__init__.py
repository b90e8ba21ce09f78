"""Replanning beside people who move: what is driven is proven at every tick."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.people.replanning.detours import Detours, PeopleNow, Roadmap
    from safe_ompl.people.replanning.guarded_path import (
        Command,
        Doing,
        GuardedPath,
        Margin,
        PathLimits,
        RobotBodies,
        StopMotion,
    )
    from safe_ompl.people.replanning.replanner import Replanner, ReplanningOptions
    from safe_ompl.people.replanning.shield import Shield, ShieldCommand

__all__ = [
    "Command",
    "Detours",
    "Doing",
    "GuardedPath",
    "Margin",
    "PathLimits",
    "PeopleNow",
    "Replanner",
    "ReplanningOptions",
    "Roadmap",
    "RobotBodies",
    "Shield",
    "ShieldCommand",
    "StopMotion",
]

__getattr__, __dir__ = lazily(__name__, __file__)
