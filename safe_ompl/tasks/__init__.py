"""Work: motions of the tool along curves, proven to stay in a corridor."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.tasks.corridor import (
        Corridor as Corridor,
        CorridorProof as CorridorProof,
        prove_corridor as prove_corridor,
    )
    from safe_ompl.tasks.tip import configurations_at as configurations_at
    from safe_ompl.tasks.tool_motions import (
        ToolMotion as ToolMotion,
        ToolPlanner as ToolPlanner,
        tool_motion as tool_motion,
    )
    from safe_ompl.tasks.tool_path import ToolPath as ToolPath

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
