"""What OMPL is given: validity, motion validity, objectives, goals, and the bridge between states and arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.planning.ompl.goals import REGION_TOLERANCE as REGION_TOLERANCE
    from safe_ompl.planning.ompl.goals import TOLERANCE as TOLERANCE
    from safe_ompl.planning.ompl.goals import RegionGoal as RegionGoal
    from safe_ompl.planning.ompl.goals import WorkspaceGoal as WorkspaceGoal
    from safe_ompl.planning.ompl.objective import DangerObjective as DangerObjective
    from safe_ompl.planning.ompl.objective import DurationObjective as DurationObjective
    from safe_ompl.planning.ompl.objective import PeakDangerObjective as PeakDangerObjective
    from safe_ompl.planning.ompl.objective import StateCost as StateCost
    from safe_ompl.planning.ompl.states import ScratchState as ScratchState
    from safe_ompl.planning.ompl.states import StateBridge as StateBridge
    from safe_ompl.planning.ompl.states import joint_space as joint_space
    from safe_ompl.planning.ompl.user_checks import RESOLUTION as RESOLUTION
    from safe_ompl.planning.ompl.user_checks import AskedMotions as AskedMotions
    from safe_ompl.planning.ompl.user_checks import SampledValidity as SampledValidity
    from safe_ompl.planning.ompl.user_checks import UserCheck as UserCheck
    from safe_ompl.planning.ompl.validity import CertifiedMotionValidator as CertifiedMotionValidator
    from safe_ompl.planning.ompl.validity import CollisionFreeValidity as CollisionFreeValidity
    from safe_ompl.planning.ompl.validity import ConfigurationCheck as ConfigurationCheck
    from safe_ompl.planning.ompl.validity import Constraints as Constraints
    from safe_ompl.planning.ompl.validity import danger_objection as danger_objection

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
