"""Motions that something else made, as piecewise polynomials: checks of freedom and rates, tubes, repair."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.motions.checks import TIME, MotionCheck, check, check_with, objection, retime, way_of, widest_tube
    from safe_ompl.motions.motion import Motion
    from safe_ompl.motions.rates import Violation, rate_violations
    from safe_ompl.motions.repair import Repair, repair_with
    from safe_ompl.motions.tube import FACTOR, MeasuredTube, measured_tube, tube_of

__all__ = [
    "FACTOR",
    "TIME",
    "MeasuredTube",
    "Motion",
    "MotionCheck",
    "Repair",
    "Violation",
    "check",
    "check_with",
    "measured_tube",
    "objection",
    "rate_violations",
    "repair_with",
    "retime",
    "tube_of",
    "way_of",
    "widest_tube",
]

__getattr__, __dir__ = lazily(__name__, __file__)
