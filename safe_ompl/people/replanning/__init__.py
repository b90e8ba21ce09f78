"""Replanning beside people who move: what is driven is proven at every tick."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.people.replanning.bodies import RobotBodies as RobotBodies
    from safe_ompl.people.replanning.detours import DetourRoadmap as DetourRoadmap
    from safe_ompl.people.replanning.detours import Detours as Detours
    from safe_ompl.people.replanning.detours import PeopleNow as PeopleNow
    from safe_ompl.people.replanning.guard import Command as Command
    from safe_ompl.people.replanning.guard import Doing as Doing
    from safe_ompl.people.replanning.guard import Guard as Guard
    from safe_ompl.people.replanning.guard import ReplanningOptions as ReplanningOptions
    from safe_ompl.people.replanning.guard import stop_as_dict as stop_as_dict
    from safe_ompl.people.replanning.guarded_path import Around as Around
    from safe_ompl.people.replanning.guarded_path import GuardedPath as GuardedPath
    from safe_ompl.people.replanning.guarded_path import MotionMargin as MotionMargin
    from safe_ompl.people.replanning.guarded_path import PathLimits as PathLimits
    from safe_ompl.people.replanning.guarded_path import StopMotion as StopMotion
    from safe_ompl.people.replanning.replanner import Replanner as Replanner
    from safe_ompl.people.replanning.shield import Shield as Shield
    from safe_ompl.people.replanning.shield import ShieldCommand as ShieldCommand

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
