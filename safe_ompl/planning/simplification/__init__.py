"""Simplification of paths that minds danger; validation, and reports on paths."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.planning.simplification.cost import PathCost as PathCost
    from safe_ompl.planning.simplification.edges import ask_for_retreats as ask_for_retreats
    from safe_ompl.planning.simplification.measures import (
        PROFILE_POINTS as PROFILE_POINTS,
        ClearanceReport as ClearanceReport,
        Curve as Curve,
        DangerReport as DangerReport,
        forced_danger as forced_danger,
    )
    from safe_ompl.planning.simplification.report import (
        PathReport as PathReport,
        Validation as Validation,
        validate as validate,
    )
    from safe_ompl.planning.simplification.simplifier import Simplifier as Simplifier, Stop as Stop, timed as timed

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
