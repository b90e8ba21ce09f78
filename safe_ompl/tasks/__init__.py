"""Work: motions of the tool along curves, proven to stay in a corridor."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.tasks.corridor import Corridor, CorridorProof, prove_corridor
    from safe_ompl.tasks.tip import configurations_at
    from safe_ompl.tasks.tool_motions import ToolMotion, ToolPlanner, tool_motion
    from safe_ompl.tasks.tool_path import ToolPath

__all__ = [
    "Corridor",
    "CorridorProof",
    "ToolMotion",
    "ToolPath",
    "ToolPlanner",
    "configurations_at",
    "prove_corridor",
    "tool_motion",
]

__getattr__, __dir__ = lazily(__name__, __file__)
