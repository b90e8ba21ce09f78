from .goals import (
    REGION_TOLERANCE as REGION_TOLERANCE,
    TOLERANCE as TOLERANCE,
    RegionGoal as RegionGoal,
    WorkspaceGoal as WorkspaceGoal,
    states_of as states_of,
)
from .objective import DangerObjective as DangerObjective, FiniteCosts as FiniteCosts, StateCost as StateCost
from .validity import (
    RESOLUTION as RESOLUTION,
    CertifiedMotionValidator as CertifiedMotionValidator,
    CollisionFreeValidity as CollisionFreeValidity,
    SampledValidity as SampledValidity,
    bridge_of as bridge_of,
)
