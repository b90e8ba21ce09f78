from .constraints import (
    BodyRegion as BodyRegion,
    MotionLimits as MotionLimits,
    MovingObstacles as MovingObstacles,
    People as People,
    ToolConstraint as ToolConstraint,
)
from .mbm import MBM_FILES_ORIGIN as MBM_FILES_ORIGIN, MbmFile as MbmFile, MbmProblem as MbmProblem
from .program import (
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
from .scenario import (
    Goal as Goal,
    Scenario as Scenario,
    configuration_for as configuration_for,
    find_scenario as find_scenario,
    list_scenarios as list_scenarios,
)
from .scene import CORE as CORE, Scene as Scene
from .scene_text import read_scene_text as read_scene_text, written_cone as written_cone
