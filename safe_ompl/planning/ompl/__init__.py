"""What OMPL is given: validity, motion validity, objectives, goals, and the bridge between states and arrays."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.planning.ompl.goals import (
        REGION_TOLERANCE as REGION_TOLERANCE,
        TOLERANCE as TOLERANCE,
        RegionGoal as RegionGoal,
        WorkspaceGoal as WorkspaceGoal,
        states_of as states_of,
    )
    from safe_ompl.planning.ompl.objective import DangerObjective as DangerObjective, StateCost as StateCost
    from safe_ompl.planning.ompl.validity import (
        RESOLUTION as RESOLUTION,
        CertifiedMotionValidator as CertifiedMotionValidator,
        CollisionFreeValidity as CollisionFreeValidity,
        SampledValidity as SampledValidity,
        bridge_of as bridge_of,
    )

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
