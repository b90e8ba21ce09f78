"""Work: motions of the tool along curves, proven to stay in a corridor, and programs of many steps."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.tasks.corridor import (
        Corridor as Corridor,
        CorridorProof as CorridorProof,
        prove_corridor as prove_corridor,
    )
    from safe_ompl.tasks.program_result import ProgramResult as ProgramResult, Stretch as Stretch
    from safe_ompl.tasks.programs import (
        PROGRAM_TIME as PROGRAM_TIME,
        plan_program as plan_program,
        program_robot as program_robot,
    )
    from safe_ompl.tasks.tip import configurations_at as configurations_at
    from safe_ompl.tasks.tool_motions import (
        ToolMotion as ToolMotion,
        ToolPlanner as ToolPlanner,
        plan_tool as plan_tool,
        tool_motion as tool_motion,
    )
    from safe_ompl.tasks.tool_path import ToolPath as ToolPath

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
