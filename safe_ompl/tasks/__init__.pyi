from .corridor import Corridor as Corridor, CorridorProof as CorridorProof, prove_corridor as prove_corridor
from .program_result import ProgramResult as ProgramResult, Stretch as Stretch
from .programs import PROGRAM_TIME as PROGRAM_TIME, plan_program as plan_program, program_robot as program_robot
from .tool_motions import (
    ToolMotion as ToolMotion,
    ToolPlanner as ToolPlanner,
    plan_tool as plan_tool,
    tool_motion as tool_motion,
)
from .tool_path import ToolPath as ToolPath
