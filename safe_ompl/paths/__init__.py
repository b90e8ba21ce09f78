"""Paths: what they must keep to, validation, reports, and danger-aware simplification."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.paths.constraints import (
        ConfigurationCheck as ConfigurationCheck,
        Constraints as Constraints,
        UserCheck as UserCheck,
    )
    from safe_ompl.paths.cost import PathCost as PathCost
    from safe_ompl.paths.edges import ask_for_retreats as ask_for_retreats
    from safe_ompl.paths.measures import (
        PROFILE_POINTS as PROFILE_POINTS,
        ClearanceReport as ClearanceReport,
        Curve as Curve,
        DangerReport as DangerReport,
        forced_danger as forced_danger,
        unrolled as unrolled,
    )
    from safe_ompl.paths.report import (
        PathReport as PathReport,
        Validation as Validation,
        claims_of as claims_of,
        validate as validate,
    )
    from safe_ompl.paths.simplifier import Simplifier as Simplifier, Stop as Stop, timed as timed

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
