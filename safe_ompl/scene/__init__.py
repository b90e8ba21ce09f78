"""Scenes and scenarios: obstacles, people, constraints, start and goal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.scene.constraints import BodyRegion, MotionLimits, MovingObstacles, People, ToolConstraint
    from safe_ompl.scene.mbm import WHERE_FROM, MbmFile, MbmProblem
    from safe_ompl.scene.program import Attach, Detach, Gripper, Line, Move, Program, Seam, Step, Wait
    from safe_ompl.scene.scenario import Goal, Scenario, configuration_for, find_scenario, list_scenarios
    from safe_ompl.scene.scene import CORE, Scene

__all__ = [
    "CORE",
    "WHERE_FROM",
    "Attach",
    "BodyRegion",
    "Detach",
    "Goal",
    "Gripper",
    "Line",
    "MbmFile",
    "MbmProblem",
    "MotionLimits",
    "Move",
    "MovingObstacles",
    "People",
    "Program",
    "Scenario",
    "Scene",
    "Seam",
    "Step",
    "ToolConstraint",
    "Wait",
    "configuration_for",
    "find_scenario",
    "list_scenarios",
]

__getattr__, __dir__ = lazily(__name__, __file__)
