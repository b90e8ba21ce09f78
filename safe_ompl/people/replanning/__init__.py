"""Replanning beside people who move: what is driven is proven at every tick."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.people.replanning.guard import Command, Doing, Guard, ReplanningOptions, stop_as_dict
    from safe_ompl.people.replanning.guarded_path import PathLimits
    from safe_ompl.people.replanning.replanner import Replanner
    from safe_ompl.people.replanning.shield import Shield, ShieldCommand

__all__ = [
    "Command",
    "Doing",
    "Guard",
    "PathLimits",
    "Replanner",
    "ReplanningOptions",
    "Shield",
    "ShieldCommand",
    "stop_as_dict",
]

__getattr__, __dir__ = lazily(__name__, __file__)
