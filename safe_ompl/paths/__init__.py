"""Paths: what they must keep to, validation, reports, and danger-aware simplification."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.paths.constraints import ConfigurationCheck, Constraints, UserCheck
    from safe_ompl.paths.cost import PathCost
    from safe_ompl.paths.measures import PROFILE_POINTS, ClearanceReport, Curve, DangerReport, forced_danger
    from safe_ompl.paths.report import PathReport, Validation, claims_of, validate
    from safe_ompl.paths.simplifier import Simplifier, Stop, timed, unrolled

__all__ = [
    "PROFILE_POINTS",
    "ClearanceReport",
    "ConfigurationCheck",
    "Constraints",
    "Curve",
    "DangerReport",
    "PathCost",
    "PathReport",
    "Simplifier",
    "Stop",
    "UserCheck",
    "Validation",
    "claims_of",
    "forced_danger",
    "timed",
    "unrolled",
    "validate",
]

__getattr__, __dir__ = lazily(__name__, __file__)
