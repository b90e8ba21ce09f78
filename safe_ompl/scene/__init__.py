"""Scenes and scenarios: obstacles, people, constraints, start and goal."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.scene.constraints import (
        BodyRegion as BodyRegion,
        MotionLimits as MotionLimits,
        MovingObstacles as MovingObstacles,
        People as People,
        ToolConstraint as ToolConstraint,
    )
    from safe_ompl.scene.mbm import WHERE_FROM as WHERE_FROM, MbmFile as MbmFile, MbmProblem as MbmProblem
    from safe_ompl.scene.program import (
        CONTACT_DEPTH as CONTACT_DEPTH,
        Attach as Attach,
        Detach as Detach,
        Gripper as Gripper,
        Line as Line,
        Move as Move,
        Program as Program,
        Seam as Seam,
        Step as Step,
        Wait as Wait,
    )
    from safe_ompl.scene.scenario import (
        Goal as Goal,
        Scenario as Scenario,
        configuration_for as configuration_for,
        find_scenario as find_scenario,
        list_scenarios as list_scenarios,
    )
    from safe_ompl.scene.scene import CORE as CORE, Scene as Scene

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
