"""Scenes and scenarios: obstacles, people, constraints, start and goal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.scene.constraints import MotionLimits as MotionLimits
    from safe_ompl.scene.constraints import MovingObstacles as MovingObstacles
    from safe_ompl.scene.constraints import ToolConstraint as ToolConstraint
    from safe_ompl.scene.mbm import WHERE_FROM as WHERE_FROM
    from safe_ompl.scene.mbm import MbmFile as MbmFile
    from safe_ompl.scene.mbm import MbmProblem as MbmProblem
    from safe_ompl.scene.people import BodyRegion as BodyRegion
    from safe_ompl.scene.people import People as People
    from safe_ompl.scene.scenario import Goal as Goal
    from safe_ompl.scene.scenario import Scenario as Scenario
    from safe_ompl.scene.scenario import find_scenario as find_scenario
    from safe_ompl.scene.scenario import list_scenarios as list_scenarios
    from safe_ompl.scene.scene import Scene as Scene

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
