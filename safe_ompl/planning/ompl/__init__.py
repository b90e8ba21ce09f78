"""What OMPL is given: validity, motion validity, objectives, goals, and the bridge between states and arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.planning.ompl.goals import REGION_TOLERANCE, TOLERANCE, RegionGoal, WorkspaceGoal
    from safe_ompl.planning.ompl.objective import DangerObjective, StateCost
    from safe_ompl.planning.ompl.states import ScratchState, StateBridge, joint_space
    from safe_ompl.planning.ompl.validity import (
        RESOLUTION,
        CertifiedMotionValidator,
        CollisionFreeValidity,
        SampledValidity,
    )

__all__ = [
    "REGION_TOLERANCE",
    "RESOLUTION",
    "TOLERANCE",
    "CertifiedMotionValidator",
    "CollisionFreeValidity",
    "DangerObjective",
    "RegionGoal",
    "SampledValidity",
    "ScratchState",
    "StateBridge",
    "StateCost",
    "WorkspaceGoal",
    "joint_space",
]

__getattr__, __dir__ = lazily(__name__, __file__)
