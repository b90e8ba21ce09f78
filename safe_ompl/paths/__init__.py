"""Paths: validation, reports, and danger-aware simplification."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.paths.measures import PROFILE_POINTS as PROFILE_POINTS
    from safe_ompl.paths.measures import ClearanceReport as ClearanceReport
    from safe_ompl.paths.measures import Curve as Curve
    from safe_ompl.paths.measures import DangerReport as DangerReport
    from safe_ompl.paths.measures import forced_danger as forced_danger
    from safe_ompl.paths.report import PathReport as PathReport
    from safe_ompl.paths.report import Validation as Validation
    from safe_ompl.paths.report import claims_of as claims_of
    from safe_ompl.paths.report import validate as validate
    from safe_ompl.paths.simplifier import Simplifier as Simplifier
    from safe_ompl.paths.simplifier import Stop as Stop
    from safe_ompl.paths.simplifier import simplify_danger as simplify_danger
    from safe_ompl.paths.simplifier import timed as timed
    from safe_ompl.paths.simplifier import unrolled as unrolled

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
