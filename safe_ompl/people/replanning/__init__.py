"""Replanning beside people: at every tick a motion that is proven together with its stop."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from safe_ompl.people.replanning.command import Command, Doing, Margin, StopMotion
    from safe_ompl.people.replanning.detours import Detours
    from safe_ompl.people.replanning.guarded_path import GuardedPath, PathLimits, RobotBodies
    from safe_ompl.people.replanning.replanner import Replanner, ReplanningOptions
    from safe_ompl.people.replanning.roadmap import PeopleNow, Roadmap

_MODULES = {
    "Command": "command",
    "Detours": "detours",
    "Doing": "command",
    "GuardedPath": "guarded_path",
    "Margin": "command",
    "PathLimits": "guarded_path",
    "PeopleNow": "roadmap",
    "Replanner": "replanner",
    "ReplanningOptions": "replanner",
    "Roadmap": "roadmap",
    "RobotBodies": "guarded_path",
    "StopMotion": "command",
}

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
    "StopMotion",
]


def __getattr__(name: str) -> object:
    """Import a public name when it is first asked for, and keep it."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = found
    return found
